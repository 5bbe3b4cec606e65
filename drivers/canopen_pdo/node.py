"""One CANopen node as the master handles it: set-up, start, heartbeat or guarding, set-up again after a reboot."""

from collections.abc import Callable, Sequence
from enum import Enum, auto

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.frame import NmtCommand, NmtState
from drivers.canopen_pdo.guarding import Guard
from drivers.canopen_pdo.play.drive_axis import DriveAxis
from drivers.canopen_pdo.profiles.channel import PdoChannel
from drivers.canopen_pdo.sdo import SdoClient, Setup, attempt, read_unsigned, write_unsigned
from drivers.errors import ConfigurationError, DriverError, FrameError, NoAnswerError, SdoAbortError, WrongDeviceError
from drivers.records import Severity
from drivers.reporter import Reporter

HEARTBEAT_MS = 500
HEARTBEAT_LIMIT_NS = 1_500_000_000
SETTLE_NS = 1_000_000_000  # heartbeats sent before a node took our NMT command may still arrive
BACKOFF_NS = 500_000_000
LONGEST_BACKOFF_NS = 8_000_000_000
COMMUNICATION = 0x8100  # error codes of this class (CiA 301, table 26)

_GOES_ON = bytes([NmtState.OPERATIONAL])
_CODES = {
    WrongDeviceError: "wrong_device",
    ConfigurationError: "configuration",
    SdoAbortError: "configuration",
    NoAnswerError: "no_answer",
}


class _State(Enum):
    OFF = auto()
    SETTING_UP = auto()
    RUNNING = auto()
    AWAY = auto()  # no answer: retried at the deadline
    REFUSED = auto()  # wrong device or unusable configuration: ignored until it boots


class Node:
    """A node and the channels it feeds.

    Set-up: pre-operational, identity 1000h, heartbeat 1017h (or guarding 100Ch and 100Dh where it has none), what each
    channel needs, NMT start.

    Args:
        number: Node number, 1..127.
        channels: Its channels.
        send: Sends a frame (COB-ID, data); does not raise on bus faults.
        report: Where events go.
        guard: Node guarding, used if it has no heartbeat.
        driven: The drive that it is, if it is to be driven.
    """

    def __init__(
        self,
        number: int,
        channels: Sequence[PdoChannel],
        send: Callable[[int, bytes], None],
        report: Reporter,
        guard: Guard | None = None,
        driven: DriveAxis | None = None,
    ) -> None:
        self.number = number
        self.channels = tuple(channels)
        self._send = send
        self._report = report
        self._guard = guard
        self._driven = driven
        self._guarded_by: Guard | None = None  # while it makes no heartbeat
        self._sdo = SdoClient(number, send)
        self._state = _State.OFF
        self._deadline_ns = 0
        self._backoff_ns = BACKOFF_NS
        self._started_ns = 0
        self._heard_ns = 0
        self._told = ""

    @property
    def source(self) -> str:
        """Source name of its events: its first channel."""
        return self.channels[0].data.name

    @property
    def asks(self) -> bool:
        """Whether an answer of its SDO server is awaited."""
        return self._sdo.busy

    def begin(self, now_ns: int) -> None:
        """Put the node into pre-operational state and start its set-up."""
        for channel in self.channels:
            channel.live = False
        if self._driven is not None:
            self._driven.lost()
        self._state = _State.SETTING_UP
        self._command(NmtCommand.PRE_OPERATIONAL)
        self._sdo.begin(self._setup(), now_ns)

    def stop(self) -> None:
        """Put the node into pre-operational state: it sends no more TPDOs."""
        if self._state is not _State.OFF:
            self._command(NmtCommand.PRE_OPERATIONAL)
        self._sdo.drop()
        self._state = _State.OFF

    def poll(self, now_ns: int) -> None:
        """Repeat requests, retry after a back-off, notice a heartbeat that stopped."""
        if self._state is _State.SETTING_UP:
            self._guarded(lambda: self._sdo.poll(now_ns), now_ns)
        elif self._state is _State.AWAY and now_ns >= self._deadline_ns:
            self.begin(now_ns)
        elif self._state is _State.RUNNING:
            self._watch(now_ns)
            self._check(now_ns)

    def rests_until(self, now_ns: int) -> int:
        """Until when it is asked nothing, if it goes on answering; ``now_ns`` while it is not running."""
        if self._state is not _State.RUNNING or self._sdo.busy:
            return now_ns
        rests_ns = now_ns + HEARTBEAT_LIMIT_NS if self._guarded_by is None else self._guarded_by.due_ns
        for channel in self.channels:
            check_ns = channel.check_ns()
            rests_ns = rests_ns if check_ns is None else min(rests_ns, check_ns)
        return rests_ns

    def on_sdo(self, host_ns: int, data: bytes) -> None:
        """An answer of its SDO server."""
        if self._state is _State.SETTING_UP:
            self._guarded(lambda: self._sdo.accept(data, host_ns), host_ns)
        elif self._state is _State.RUNNING:
            self._checked(lambda: self._sdo.accept(data, host_ns), host_ns)

    def on_heartbeat(self, host_ns: int, data: bytes) -> None:
        """A heartbeat or boot-up message."""
        try:
            state = frame.decode_heartbeat(data)
        except FrameError as error:
            self._report.event(host_ns, Severity.WARNING, "bad_heartbeat", str(error), self.source)
            return
        if self._guarded_by is None or state is NmtState.BOOT_UP or self._guarded_by.answered(data):
            self._heard_ns = host_ns
        else:
            text = f"node {self.number}: guarding bit does not toggle: its program hangs, or a second node answers"
            self._report.event(host_ns, Severity.WARNING, "guard_toggle", text, self.source)
        if self._state is _State.OFF:
            return
        if state is NmtState.BOOT_UP:
            if self._state is _State.RUNNING:
                text = f"node {self.number} rebooted: set up again; check its supply"
                self._report.event(host_ns, Severity.WARNING, "node_rebooted", text, self.source)
            self._told = ""
            for channel in self.channels:
                channel.node_rebooted()
            self._reset(host_ns)
        elif self._state is _State.AWAY:
            self.begin(host_ns)
        elif (
            self._state is _State.RUNNING
            and state is not NmtState.OPERATIONAL
            and host_ns - self._started_ns > SETTLE_NS
        ):
            text = f"node {self.number} is {state.name.lower()}: started again; look for a second master"
            self._report.event(host_ns, Severity.WARNING, "not_operational", text, self.source)
            if self._driven is not None:
                self._driven.lost()
            self._start(host_ns)

    def only_lives(self, data: bytes) -> bool:
        """Whether this heartbeat only confirms the present state of the node."""
        return self._state is _State.RUNNING and self._guarded_by is None and data == _GOES_ON

    def on_emergency(self, host_ns: int, data: bytes) -> None:
        """An EMCY message."""
        try:
            emergency = frame.decode_emergency(data)
        except FrameError as error:
            self._report.event(host_ns, Severity.WARNING, "bad_emergency", str(error), self.source)
            return
        for channel in self.channels:
            channel.suspect(host_ns, bus=emergency.code & 0xFF00 == COMMUNICATION)
        severity = Severity.WARNING if emergency.code else Severity.INFO
        what = f"{emergency.code:04X}h, register {emergency.register:02X}h, {emergency.vendor.hex()}"
        text = f"node {self.number} EMCY {what}" if emergency.code else f"node {self.number} EMCY: errors are over"
        self._report.event(host_ns, severity, f"emcy_{emergency.code:04X}", text, self.source)

    def _setup(self) -> Setup:
        device_type = yield from read_unsigned(0x1000)
        for channel in self.channels:
            profile = channel.data.profile
            if profile is not None and device_type & 0xFFFF != profile:
                raise WrongDeviceError(
                    f"node {self.number} has device type {device_type:08X}h, {channel.data.name} needs "
                    f"xxxx{profile:04X}h: check the node numbers"
                )
        yield from self._watching()
        for channel in self.channels:
            yield from channel.data.setup()
        if self._driven is not None:
            yield from self._driven.setup()

    def _watching(self) -> Setup:
        """Configure its heartbeat; if it has none, configure node guarding."""
        self._guarded_by = None
        guard = self._guard
        try:
            yield from write_unsigned(0x1017, 0, HEARTBEAT_MS, 2)
        except SdoAbortError as error:
            if guard is None:
                raise ConfigurationError(f"{error}: it makes no heartbeat; configure node guarding for it") from error
            yield from attempt(0x100C, 0, guard.config.guard_time_ms, 2)  # its life guarding of the master: optional
            yield from attempt(0x100D, 0, guard.config.life_time_factor, 1)
            self._guarded_by = guard

    def _watch(self, now_ns: int) -> None:
        guard = self._guarded_by
        silent_ns = now_ns - self._heard_ns
        if guard is not None and not guard.poll(now_ns):
            code, what = "guarding_lost", "sign of life when guarded"
        elif guard is None and silent_ns > HEARTBEAT_LIMIT_NS:
            code, what = "heartbeat_lost", "heartbeat"
        else:
            return
        text = f"node {self.number}: no {what} for {silent_ns // 1_000_000} ms: set up again"
        self._report.event(now_ns, Severity.ERROR, code, text, self.source)
        self._reset(now_ns)

    def _guarded(self, step: Callable[[], None], now_ns: int) -> None:
        """Run a step of the set-up; an error that ends it becomes an event."""
        try:
            step()
        except NoAnswerError as error:
            self._tell(now_ns, error)
            self._state, self._deadline_ns = _State.AWAY, now_ns + self._backoff_ns
            self._backoff_ns = min(2 * self._backoff_ns, LONGEST_BACKOFF_NS)
        except DriverError as error:
            self._tell(now_ns, error)
            self._state = _State.REFUSED
        else:
            if not self._sdo.busy:
                self._run(now_ns)

    def _check(self, now_ns: int) -> None:
        """Start the read-back of a channel that is due."""
        if self._sdo.busy:
            self._checked(lambda: self._sdo.poll(now_ns), now_ns)
            return
        for channel in self.channels:
            sequence = channel.check(now_ns) if self._state is _State.RUNNING else None
            if sequence is not None:
                self._sdo.begin(sequence, now_ns)
                return

    def _checked(self, step: Callable[[], None], now_ns: int) -> None:
        """Run a step of a read-back; an error that ends it becomes an event and the node stays operational."""
        try:
            step()
        except DriverError as error:
            self._tell(now_ns, error)
        else:
            if not self._sdo.busy:
                self._told = ""

    def _run(self, now_ns: int) -> None:
        self._state = _State.RUNNING
        self._heard_ns = now_ns
        self._backoff_ns = BACKOFF_NS
        self._told = ""
        if self._guarded_by is not None:
            self._guarded_by.begin(now_ns)
        for channel in self.channels:
            channel.go_live()
        if self._driven is not None:
            self._driven.started()
        self._start(now_ns)
        text = f"node {self.number} set up and started"
        self._report.event(now_ns, Severity.INFO, "started", text, self.source)

    def _start(self, now_ns: int) -> None:
        self._started_ns = now_ns
        self._command(NmtCommand.START)

    def _reset(self, now_ns: int) -> None:
        for channel in self.channels:
            channel.node_reset()
        self.begin(now_ns)

    def _tell(self, now_ns: int, error: DriverError) -> None:
        code = _CODES.get(type(error), "error")
        if code != self._told:
            self._report.event(now_ns, Severity.ERROR, code, str(error), self.source)
            self._told = code

    def _command(self, command: NmtCommand) -> None:
        self._send(frame.NMT, frame.encode_nmt(command, self.number))
