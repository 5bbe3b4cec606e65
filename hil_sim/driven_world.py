"""The vehicle of a scenario with CiA 402 servo drives in its joints, on one CAN bus in this process, in virtual time.

Base, arm, payload, release and posture are those that the same scenario and seed fly; its other devices are not here.
At first the gripper is empty.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from hil_sim.arm_rig import ArmRig, Wired
from hil_sim.faults import Fault
from hil_sim.mission import Mission
from hil_sim.plants.drives.driven_vehicle import DrivenVehicle
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.scenario.load import Scenario
from hil_sim.scenario.tables import ScenarioError


class DrivenWorld(ArmRig):
    """The vehicle. A context manager.

    Args:
        scenario: Whose it is.
        seed: Of everything drawn.
        wired: Its drives, one for each joint.
        faults: By the names of the drives, ``sync_box`` and the bus.
        period_ns: SYNC period.
        noise_rad: White noise of every drive's encoder, 1 sigma.

    Attributes:
        vehicle: The plant.

    Raises:
        ScenarioError: a joint without a drive.
        FaultError: a fault that its device cannot have.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        wired: Sequence[Wired],
        faults: Iterable[Fault] = (),
        *,
        period_ns: int = 4_000_000,
        noise_rad: float = 0.0,
    ) -> None:
        plant = Mission(scenario, seed).plant
        assert isinstance(plant, VehiclePlant)
        self._truth = plant.truth()
        built = plant.driven()
        missing = sorted(set(built.joints) ^ {drive.joint for drive in wired})
        if missing:
            raise ScenarioError(
                f"{', '.join(missing)}: a drive is needed for every joint of the URDF, and for nothing else"
            )
        self.vehicle = DrivenVehicle(built, noise_rad, seed)
        axes = {drive.name: self.vehicle.axes[drive.joint] for drive in wired}
        super().__init__(wired, faults, period_ns=period_ns, seed=seed, axes=axes)

    def capture(self) -> None:
        """The gripper closes about the payload."""
        self.vehicle.capture()

    def truth(self) -> dict[str, Any]:
        """Of the scenario's payload and vehicle, and of the drives."""
        built = self.vehicle.built
        return self._truth | {"drives": {name: drive._asdict() for name, drive in built.drives.items()}}
