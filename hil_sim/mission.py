"""A mission: one world, its sensors, and the device twins that put them on the buses.

The physics is drawn from the seed alone: neither the start time nor the flight computer's polling changes a truth or a
noise sample. Twins are made by ``attach``, when the buses and the start time are known.
"""

import dataclasses
import tempfile
import zlib
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from hil_sim.buses.in_process import in_process
from hil_sim.buses.media import Bus, CanBus, PulseLine
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.faults import NEVER, Fault, FaultError, FaultKind, FaultPlan
from hil_sim.plants.drives.servo_axis import DriveJoint
from hil_sim.plants.planned import Planned, planned
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.plants.world import Plant
from hil_sim.scenario.load import Scenario, ScenarioError
from hil_sim.scenario.vehicle_tables import SequenceStep
from hil_sim.sensing.sensors import DriftingClock, ImuSensor, LoadCellSensor
from hil_sim.twins import Sensor, Twins, emulators, sensor

_AHEAD_S = 1.0  # in virtual time
_AHEAD_ASKED_S = 0.1  # where what the flight computer asks for is to come soon
_KEPT_S = 60.0  # of the truth, before where all devices stand, and as long as an input's reading may be delayed
VIRTUAL_START_NS = 100_000_000_000  # CLOCK_MONOTONIC of mission time 0 where no real clock says otherwise


class Mission:
    """Plant, sensors and twins of one scenario.

    Args:
        scenario: what is flown.
        seed: everything random comes from it.
        faults: besides those of the scenario.
        linger_s: how long all devices stay on after the sequence, the arm at rest in the last phase.

    Attributes:
        scenario: as above, with that rest as the last step of its sequence.
        plant: the world.
        sensors: what the devices measure with, by signal.
        faults: the scenario's ``[[fault]]`` tables, and those given.
        start_ns: ``CLOCK_MONOTONIC`` ns of mission time 0 (power-up of all devices); set by ``attach``.
        now_ns: up to when the mission has been advanced.
        ahead_s: how far the plant is computed beyond that at a time; 0 on the real clock, so that no device is late.

    Raises:
        ScenarioError: a device that is none, a ``[[fault]]`` table that is no fault, or a place in the plant that is
            not there.
        FaultError: a fault that would begin after the end of the mission.
    """

    def __init__(self, scenario: Scenario, seed: int, faults: Iterable[Fault] = (), *, linger_s: float = 0.0) -> None:
        self.scenario = _lingering(scenario, linger_s) if linger_s else scenario
        self._linger_s = linger_s
        self.seed = seed
        self._devices = emulators(scenario)
        self.plant = self._plant()
        self.sensors: dict[str, Sensor] = {}
        self._clocks: dict[str, DriftingClock] = {}
        for name, device in self._devices.items():
            for signal, (table, _, at) in device.signals(name).items():
                self.sensors[signal] = sensor(self.plant, scenario.sensor[table], self._rng(signal), at)
            for clock in device.clocks(name):
                self._clocks[clock] = DriftingClock.draw(scenario.clock[clock], self._rng(f"clock.{clock}"))
        self.faults = (*(_fault(table) for table in scenario.fault), *faults)
        self._require_in_time()
        delays = [fault.value for fault in self.faults if fault.kind is FaultKind.DELAYED]
        self._kept_s = _KEPT_S + max([0.0, *delays])
        self.start_ns = VIRTUAL_START_NS
        self.now_ns = self.start_ns
        self.ahead_s = 0.0
        self._twins: Twins | None = None
        self._plan: FaultPlan | None = None
        self._buses: list[Bus] = []
        self._resources = ExitStack()

    def _require_in_time(self) -> None:
        duration_s = self.duration_s
        for fault in self.faults:
            if fault.start_s >= duration_s:
                said = f"Fault {fault.kind} of {fault.device} begins at {fault.start_s:g} s"
                raise FaultError(f"{said}, and the mission ends at {duration_s:g} s; give an earlier start.")

    def _plant(self) -> Plant:
        return VehiclePlant(self.scenario, self._rng("vehicle"))

    def _rng(self, subsystem: str) -> np.random.Generator:
        """A stream of its own per subsystem: adding one leaves the others as they are."""
        key = zlib.crc32(subsystem.encode())
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=(key,))))

    @property
    def duration_s(self) -> float:
        """Of the sequence."""
        return self.plant.program.duration_s - self._linger_s

    @property
    def end_ns(self) -> int:
        """``CLOCK_MONOTONIC`` ns at which the devices end."""
        return self.start_ns + round(1e9 * self.plant.program.duration_s)

    @property
    def finished(self) -> bool:
        """True once advanced to the end."""
        return self.now_ns >= self.end_ns

    @property
    def undisturbed(self) -> bool:
        """Whether no device and no bus has a fault."""
        return not self.faults

    def attach(self, buses: Mapping[str, Bus], start_ns: int = VIRTUAL_START_NS) -> None:
        """Make the devices, plug them into the buses, and power them all up at ``start_ns``.

        Args:
            buses: Those of the scenario, by name.
            start_ns: ``CLOCK_MONOTONIC`` ns of mission time 0.

        Raises:
            ScenarioError: a device that cannot be as its table says.
            FaultError: a fault that its device cannot have, or of a device that is not there.
            RuntimeError: attached before; a mission is flown once.
        """
        if self._twins is not None:
            raise RuntimeError("this mission is attached already; make a new Mission for another run")
        self.start_ns = self.now_ns = start_ns
        plan = self._plan = FaultPlan(self.faults, start_ns)
        clocks = {name: dataclasses.replace(clock, start_ns=start_ns) for name, clock in self._clocks.items()}
        drawn = start_ns, self.seed
        self._twins = Twins(self.scenario, self._devices, buses, self.sensors, clocks, plan.of, *drawn, self._axes())
        plan.check_all_taken()
        # the sync box first: what its pulse reaches may not be ahead of it
        can, lines = ([b for b in buses.values() if isinstance(b, kind)] for kind in (CanBus, PulseLine))
        self._buses = [*can, *lines, *(b for b in buses.values() if not isinstance(b, CanBus | PulseLine))]

    def _axes(self) -> Mapping[str, DriveJoint]:
        """Joints of the drives that the flight computer commands, by device."""
        return {}

    def known_ns(self) -> int:
        """``CLOCK_MONOTONIC`` ns before which the plant is computed."""
        if self.plant.count >= self.plant.rows:
            return NEVER
        return self.start_ns + int(1e9 * (self.plant.count - 4) * self.plant.step_s)

    def advance(self, now_ns: int) -> None:
        """Everything that happens up to ``now_ns``: physics first, then frames and edges in the order of the wires.

        Raises:
            RuntimeError: not attached.
        """
        if self._twins is None:
            raise RuntimeError("no buses yet; call Mission.attach first")
        self.forget()
        self.plant.advance(1e-9 * (now_ns - self.start_ns), self.ahead_s)
        self.now_ns = now_ns
        for bus in self._buses:
            bus.advance(now_ns)

    def forget(self) -> None:
        """Give back the truth that no device asks for any more."""
        before = int((1e-9 * (self.now_ns - self.start_ns) - self._kept_s) / self.plant.step_s)
        if before > 0:
            self.plant.forget(before)
            for sensor in self.sensors.values():
                if isinstance(sensor, ImuSensor | LoadCellSensor):
                    sensor.forget(before)

    def produced(self) -> dict[str, int]:
        """Samples made so far, per channel of the flight log.

        The IMU's count from the first to the last meant for its FIFO, or read out of its registers as new; those of a
        device that talks unasked on a serial line, SYNCs and edges, which come whether or not anybody listens, while
        the flight computer had the bus open; a device that is asked is meant to make one for each question.

        Raises:
            RuntimeError: not attached.
        """
        if self._twins is None:
            raise RuntimeError("no buses yet; call Mission.attach first")
        return self._twins.produced()

    def ask(self, segment: str) -> bool:
        """The flight computer asks for a motion; False where the arm cannot play it now."""
        return isinstance(self.plant, VehiclePlant) and self.plant.ask(segment)

    def possible_faults(self) -> dict[str, tuple[FaultKind, ...]]:
        """Kinds of faults that each device and bus can have, by its name.

        Raises:
            RuntimeError: not attached.
        """
        if self._plan is None:
            raise RuntimeError("no buses yet; call Mission.attach first")
        return self._plan.possible()

    def truth(self) -> dict[str, Any]:
        """What an estimate is to be compared with: the plant's truth, and what else was drawn."""
        program = self.plant.program
        return {
            "scenario": self.scenario.scenario.name,
            "published": self.scenario.scenario.published,
            "seed": self.seed,
            **self.plant.truth(),
            "phases": [span._asdict() for span in program.spans],
            "duration_s": self.duration_s,
            "start_ns": self.start_ns,
            **{name: sensor.truth() for name, sensor in self.sensors.items()},
            "clock": {name: _clock_truth(clock) for name, clock in self._clocks.items()},
            "faults": [dataclasses.asdict(fault) for fault in self.faults],
        }

    def planned(self, period_s: float) -> Planned | None:
        """What is known of the motion before it is flown, on a grid; None of a bench, and of parabolas.

        Args:
            period_s: of the grid.
        """
        if not isinstance(self.plant, VehiclePlant) or self.scenario.parabolas is not None:  # let go at an unknown time
            return None
        joints = tuple(joint.name for joint in self.plant.joints)
        return planned(self.scenario, self.plant.program, joints, period_s)

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


def open_in_process(
    scenario: str | Scenario, seed: int, faults: Iterable[Fault] = ()
) -> tuple[Mission, dict[str, str]]:
    """Tier T0: a mission on buses inside this process, its clock the mission's own ``now_ns``.

    Args:
        scenario: a packaged scenario's name, a path to a scenario's or a vehicle's TOML file, or a scenario.
        seed: of everything random.
        faults: besides those of the scenario.

    Returns:
        The mission (close it when done; it is a context manager) and the URL of each bus.

    Raises:
        ScenarioError: the scenario cannot be used.
        FaultError: a fault that its device cannot have, or of a device that is not there.
    """
    mission = Mission(scenario_of(scenario) if isinstance(scenario, str) else scenario, seed, faults)
    waits = isinstance(mission.plant, VehiclePlant) and mission.plant.program.waits
    mission.ahead_s = _AHEAD_ASKED_S if waits else _AHEAD_S
    with ExitStack() as stack:
        directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="hil_"))
        tables = mission.scenario.bus
        ports = stack.enter_context(in_process(tables, Path(directory), lambda: mission.now_ns, seed=seed))
        mission.attach(ports.buses, mission.start_ns)
        for bus in ports.buses.values():
            if isinstance(bus, CanBus):
                bus.know_ahead(mission.known_ns)
        mission.own(stack.pop_all())
    return mission, ports.urls


def _lingering(scenario: Scenario, linger_s: float) -> Scenario:
    rest = SequenceStep(phase=scenario.sequence[-1].phase, action="hold", duration_s=linger_s)
    return scenario.model_copy(update={"sequence": (*scenario.sequence, rest)})


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
