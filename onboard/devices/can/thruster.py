"""Thruster: a known force on the base, an object of a CANopen node."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.canopen_pdo.profiles.mapped_object import CanopenObjectConfig
from onboard.devices import roles
from onboard.devices.can.canopen_object import MappedObjectDevice
from onboard.devices.roles import Roles, ThrusterRole
from onboard.section import Direction, NotNegative, Real


class ThrusterDevice(MappedObjectDevice):
    """Force of a thruster, in N by ``scale``, on every SYNC: of its valve, its fan, or the pressure before its nozzle.

    The force is along ``axis`` of ``frame``, a frame of the URDF that is fixed in the base, and through its origin.
    """

    about_role = "known force on a free base"
    kind: Literal["thruster"]
    frame: Annotated[str, Field(description="Of the URDF, fixed in the base; the force goes through its origin.")]
    axis: Annotated[Direction, Field(description="Direction of the force on the vehicle, in the frame's axes.")]
    scale_sigma: Annotated[NotNegative, Field(description="Relative 1 sigma of its force.")] = 0.05
    delay_ms: Annotated[
        Real, Field(description="From the force to its record; negative where the record is first.")
    ] = 0.0

    def settings(self, name: str) -> CanopenObjectConfig:
        """See ``BusDevice``."""
        return self._settings(CanopenObjectConfig, name=name, unit="N", synchronous=True)

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        force = roles.scalar(self.delay_ms, 0.0, period_s, roles.FORCE)._replace(repeats=True)
        role = ThrusterRole(name, name, self.frame, self.axis, self.scale_sigma)
        return Roles([], [], [], [role], [], {name: force})
