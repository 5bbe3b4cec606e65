"""Drive (CiA 402)."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.canopen_pdo.cia402 import Cia402Config
from drivers.canopen_pdo.guarding import GuardConfig
from drivers.records import SCALAR
from onboard.devices.base import Channels, JointDevice
from onboard.devices.canopen import CanopenNodeDevice


class Cia402Device(CanopenNodeDevice, JointDevice):
    """Drive (CiA 402), sampled on SYNC: its position is the joint's, velocity and torque are recorded where wanted.

    ``velocity_scale_rad_s``: the drive's unit of velocity; counts a second where not given. ``rated_torque_N_m``: read
    from the drive where not given. ``gear_ratio``: revolutions of the motor in one of the joint, for the torque.
    """

    driver_configs = (Cia402Config, GuardConfig)
    kind: Literal["cia402"]
    counts_per_revolution: Annotated[int, Field(gt=0)]
    velocity: Annotated[bool, Field(description="Record 606Ch too, as `NAME_velocity`.")] = False
    torque: Annotated[bool, Field(description="Record 6077h too, as `NAME_torque`.")] = False
    velocity_scale_rad_s: Annotated[
        float | None,
        Field(description="Unit of velocity of the drive, of the joint; counts a second where not given."),
    ] = None
    rated_torque_N_m: Annotated[  # noqa: N815
        float | None, Field(description="Rated torque of the motor; read from the drive (6076h) where not given.")
    ] = None
    gear_ratio: float = Cia402Config.gear_ratio
    tpdos: tuple[int, ...] = Cia402Config.tpdos

    def channels(self, name: str) -> Channels:
        """Position, velocity, torque."""
        return dict.fromkeys(self.settings(name).names, SCALAR)

    def settings(self, name: str) -> Cia402Config:
        """See ``BusDevice``."""
        velocity = f"{name}_velocity" if self.velocity else None
        torque = f"{name}_torque" if self.torque else None
        return self._settings(Cia402Config, position=name, velocity=velocity, torque=torque)
