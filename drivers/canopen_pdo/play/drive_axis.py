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
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Final

import numpy as np

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.frame import NmtState
from drivers.canopen_pdo.profiles.cia402 import MODE, POSITION, RATED_TORQUE, STATUS, Cia402Config, Place
from drivers.canopen_pdo.sdo import SdoData, SdoRead, SdoWrite, Setup, confirm, ensure_rpdo, read_unsigned
from drivers.canopen_pdo.sync import SyncCounter
from drivers.errors import ConfigurationError, SdoAbortError
from drivers.play.axis import Axis, AxisConfig
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
_FRAME = struct.Struct("<i")


@dataclass(frozen=True)
class Cia402AxisConfig(AxisConfig):
    """A CiA 402 drive that is driven.

    Attributes:
        drive: What is read from it, with position and status.
        brakes: It has a brake, which stops it in a fault; else it is slowed down by its motor.
        checks_units: 608Fh, 6091h and 6092h have to agree with ``counts_per_revolution``.
        master: Our node number, of the heartbeat.
    """

    drive: Cia402Config
    brakes: bool = True
    checks_units: bool = True
    master: int = 127

    def __post_init__(self) -> None:
        if self.drive.position is None or self.drive.status is None:
            raise ConfigurationError(f"{self.sent}: a drive that is driven is read by position and status: name both")
        if not 1 <= self.master <= 127 or self.master == self.drive.node:
            raise ConfigurationError(f"master node {self.master}: a number of 1..127 that no drive has")
        super().__post_init__()


class DriveAxis(Axis):
    """One CiA 402 drive, as its master has it.

    Args:
        config: The drive.
        mode: ``CYCLIC``, ``PROFILE`` or ``CYCLIC_TORQUE``.
        sync: Numbers the SYNCs, which its positions are of.
        heartbeat_ms: How long the drive does without our heartbeat.
        send: Sends a frame (COB-ID, data).
        report: Where its frames go as rows.

    Attributes:
        status: Statusword; None before the first.
        mode_shown: Mode of operation that is in force.
        places: Where entries lie in the TPDOs that are read, by COB-ID.
        failed: Error code of its last EMCY since it was started; 0 for none.
        rated_torque_mNm: Of its motor, by its object 6076h; 0 before it is set up in mode 10.
    """

    ANSWERS: ClassVar = " SYNC"
    SHOWS: ClassVar = "statuswords"

    def __init__(
        self,
        config: Cia402AxisConfig,
        mode: int,
        sync: SyncCounter,
        heartbeat_ms: int,
        send: Callable[[int, bytes], None],
        report: Reporter,
    ) -> None:
        super().__init__(config, sync)
        self.config: Cia402AxisConfig = config
        self.mode, self.node = mode, config.drive.node
        self._is_set_up, self.failed = False, 0
        self.rated_torque_mNm = 0
        self.status: int | None = None
        self.mode_shown: int | None = None
        self._sync, self._heartbeat_ms = sync, heartbeat_ms
        self._transmit, self._report = send, report
        self._rows: list[tuple[int, int, int, int, list[int]]] = []
        self._sequence = 0
        at = [(entry, config.drive.place(entry)) for entry in (POSITION, STATUS, MODE)]
        self.places: dict[int, list[tuple[int, Place]]] = {}
        for entry, place in at:
            self.places.setdefault(frame.TPDO[place.tpdo] + self.node, []).append((entry, place))
        self._heard_ns = dict.fromkeys(self.places, 0)

    @property
    def cob_ids(self) -> tuple[int, ...]:
        """TPDOs with position and status."""
        return tuple(self.places)

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

    def routes(self) -> list[tuple[int, Callable[[int, bytes], None]]]:
        """COB-IDs that it listens to."""
        tpdos = [(cob_id, partial(self.on_tpdo, cob_id)) for cob_id in self.cob_ids]
        return [*tpdos, (frame.EMERGENCY + self.node, self.on_emergency)]

    def on_tpdo(self, cob_id: int, host_ns: int, data: bytes) -> None:
        """A TPDO of it came; one of wrong length is reported by its channel."""
        for entry, place in self.places[cob_id]:
            if len(data) != place.length:
                continue
            word = data[place.start : place.start + place.size]
            if entry == POSITION:
                self._is_at(int.from_bytes(word, "little", signed=True), self._sync.tick or 0)
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
        self._is_set_up, self.failed = True, 0
        self.status = self.mode_shown = None
        self._forget()

    def lost(self) -> None:
        """It has to be set up again."""
        self._is_set_up = False

    # What it says

    @property
    def is_ready(self) -> bool:
        """See ``Axis``."""
        return self._is_set_up and self.position is not None and self.status is not None

    @property
    def may_move(self) -> bool:
        """See ``Axis``."""
        return self.is_enabled or self.status is None

    @property
    def shown(self) -> str:
        """See ``Axis``: its statusword."""
        return f"{self.status or 0:04X}h"

    @property
    def has_taken(self) -> bool:
        """See ``Axis``."""
        return bool((self.status or 0) & ACKNOWLEDGE)

    @property
    def has_arrived(self) -> bool:
        """See ``Axis``."""
        return bool((self.status or 0) & REACHED)

    def not_to_be_armed(self) -> str:
        """See ``Axis``."""
        if self.state in FAULTS:
            return f"is in fault, statusword {self.shown}: clear it with its tool"
        if self.failed:
            return f"reports {self.failed:04X}h (EMCY): clear it with its tool"
        return ""

    def broken(self) -> str:
        """See ``Axis``."""
        if self.failed:
            return f"reports {self.failed:04X}h (EMCY)"
        if not self._is_set_up:
            return "was set up again: it had rebooted, or its heartbeat had stopped"
        if self.state in FAULTS:
            return f"is in fault, statusword {self.shown}"
        return ""

    def astray(self) -> Iterator[str]:
        """See ``Axis``."""
        if not self.is_enabled:
            yield f"has left the operation enabled state, statusword {self.shown}"
        if self.mode_shown != self.mode:
            yield f"is in mode {self.mode_shown}, not {self.mode} (6061h)"
        if self.mode == CYCLIC and (self.status or 0) & FOLLOWING_ERROR:
            yield "reports a following error"

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

    def beat(self) -> None:
        """See ``Axis``: our heartbeat, which every drive hears."""
        self.send(frame.HEARTBEAT + self.config.master, bytes([NmtState.OPERATIONAL]))

    def enable(self) -> None:
        """See ``Axis``: in mode 10 without torque; else a drive without a set point stays where it is."""
        if self.mode == CYCLIC_TORQUE:
            self.torque(0)
        self.control(ENABLING.get(self.state or 0, DISABLE_VOLTAGE))

    def quick_stop(self) -> None:
        """See ``Axis``."""
        self.control(QUICK_STOP)

    def cut(self) -> None:
        """See ``Axis``."""
        self.control(DISABLE_VOLTAGE)

    def target(self, counts: int) -> None:
        """See ``Axis``."""
        self.send(0x300 + self.node, _FRAME.pack(self._held(counts)))

    def way_point(self, counts: int) -> None:
        """See ``Axis``: the controlword that says that it is new comes with it."""
        word = ENABLE | AT_ONCE | NEW_SET_POINT
        self.send(0x300 + self.node, _FRAME.pack(self._held(counts)) + word.to_bytes(2, "little"))

    def confirm(self) -> None:
        """See ``Axis``."""
        self.control(ENABLE | AT_ONCE)

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
        objects = [
            (0x607D, 1, config.low, 4),
            (0x607D, 2, config.high, 4),
            (0x6065, 0, config.following_error, 4),
            (0x6066, 0, FOLLOWING_MS, 2),
            (0x6085, 0, round(config.quick_stop), 4),
            (0x605A, 0, 6 if config.holds else 2, 2),
            (0x605E, 0, 0 if config.brakes else 2, 2),
            (0x6007, 0, 3, 2),
            (0x1016, 1, config.master << 16 | self._heartbeat_ms, 4),
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
