"""The motor of a simulated DYNAMIXEL X servo, and its table in a scenario (ROBOTIS e-manual, XM430-W350).

Position control with a profile (Drive Mode velocity-based): Profile Velocity 0 is no limit of speed, Profile
Acceleration 0 none of acceleration; a goal that comes on the way begins a new profile at the speed that the last one
had. The position controller is proportional as it comes, 800/128 PWM counts of 885 in a count of error; what the PWM
makes is the stall torque less the back EMF's part, 4.82 rad/s without load. Torque off: nothing drives, nothing brakes.
Not here: I, D and feed-forward gains, velocity, current and PWM modes, time-based profiles.

Bus Watchdog: with the torque on, no instruction for as long as it says stops the servo where it is; it then reads -1,
and goals are read-only until 0 is written to it.
"""

import math
import struct
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Final, Literal

from pydantic import Field, PositiveFloat

from hil_sim.devices.canopen.servo_loop import ServoLoop
from hil_sim.devices.emulator import Bench, Equivalent, JointEmulator, Twin
from hil_sim.devices.serial_line.dynamixel import BAUD_RATES, COUNTS, DynamixelTwin, asks
from hil_sim.faults import NO_FAULTS, DeviceFaults
from hil_sim.plants.drives.servo_axis import AxisAngle, AxisTorque, DriveJoint
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.controller_sensors import MotorTorqueSensor
from hil_sim.sensing.sensors import EncoderSensor

_VELOCITY_RAD_S: Final = 0.229 * math.tau / 60.0
_ACCELERATION_RAD_S2: Final = 214.577 * math.tau / 3600.0
_POSITION, _EXTENDED = 3, 4
_NO_LIMIT: Final = 1e6  # rad/s, rad/s2
_STALL_A: Final = 2.3  # at 12 V
_FREE_RAD_S: Final = 46.0 * math.tau / 60.0
_FINER: Final = 256  # steps of a sensor in a count: the servo rounds, after its noise
_FULL_PWM, _GAIN_UNIT = 885.0, 128.0
_OUT_OF_RANGE, _LIMIT = 4, 6
_TRIPPED: Final = 0xFF
_WATCHDOG_NS: Final = 20_000_000
_IN_POSITION: Final = 20  # counts; the manual does not say how near that is


class DynamixelServo(DynamixelTwin):
    """One servo and the axis that it turns.

    Args:
        axis: What it turns.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        sensed: What its current tells of the motor's torque at a time [N m], [s]; None: that torque.
        faults: What breaks.
        options: Of :class:`DynamixelTwin`.

    Raises:
        FaultError: a fault that it cannot have.
    """

    def __init__(
        self,
        axis: DriveJoint,
        start_ns: int,
        *,
        sensed: Callable[[float, float], float] | None = None,
        faults: DeviceFaults = NO_FAULTS,
        **options: Any,
    ) -> None:
        self.axis = axis
        self._loop = ServoLoop(axis, axis.angle_rad)
        super().__init__(AxisAngle(axis), AxisTorque(axis, sensed), start_ns, faults=faults, **options)
        axis.controller = self._control

    @property
    def drive_state(self) -> int:
        """Torque Enable."""
        return self.memory[64]

    def _power_up(self, now_ns: int) -> None:
        super()._power_up(now_ns)
        self.memory[64] = 0
        struct.pack_into("<H", self.memory, 84, 800)

    def _lose_power(self, now_ns: int) -> None:
        self.axis.advance(self._seconds(now_ns))
        super()._lose_power(now_ns)

    def _heard_instruction(self, now_ns: int) -> None:
        self.axis.advance(self._seconds(now_ns))
        self._watch(now_ns)

    def _watch(self, now_ns: int) -> None:
        limit = self.memory[98]
        if self.memory[64] and 0 < limit < 128:
            self._at("watchdog", now_ns + limit * _WATCHDOG_NS, self._trip_watchdog)
        else:
            self._stop("watchdog")

    def _trip_watchdog(self, now_ns: int) -> None:
        self.axis.advance(self._seconds(now_ns))
        self.memory[98] = _TRIPPED
        self._stand(now_ns)

    def _stand(self, now_ns: int) -> None:
        """The goal is where it is."""
        self.measure(now_ns)
        self.memory[116:120] = self.memory[132:136]
        self._loop.stand()

    def measure(self, now_ns: int) -> None:
        """And whether it is at its goal, or on its way."""
        super().measure(now_ns)
        goal, position = (struct.unpack_from("<i", self.memory, at)[0] for at in (116, 132))
        self.memory[123] = (abs(goal - position) <= _IN_POSITION) | 2 * (self._loop.target is not None)

    def refuses(self, address: int, value: int) -> int:
        """A tripped servo takes no goals, one in position mode none beyond its limits."""
        if 100 <= address < 120 and address not in (108, 112) and self.memory[98] == _TRIPPED:
            return _OUT_OF_RANGE
        if address == 116 and self.memory[11] == _POSITION:
            most, least = struct.unpack_from("<ii", self.memory, 48)
            return 0 if least <= value <= most else _LIMIT
        return 0

    def changed(self, address: int, now_ns: int) -> None:
        """The servo goes on as its registers are now."""
        self.axis.advance(self._seconds(now_ns))
        if address == 11:
            self._turn = None  # within one turn again
        elif address == 64 and self.memory[64]:
            if self.memory[70] & self.memory[63]:
                self.memory[64] = 0  # until a reboot
                return
            if self.memory[11] == _POSITION:
                self._turn = 0 if self._turn is None else self._turn_of(now_ns)
            self._stand(now_ns)
        elif address == 116:
            self._loop.target = self._angle_of(struct.unpack_from("<i", self.memory, 116)[0])
        if address in (64, 98):
            self._watch(now_ns)

    def _turn_of(self, now_ns: int) -> int:
        """Counts that bring it into the first revolution now."""
        self.measure(now_ns)
        position: int = struct.unpack_from("<i", self.memory, 132)[0]
        return (self._turn or 0) + position // COUNTS * COUNTS

    def _angle_of(self, position: int) -> float:
        """Of the axis, rad."""
        return (position + (self._turn or 0) - self._zero) * math.tau / COUNTS / self._turns

    def _control(self, time_s: float, rate_rad_s: float) -> float | None:
        """Torque on the axis; see ``Controller``."""
        if not self.powered or not self.memory[64]:
            return 0.0
        velocity = struct.unpack_from("<I", self.memory, 112)[0] * _VELOCITY_RAD_S / abs(self._turns)
        acceleration = struct.unpack_from("<I", self.memory, 108)[0] * _ACCELERATION_RAD_S2 / abs(self._turns)
        self._loop.follow_profile(velocity or _NO_LIMIT, *(acceleration or _NO_LIMIT,) * 2)
        error = (self._loop.demand - self.axis.angle_rad(time_s)) * abs(self._turns) * COUNTS / math.tau
        gain: int = struct.unpack_from("<H", self.memory, 84)[0]
        pwm = min(max(gain / _GAIN_UNIT * error / _FULL_PWM, -1.0), 1.0)
        stall_n_m = _STALL_A * self._torque_n_m_a * abs(self._turns)
        return stall_n_m * (pwm - rate_rad_s * abs(self._turns) / _FREE_RAD_S)


class DynamixelTable(JointEmulator):
    """An XM430-W350 on a joint."""

    baud_rates: ClassVar[tuple[int, ...]] = BAUD_RATES
    has_clock = False
    turns_axis = True
    where = "ID {id}"

    kind: Literal["dynamixel"]
    id: Annotated[int, Field(ge=0, le=252)] = 1
    turns: PositiveFloat = 1.0
    zero_count: int = 2048
    torque_N_m_A: PositiveFloat = 1.78  # noqa: N815  (the newton's letter)
    firmware: Annotated[int, Field(ge=1, le=255)] = 45
    return_delay: Annotated[int, Field(ge=0, le=254)] = 250
    reversed_count: bool = False

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: its torque's errors are in shares of what the URDF allows the joint."""
        counts = said.get("counts_per_revolution", COUNTS)
        table = {
            "id": said.get("id", 1),
            "measures": name,
            "torque": f"{name}_torque",
            "at": said["joint"],
            "turns": counts / COUNTS,
            "zero_count": said.get("zero_count", 0),
            "torque_N_m_A": said.get("gain_N_m_A", 1.78) / (counts / COUNTS),
            "channels": [
                *(channel for channel in ("velocity", "torque") if said.get(channel)),
                *(["status"] if said.get("driven") else []),
            ],
            "reversed_count": said.get("gain", 1.0) < 0.0,
        }
        own = {**said, "counts_per_revolution": counts * _FINER}
        torque = sheets.torque(sheets.effort_n_m(said["joint"]), said)
        return Equivalent(table, {name: sheets.encoder(name, own), f"{name}_torque": torque}, {})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        options: dict[str, Any] = {
            "identifier": self.id,
            "turns": self.turns,
            "zero_count": self.zero_count,
            "torque_n_m_a": self.torque_N_m_A,
            "firmware": self.firmware,
            "return_delay": self.return_delay,
            "line": bench.line,
            "seed": bench.seed,
            "faults": bench.faults,
        }
        torque = bench.sensor(MotorTorqueSensor, "torque")
        if bench.axis is None:
            twin = DynamixelTwin(bench.sensor(EncoderSensor), torque, bench.start_ns, **options)
        else:
            options["turns"] *= -1.0 if self.reversed_count else 1.0
            twin = DynamixelServo(bench.axis, bench.start_ns, sensed=torque.measured, **options)
        return Twin(twin, lambda: twin.answered, self.recorded(bench.name), asks=asks)
