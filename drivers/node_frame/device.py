"""Custom sensor node device: frames in, one SCALAR channel per node channel and MARK rows out."""

from collections import deque
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import FrameError, WrongDeviceError
from drivers.marks import MARK
from drivers.node_frame import frame
from drivers.node_frame.counters import TURN, FrameTicks, NodeCounters
from drivers.records import SCALAR, SampleStatus, Severity
from drivers.serial_line.device import Channels, Clock, OpenPort, ReceivedBytes, SerialDevice
from drivers.unwrap import unwrapped

MOST_HELD = 4096  # data frames held until the first descriptor
LONGEST_FRAME_NS = 60e9  # longest interval between two frames accepted from the node's clock
LONGEST_GAP_NS = 1 << 62
NODE_NOT_VALID, NODE_SATURATED = 1, 2  # bits of the node's status byte; the others are node-specific
_SEQUENCE_AT = slice(4, 8)


class _Known(NamedTuple):
    """Last descriptor of the node and the derived layout of its data frames."""

    descriptor: frame.Descriptor
    counters: NodeCounters
    prefix: bytes
    dtype: np.dtype[np.void]
    units: list[bytes]  # of its channels

    def is_data(self, payload: bytes) -> bool:
        """Whether the payload is a data frame of this node and schema."""
        return payload.startswith(self.prefix) and len(payload) == self.dtype.itemsize

    def are_data(self, payloads: list[bytes]) -> bool:
        """Whether all payloads are data frames of this node and schema."""
        prefix, size = self.prefix, self.dtype.itemsize
        return all([payload.startswith(prefix) and len(payload) == size for payload in payloads])  # noqa: C419 - faster


class NodeFrame(SerialDevice):
    """A node, as SCALAR rows on ``NAME_CHANNEL`` for each of its channels and MARK rows on ``NAME_mark``.

    ``tick`` is the node's clock, 64 bits; ``device_status`` its status byte. Lost frames are counted by their sequence.
    Data frames before the first descriptor are held until it arrives. A mark carries the node's pulse number.

    Args:
        name: First part of its channels, and source of its events.
        open_port: Opens its serial port.
        clock: CLOCK_MONOTONIC, ns.
        config: Node number and channels.
    """

    def __init__(self, name: str, open_port: OpenPort, clock: Clock, config: frame.NodeFrameConfig) -> None:
        self.config = config
        super().__init__(name, open_port, clock, config.poll_period_ms, config.silence_ms)
        self._names = [f"{name}_{channel}" for channel in config.channels]
        self._frames = frame.FrameStream()
        self._known: _Known | None = None
        self._held: deque[tuple[int, bytes]] = deque()
        self._before_held: int | None = None  # sequence before the first held frame, if frames were dropped
        self._next = 0  # sequence of the next row, if none is lost before it
        self._marks = 0
        self._pulse = 0
        self._values: list[tuple[int, int] | None] = []  # raw and unwrapped value of each channel
        self._after_reset = False
        self._last_ns: int | None = None
        self._frame_ns = 0.0  # between two frames
        self._named = 0  # lost rows already recorded at a stop

    @property
    def channels(self) -> Channels:
        """See ``SerialDevice``."""
        dtypes: dict[str, np.dtype[Any]] = dict.fromkeys(self._names, SCALAR)
        return dtypes | {f"{self.name}_mark": MARK}

    def _opened(self, now_ns: int) -> None:
        self._frames.clear()

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        for payloads in self._frames_in(chunk, self._frames):
            self._broken = False
            known = self._known
            if known is not None and known.are_data(payloads):
                self._heard(now_ns)
                self._data(chunk.host_ns, known, payloads)
                continue
            for is_data, group in groupby(payloads, self._is_data):
                if is_data and self._known is not None:
                    self._heard(now_ns)
                    self._data(chunk.host_ns, self._known, list(group))
                else:
                    for payload in group:
                        self._other(now_ns, chunk.host_ns, payload)

    def _is_data(self, payload: bytes) -> bool:
        return self._known is not None and self._known.is_data(payload)

    def _other(self, now_ns: int, host_ns: int, payload: bytes) -> None:
        """Handle any frame but a data frame of the known schema."""
        kind, node = payload[:2]
        if kind not in {frame.DATA, frame.DESCRIPTOR}:
            text = f"frame of kind {kind:#04x}: the node speaks another version of the format"
            self._report.event(host_ns, Severity.ERROR, "version", text)
        elif node != self.config.node:
            text = f"frame of node {node}, not {self.config.node}: correct the configuration, a single node per port"
            self._report.event(host_ns, Severity.WARNING, "other_node", text)
        elif kind == frame.DESCRIPTOR:
            self._heard(now_ns)
            self._describe(host_ns, payload)
        else:
            self._heard(now_ns)
            self._hold(host_ns, payload)

    def _hold(self, host_ns: int, payload: bytes) -> None:
        if len(self._held) == MOST_HELD:
            _, dropped = self._held.popleft()
            text = "data frames without a descriptor are dropped: the node has to send it every second"
            self._report.event(host_ns, Severity.ERROR, "no_descriptor", text)
            if self._before_held is None:
                self._before_held = int.from_bytes(dropped[_SEQUENCE_AT], "little") - 1
        self._held.append((host_ns, payload))

    def _describe(self, host_ns: int, payload: bytes) -> None:
        try:
            told = frame.decode_descriptor(payload)
            self._check(told)
        except (FrameError, WrongDeviceError) as error:
            code = "wrong_device" if isinstance(error, WrongDeviceError) else "bad_descriptor"
            self._report.event(host_ns, Severity.ERROR, code, str(error))
            return
        if self._known is None:
            self._adopt(host_ns, told, rebooted=False)
            return
        before = self._known.descriptor
        another = (told.schema, told.boot) != (before.schema, before.boot)
        if another or self._known.counters.is_past(told.sequence):
            self._adopt(host_ns, told, rebooted=True)

    def _check(self, told: frame.Descriptor) -> None:
        names = tuple(channel.name for channel in told.channels)
        if names != self.config.channels:
            raise WrongDeviceError(
                f"node {told.node} has channels {', '.join(names)}, not {', '.join(self.config.channels)}: "
                "flash the right firmware, or correct the configuration"
            )

    def _adopt(self, host_ns: int, told: frame.Descriptor, *, rebooted: bool) -> None:
        """Use a descriptor (the first one, or one after a restart of the node) for the frames that follow."""
        held, self._held = self._held, deque()
        first_ns = held[0][0] if held else host_ns
        tick = told.tick - round((host_ns - first_ns) * 1e-9 * told.tick_hz)
        began_with_us = tick / told.tick_hz <= 1e-9 * (first_ns - self._started_ns)  # its first frames were for us
        before = -1 if rebooted or (began_with_us and self._before_held is None) else self._before_held
        counters = NodeCounters(told.tick_hz, max(0, tick), first_ns, before)
        prefix = bytes([frame.DATA, told.node]) + told.schema.to_bytes(2, "little")
        units = [channel.unit.encode() for channel in told.channels]
        self._known = known = _Known(told, counters, prefix, frame.payload_dtype(told.channels), units)
        self._pulse = 0
        self._before_held = None
        self._after_reset |= rebooted
        self._values = [None] * len(told.channels)
        listed = ", ".join(f"{channel.name} [{channel.unit}]" for channel in told.channels)
        what = "restarted" if rebooted else "describes itself"
        severity = Severity.WARNING if rebooted else Severity.INFO
        self._report.event(host_ns, severity, "node_reset" if rebooted else "described", f"node {what}: {listed}")
        for stamp_ns, group in groupby(held, lambda pair: pair[0]):
            payloads = [payload for _, payload in group]
            run = [payload for payload in payloads if known.is_data(payload)]
            if len(run) < len(payloads):
                text = f"{len(payloads) - len(run)} data frames are of no schema that was described: they are dropped"
                self._report.event(host_ns, Severity.ERROR, "unknown_schema", text)
            if run:
                self._data(stamp_ns, known, run)

    def _data(self, host_ns: int, known: _Known, payloads: list[bytes]) -> None:
        """Decode data frames of the known schema that arrived together."""
        frames = np.frombuffer(b"".join(payloads), known.dtype)
        first = self._last_ns is None
        placed = known.counters.place(frames["sequence"], frames["tick"], host_ns)
        numbers = self._number(host_ns, placed, known.descriptor.tick_hz)
        rows = np.zeros(len(frames), SCALAR)
        rows["sequence"] = numbers
        rows["host_ns"] = host_ns
        rows["tick"] = placed.ticks if placed.whole else np.maximum(placed.ticks, 0)
        reset = None
        if self._after_reset or not placed.whole:
            reset = placed.rebooted | placed.jumped
            reset[0] |= self._after_reset
            reset[0] &= not first
            rows["status"] = reset * np.uint8(SampleStatus.AFTER_RESET)
            self._after_reset = False
            self._tell(host_ns, placed)
        status = frames["status"]
        if any(status.tolist()):
            rows["device_status"] = status
            rows["status"] |= (status & NODE_NOT_VALID != 0) * np.uint8(SampleStatus.NOT_VALID)
            rows["status"] |= (status & NODE_SATURATED != 0) * np.uint8(SampleStatus.SATURATED)
        for place, (name, channel) in enumerate(zip(self._names, known.descriptor.channels, strict=True)):
            if place:
                rows = rows.copy()
            words = frames[f"value_{place}"]
            rows["value_raw"] = self._unwrapped(place, words, reset) if channel.wraps else words
            rows["scale"] = channel.scale
            rows["unit"] = known.units[place]
            self._report.rows(name, rows)
        if frames["pulse"][-1] != self._pulse or not placed.whole:
            self._hand_over_marks(host_ns, frames, placed)
        self._last_ns = host_ns

    def _number(self, host_ns: int, placed: FrameTicks, tick_hz: int) -> NDArray[np.int64]:
        """Sequence numbers of the rows, after recording lost ones."""
        ticks = placed.ticks
        if placed.whole:
            first = self._next
            self._next += len(ticks)
            if len(ticks) > 1:
                between_ns = (int(ticks[-1]) - int(ticks[0])) * 1e9 / tick_hz
                self._frame_ns = min(between_ns / (len(ticks) - 1), LONGEST_FRAME_NS)
            self._named = 0
            return np.arange(first, self._next)
        lost = placed.lost
        is_named_before = self._named > 0
        if is_named_before:
            lost[0] = max(0, lost[0] - self._named)
            self._named = 0
        numbers = self._next + np.cumsum(lost) + np.arange(len(lost))
        since = np.diff(placed.ticks)
        plain = (placed.lost[1:] == 0) & ~placed.jumped[1:] & ~placed.rebooted[1:] & (since > 0)
        if plain.any():
            self._frame_ns = min(float(np.median(since[plain])) * 1e9 / tick_hz, LONGEST_FRAME_NS)
        for place in np.flatnonzero(lost):
            count, last = int(lost[place]), int(numbers[place]) - 1
            cause = "node_reset" if placed.rebooted[place] else "frames_lost"
            counted = cause == "frames_lost" and not is_named_before
            for channel in self._names:
                duration_ns = min(round(count * self._frame_ns), LONGEST_GAP_NS)
                self._report.gap(host_ns, channel, last - count + 1, last, duration_ns, cause, counted=counted)
        self._next = int(numbers[-1]) + 1
        return numbers

    def _tell(self, host_ns: int, placed: FrameTicks) -> None:
        if placed.rebooted.any():
            text = "frame sequence restarted: the node was reset, check its supply"
            self._report.event(host_ns, Severity.WARNING, "node_reset", text)
        if placed.jumped.any():
            text = "the node's clock jumped and the host's did not: check its crystal and timer code"
            self._report.event(host_ns, Severity.WARNING, "clock_jump", text)

    def _unwrapped(self, place: int, words: NDArray[np.integer], reset: NDArray[np.bool_] | None) -> NDArray[np.int64]:
        """Unwrapped values of a counter channel; after a reset it restarts from the value then read."""
        word, value = self._values[place] or (int(words[0]), int(words[0]))
        values = unwrapped(words, 8 * words.dtype.itemsize, word, value)
        for at in () if reset is None else np.flatnonzero(reset):
            values[at:] += int(words[at]) - values[at]
        self._values[place] = int(words[-1]), int(values[-1])
        return values

    def _hand_over_marks(self, host_ns: int, frames: NDArray[np.void], placed: FrameTicks) -> None:
        pulses = frames["pulse"]
        before = np.where(placed.rebooted, 0, np.concatenate([[self._pulse], pulses[:-1]]))
        at = np.flatnonzero((pulses != before) & (pulses != 0))
        self._pulse = int(pulses[-1])
        if len(at):
            since = (frames["tick"][at].astype(np.int64) - frames["pulse_tick"][at]) % TURN
            rows = np.zeros(len(at), MARK)
            rows["sequence"] = self._marks + np.arange(len(at))
            rows["host_ns"] = host_ns
            rows["tick"] = np.maximum(placed.ticks[at] - since, 0)
            rows["pulse"] = pulses[at]
            self._report.rows(f"{self.name}_mark", rows)
            self._marks += len(at)

    def _finish(self, now_ns: int) -> None:
        if self._held:
            text = f"{len(self._held)} data frames without a descriptor are dropped: the node has to send it"
            self._report.event(now_ns, Severity.ERROR, "no_descriptor", text)
            self._held.clear()
        if self._last_ns is None or self._frame_ns == 0.0:
            return
        silent_ns = now_ns - self._last_ns
        lost = round(silent_ns / self._frame_ns)
        if lost and self._misses_its_end(silent_ns, self._frame_ns):
            for channel in self._names:
                self._report.gap(now_ns, channel, self._next, self._next + lost - 1, silent_ns, "silent")
            self._next += lost
            self._named += lost
