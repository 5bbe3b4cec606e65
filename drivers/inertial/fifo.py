"""Reads samples from the chip's FIFO: drained once per poll, restarted after an overflow or a slipped packet."""

import errno
from abc import ABC, abstractmethod

from drivers.i2c.bus import NOT_ACKNOWLEDGED, explain
from drivers.inertial.packet import PACKET_BYTES, Sampling, WordOrder, decode_words, first_misaligned
from drivers.inertial.sample_clock import Onset
from drivers.inertial.stream import SampleStream
from drivers.ports import I2cReply
from drivers.records import Severity
from drivers.reporter import Reporter

MOST_STARTS = 3  # restarts in a row if it overflows before the first count
FASTEST = 0.8  # nominal sample periods: below the shortest period of any chip
MOST_COUNTS = 12  # count reads after a restart, until its time is known to a third of a sample


class Fifo(ABC):
    """Samples from the FIFO of a configured chip, whose registers the class of the chip has.

    Args:
        config: How the chip was set up.
        stream: Numbers its samples.
        report: Where events go.

    Attributes:
        running: Samples are counted.
    """

    order: WordOrder
    largest_count: int | None = None  # that it can show, where that is more than its size

    def __init__(self, config: Sampling, stream: SampleStream, report: Reporter) -> None:
        self.running = False
        self._config = config
        self._stream = stream
        self._report = report
        self._temperature: int | None = None

    @property
    @abstractmethod
    def fifo_bytes(self) -> int:
        """Its size."""

    @abstractmethod
    def silence(self) -> None:
        """Let no more samples into it. Raises OSError."""

    @abstractmethod
    def _clear(self) -> int:
        """Stop and clear it, its overflow flag too; the stamp of the last transfer. Raises OSError."""

    @abstractmethod
    def _open(self) -> None:
        """Let samples into it from now on. Raises OSError."""

    @abstractmethod
    def _queued(self) -> I2cReply:
        """Its count, two bytes, high one first. Raises OSError."""

    @abstractmethod
    def _read(self, count: int) -> I2cReply:
        """Take so many bytes out of it. Raises OSError."""

    @abstractmethod
    def _has_run_over(self) -> bool:
        """Its overflow flag, which is cleared. Raises OSError."""

    @property
    def period_ns(self) -> int:
        """Time between two drains: as configured, or until the chip's FIFO is half full."""
        return min(round(self._config.poll_period_ms * 1e6), self._full_ns // 2)

    @property
    def rests_ns(self) -> int:
        """How long samples may wait in the chip where nothing delays the next drain."""
        return self._full_ns * 3 // 4

    @property
    def _full_ns(self) -> int:
        return self.fifo_bytes // PACKET_BYTES * self._config.sample_period_ns

    def restart(self, now_ns: int, at_least: int = 0) -> None:
        """Clear and start the FIFO; record the samples lost by the clock, ``at_least`` as many. Raises OSError."""
        self.running = False
        self._temperature = None
        stream, clock = self._stream, self._stream.clock
        for _ in range(MOST_STARTS):
            onset, overrun = self._begin()
            if not overrun:
                break
        if clock:
            first = max(clock.number_after(onset), stream.next + at_least)
            clock.gap(first - stream.next)
            stream.lose(now_ns, first)
            if stream.after_reset:
                clock.forget_phase()
        for before_ns, host_ns, queued in onset.reads:
            clock.observe(host_ns, stream.next + queued, before_ns)
        self.running = True

    def take(self, now_ns: int) -> bool:
        """Drain the FIFO; False if it was empty. Raises OSError."""
        reply = self._queued()
        count = int.from_bytes(reply.data)
        samples, part = divmod(min(count, self.fifo_bytes), PACKET_BYTES)
        if part or self._is_over(count):
            self._count_again(count, now_ns)
        if self._is_over(count):
            self._overflow(now_ns, samples + (part > 0), count)  # the rest of a partial packet was overwritten
            return True
        if part:
            self._discard(now_ns, "misaligned", samples, f"FIFO holds {count} bytes, no whole packets: it was reset")
            return True
        self._stream.cause = ""
        if not samples:
            return False
        data, broke_off, popped_ns = self._pop(samples * PACKET_BYTES)
        if broke_off is None and self._most(count, popped_ns - now_ns) > self.fifo_bytes:
            try:  # so late that it may have overflowed after the count
                if self._has_run_over():
                    self._overflow(now_ns, samples + 1, count)
                    return True
            except OSError as error:
                broke_off = error
        rows = decode_words(data, self.order, self._config)
        slip = first_misaligned(rows["temperature_raw"], self._temperature)
        if slip is None:
            self._stream.clock.observe(reply.host_ns, self._stream.next + samples, min(now_ns, reply.host_ns))
        rows = rows[:slip]
        good = self._stream.hand_over(rows, reply.host_ns)
        if good:
            self._temperature = int(rows["temperature_raw"][-1])
        if slip is not None:
            self._discard(now_ns, "misaligned", samples - good, "temperature word jumped: the FIFO was reset")
        elif broke_off is not None and broke_off.errno in NOT_ACKNOWLEDGED:
            raise broke_off  # the rest is still in the FIFO
        elif broke_off is not None:
            self._discard(now_ns, "bus_error", samples - good, f"FIFO read broke off {explain(broke_off)}")
        return True

    def _begin(self) -> tuple[Onset, bool]:
        """Clear and start the FIFO; read its count until the instant of the start is bounded (a stamp may be late).

        Returns:
            Bounds of the start, and whether the FIFO has overflowed meanwhile.
        """
        stopped_ns = self._clear()
        self._open()
        clock = self._stream.clock
        onset = Onset(stopped_ns, clock.period_ns())
        for _ in range(MOST_COUNTS):
            reply = self._queued()
            count = int.from_bytes(reply.data)
            overrun = self._is_over(count)
            self._check_growth(0, count, reply.host_ns - stopped_ns)
            if not (overrun and onset.reads):
                onset.observe(reply.host_ns, min(count, self.fifo_bytes) // PACKET_BYTES)
            if overrun or onset.settled or not clock:
                break
        return onset, overrun

    def _count_again(self, count: int, before_ns: int) -> None:
        """Read the count a second time before acting on a slip or overflow. Raises OSError."""
        reply = self._queued()
        self._check_growth(count, int.from_bytes(reply.data), reply.host_ns - before_ns)

    def _check_growth(self, before: int, count: int, elapsed_ns: int) -> None:
        """Reject a count that falls or grows faster than samples are made.

        Raises:
            OSError: EBADMSG, the count is impossible.
        """
        if not before <= count <= min(self._most(before, elapsed_ns), self.largest_count or self.fifo_bytes):
            raise OSError(errno.EBADMSG, f"FIFO counts {before} bytes, then {count}")

    def _most(self, before: int, elapsed_ns: int) -> int:
        """Bytes that it may have come to hold since there were so many."""
        return before + PACKET_BYTES * (2 + int(elapsed_ns / (FASTEST * self._config.sample_period_ns)))

    def _is_over(self, count: int) -> bool:
        return count > self.fifo_bytes - PACKET_BYTES

    def _pop(self, left: int) -> tuple[bytes, OSError | None, int]:
        """Read ``left`` bytes in transfers of whole packets: the bytes, the error that ended it, the last one's end."""
        longest = self._config.max_transfer_bytes // PACKET_BYTES * PACKET_BYTES
        data, host_ns = b"", 0
        while left:
            size = min(left, longest)
            try:
                piece, host_ns = self._read(size)
            except OSError as error:
                return data, error, host_ns
            data, left = data + piece, left - size
        return data, None, host_ns

    def _overflow(self, now_ns: int, at_least: int, count: int) -> None:
        text = f"FIFO ran over, {count} bytes counted: it was reset; pump more often"
        self._discard(now_ns, "fifo_overflow", at_least, text)

    def _discard(self, now_ns: int, cause: str, at_least: int, text: str) -> None:
        """Discard its content (``at_least`` samples are lost) and restart it."""
        self._stream.cause = self._stream.cause or cause
        self._report.event(now_ns, Severity.WARNING, cause, text)
        self.restart(now_ns, at_least)
