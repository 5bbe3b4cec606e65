"""Calibration benches with the devices of a scenario: the twins measure what :mod:`hil_sim.plants.bench` does.

The instruments of a seed are those that fly with that seed, and so is the body that swings or is weighed.
"""

import tempfile
import zlib
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.buses.in_process import in_process
from hil_sim.devices import registry
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import Mission
from hil_sim.plants import bench, urdf_drawing
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.plants.world import Plant
from hil_sim.scenario.load import Scenario, ScenarioError
from hil_sim.scenario.sensor_tables import ForceCellTable
from hil_sim.scenario.vehicle_tables import SequenceStep

KINDS = ("imu", "load-cell", "encoder", "bifilar", "balance", "weigh")
LATITUDE_deg = bench.LATITUDE_deg
_STILL = SequenceStep(phase=0, action="hold", duration_s=0.1)
_FAR_rad = 2.5  # of a joint from its zero: its cable
SPACING_SIGMA_m, LENGTH_SIGMA_m = 1e-4, 3e-4  # of strings that were measured with a rule


class BenchMission(Mission):
    """A mission that stands on a bench.

    Args:
        kind: one of :data:`KINDS`.
        scenario: whose devices are there.
        seed: of everything random.
        settings: arguments of the bench, by name.

    Raises:
        ScenarioError: the scenario has no body that could be weighed, or no such bench.
    """

    def __init__(self, kind: str, scenario: Scenario, seed: int, settings: Mapping[str, Any]) -> None:
        if kind not in KINDS:
            raise ScenarioError(f"there is no bench {kind!r}; there are {', '.join(KINDS)}")
        self._kind, self._settings = kind, settings
        super().__init__(scenario, seed)

    def _plant(self) -> Plant:
        rng, given = self._rng(f"bench.{self._kind}"), dict(self._settings)
        if self._kind == "weigh":
            return self._in_poses(rng, **given)
        axis, turn = _cell_axis(self.scenario), lambda at: np.eye(3)
        if self._kind == "imu":
            signals = bench.turntable(rng, **given)
        elif self._kind == "load-cell":
            signals = bench.masses(rng, **given)
        elif self._kind == "encoder":
            signals = bench.stops(rng, **given)
        elif self._kind == "bifilar":
            strings = bench.Strings(
                given.pop("spacing_m") + SPACING_SIGMA_m * rng.standard_normal(),
                given.pop("length_m") + LENGTH_SIGMA_m * rng.standard_normal(),
            )
            standing = self._standing()
            signals, turn = bench.bifilar(rng, standing.base, strings, **given), standing.turn
        else:
            standing = self._standing()
            signals, turn = bench.balance(rng, standing.base, **given), standing.turn
        return bench.BenchPlant(signals, axis, turn)

    def _in_poses(self, rng: np.random.Generator, poses: int = 60, move_s: float = 2.5, rest_s: float = 4.0) -> Plant:
        """The arm with what it holds goes from pose to pose, and rests in each."""
        if self.scenario.vehicle.base != "fixed":
            raise ScenarioError(f"{self.scenario.scenario.name} has no arm on a fixed base that could turn a wrist")
        joints = urdf_drawing.read(self.scenario.vehicle.urdf, self.scenario.vehicle.label).joints
        motion = self.scenario.motion.model_copy(update={"posture": dict.fromkeys(joints, 0.0), "posture_spread": 0.0})
        ways = [
            {
                name: float(rng.uniform(*np.clip((one.low, one.high), -_FAR_rad, _FAR_rad)))
                for name, one in joints.items()
            }
            for _ in range(poses)
        ]
        steps = [
            SequenceStep.model_validate(
                {"phase": 1, "action": "push", "to": way, "approach_s": move_s, "hold_s": rest_s, "retreat_s": move_s}
            )
            for way in ways
        ]
        still = {"sequence": (_STILL, *steps), "capture": None, "ejection": None, "motion": motion}
        return VehiclePlant(self.scenario.model_copy(update=still), self._rng("vehicle"))

    def _standing(self) -> VehiclePlant:
        """The vehicle that flies with this seed, as it is built: it is not flown."""
        if self.scenario.vehicle.base != "free":
            raise ScenarioError(f"{self.scenario.scenario.name} has no free base that could be swung or weighed")
        still = {"sequence": (_STILL,), "capture": None, "ejection": None, "burn": (), "wrench": (), "parabolas": None}
        return VehiclePlant(self.scenario.model_copy(update=still), self._rng("vehicle"))


def _cell_axis(scenario: Scenario) -> FloatArray:
    axes = [table.axis for table in scenario.sensor.values() if isinstance(table, ForceCellTable)]
    return np.array(axes[0] if axes else (1.0, 0.0, 0.0))


def part_readings(scenario: str | Scenario, seed: int, link: str, rig: Mapping[str, Any]) -> dict[str, Any]:
    """What edges and scales read of a link as it is built for the flight of this seed.

    Args:
        scenario: a mission by name, a path to a TOML file, or a scenario.
        seed: of everything random.
        link: that lies on them.
        rig: see :func:`hil_sim.plants.bench.part`.

    Raises:
        ScenarioError: no such link.
    """
    whole = scenario_of(scenario) if isinstance(scenario, str) else scenario
    plant = Mission(whole, seed).plant
    assert isinstance(plant, VehiclePlant)
    bodies = plant.bodies | ({} if plant.payload is None else {str(whole.vehicle.payload_link): plant.payload})
    if link not in bodies:
        raise ScenarioError(f"{whole.scenario.name} has no link {link!r}; it has {', '.join(bodies)}")
    rng = np.random.default_rng([seed, zlib.crc32(f"part.{link}".encode())])
    return bench.part(rng, bodies[link], rig)


def open_bench(
    kind: str, scenario: str | Scenario, seed: int, devices: set[str], settings: Mapping[str, Any]
) -> tuple[BenchMission, dict[str, str]]:
    """A bench on buses inside this process, its clock the mission's own ``now_ns``.

    Args:
        kind: one of :data:`KINDS`.
        scenario: a mission by name, a path to a TOML file, or a scenario.
        seed: of everything random.
        devices: that are there, by name; what sends SYNC on their CAN bus is too.
        settings: arguments of the bench, by name.

    Returns:
        The bench (close it when done; it is a context manager) and the URL of each bus.

    Raises:
        ScenarioError: the scenario cannot be used.
    """
    whole = scenario_of(scenario) if isinstance(scenario, str) else scenario
    buses = {table.model_dump().get("bus") for name, table in whole.device.items() if name in devices}
    kept = {n: table for n, table in whole.device.items() if n in devices or _sends_sync(table.model_dump(), buses)}
    ticking = {clock for name, one in registry.read(kept).items() for clock in one.clocks(name)}
    clocks = {name: table for name, table in whole.clock.items() if name in ticking}
    there = whole.model_copy(update={"device": kept, "clock": clocks, "fault": ()})
    stands = BenchMission(kind, there, seed, settings)
    with ExitStack() as stack:
        directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="hil_"))
        ports = stack.enter_context(in_process(whole.bus, Path(directory), lambda: stands.now_ns, seed=seed))
        stands.attach(ports.buses, stands.start_ns)
        stands.own(stack.pop_all())
    return stands, ports.urls


def _sends_sync(table: Mapping[str, Any], buses: set[Any]) -> bool:
    return "line" in table and table["bus"] in buses
