"""A vehicle with all of its sensors and with CiA 402 servo drives in its joints, in one world.

What a flight computer commands moves the arm, the arm moves the base, and IMU, load cell and drives feel it.
"""

from collections.abc import Iterable, Mapping, Sequence

from hil_sim.arm_rig import Wired, drive_of
from hil_sim.buses.media import Bus, CanBus
from hil_sim.devices.canopen.servo402 import ServoDrive402
from hil_sim.driven_plant import DrivenPlant, late
from hil_sim.faults import Fault, FaultPlan
from hil_sim.mission import VIRTUAL_START_NS, Mission
from hil_sim.plants.drives.servo_axis import STEP_S
from hil_sim.plants.world import Plant
from hil_sim.scenario.load import Scenario
from hil_sim.scenario.tables import ScenarioError


class DrivenFlight(Mission):
    """The vehicle.

    Args:
        scenario: of a vehicle of one's own; of its motion only the posture and the length count.
        seed: of everything drawn.
        wired: its drives, one for each joint that is driven; in place of the devices of their names.
        can: name of their bus.
        faults: by the names of the devices, the drives among them, and of the buses.

    Attributes:
        drives: by name, once attached.

    Raises:
        ScenarioError: a scenario without a joint that is wired, or of a base that moves as it is told.
        FaultError: a fault that its device cannot have.
    """

    def __init__(
        self, scenario: Scenario, seed: int, wired: Sequence[Wired], can: str, faults: Iterable[Fault] = ()
    ) -> None:
        self._wired, self._can, names = tuple(wired), can, {drive.name for drive in wired}
        all_faults = tuple(faults)
        self._of_drives = [fault for fault in all_faults if fault.device in names]
        others = {name: table for name, table in scenario.device.items() if name not in names}
        rest = [fault for fault in all_faults if fault.device not in names]
        super().__init__(scenario.model_copy(update={"device": others}), seed, rest)
        self.drives: dict[str, ServoDrive402] = {}

    def _plant(self) -> Plant:
        return DrivenPlant(self.scenario, self._rng("vehicle"))

    def ask(self, segment: str) -> bool:
        """See ``Mission``: the arm moves by its drives, which the flight computer commands itself."""
        del segment
        return True

    def attach(self, buses: Mapping[str, Bus], start_ns: int = VIRTUAL_START_NS) -> None:
        """See ``Mission``; the drives are on their bus too."""
        super().attach(buses, start_ns)
        assert isinstance(self.plant, DrivenPlant)
        assert self.plant.vehicle is not None
        bus, plan = buses[self._can], FaultPlan(self._of_drives, self.start_ns)
        if not isinstance(bus, CanBus):
            raise ScenarioError(f"bus.{self._can} is no CAN bus; drives are on one")
        for drive in self._wired:
            axis = self.plant.vehicle.axes[drive.joint]
            self.drives[drive.name] = drive_of(drive, axis, self.start_ns, plan.of(drive.name))
            bus.add(self.drives[drive.name])
            axis.controller = None if axis.controller is None else late(axis.controller)
        plan.check_all_taken()

    def advance(self, now_ns: int) -> None:
        """See ``Mission``; step by step, so that no set point waits for a slow loop around this world."""
        step_ns = round(1e9 * STEP_S)
        for at_ns in range(self.now_ns + step_ns, now_ns, step_ns):
            super().advance(at_ns)
        super().advance(now_ns)
