"""A mission: one world, its sensors, and the device twins that put them on the buses.

The physics is drawn from the seed alone: neither the start time nor the flight computer's polling changes a truth or a
noise sample. Twins are made by ``attach``, when the buses and the start time are known.
"""

import dataclasses
import tempfile
import zlib
from contextlib import ExitStack
from typing import Any

import numpy as np

from hil_sim.buses import CanBus, I2cBus, InProcess, PulseLine
from hil_sim.devices.arm_controller import ArmController
from hil_sim.devices.encoder406 import Encoder406
from hil_sim.devices.loadcell404 import LoadCell404
from hil_sim.devices.mpu6050 import Mpu6050
from hil_sim.devices.sync_box import SYNC_COB_ID, SyncBox
from hil_sim.faults import Fault, FaultPlan
from hil_sim.plant import Plant, mass_properties
from hil_sim.scenario import Scenario, ScenarioError, load
from hil_sim.sensors import DriftingClock, EncoderSensor, ImuSensor, LoadCellSensor

_VIRTUAL_START_NS = 100_000_000_000  # CLOCK_MONOTONIC of mission time 0 where no real clock says otherwise


class Mission:
    """Plant, sensors and twins of one scenario.

    Args:
        scenario: what is flown.
        seed: everything random comes from it.

    Attributes:
        plant: the world.
        faults: the scenario's ``[[fault]]`` tables.
        start_ns: ``CLOCK_MONOTONIC`` ns of mission time 0 (power-up of all devices); set by ``attach``.
        now_ns: up to when the mission has been advanced.

    Raises:
        ScenarioError: a ``[[fault]]`` table that is no fault.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario = scenario
        self.seed = seed
        self.plant = Plant(scenario, self._rng("rocket"))
        self.imu = ImuSensor(self.plant, scenario.imu, self._rng("imu_base"))
        self.encoder = EncoderSensor(self.plant, scenario.encoder, self._rng("joint_1"))
        self.load_cell = LoadCellSensor(self.plant, scenario.load_cell, self._rng("load_cell"))
        clocks = scenario.clock
        self._imu_clock = DriftingClock.draw(clocks.imu_base, self._rng("clock.imu_base"))
        self._imu_rc_clock = DriftingClock.draw(clocks.imu_base_rc, self._rng("clock.imu_base_rc"))
        self._sync_clock = DriftingClock.draw(clocks.sync_box, self._rng("clock.sync_box"))
        self.faults = tuple(_fault(table) for table in scenario.fault)
        self.start_ns = _VIRTUAL_START_NS
        self.now_ns = self.start_ns
        self._attached: _Twins | None = None
        self._resources = ExitStack()

    def _rng(self, subsystem: str) -> np.random.Generator:
        """A stream of its own per subsystem: adding one leaves the others as they are."""
        key = zlib.crc32(subsystem.encode())
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=(key,))))

    @property
    def end_ns(self) -> int:
        """``CLOCK_MONOTONIC`` ns of the end of the sequence."""
        return self.start_ns + round(1e9 * self.plant.program.duration_s)

    @property
    def finished(self) -> bool:
        """True once advanced to the end."""
        return self.now_ns >= self.end_ns

    def attach(self, *, i2c: I2cBus, can: CanBus, pulse: PulseLine, start_ns: int = _VIRTUAL_START_NS) -> None:
        """Make the devices, plug them into the buses, and power them all up at ``start_ns``.

        Raises:
            FaultError: a fault that its device cannot have, or of a device that is not there.
            RuntimeError: attached before; a mission is flown once.
        """
        if self._attached is not None:
            raise RuntimeError("this mission is attached already; make a new Mission for another run")
        self.start_ns = self.now_ns = start_ns
        plan = FaultPlan(self.faults, start_ns)
        encoder, cell = self.scenario.encoder, self.scenario.load_cell
        imu = Mpu6050(
            self.imu,
            dataclasses.replace(self._imu_clock, start_ns=start_ns),
            start_ns,
            faults=plan.of("imu_base"),
            rc_clock=dataclasses.replace(self._imu_rc_clock, start_ns=start_ns),
        )
        sync_box = SyncBox(
            dataclasses.replace(self._sync_clock, start_ns=start_ns), start_ns, faults=plan.of("sync_box")
        )
        joint = Encoder406(
            1,
            self.encoder,
            start_ns,
            zero_count=encoder.zero_count,
            counts_per_revolution=encoder.counts_per_revolution,
            faults=plan.of("joint_1"),
        )
        load_cell = LoadCell404(2, self.load_cell, start_ns, capacity_n=cell.capacity_N, faults=plan.of("load_cell"))
        arm = ArmController(3, self.plant.program.phase_changes, start_ns, faults=plan.of("arm_phase"))
        i2c.add(imu)
        for node in (sync_box, joint, load_cell, arm):
            can.add(node)
        sync_box.connect_pin(imu.fsync)
        sync_box.connect_pin(pulse.edge)
        i2c.inject(plan.of("i2c_1"))
        can.inject(plan.of("can_0"))
        pulse.inject(plan.of("sync_line"))
        plan.check_all_taken()
        self._attached = _Twins(i2c, can, pulse, imu, sync_box, joint, load_cell, arm)

    def advance(self, now_ns: int) -> None:
        """Everything that happens up to ``now_ns``: physics first, then frames and edges in the order of the wires.

        Raises:
            RuntimeError: not attached.
        """
        twins = self._twins()
        self.plant.advance(1e-9 * (now_ns - self.start_ns))
        self.now_ns = now_ns
        twins.can.advance(now_ns)
        twins.i2c.advance(now_ns)
        twins.pulse.advance(now_ns)

    def produced(self) -> dict[str, int]:
        """Samples made so far, per channel of the flight log.

        The IMU's count from the first to the last meant for its FIFO; SYNCs and edges, which are sent whether or not
        anybody listens, from when the flight computer opened the bus.
        """
        twins = self._twins()
        return {
            "imu_base": twins.imu.sampled,
            "joint_1": twins.joint.produced,
            "load_cell": twins.load_cell.produced,
            "arm_phase": twins.arm.produced,
            "can_sync": twins.can.heard[SYNC_COB_ID],
            "pulse": twins.pulse.heard,
        }

    def truth(self) -> dict[str, Any]:
        """What an estimate is to be compared with: scalars, lists and arrays, SI units, frame 3 where one matters."""
        held, free = (mass_properties(self.scenario, with_tip=tip) for tip in (True, False))
        program = self.plant.program
        return {
            "scenario": self.scenario.scenario.name,
            "seed": self.seed,
            "m4_kg": free.mass_kg,
            "m5_kg": held.mass_kg - free.mass_kg,
            "m4_plus_m5_kg": held.mass_kg,
            "ZZ_with_tip_kg_m2": float(held.inertia_kg_m2[2, 2]),
            "ZZ_without_tip_kg_m2": float(free.inertia_kg_m2[2, 2]),
            "first_moment_with_tip_kg_m": held.first_moment_kg_m,
            "first_moment_without_tip_kg_m": free.first_moment_kg_m,
            "inertia_with_tip_kg_m2": held.inertia_kg_m2,
            "inertia_without_tip_kg_m2": free.inertia_kg_m2,
            "phases": [span._asdict() for span in program.spans],
            "ejection_s": program.ejection_s,
            "duration_s": program.duration_s,
            "start_ns": self.start_ns,
            "imu_base": self.imu.truth(),
            "joint_1": self.encoder.truth(),
            "load_cell": self.load_cell.truth(),
            "clock": {
                "imu_base": _clock_truth(self._imu_clock),
                "sync_box": _clock_truth(self._sync_clock),
            },
            "faults": [dataclasses.asdict(fault) for fault in self.faults],
        }

    def own(self, resources: ExitStack) -> None:
        """Take over what must be closed with the mission."""
        self._resources = resources

    def close(self) -> None:
        """Give the buses back."""
        self._resources.close()

    def __enter__(self) -> "Mission":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _twins(self) -> "_Twins":
        if self._attached is None:
            raise RuntimeError("no buses yet; call Mission.attach first")
        return self._attached


@dataclasses.dataclass(frozen=True)
class _Twins:
    i2c: I2cBus
    can: CanBus
    pulse: PulseLine
    imu: Mpu6050
    sync_box: SyncBox
    joint: Encoder406
    load_cell: LoadCell404
    arm: ArmController


def open_in_process(scenario: str | Scenario, seed: int) -> tuple[Mission, dict[str, str]]:
    """Tier T0: a mission on buses inside this process, its clock the mission's own ``now_ns``.

    Args:
        scenario: a packaged scenario's name, a path to a TOML file, or a scenario.
        seed: of everything random.

    Returns:
        The mission (close it when done; it is a context manager) and the URL of each bus.

    Raises:
        ScenarioError: the scenario cannot be used.
    """
    mission = Mission(load(scenario) if isinstance(scenario, str) else scenario, seed)
    with ExitStack() as stack:
        directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="hil_"))
        buses = stack.enter_context(InProcess(directory, lambda: mission.now_ns, seed=seed))
        mission.attach(i2c=buses.i2c, can=buses.can, pulse=buses.pulse, start_ns=mission.start_ns)
        mission.own(stack.pop_all())
    return mission, dict(buses.urls)


def _fault(table: dict[str, Any]) -> Fault:
    known = {field.name for field in dataclasses.fields(Fault)}
    unknown = sorted(table.keys() - known)
    if unknown:
        raise ScenarioError(f"a [[fault]] has no key {', '.join(unknown)}; its keys are {', '.join(sorted(known))}")
    missing = sorted({"kind", "device", "start_s"} - table.keys())
    if missing:
        raise ScenarioError(f"a [[fault]] lacks {', '.join(missing)}; add it")
    return Fault(**table)


def _clock_truth(clock: DriftingClock) -> dict[str, float]:
    return {"rate_error": clock.rate_error, "drift_per_s": clock.drift_per_s}
