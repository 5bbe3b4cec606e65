"""Reaction wheel: a rotor of the URDF, its speed an object of a CANopen node."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.canopen_pdo.profiles.mapped_object import CanopenObjectConfig
from onboard.devices import roles
from onboard.devices.can.canopen_object import MappedObjectDevice
from onboard.devices.roles import JointRole, Roles
from onboard.section import NotNegative, Positive


class ReactionWheelDevice(MappedObjectDevice):
    """Speed of a reaction wheel, in rad/s by ``scale``, on every SYNC.

    The wheel is a body of revolution in the URDF on a continuous joint of the base: its angle is not needed.
    """

    about_role = "joint rate"
    kind: Literal["reaction_wheel"]
    joint: Annotated[str, Field(description="The wheel's continuous joint in the URDF.")]
    noise_rad_s: Positive
    scale_sigma: Annotated[
        NotNegative, Field(description="Relative 1 sigma of what it stores: axial inertia in the URDF, scale of speed.")
    ] = 0.01
    delay_ms: NotNegative = 0.0
    delay_sigma_ms: NotNegative = 0.2

    def settings(self, name: str) -> CanopenObjectConfig:
        """See ``BusDevice``."""
        return self._settings(CanopenObjectConfig, name=name, unit="rad/s", synchronous=True)

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        rate = roles.scalar(self.delay_ms, self.noise_rad_s, period_s, roles.RATE)
        sigma = {"scale_sigma": self.scale_sigma, "delay_sigma_s": 1e-3 * self.delay_sigma_ms}
        return Roles([], [JointRole(self.joint, name, is_rate=True, **sigma)], [], [], [], {name: rate})
