"""A vehicle with all of its sensors and with servo drives in its joints, in one world.

What a flight computer commands moves the arm, the arm moves the base, and IMU, load cell and drives feel it. Base,
arm, payload, release and posture are those that the same scenario and seed fly. No motion is known beforehand: MuJoCo
steps (1 ms) as the drives are commanded. Sensors interpolate between rows around their time, so the plant stands a few
rows ahead of the devices, and the drives' loops run ``LATE_S`` behind it: what a drive is sent, and what its encoder
says to its loop, reaches the motor so much later. A payload is held from the start; captures, ejections and servos of
the scenario are not flown here.
"""

from collections.abc import Iterable, Mapping, Sequence

import mujoco
import numpy as np

from hil_sim.arm_rig import ServoOnBus, Wired, drive_of
from hil_sim.arrays import FloatArray
from hil_sim.buses.media import Bus, CanBus
from hil_sim.faults import Fault, FaultPlan
from hil_sim.mission import VIRTUAL_START_NS, Mission
from hil_sim.plants.drives.driven_vehicle import Drivable, DrivenJoint, DrivenVehicle
from hil_sim.plants.drives.servo_axis import STEP_S, Controller, DriveJoint
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.plants.world import Plant
from hil_sim.scenario.load import Scenario
from hil_sim.scenario.tables import ScenarioError

LATE_S = 5.0 * STEP_S  # the plant is four to five rows ahead of the devices: no loop may act before its command


class _LateJoint(DrivenJoint):
    """A joint whose drive's loop has times of ``LATE_S`` ago."""

    @property
    def newest_s(self) -> float:
        """Time that the drive's loop has reached."""
        return super().newest_s - LATE_S


def late(controller: Controller) -> Controller:
    """A drive's loop, ``LATE_S`` behind the plant."""
    return lambda time_s, rate_rad_s: controller(time_s - LATE_S, rate_rad_s)


class _Watched(DrivenVehicle):
    """A driven vehicle that writes what it felt at each step into the rows of its plant."""

    def __init__(self, built: Drivable, plant: "DrivenPlant") -> None:
        self._plant = plant
        super().__init__(built)
        self.axes = {
            name: _LateJoint(self, place, axis.largest_n_m, axis.inertia_kg_m2)
            for place, (name, axis) in enumerate(self.axes.items())
        }

    def _step(self) -> None:
        row, angles, rates = self._count, self.angles_rad, self.rates_rad_s
        super()._step()
        self._plant.felt(row, self.data.sensordata, angles, rates)  # sensors are of the step's begin


class DrivenPlant(VehiclePlant):
    """The vehicle, to be moved by its drives.

    Args:
        scenario: the mission; of its motion only the posture and the length count.
        rng: see ``VehiclePlant``.

    Attributes:
        vehicle: joints for the drives, by name in its ``axes``.

    Raises:
        ScenarioError: a prescribed base, or a number that cannot be simulated.
    """

    def __init__(self, scenario: Scenario, rng: np.random.Generator) -> None:
        if scenario.capture is not None or scenario.ejection is not None or scenario.servo:
            raise ScenarioError("drives move a vehicle that holds its payload: take capture, ejection and servo out")
        physics = scenario.physics.model_copy(update={"step_us": 1e6 * STEP_S, "chunk_steps": 1})
        self.vehicle: _Watched | None = None
        super().__init__(scenario.model_copy(update={"physics": physics}), rng)
        self.vehicle = _Watched(self.driven(), self)
        if self.payload is not None:
            self.vehicle.capture()
        for axis, inertia in zip(self.vehicle.axes.values(), self._felt_inertias(), strict=True):
            axis.inertia_kg_m2 = inertia

    def _felt_inertias(self) -> list[float]:
        """What each joint's drive has to turn, kg m^2, base and other joints as free as they are: 1 / (M^-1)_jj."""
        assert self.vehicle is not None
        model, data = self.vehicle.model, self.vehicle.data
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        found: list[float] = (1.0 / np.diag(np.linalg.inv(inertia)))[model.nv - len(self.joints) :].tolist()
        return found

    def felt(self, row: int, sensors: FloatArray, angles: list[float], rates: list[float]) -> None:
        """What there is at a row; nothing after the last."""
        if row < self.rows:
            out = self.rows_true
            out.sensors[row], out.joints[row], out.rates[row] = sensors, angles, rates

    def _compute(self, rows: int) -> None:
        """Steps up to so many rows."""
        if self.vehicle is None:  # nothing is computed beforehand
            return
        self.vehicle.advance((rows - 1) * STEP_S)
        done = slice(self._filled, min(rows, self.rows))
        for made_of, made in self._live:
            made_of[done] = made(done)
        self._filled = done.stop

    def _make(self, until: int) -> None:
        """Nothing is interpolated."""


class DrivenFlight(Mission):
    """The vehicle.

    Args:
        scenario: of a vehicle of one's own; of its motion only the posture and the length count.
        seed: of everything drawn.
        wired: its CiA 402 drives, in place of the devices of their names.
        can: name of their bus.
        driven: joints of its devices of other kinds that are drives, by device.
        faults: by the names of the devices, the drives among them, and of the buses.

    Attributes:
        drives: by name, once attached.

    Raises:
        ScenarioError: a scenario without a joint that is wired, or of a prescribed base.
        FaultError: a fault that its device cannot have.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        wired: Sequence[Wired],
        can: str,
        faults: Iterable[Fault] = (),
        driven: Mapping[str, str] | None = None,
    ) -> None:
        self._wired, self._can, names = tuple(wired), can, {drive.name for drive in wired}
        self._driven = driven or {}
        all_faults = tuple(faults)
        self._of_drives = [fault for fault in all_faults if fault.device in names]
        others = {name: table for name, table in scenario.device.items() if name not in names}
        rest = [fault for fault in all_faults if fault.device not in names]
        super().__init__(scenario.model_copy(update={"device": others}), seed, rest)
        self.drives: dict[str, ServoOnBus] = {}

    def _plant(self) -> Plant:
        return DrivenPlant(self.scenario, self._rng("vehicle"))

    def _axes(self) -> Mapping[str, DriveJoint]:
        return {name: self._axis(joint) for name, joint in self._driven.items()}

    def _axis(self, joint: str) -> DriveJoint:
        assert isinstance(self.plant, DrivenPlant)
        assert self.plant.vehicle is not None
        return self.plant.vehicle.axes[joint]

    def ask(self, segment: str) -> bool:
        """See ``Mission``: the arm moves by its drives, which the flight computer commands itself."""
        del segment
        return True

    def attach(self, buses: Mapping[str, Bus], start_ns: int = VIRTUAL_START_NS) -> None:
        """See ``Mission``; the drives are on their bus too."""
        super().attach(buses, start_ns)
        assert self._twins is not None
        self.drives = {name: self._twins.devices[name] for name in self._driven}
        plan = FaultPlan(self._of_drives, self.start_ns)
        for drive in self._wired:
            bus = buses[self._can]
            if not isinstance(bus, CanBus):
                raise ScenarioError(f"bus.{self._can} is no CAN bus; drives are on CAN")
            servo = drive_of(drive, self._axis(drive.joint), self.start_ns, plan.of(drive.name))
            self.drives[drive.name] = servo
            bus.add(servo)
        for one in self.drives.values():
            one.axis.controller = None if one.axis.controller is None else late(one.axis.controller)
        plan.check_all_taken()

    def advance(self, now_ns: int) -> None:
        """See ``Mission``; step by step, so that no set point waits for a slow loop around this world."""
        step_ns = round(1e9 * STEP_S)
        for at_ns in range(self.now_ns + step_ns, now_ns, step_ns):
            super().advance(at_ns)
        super().advance(now_ns)
