"""Base of polled serial devices: one request, one answer, stamped before and after.

A device may ask for other things between its samples (``_aside``). An answer may be incomplete: of several stations on
a line one is silent, and its channels lack that sample.

The value was sampled at some time between request and answer. SCALAR rows carry both stamps: ``tick`` is
CLOCK_MONOTONIC ns just before the request was written, ``host_ns`` when the last byte of the answer was read. The error
of their mean is at most half their difference, plus the device's filter delay.

A device makes a sample when it hears a request, which only a valid answer shows: a gap is counted where each of its
requests was refused. A request without an answer may have been lost on its way, or the device was off; bytes that make
no answer may be noise, or a late answer to another request: a gap with such a request is an estimate.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers.errors import ConfigurationError, FrameError
from drivers.records import SCALAR, Severity
from drivers.serial_line.device import MS, Channels, Clock, OpenPort, ReceivedBytes, SerialDevice

SETTLE_NS = 10 * MS  # silence required after invalid bytes
UNANSWERED_TO_TELL = 5
UNANSWERED_TO_REOPEN = 20
REFUSED = "refused"  # cause of a gap: the answer is valid, and has no value


class Value(NamedTuple):
    """One value of an answer: the fields of a SCALAR row."""

    channel: str
    value_raw: int
    scale: float
    unit: str
    device_status: int = 0
    status: int = 0


@dataclass
class _Channel:
    """What is not recorded of a channel yet: samples from ``following`` on, and why the first of them is missing."""

    following: int = 0
    last_ns: int | None = None
    cause: str = ""
    counted: bool = True


class PolledDevice(SerialDevice):
    """Sends requests and reads answers. Every request is a sample: an unanswered one is recorded as a gap.

    Args:
        name: Source of its events.
        open_port: Opens its port.
        clock: CLOCK_MONOTONIC, ns.
        poll_period_ms: Time between two pumps, ms; 0: the port waits.
        sample_period_ms: Time between two requests, ms; 0: as fast as the link allows.
        timeout_ms: Longest wait for an answer, ms.
        pause_ms: Silence between an answer and the next request, ms.

    Raises:
        ConfigurationError: A time is out of range.
    """

    def __init__(
        self,
        name: str,
        open_port: OpenPort,
        clock: Clock,
        poll_period_ms: float,
        sample_period_ms: float,
        timeout_ms: float,
        pause_ms: float,
    ) -> None:
        if timeout_ms <= 0.0 or min(sample_period_ms, pause_ms) < 0.0:
            raise ConfigurationError(f"{name}: timeout_ms is more than 0, sample_period_ms 0 or more: correct them")
        super().__init__(name, open_port, clock, poll_period_ms, timeout_ms)
        self._sample_period_ns = round(sample_period_ms * 1e6)
        self._timeout_ns = round(timeout_ms * 1e6)
        self._pause_ns = round(pause_ms * 1e6)
        self._settle_ns = max(self._pause_ns, SETTLE_NS)
        self._asked_ns: int | None = None  # stamp of the open request
        self._due_ns = 0  # of the next request by the sample period
        self._earliest_ns = 0  # of the next request by the required silence
        self._deadline_ns = 0  # of the answer
        self._next = 0  # sequence of the next row, if none is lost before it
        self._unanswered = 0  # requests since the last answer
        self._cause = ""  # of the first of them
        self._are_heard = True  # by a device that refused each of them
        self._last_ns: int | None = None  # of the last answer
        self._was_down = False  # the port was closed since the last answer
        self._is_aside = False  # the open request is no sample
        self._untold = {channel: _Channel() for channel in self._value_channels()}

    @property
    def channels(self) -> Channels:
        """See ``SerialDevice``."""
        return dict.fromkeys(self._value_channels(), SCALAR)

    @abstractmethod
    def _value_channels(self) -> tuple[str, ...]:
        """Channels of its values."""

    @abstractmethod
    def _question(self, retry: bool) -> bytes:
        """The next request. ``retry``: the last one was not answered, and its answer may still arrive."""

    @abstractmethod
    def _missing(self) -> int:
        """Number of bytes the answer still lacks, at least 1."""

    @abstractmethod
    def _answer(self, host_ns: int, data: bytes) -> list[Value] | None:
        """Take answer bytes: returns values (none, with an event, if the device refused), or None for need more data.

        Raises:
            FrameError: The bytes are not the answer.
        """

    def _aside(self, now_ns: int) -> bytes:
        """A request that is no sample, to be sent now; empty for none. ``_answer`` gets what comes."""
        del now_ns
        return b""

    def _given_up(self, now_ns: int, cause: str) -> tuple[int, list[Value]]:
        """The open request is not answered in time, or by bad bytes: what came of it before, and when."""
        del cause
        return now_ns, []

    def _opened(self, now_ns: int) -> None:
        self._asked_ns = None
        self._earliest_ns = self._due_ns = now_ns

    def _closed(self, now_ns: int) -> None:
        self._lose("port_lost")
        self._was_down = True

    def _wanted(self) -> int:
        return 0 if self._asked_ns is None else self._missing()

    def _act(self, now_ns: int) -> bool:
        if self._asked_ns is not None:
            if now_ns < self._deadline_ns:
                return False
            is_sample = not self._is_aside
            if not self._give_up(now_ns, "no_answer") and is_sample:
                if self._unanswered == UNANSWERED_TO_TELL:
                    text = (
                        f"{UNANSWERED_TO_TELL} requests without an answer: check power, address, baud rate and wiring"
                    )
                    self._report.event(now_ns, Severity.ERROR, "no_answer", text)
                if self._unanswered % UNANSWERED_TO_REOPEN == 0:
                    text = f"{UNANSWERED_TO_REOPEN} requests without an answer ({self._last_error}): port is reopened"
                    self._link.drop(now_ns, "silent", text)
                    return False
        if now_ns < self._earliest_ns:
            return False
        aside = self._aside(now_ns)
        if not aside and now_ns < self._due_ns:
            return False
        before_ns = self._link.write(now_ns, aside or self._question(retry=self._unanswered > 0))
        if before_ns is None:
            return False
        self._asked_ns, self._deadline_ns = before_ns, before_ns + self._timeout_ns
        self._is_aside = bool(aside)
        if not aside:
            self._due_ns = max(self._due_ns + self._sample_period_ns, now_ns)
        self._broken = False
        return True

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        if self._asked_ns is None:
            if not self._broken:
                error = FrameError(f"{len(chunk.data)} bytes without a request: is another master on the line?")
                self._bad_frame(chunk.host_ns, error)
            self._earliest_ns = chunk.host_ns + self._settle_ns
            return
        try:
            values = self._answer(chunk.host_ns, chunk.data)
        except FrameError as error:
            self._bad_frame(chunk.host_ns, error)
            self._give_up(chunk.host_ns, "bad_frame")
            self._earliest_ns = chunk.host_ns + self._settle_ns
            return
        if values is None:
            return
        self._earliest_ns = chunk.host_ns + self._pause_ns
        self._broken = False
        self._heard(now_ns)
        if self._is_aside:
            self._asked_ns = None
        elif values:
            self._append(chunk.host_ns, values)
        else:
            self._lose(REFUSED)

    def _append(self, host_ns: int, values: list[Value], cause: str = "no_answer") -> None:
        """Record the answer to the open request; channels without a value lack it for ``cause``."""
        if self._last_ns is None:
            self._report.event(host_ns, Severity.INFO, "started", "it answers")
        self._count_lost(host_ns)
        for value in values:
            self._name_gap(host_ns, value.channel)
            rows = np.zeros(1, SCALAR)
            number = value.value_raw, value.scale, value.unit
            rows[0] = (self._next, host_ns, self._asked_ns, *number, 0, value.device_status, value.status)
            self._report.rows(value.channel, rows)
            self._untold[value.channel] = _Channel(self._next + 1, host_ns)
        self._next += 1
        for untold in self._untold.values():
            if untold.following < self._next:
                untold.cause = untold.cause or cause
                untold.counted &= cause == REFUSED
        self._last_ns, self._asked_ns = host_ns, None

    def _give_up(self, now_ns: int, cause: str) -> bool:
        """Give up the open request; whether a part of its answer had come, which is recorded."""
        stamp_ns, values = self._given_up(now_ns, cause)
        if values:
            self._append(stamp_ns, values, cause)
        else:
            self._lose(cause)
        return bool(values)

    def _lose(self, cause: str) -> None:
        """Give up the open request, if any."""
        if self._asked_ns is not None and not self._is_aside:
            self._unanswered += 1
            self._cause = self._cause or cause
            self._are_heard &= cause == REFUSED
        self._asked_ns = None

    def _count_lost(self, now_ns: int) -> None:
        """Number unanswered and unsent requests (without a period: at least one)."""
        lost, counted = self._unanswered, self._are_heard and not self._was_down
        if self._was_down and self._last_ns is not None:
            period_ns = self._sample_period_ns
            lost = max(lost, round((now_ns - self._last_ns) / period_ns) - 1 if period_ns else 1)
        if lost:
            self._next += lost
            for untold in self._untold.values():
                untold.cause = untold.cause or self._cause or "port_lost"
                untold.counted = untold.counted and counted
        self._unanswered, self._cause, self._are_heard, self._was_down = 0, "", True, False

    def _name_gap(self, now_ns: int, channel: str) -> None:
        """Record as a gap what a channel lacks."""
        lacks = self._untold[channel]
        if lacks.following < self._next:
            elapsed_ns = 0 if lacks.last_ns is None else now_ns - lacks.last_ns
            its = channel, lacks.following, self._next - 1, elapsed_ns, lacks.cause
            self._report.gap(now_ns, *its, counted=lacks.counted)
            self._untold[channel] = _Channel(self._next, lacks.last_ns)

    def _finish(self, now_ns: int) -> None:
        self._lose("stopped")
        self._count_lost(now_ns)
        for channel in self._value_channels():
            self._name_gap(now_ns, channel)
