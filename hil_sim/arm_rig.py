"""An arm whose joints are CiA 402 servo drives on one CAN bus with a SYNC producer: a world that set points move.

Nothing else of a vehicle is there. What a flight computer does to it, and what breaks, shows in how far each axis went.
"""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple, Protocol, Self

from hil_sim.buses.in_process import in_process
from hil_sim.buses.media import CanBus, PulseLine
from hil_sim.devices.canopen.servo402 import ServoDrive402
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.faults import NEVER, DeviceFaults, Fault, FaultPlan
from hil_sim.plants.drives.servo_axis import DriveJoint, ServoAxis
from hil_sim.scenario.bus_tables import CanBusTable
from hil_sim.sensing.sensors import DriftingClock

BUS = "can_0"
START_NS = 100_000_000_000
_RATED_N_M = 10.0  # of a motor, at the joint
_RATE_ERROR = 3e-5  # of the SYNC producer


class RigMotor(NamedTuple):
    """One joint of the rig.

    Attributes:
        name: Of the drive, for its faults.
        node: Its node number.
        angle_rad: Where it stands at first.
        counts: Increments in a revolution of the joint.
        zero: Increments at angle zero.
        reversed_count: It counts against the joint.
        torque_n_m: Of the motor, at the joint.
        inertia_kg_m2: Of what it moves.
        gear_ratio: Revolutions of the motor in one of the joint.
    """

    name: str
    node: int
    angle_rad: float = 0.0
    counts: int = 500_000
    zero: int = 0
    reversed_count: bool = False
    torque_n_m: float = 30.0
    inertia_kg_m2: float = 1.0
    gear_ratio: float = 1.0


class Wired(NamedTuple):
    """A drive and the joint of a vehicle that it moves; its other fields are those of :class:`RigMotor`."""

    name: str
    joint: str
    node: int
    counts: int
    zero: int = 0
    reversed_count: bool = False
    gear_ratio: float = 1.0


def _alone(motor: RigMotor | Wired) -> DriveJoint:
    assert isinstance(motor, RigMotor), "a drive of a vehicle moves an axis of the vehicle"
    torque = motor.torque_n_m
    return ServoAxis(motor.angle_rad, inertia_kg_m2=motor.inertia_kg_m2, torque_n_m=torque, brake_n_m=torque)


def drive_of(motor: RigMotor | Wired, axis: DriveJoint, start_ns: int, faults: DeviceFaults) -> ServoDrive402:
    """The drive of a motor that moves ``axis``.

    Raises:
        FaultError: a fault that it cannot have.
    """
    return ServoDrive402(
        motor.node,
        axis,
        start_ns,
        increments_per_revolution=motor.counts,
        zero_increments=motor.zero,
        reversed_count=motor.reversed_count,
        rated_torque_nm=_RATED_N_M / abs(motor.gear_ratio),
        gear_ratio=motor.gear_ratio,
        faults=faults,
    )


class ServoOnBus(Protocol):
    """A drive, of whatever kind, and the axis that it moves."""

    axis: DriveJoint

    @property
    def drive_state(self) -> int:
        """Of its state machine, or Torque Enable."""


def travels(drives: Mapping[str, ServoOnBus]) -> dict[str, dict[str, float | str]]:
    """Where the joint of each drive has been (rad), how fast it was and is (rad/s), and the drive's state."""
    return {
        name: {
            "lowest_rad": drive.axis.lowest_rad,
            "highest_rad": drive.axis.highest_rad,
            "fastest_rad_s": drive.axis.fastest_rad_s,
            "rate_rad_s": drive.axis.rate_rad_s,
            "state": f"{drive.drive_state:02X}h",
        }
        for name, drive in drives.items()
    }


class Arm:
    """The arm, to be put on a bus.

    Args:
        motors: Its joints.
        faults: By the names of the motors, and ``sync_box``.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up.
        period_ns: SYNC period.
        end_ns: Until when it is there.
        axes: The joints, by name, where they are those of a vehicle; else each is a rigid body of its own.

    Attributes:
        axes: Where the joints truly are, by name.
        drives: Their drives, by name.
        box: The SYNC producer.

    Raises:
        FaultError: a fault that its device cannot have.
    """

    def __init__(
        self,
        motors: Sequence[RigMotor | Wired],
        plan: FaultPlan,
        start_ns: int,
        period_ns: int,
        end_ns: int = NEVER,
        axes: Mapping[str, DriveJoint] | None = None,
    ) -> None:
        self.start_ns, self.now_ns, self.end_ns = start_ns, start_ns, end_ns
        self.axes: dict[str, DriveJoint] = {}
        self.drives: dict[str, ServoDrive402] = {}
        for motor in motors:
            axis = self.axes[motor.name] = _alone(motor) if axes is None else axes[motor.name]
            self.drives[motor.name] = drive_of(motor, axis, start_ns, plan.of(motor.name))
        clock = DriftingClock(start_ns, _RATE_ERROR, 0.0)
        self.box = SyncBox(clock, start_ns, period_ns=period_ns, faults=plan.of("sync_box"))
        self._buses: list[CanBus | PulseLine] = []

    @property
    def finished(self) -> bool:
        """Whether it has been advanced to its end."""
        return self.now_ns >= self.end_ns

    def plug(self, bus: CanBus, line: PulseLine | None = None) -> None:
        """Connect SYNC producer and drives to a bus, and the sync pulse to a line."""
        bus.add(self.box)
        for drive in self.drives.values():
            bus.add(drive)
        self._buses = [bus]
        if line is not None:
            self.box.connect_pin(line.edge)
            self._buses.append(line)

    def advance(self, now_ns: int) -> None:
        """Everything that happens up to ``now_ns``."""
        self.now_ns = now_ns
        for bus in self._buses:
            bus.advance(now_ns)
        for axis in self.axes.values():
            axis.advance(1e-9 * (now_ns - self.start_ns))


class ArmRig(Arm):
    """The arm on a bus in this process, in virtual time. A context manager.

    Args:
        motors: Its joints.
        faults: By the names of the motors, ``sync_box`` and the bus, ``can_0``.
        period_ns: SYNC period.
        seed: Of the stamps' jitter.
        axes: See :class:`Arm`.

    Attributes:
        now_ns: Up to when it was advanced; the flight computer's clock.
        url: Of its bus.

    Raises:
        FaultError: a fault that its device cannot have.
    """

    def __init__(
        self,
        motors: Sequence[RigMotor | Wired],
        faults: Iterable[Fault] = (),
        *,
        period_ns: int = 5_000_000,
        seed: int = 0,
        axes: Mapping[str, DriveJoint] | None = None,
    ) -> None:
        plan = FaultPlan(faults, START_NS)
        super().__init__(motors, plan, START_NS, period_ns, axes=axes)
        with ExitStack() as stack:
            directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="hil_"))
            table = {BUS: CanBusTable(kind="can", bit_rate=1_000_000)}
            ports = stack.enter_context(in_process(table, Path(directory), lambda: self.now_ns, name="arm", seed=seed))
            self.url = ports.urls[BUS]
            bus = ports.buses[BUS]
            assert isinstance(bus, CanBus)
            self.plug(bus)
            bus.inject(plan.of(BUS))
            plan.check_all_taken()
            self._resources = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()
