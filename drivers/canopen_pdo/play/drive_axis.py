"""One CiA 402 drive that is given set points: its set-up, its answers, and the frames that command it.

Set-up writes and reads back: software position limits 607Dh, following error window 6065h and time 6066h, quick stop
605Ah and 6085h, fault reaction 605Eh, what a lost master means (6007h: quick stop, 1016h: our heartbeat), the profile
6081h, 6083h, 6084h, the interpolation period 60C2h and the mode 6060h. An object of these that the drive does not have,
or that keeps another value, refuses it: it is not driven. A drive that is found enabled is stopped first. The
controlword goes in RPDO1, which acts at once; the target in RPDO2, in mode 8 on the next SYNC, in mode 1 at once, with
the controlword that says that it is new: two frames would be put in order by their identifiers, the target last. In
mode 10 the target is a torque, in thousandths of the rated one (6076h), on the next SYNC.
"""

import struct
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.profiles.cia402 import MODE, POSITION, RATED_TORQUE, STATUS, Cia402Config, Place
from drivers.canopen_pdo.sdo import SdoData, SdoRead, SdoWrite, Setup, confirm, ensure_rpdo, read_unsigned
from drivers.canopen_pdo.sync import SyncCounter
from drivers.errors import ConfigurationError, SdoAbortError
from drivers.records import CAN_FRAME
from drivers.reporter import Reporter

PROFILE, CYCLIC, CYCLIC_TORQUE = 1, 8, 10  # modes of operation
CONTROLWORD, TARGET, TARGET_TORQUE = 0x6040_0010, 0x607A_0020, 0x6071_0010
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, DISABLE_VOLTAGE = 0x06, 0x07, 0x0F, 0x02, 0x00
NEW_SET_POINT, AT_ONCE = 0x10, 0x20  # of the controlword in mode 1
SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED = 0x40, 0x21, 0x23, 0x27
FAULTS: Final = (0x0F, 0x08)  # states: fault reaction active, fault
ENABLING: Final = {  # the controlword that leads on from a state
    SWITCH_ON_DISABLED: SHUTDOWN,
    READY: SWITCH_ON,
    SWITCHED_ON: ENABLE,
    ENABLED: ENABLE,
}
FOLLOWING_ERROR, ACKNOWLEDGE, REACHED = 1 << 13, 1 << 12, 1 << 10  # of the statusword
FOLLOWING_MS: Final = 10
LARGEST_TORQUE: Final = 32_767  # thousandths of the rated torque, in an I16
RATE_SLACK: Final = 1.25  # of the rate limit, for the drive's own control
RATE_WINDOW_NS: Final = 25_000_000
_WRAP, _HALF = 1 << 32, 1 << 31
_FRAME = struct.Struct("<i")


@dataclass(frozen=True)
class AxisConfig:
    """A drive that is driven; counts are the drive's position units, as it sends them.

    Attributes:
        drive: What is read from it, with position and status.
        sent: Channel of the frames that it is sent.
        low: Least position, counts.
        high: Largest.
        rate: Largest rate, counts/s.
        acceleration: Of a profile, counts/s2.
        quick_stop: Deceleration, counts/s2.
        following_error: Largest, counts.
        start_within: How far it may stand from where the motion begins, counts.
        holds: It holds its position after a quick stop, instead of being released to its brake.
        brakes: It has a brake, which stops it in a fault; else it is slowed down by its motor.
        checks_units: 608Fh, 6091h and 6092h have to agree with ``counts_per_revolution``.
    """

    drive: Cia402Config
    sent: str
    low: int
    high: int
    rate: float
    acceleration: float
    quick_stop: float
    following_error: int
    start_within: int
    holds: bool = False
    brakes: bool = True
    checks_units: bool = True

    def __post_init__(self) -> None:
        if self.drive.position is None or self.drive.status is None:
            raise ConfigurationError(f"{self.sent}: a drive that is driven is read by position and status: name both")
        if not -_HALF <= self.low < self.high < _HALF:
            text = f"{self.drive.name}: may be between {self.low} and {self.high} counts: a drive counts in 32 bits"
            raise ConfigurationError(f"{text}, the least below the most: correct limits, zero_count or margin")
        if min(self.rate, self.acceleration, self.quick_stop, self.following_error, self.start_within) < 1:
            raise ConfigurationError(f"{self.drive.name}: a limit of less than one count: give larger ones")


class DriveAxis:
    """One drive, as the player has it.

    Args:
        config: The drive.
        mode: ``CYCLIC``, ``PROFILE`` or ``CYCLIC_TORQUE``.
        sync: Numbers the SYNCs, which its positions are of.
        master: Our node number and, in ms, how long the drive does without our heartbeat.
        send: Sends a frame (COB-ID, data).
        report: Where its frames go as rows.

    Attributes:
        is_ready: It is set up and started.
        status: Statusword; None before the first.
        mode_shown: Mode of operation that is in force.
        position: Counts, within 32 bits.
        failed: Error code of its last EMCY since it was started; 0 for none.
        rated_torque_mNm: Of its motor, by its object 6076h; 0 before it is set up in mode 10.
    """

    def __init__(
        self,
        config: AxisConfig,
        mode: int,
        sync: SyncCounter,
        master: tuple[int, int],
        send: Callable[[int, bytes], None],
        report: Reporter,
    ) -> None:
        self.config, self.mode = config, mode
        self.node, self.name = config.drive.node, config.drive.name
        self.is_ready, self.failed = False, 0
        self.rated_torque_mNm = 0
        self.status: int | None = None
        self.mode_shown: int | None = None
        self.position: int | None = None
        self.now_ns = 0
        self._sync, self._master = sync, master
        self._past: deque[tuple[int, int]] = deque()  # SYNC numbers, and positions
        self._transmit, self._report = send, report
        self._rows: list[tuple[int, int, int, int, list[int]]] = []
        self._sequence = 0
        at = [(entry, config.drive.place(entry)) for entry in (POSITION, STATUS, MODE)]
        self._places: dict[int, list[tuple[int, Place]]] = {}
        for entry, place in at:
            self._places.setdefault(frame.TPDO[place.tpdo] + self.node, []).append((entry, place))
        self._heard_ns = dict.fromkeys(self._places, 0)

    @property
    def cob_ids(self) -> tuple[int, ...]:
        """TPDOs with position and status."""
        return tuple(self._places)

    @property
    def heard_ns(self) -> int:
        """When the TPDO came last that has been missing longest."""
        return min(self._heard_ns.values())

    @property
    def state(self) -> int | None:
        """State of the drive by its statusword (CiA 402-2): of a fault 0Fh or 08h."""
        if self.status is None:
            return None
        low = self.status & 0x4F
        return low if low in (SWITCH_ON_DISABLED, *FAULTS) else self.status & 0x6F

    @property
    def is_enabled(self) -> bool:
        """Whether it follows set points."""
        return self.state == ENABLED

    # Received

    def on_tpdo(self, cob_id: int, host_ns: int, data: bytes) -> None:
        """A TPDO of it came; one of wrong length is reported by its channel."""
        for entry, place in self._places[cob_id]:
            if len(data) != place.length:
                continue
            word = data[place.start : place.start + place.size]
            if entry == POSITION:
                self.position = int.from_bytes(word, "little", signed=True)
                self._past.append((self._sync.tick or 0, self.position))
            elif entry == STATUS:
                self.status = int.from_bytes(word, "little")
            else:
                self.mode_shown = int.from_bytes(word, "little", signed=True)
            self._heard_ns[cob_id] = host_ns

    def on_emergency(self, host_ns: int, data: bytes) -> None:
        """An EMCY of it came."""
        del host_ns
        if len(data) == 8:
            self.failed = int.from_bytes(data[:2], "little")

    def started(self) -> None:
        """It is set up, and was started."""
        self.is_ready, self.failed = True, 0
        self.status = self.position = self.mode_shown = None
        self._past.clear()

    def lost(self) -> None:
        """It has to be set up again."""
        self.is_ready = False

    def distance(self, counts: int) -> int:
        """Counts from ``counts`` to where it is, across the end of 32 bits."""
        assert self.position is not None
        return (self.position - counts + _HALF) % _WRAP - _HALF

    def unwell(self, now_ns: int, limit_ns: int) -> str:
        """Why it must not go on, whatever it is sent; empty while all is well."""
        slack = self.config.following_error
        if self.failed:
            return f"reports {self.failed:04X}h (EMCY)"
        if not self.is_ready:
            return "was set up again: it had rebooted, or its heartbeat had stopped"
        if self.state in FAULTS:
            return f"is in fault, statusword {self.status or 0:04X}h"
        if (silent_ns := now_ns - self.heard_ns) > limit_ns:
            return f"has not answered SYNC for {silent_ns // 1_000_000} ms"
        if self.position is None or not self.config.low - slack <= self.position <= self.config.high + slack:
            return "is outside its limits"
        return self._too_fast()

    def _too_fast(self) -> str:
        """Its rate between SYNCs, over a window long enough for the counts; when its frames arrived does not matter."""
        window = -(-RATE_WINDOW_NS // self._sync.period_ns)
        while len(self._past) > 2 and self._past[-1][0] - self._past[1][0] >= window:
            self._past.popleft()
        periods = self._past[-1][0] - self._past[0][0] if self._past else 0
        if periods < window:
            return ""
        per_s = 1e9 / (periods * self._sync.period_ns)
        rate = abs(self.distance(self._past[0][1])) * per_s
        if rate <= RATE_SLACK * self.config.rate + 2.0 * per_s:
            return ""
        return f"moves at {360.0 * rate / self.config.drive.counts_per_revolution:.1f} deg/s, faster than its limit"

    # Sent

    def send(self, cob_id: int, data: bytes) -> None:
        """Send a frame and keep it as a row."""
        body = [*data[:8], *bytes(8 - len(data[:8]))]
        self._rows.append((self._sequence, self.now_ns, cob_id, len(data), body))
        self._sequence += 1
        self._transmit(cob_id, data)

    def control(self, word: int) -> None:
        """Send a controlword."""
        self.send(0x200 + self.node, word.to_bytes(2, "little"))

    def target(self, counts: int, word: int | None = None) -> None:
        """Send a target position, in mode 1 with its controlword; outside the limits it is cut to them."""
        held = _FRAME.pack(min(max(counts, self.config.low), self.config.high))
        self.send(0x300 + self.node, held if word is None else held + word.to_bytes(2, "little"))

    def torque(self, per_mille: int) -> None:
        """Send a target torque, in thousandths of the rated one, positive towards larger counts."""
        held = min(max(per_mille, -LARGEST_TORQUE), LARGEST_TORQUE)
        self.send(0x300 + self.node, held.to_bytes(2, "little", signed=True))

    def hand_over(self) -> None:
        """Pass the frames sent to the reporter."""
        if self._rows:
            rows = np.zeros(len(self._rows), CAN_FRAME)
            rows[:] = [(*head, tuple(body)) for *head, body in self._rows]
            self._rows.clear()
            self._report.rows(self.config.sent, rows)

    def setup(self) -> Setup:
        """SDO transfers before it may be driven.

        Raises:
            ConfigurationError: It cannot be driven as configured.
        """
        status = yield from read_unsigned(0x6041)
        if status & 0x6F == ENABLED:
            yield SdoWrite(0x6040, 0, QUICK_STOP.to_bytes(2, "little"))
        supported = yield from read_unsigned(0x6502)
        if not supported >> self.mode - 1 & 1:
            raise ConfigurationError(f"{self.name}: the drive has no mode {self.mode} (6502h): use [drive] mode")
        if self.config.checks_units:
            yield from self._check_units()
        for index, sub, value, size in self._objects():
            try:
                yield from confirm(index, sub, value, size)
            except (SdoAbortError, ConfigurationError) as error:
                raise ConfigurationError(f"{self.name} cannot be driven safely: {error}") from error
        yield from ensure_rpdo(1, 0x200 + self.node, 255, (CONTROLWORD,))
        if self.mode == CYCLIC_TORQUE:
            self.rated_torque_mNm = yield from read_unsigned(RATED_TORQUE)
            yield from ensure_rpdo(2, 0x300 + self.node, 1, (TARGET_TORQUE,))
        elif self.mode == CYCLIC:
            yield from ensure_rpdo(2, 0x300 + self.node, 1, (TARGET,))
        else:
            yield from ensure_rpdo(2, 0x300 + self.node, 255, (TARGET, CONTROLWORD))

    def _objects(self) -> list[tuple[int, int, int, int]]:
        config = self.config
        node, silence_ms = self._master
        objects = [
            (0x607D, 1, config.low, 4),
            (0x607D, 2, config.high, 4),
            (0x6065, 0, config.following_error, 4),
            (0x6066, 0, FOLLOWING_MS, 2),
            (0x6085, 0, round(config.quick_stop), 4),
            (0x605A, 0, 6 if config.holds else 2, 2),
            (0x605E, 0, 0 if config.brakes else 2, 2),
            (0x6007, 0, 3, 2),
            (0x1016, 1, node << 16 | silence_ms, 4),
            (0x6060, 0, self.mode, 1),
        ]
        if self.mode == PROFILE:
            objects += [(0x6081, 0, round(config.rate), 4)]
            objects += [(index, 0, round(config.acceleration), 4) for index in (0x6083, 0x6084)]
        else:
            count, power = interpolation(self._sync.period_ns)
            objects += [(0x60C2, 1, count, 1), (0x60C2, 2, power, 1)]
        return objects

    def _check_units(self) -> Setup:
        """Check the drive's counts a revolution against the configuration, if it has the objects."""
        encoder = yield from _ratio(0x608F)
        gear = yield from _ratio(0x6091)
        feed = yield from _ratio(0x6092)
        own = [value for value in (encoder, feed) if value is not None]
        told = {value * factor for value in own for factor in (1.0, gear or 1.0)}
        if told and not any(abs(value - self.config.drive.counts_per_revolution) < 0.5 for value in told):
            numbers = ", ".join(f"{value:g}" for value in sorted(told))
            raise ConfigurationError(
                f"{self.name}: counts_per_revolution = {self.config.drive.counts_per_revolution}, the drive says "
                f"{numbers} (608Fh, 6091h, 6092h): correct it, or set check_units = false"
            )


def _ratio(index: int) -> Generator[SdoRead | SdoWrite, SdoData, float | None]:
    """Part of a sequence: subindex 1 over subindex 2; None where the drive does not have them."""
    try:
        above = yield from read_unsigned(index, 1)
        below = yield from read_unsigned(index, 2)
    except SdoAbortError:
        return None
    return above / below if below else None


def interpolation(period_ns: int) -> tuple[int, int]:
    """60C2h:1 and :2 for a period: count and power of ten of a second.

    Raises:
        ConfigurationError: The period is no such number.
    """
    for power in (-3, -4, -5, -2):
        unit = 10 ** (9 + power)
        if period_ns % unit == 0 and 1 <= period_ns // unit <= 255:
            return period_ns // unit, power
    raise ConfigurationError(f"60C2h cannot say a SYNC period of {period_ns * 1e-6:g} ms: use whole hundredths of ms")
