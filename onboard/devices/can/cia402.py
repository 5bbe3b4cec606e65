"""Drive (CiA 402)."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.play.drive_axis import Cia402AxisConfig
from drivers.canopen_pdo.profiles.cia402 import Cia402Config
from drivers.records import CAN_FRAME, SCALAR
from onboard.devices.base import Channels, Surroundings
from onboard.devices.can.canopen import CanopenNodeDevice
from onboard.devices.driven import DrivenDevice, MotorDevice
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock


class Cia402Device(CanopenNodeDevice, MotorDevice, DrivenDevice):
    """Drive (CiA 402), sampled on SYNC: its position is the joint's; velocity (606Ch) and torque (6077h) where wanted.

    ``velocity_scale_rad_s``: the drive's unit of velocity; counts a second where not given. ``rated_torque_N_m``: read
    from the drive where not given. ``gear_ratio``: revolutions of the motor in one of the joint, for the torque.
    ``driven``: it is sent set points (docs/driving.md); its statusword and every frame that it is sent are recorded.
    """

    driver_configs = (Cia402Config, GuardConfig)
    new_keys = "node = {number}\n" + DrivenDevice.new_keys
    kind: Literal["cia402"]
    counts_per_revolution: Annotated[int, Field(gt=0, le=0xFFFFFFFF)]
    velocity_scale_rad_s: Annotated[
        float | None, Field(description="Unit of velocity of the drive, of the joint; counts a second where not given.")
    ] = None
    rated_torque_N_m: Annotated[  # noqa: N815
        float | None, Field(description="Rated torque of the motor; read from the drive (6076h) where not given.")
    ] = None
    gear_ratio: float = Cia402Config.gear_ratio
    tpdos: tuple[int, ...] = Cia402Config.tpdos
    brake: Annotated[
        bool, Field(description="It has a brake, which stops it in a fault; else its motor slows it down.")
    ] = True
    check_units: Annotated[
        bool, Field(description="Refuse to drive it unless 608Fh, 6091h or 6092h say `counts_per_revolution` too.")
    ] = True

    def channels(self, name: str) -> Channels:
        """Position, velocity, torque; of a driven one statusword and the frames sent."""
        sent: Channels = {f"{name}_sent": CAN_FRAME} if self.driven else {}
        return {**dict.fromkeys(self.settings(name).names, SCALAR), **sent}

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``: of what it sends."""
        return {channel: one for channel, one in super().clocks(name, around).items() if channel != f"{name}_sent"}

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``: of what it sends."""
        return [delay for delay in super().delays(name, around) if delay.channel != f"{name}_sent"]

    def settings(self, name: str) -> Cia402Config:
        """See ``BusDevice``."""
        velocity = f"{name}_velocity" if self.velocity else None
        torque = f"{name}_torque" if self.torque else None
        status = f"{name}_status" if self.driven else None
        return self._settings(Cia402Config, position=name, velocity=velocity, torque=torque, status=status)

    def axis(self, name: str, limits: Mapping[str, Any], master_node: int) -> Cia402AxisConfig:
        """See ``DrivenDevice``."""
        keys = {**limits, "brakes": self.brake, "checks_units": self.check_units, "master": master_node}
        return Cia402AxisConfig(self.settings(name), **keys)
