"""A CiA 402 servo drive as a data logger meets it: state machine, position, velocity, torque (IEC 61800-7-201).

The plant moves the axis and gives angle and torque, and the drive's motion controller gives its controlwords
at the times of ``commands``, beside those that arrive over SDO or in RPDO1. What the axis does is not affected by
them; the torque reads 0 unless the operation is enabled. ``servo402`` is the one that moves its axis itself.

=====  =============================  ============================================================================
index  object                         here
=====  =============================  ============================================================================
603Fh  error code                     of the last fault; 0 after a fault reset
6040h  controlword                    rw, RPDO1
6041h  statusword                     TPDO1, on every change (type 255)
6060h  modes of operation             rw, stored; 6061h shows it
6064h  position actual value          increments of 608Fh, I32 that wraps; TPDO2 with 606Ch, on SYNC (type 1)
606Ch  velocity actual value          increments/s: the change of 6064h over ``velocity_window_ns``
6076h  motor rated torque             mN m
6077h  torque actual value            in 0.1 % of 6076h; TPDO3 with 6041h, on SYNC (type 1)
608Fh  position encoder resolution    increments in a revolution
6502h  supported drive modes          cyclic synchronous position and torque
=====  =============================  ============================================================================
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Final, Literal

from pydantic import Field, PositiveFloat

from hil_sim.devices.can_bus.object_dictionary import Abort, Access, DataType, DictionaryError, Entry
from hil_sim.devices.canopen.can_emulator import CanNodeEmulator
from hil_sim.devices.canopen.canopen_node import OFF, OPERATIONAL, CanopenNode
from hil_sim.devices.canopen.rpdo import Rpdo
from hil_sim.devices.emulator import Bench, Equivalent, JointEmulator, Twin
from hil_sim.faults import ENCODER_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyScalar
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ScalarAnalog
from hil_sim.sensing.controller_sensors import MotorTorqueSensor
from hil_sim.sensing.sensors import EncoderSensor

# States by their bits in the statusword: 6, 5, 3, 2, 1, 0 (bit 4, voltage, and the others are added to them).
SWITCH_ON_DISABLED = 0x40
READY_TO_SWITCH_ON = 0x21
SWITCHED_ON = 0x23
OPERATION_ENABLED = 0x27
QUICK_STOP_ACTIVE = 0x07
FAULT_REACTION_ACTIVE = 0x0F
FAULT = 0x08

_VOLTAGE, _REMOTE, _TARGET_REACHED, _INTERNAL_LIMIT = 0x0010, 0x0200, 0x0400, 0x0800
_FAULT_RESET: Final = 0x80  # controlword
_PDO_LENGTH_ERROR: Final = 0x8210
_POWERED_STATES: Final = (SWITCHED_ON, OPERATION_ENABLED, QUICK_STOP_ACTIVE, FAULT_REACTION_ACTIVE)
_FAULT_REACTION_NS: Final = 20_000_000
_QUICK_STOP_NS: Final = 50_000_000
_CSP, _CST = 1 << 7, 1 << 9  # 6502h
_MODE_CSP, _MODE_CST = 8, 10
_LARGEST_TORQUE: Final = 32_767  # 0.1 % of the rated torque, in an I16

ENABLE: Final = ((0.3, 0x06), (0.35, 0x07), (0.4, 0x0F))  # shutdown, switch on, enable operation


class Drive402(CanopenNode):
    """One drive.

    Args:
        node_id: CANopen node number.
        angle: Axis angle, rad.
        torque: Torque of the motor on the axis, N m, gear included.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        increments_per_revolution: 608Fh; of the axis.
        zero_increments: Position actual value at angle zero.
        rated_torque_nm: 6076h, N m, of the motor itself.
        gear_ratio: Revolutions of the motor in one of the axis.
        velocity_window_ns: Over which the position is differenced.
        commands: (mission time in s, controlword) given by the motion controller.
        trips: (mission time in s, error code) at which the drive faults.
        faults: What breaks.
        extra_faults: Kinds that a subclass applies itself.

    Raises:
        FaultError: a fault that a drive cannot have.
    """

    def __init__(
        self,
        node_id: int,
        angle: ScalarAnalog,
        torque: ScalarAnalog,
        start_ns: int,
        *,
        increments_per_revolution: int = 500_000,
        zero_increments: int = 0,
        rated_torque_nm: float = 10.0,
        gear_ratio: float = 1.0,
        velocity_window_ns: int = 4_000_000,
        commands: Sequence[tuple[float, int]] = ENABLE,
        trips: Sequence[tuple[float, int]] = (),
        faults: DeviceFaults = NO_FAULTS,
        extra_faults: tuple[FaultKind, ...] = (),
    ) -> None:
        super().__init__(node_id, 0x0002_0192, start_ns, faults, (FaultKind.SATURATED, *ENCODER_KINDS, *extra_faults))
        self.hears_process_data = True
        here = [window for window in faults.windows if window.kind is not FaultKind.SATURATED]
        before = [window for window in here if window.kind is not FaultKind.STUCK]
        self._angle = FaultyScalar(angle, DeviceFaults(faults.device, here), start_ns)
        self._angle_before = FaultyScalar(angle, DeviceFaults(faults.device, before), start_ns)
        self._torque = FaultyScalar(torque, faults, start_ns)
        self._increments_per_rad = increments_per_revolution / math.tau
        self._zero_increments = zero_increments
        self._rated_torque_nm = rated_torque_nm * gear_ratio  # at the axis
        self._window_ns = velocity_window_ns
        plan: list[tuple[float, Callable[[int, int], None], int]] = []
        plan += [(time_s, self._command, word) for time_s, word in commands]
        plan += [(time_s, self.trip, code) for time_s, code in trips]
        self._plan = sorted(plan, key=lambda step: step[0])[::-1]  # the next one last
        add, u8, u16, u32 = self.dictionary.add, DataType.U8, DataType.U16, DataType.U32
        i16, i32, ro, rw = DataType.I16, DataType.I32, Access.RO, Access.RW
        self._error_code = add(0x603F, 0, Entry(u16, ro, mappable=True))
        self._controlword = add(0x6040, 0, Entry(u16, rw, changed=self._on_controlword, mappable=True))
        self._rpdos = [Rpdo(self.dictionary, 1, 0x200 + node_id, (0x6040_00_10,))]
        add(0x6041, 0, Entry(u16, ro, read=self.statusword, mappable=True))
        self._mode = add(0x6060, 0, Entry(u8, rw, _MODE_CSP, check=self._check_mode))
        add(0x6061, 0, Entry(u8, ro, read=lambda _: self._mode.value, mappable=True))
        add(0x6064, 0, Entry(i32, ro, read=self.position, mappable=True))
        add(0x606C, 0, Entry(i32, ro, read=self.velocity, mappable=True))
        add(0x6076, 0, Entry(u32, ro, round(rated_torque_nm * 1e3)))
        add(0x6077, 0, Entry(i16, ro, read=self.torque, mappable=True))
        for sub, value in enumerate((2, increments_per_revolution, 1)):
            add(0x608F, sub, Entry(u32 if sub else u8, ro, value))
        add(0x6502, 0, Entry(u32, ro, _CSP | _CST))
        self._tpdo_1 = self._add_tpdo(1, 255, (0x6041_00_10,))
        self._sampled = self._add_tpdo(2, 1, (0x6064_00_20, 0x606C_00_20))
        self._add_tpdo(3, 1, (0x6077_00_10, 0x6041_00_10))
        self._drive_state = SWITCH_ON_DISABLED
        self._last_controlword = 0
        self._next_step()

    @property
    def drive_state(self) -> int:
        """One of the states named in this module."""
        return self._drive_state

    def receive(self, identifier: int, data: bytes, now_ns: int) -> None:
        """A frame has ended on the wire."""
        mine = [rpdo for rpdo in self._rpdos if rpdo.valid and rpdo.cob_id == identifier]
        if not mine:
            super().receive(identifier, data, now_ns)
        elif self.state == OPERATIONAL and not self._is_silent(now_ns):
            self.revision += 1
            for rpdo in mine:
                if not rpdo.take(data, now_ns):
                    self.emergency(_PDO_LENGTH_ERROR, 0x10, b"", now_ns)

    def hears(self, identifier: int) -> bool:
        """See ``CanopenNode``."""
        return super().hears(identifier) or any(rpdo.valid and rpdo.cob_id == identifier for rpdo in self._rpdos)

    def statusword(self, now_ns: int) -> int:
        """Object 6041h."""
        word = self._drive_state | _REMOTE
        if self._drive_state in _POWERED_STATES:
            word |= _VOLTAGE
        if self._drive_state == OPERATION_ENABLED:
            word |= _TARGET_REACHED
            if abs(self._raw_torque(now_ns)) > _LARGEST_TORQUE:
                word |= _INTERNAL_LIMIT
        return word

    def position(self, now_ns: int) -> int:
        """Object 6064h at ``now_ns``."""
        return _wrap(self._increments(now_ns) + self._zero_increments)

    def velocity(self, now_ns: int) -> int:
        """Object 606Ch at ``now_ns``; it is that of half a window earlier."""
        before_ns = max(now_ns - self._window_ns, self._start_ns)
        if before_ns == now_ns or self._faults.active(FaultKind.STUCK, now_ns) is not None:
            return 0
        before = round(self._angle_before.value(self._seconds(before_ns)) * self._increments_per_rad)
        return round((self._increments(now_ns) - before) * 1e9 / (now_ns - before_ns))

    def torque(self, now_ns: int) -> int:
        """Object 6077h at ``now_ns``."""
        if self._drive_state not in (OPERATION_ENABLED, QUICK_STOP_ACTIVE):
            return 0
        return round(min(max(self._raw_torque(now_ns), -_LARGEST_TORQUE), _LARGEST_TORQUE))

    def trip(self, code: int, now_ns: int) -> None:
        """Fault: reaction, then the state FAULT, an EMCY message and 603Fh.

        Args:
            code: CiA 402 error code, as 2310h for continuous over current.
            now_ns: When.
        """
        self._error_code.value = code
        self.emergency(code, _error_register(code), b"", now_ns)
        self._enter(FAULT_REACTION_ACTIVE, now_ns)
        self._at("drive", now_ns + _FAULT_REACTION_NS, lambda t: self._enter(FAULT, t))

    # State machine (IEC 61800-7-201, figure and table of the power drive system's states)

    def _on_controlword(self, word: int, now_ns: int) -> None:
        reset = word & _FAULT_RESET and not self._last_controlword & _FAULT_RESET
        self._last_controlword = word
        state = self._drive_state
        if state == FAULT:
            if reset:
                self._error_code.value = 0
                self.emergency(0, 0, b"", now_ns)
                self._enter(SWITCH_ON_DISABLED, now_ns)
        elif state == FAULT_REACTION_ACTIVE:
            return
        elif not word & 0x02:  # disable voltage
            self._enter(SWITCH_ON_DISABLED, now_ns)
        elif not word & 0x04:  # quick stop
            self._quick_stop(now_ns)
        elif not word & 0x01:  # shutdown
            if state in (SWITCH_ON_DISABLED, SWITCHED_ON, OPERATION_ENABLED):
                self._enter(READY_TO_SWITCH_ON, now_ns)
        elif not word & 0x08:  # switch on, disable operation
            if state in (READY_TO_SWITCH_ON, OPERATION_ENABLED):
                self._enter(SWITCHED_ON, now_ns)
        elif state in (READY_TO_SWITCH_ON, SWITCHED_ON, QUICK_STOP_ACTIVE):  # enable operation
            if state == READY_TO_SWITCH_ON:
                self._enter(SWITCHED_ON, now_ns)
            self._enter(OPERATION_ENABLED, now_ns)

    def _quick_stop(self, now_ns: int) -> None:
        if self._drive_state == OPERATION_ENABLED:
            self._enter(QUICK_STOP_ACTIVE, now_ns)
            self._at("drive", now_ns + _QUICK_STOP_NS, lambda t: self._enter(SWITCH_ON_DISABLED, t))
        elif self._drive_state != QUICK_STOP_ACTIVE:
            self._enter(SWITCH_ON_DISABLED, now_ns)

    def _enter(self, state: int, now_ns: int) -> None:
        self._stop("drive")
        if state != self._drive_state:
            self._drive_state = state
            self._event(self._tpdo_1, now_ns)

    def _before_start(self) -> None:
        self._stop("drive")
        self._drive_state = SWITCH_ON_DISABLED
        self._last_controlword = 0

    # The motion controller and what goes wrong

    def _next_step(self) -> None:
        if self._plan:
            self._at("plan", self._start_ns + round(self._plan[-1][0] * 1e9), self._step)

    def _step(self, now_ns: int) -> None:
        _, action, value = self._plan.pop()
        if self.state != OFF:
            action(value, now_ns)
        self._next_step()

    def _command(self, word: int, now_ns: int) -> None:
        self._controlword.value = word
        self._on_controlword(word, now_ns)

    # Objects

    def _increments(self, now_ns: int) -> int:
        return round(self._angle.value(self._seconds(now_ns)) * self._increments_per_rad)

    def _raw_torque(self, now_ns: int) -> float:
        """Torque in 0.1 % of the rated one."""
        return self._torque.value(self._seconds(now_ns)) / self._rated_torque_nm * 1e3

    @staticmethod
    def _check_mode(value: int, now_ns: int) -> None:
        del now_ns
        if value not in (_MODE_CSP, _MODE_CST):
            raise DictionaryError(Abort.VALUE_RANGE)


def _wrap(increments: int) -> int:
    """As a signed 32-bit counter shows it."""
    return (increments + (1 << 31)) % (1 << 32) - (1 << 31)


def _error_register(code: int) -> int:
    """1001h: generic error, and the bit of the error code's class."""
    return 0x01 | {2: 0x02, 3: 0x04, 4: 0x08, 8: 0x10}.get(code >> 12, 0)


class Drive402Table(CanNodeEmulator, JointEmulator):
    """A CiA 402 drive."""

    kind: Literal["drive402"]
    zero_count: Annotated[int, Field(ge=-(2**31), lt=2**31)] = 0
    rated_torque_Nm: PositiveFloat
    velocity_window_ms: PositiveFloat = 4.0
    gear_ratio: float = 1.0

    vehicle_kind = "cia402"

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: the rated torque is the file's, or what the URDF allows the joint."""
        gear = said.get("gear_ratio", 1.0)
        rated = said.get("rated_torque_N_m", sheets.effort_n_m(said["joint"]) / abs(gear))
        table = {
            "zero_count": said.get("zero_count", 0),
            "measures": name,
            "torque": f"{name}_torque",
            "at": said["joint"],
            "rated_torque_Nm": rated,
            "gear_ratio": gear,
            "channels": [channel for channel in ("velocity", "torque") if said.get(channel)],
        }
        sensors = {name: sheets.encoder(name, said), f"{name}_torque": sheets.torque(rated * abs(gear), said)}
        return Equivalent(cls.node_keys(said) | table, sensors, {})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        encoder = bench.sensor(EncoderSensor)
        twin = Drive402(
            self.node,
            encoder,
            bench.sensor(MotorTorqueSensor, "torque"),
            bench.start_ns,
            increments_per_revolution=encoder.counts_per_revolution,
            zero_increments=self.zero_count,
            rated_torque_nm=self.rated_torque_Nm,
            gear_ratio=self.gear_ratio,
            velocity_window_ns=round(self.velocity_window_ms * 1e6),
            commands=[(0.0, word) for _, word in ENABLE],  # the arm may move from the start, by drives that are on
            faults=bench.faults,
        )
        return self.supervised(twin, *self.recorded(bench.name))
