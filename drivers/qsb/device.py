"""QSB device: set-up by echoed commands, position rows and sync marks from its streams."""

from collections import deque
from collections.abc import Iterable
from math import tau

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, NoAnswerError
from drivers.marks import MARK
from drivers.position import Position
from drivers.qsb import registers as reg
from drivers.qsb.counter import TURN, TickCounter
from drivers.qsb.edges import SyncEdges
from drivers.qsb.line import GREETING, Lines, LineStream
from drivers.qsb.registers import Command, QsbConfig, greeting_commands, setup_commands
from drivers.records import SCALAR, SampleStatus, Severity
from drivers.serial_line.device import MS, Channels, Clock, OpenPort, ReceivedBytes, SerialDevice
from drivers.unwrap import unwrapped

TRIES = 3
OPTIONAL_REPLY_NS = 50 * MS
LONGEST_REST_NS = 100 * MS  # 13 lines or so at 128 a second, of the 4096 bytes that a port holds
MARKED = 32  # edges of the pulse line: from then on the times of its lines hang on no arrival
_STREAM, _REFUSED, _UNSUPPORTED = b"sex"


class Qsb(SerialDevice):
    """A QSB, as SCALAR rows on the channel of its name and MARK rows on ``NAME_mark``.

    ``tick`` is the adapter's timestamp, unwrapped; ``value_raw`` the count, unwrapped; ``scale`` rad. Lost lines are
    counted by the timestamp. A line has no checksum: an impossible step of the count is NOT_VALID. After a reset
    ``value_raw`` restarts from the counter's content and the row is marked AFTER_RESET; samples lost to the reset are
    estimated from host time. A mark's ``value_raw`` is the count latched on the edge.

    Args:
        name: Channel, and source of its events.
        open_port: Opens its serial port.
        clock: CLOCK_MONOTONIC, ns.
        config: Resolution, rate, sync edge.
    """

    def __init__(self, name: str, open_port: OpenPort, clock: Clock, config: QsbConfig | None = None) -> None:
        self.config = QsbConfig() if config is None else config
        super().__init__(name, open_port, clock, self.config.poll_period_ms, self.config.silence_ms)
        self._scale = tau / self.config.counts_per_revolution
        self._interval, self._jitter = self.config.interval_ticks, self.config.tick_jitter
        self._position = Position(self.config.counts_per_revolution)
        self._lines = LineStream()
        self._ticks = TickCounter()
        self._edges = SyncEdges(self.config.sync_edge != "falling")
        self._todo: deque[Command] = deque()
        self._deadline_ns: int | None = None  # of the reply to the first command; None: not yet sent
        self._tries = 0
        self._after_reset = False
        self._cause = ""  # cause of a possible gap before the next line
        self._next = 0  # sequence of the next position row, if none is lost before it
        self._marks = 0
        self._last_tick = 0  # of the last position row
        self._last_ns: int | None = None  # its arrival
        self._count = 0  # modulo 2^32, of the last position row
        self._value = 0  # unwrapped
        self._named = 0  # lost rows already recorded at a stop

    @property
    def channels(self) -> Channels:
        """See ``SerialDevice``."""
        return {self.name: SCALAR, f"{self.name}_mark": MARK}

    # Setting up

    def _opened(self, now_ns: int) -> None:
        self._lines.clear()
        self._set_up("port_lost" if self._last_ns is not None else "")

    def _set_up(self, cause: str) -> None:
        self._cause = self._cause or cause
        self._command(greeting_commands())

    def _command(self, commands: Iterable[Command]) -> None:
        self._todo = deque(commands)
        self._deadline_ns = None
        self._tries = 0

    def _act(self, now_ns: int) -> bool:
        if not self._todo:
            if now_ns - self._heard_ns > self._silence_ns:
                text = f"no position line for {self._silence_ns // MS} ms ({self._last_error}): it is set up again"
                self._report.event(now_ns, Severity.WARNING, "silent", text)
                self._heard_ns = now_ns
                self._set_up("silent")
            return bool(self._todo)
        command = self._todo[0]
        if self._deadline_ns is None:
            reply_ns = round(self.config.reply_timeout_ms * 1e6) if command.compulsory else OPTIONAL_REPLY_NS
            self._tries += 1
            self._deadline_ns = now_ns + reply_ns
            return self._link.write(now_ns, command.text.encode() + b"\r") is not None
        if now_ns < self._deadline_ns:
            return False
        if not command.compulsory:
            self._done()
        elif self._tries == TRIES:
            error = NoAnswerError(
                f"no valid answer to {command.text} in {TRIES} tries ({self._last_error}): check power and baud rate"
            )
            self._link.drop(now_ns, "no_answer", str(error))
        self._deadline_ns = None
        return True

    def _done(self) -> None:
        self._todo.popleft()
        self._deadline_ns = None
        self._tries = 0

    def _reply(self, now_ns: int, host_ns: int, kind: int, register: int, data: int, stamp: int | None) -> None:
        """Compare a line during set-up with the expected reply."""
        command = self._todo[0]
        if self._deadline_ns is None or register != command.register:
            return  # a stream left running by an earlier session
        if kind in {_REFUSED, _UNSUPPORTED}:
            what = "refuses" if kind == _REFUSED else "does not know"
            error = ConfigurationError(f"adapter {what} {command.text}: check its model and firmware")
            self._link.drop(now_ns, "configuration", str(error))
            return
        if kind != ord(command.kind):
            return
        if command.value is not None and data != command.value:
            self._last_error = f"{command.text} was echoed with {data:X}"
            return
        self._done()
        if register == reg.VERSION:
            self._identified(host_ns, data, stamp)
        elif kind == ord("r"):
            self._edges.preset(register, data)
        elif not self._todo:
            self._link.alive(now_ns)
            rate = 1e9 / self.config.interval_ns
            self._report.event(host_ns, Severity.INFO, "started", f"streaming {rate:.0f} lines/s")

    def _identified(self, host_ns: int, version: int, stamp: int | None) -> None:
        model = reg.MODELS.get(version >> 8 & 0xF, "unknown model")
        text = f"{model}, serial number {version >> 12}, firmware {version & 0xFF:#04x}"
        self._report.event(host_ns, Severity.INFO, "identified", text)
        runs_on = stamp is not None and self._ticks.runs_on(stamp, host_ns)
        if not runs_on:
            self._after_reset = self._last_ns is not None
            self._ticks.restart()
        self._command(setup_commands(self.config, clear_timestamp=not runs_on))

    def rests_until(self, now_ns: int) -> int:
        """See ``drivers.device.Rests``: lines may wait in the port: marks and not arrivals give their times."""
        is_streaming = self._running and self._link.is_open and not (self._todo or self._broken)
        return now_ns + LONGEST_REST_NS if is_streaming and self._marks > MARKED else now_ns

    # Streaming

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        for lines in self._frames_in(chunk, self._lines):
            if lines.kind[0] == GREETING:
                self._greeted(chunk.host_ns)
            elif (answers := self._answers(now_ns, chunk.host_ns, lines)) < len(lines.kind):
                self._streamed(now_ns, chunk.host_ns, lines.since(answers))
            if not self._link.is_open:
                break
        self._hand_over_marks(chunk.host_ns, self._last_tick)

    def _greeted(self, host_ns: int) -> None:
        if not self._todo:
            text = "it sent its greeting: it was reset, check its supply"
            self._report.event(host_ns, Severity.WARNING, "device_reset", text)
        self._ticks.restart()
        self._set_up("device_reset" if self._last_ns is not None else "")

    def _answers(self, now_ns: int, host_ns: int, lines: Lines) -> int:
        """Process replies to commands; returns how many lines belong to the set-up."""
        for place in range(len(lines.kind)):
            if not self._todo:
                return place
            stamp = int(lines.stamp[place]) if lines.stamped else None
            kind, register, data = int(lines.kind[place]), int(lines.register[place]), int(lines.data[place])
            self._reply(now_ns, host_ns, kind, register, data, stamp)
            if not self._todo:
                return place  # the answer to the last command is the first position
        return 0 if not self._todo else len(lines.kind)

    def _streamed(self, now_ns: int, host_ns: int, lines: Lines) -> None:
        complaints = () if lines.positions else np.flatnonzero(np.isin(lines.kind, (_REFUSED, _UNSUPPORTED)))
        for place in complaints:
            text = f"it complains about register {lines.register[place]:02X}, without a command to it"
            self._report.event(host_ns, Severity.WARNING, "complaint", text)
        if not lines.stamped:
            return
        placed = self._ticks.place(lines.stamp, host_ns)
        if placed.jump is not None:
            text = f"timestamp jumped to {lines.stamp[placed.jump]} and the host's clock did not: it restarted"
            self._report.event(host_ns, Severity.WARNING, "clock_jump", text)
        if lines.positions:
            self._heard(now_ns)
            self._positions(host_ns, lines.data, placed.ticks, placed.jump)
            return
        streamed = lines.kind == _STREAM
        at = np.flatnonzero(streamed & (lines.register == reg.ENCODER))
        if len(at):
            self._heard(now_ns)
            jump = None if placed.jump is None else int(np.searchsorted(at, placed.jump))
            self._positions(host_ns, lines.data[at], placed.ticks[at], jump)
        for place in np.flatnonzero(streamed & (lines.register != reg.ENCODER)):
            register, data = int(lines.register[place]), int(lines.data[place])
            self._edges.line(register, data, int(placed.ticks[place]), host_ns)

    def _positions(self, host_ns: int, counts: NDArray[np.uint32], ticks: NDArray[np.int64], jump: int | None) -> None:
        rows = np.zeros(len(counts), SCALAR)
        if self._last_ns is None or self._after_reset:
            self._count = int(counts[0])
            self._value = self._count - (self._count >> 31 << 32)
            self._position.at = self._value
        values = unwrapped(counts, 32, self._count, self._value)
        if not self._position.follow(values.tolist()):
            placed = [self._position.place(count) for count in counts.tolist()]
            values = np.array([value for value, _ in placed])
            rows["status"] = [0 if is_accepted else SampleStatus.NOT_VALID for _, is_accepted in placed]
        rows["sequence"] = numbers = self._numbers(host_ns, ticks, jump)
        rows["host_ns"] = host_ns
        rows["tick"] = ticks if ticks[0] >= 0 and jump is None else np.maximum(ticks, 0)
        rows["value_raw"] = values
        rows["scale"] = self._scale
        rows["unit"] = b"rad"
        if self._after_reset:
            rows["status"][0] |= SampleStatus.AFTER_RESET
        if jump is not None and jump < len(rows):
            rows["status"][jump] |= SampleStatus.AFTER_RESET
        self._report.rows(self.name, rows)
        self._next = int(numbers[-1]) + 1
        self._last_tick, self._last_ns = int(ticks[-1]), host_ns
        self._value = self._value if self._position.at is None else self._position.at
        self._count = self._value % TURN
        self._after_reset = self._broken = False
        self._cause = ""

    def _numbers(self, host_ns: int, ticks: NDArray[np.int64], jump: int | None) -> NDArray[np.int64]:
        """Sequence numbers of these lines, shape (n,), after recording lost ones."""
        numbers = np.arange(self._next, self._next + len(ticks))
        if jump is None and not self._after_reset and self._last_ns is not None and self._is_dense(ticks.tolist()):
            self._named = 0
            return numbers
        lost = self._lost(host_ns, ticks, jump)
        numbers += lost.cumsum()
        for place in np.flatnonzero(lost):
            count, last = int(lost[place]), int(numbers[place]) - 1
            duration_ns = round(count * self.config.interval_ns)
            cause = self._cause if place == 0 and self._cause else "lines_lost"
            self._report.gap(host_ns, self.name, last - count + 1, last, duration_ns, cause)
        return numbers

    def _is_dense(self, ticks: list[int]) -> bool:
        """Whether no line is missing before any of these: the fast path of the normal case."""
        longest = self._interval + self._jitter
        before = self._last_tick
        for tick in ticks:
            if tick - before > longest:
                return False
            before = tick
        return True

    def _lost(self, host_ns: int, ticks: NDArray[np.int64], jump: int | None) -> NDArray[np.int64]:
        """Lines missing before each of these, shape (n,), minus those recorded at a stop."""
        interval = self._interval
        since = ticks - np.concatenate(([self._last_tick], ticks[:-1]))
        lost = np.where(since > interval + self._jitter, np.rint(since / interval).astype(np.int64) - 1, 0)
        if jump is not None and jump < len(lost):
            lost[jump] = 0
            if self._last_ns is not None:  # the timestamp does not tell: by the host's clock
                due = round((host_ns - self._last_ns) / self.config.interval_ns)
                lost[jump] = max(0, due - len(lost) - int(lost.sum()))
        if self._last_ns is None:
            lost[0] = 0
        elif self._after_reset:
            lost[0] = max(0, round((host_ns - self._last_ns) / self.config.interval_ns) - 1)
        lost[0] = max(0, lost[0] - self._named)
        self._named = 0
        return lost

    def _hand_over_marks(self, host_ns: int, tick: int | None) -> None:
        edges = self._edges.take(tick)
        if not edges:
            return
        rows = np.zeros(len(edges), MARK)
        for place, edge in enumerate(edges):
            latched = self._value + ((edge.capture - self._count + (1 << 31)) % (1 << 32) - (1 << 31))
            rows[place] = (self._marks, edge.host_ns, max(0, edge.tick), 0, latched)
            self._marks += 1
        self._report.rows(f"{self.name}_mark", rows)

    def _end_stream(self, now_ns: int) -> bool:
        command = greeting_commands()[0].text.encode() + b"\r"
        return self._link.write(now_ns, command) is not None and not self._todo

    def _finish(self, now_ns: int) -> None:
        self._hand_over_marks(now_ns, None)
        if self._last_ns is not None and self._misses_its_end(now_ns - self._last_ns):
            lost = round((now_ns - self._last_ns) / self.config.interval_ns)
            cause = self._cause or "silent"
            if lost > 0:  # a long interval may not have passed yet
                self._report.gap(now_ns, self.name, self._next, self._next + lost - 1, now_ns - self._last_ns, cause)
            self._next += lost
            self._named += lost
        self._cause = ""
