"""Drive (CiA 402)."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.profiles.cia402 import Cia402Config
from drivers.records import CAN_FRAME, SCALAR
from onboard.devices import roles
from onboard.devices.base import Channels, Problem, Surroundings
from onboard.devices.can.canopen import CanopenNodeDevice
from onboard.devices.driven import DrivenDevice
from onboard.devices.roles import LoadCellRole, Roles, TorqueKeys
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay
from onboard.timebase.specs import ChannelClock


class Cia402Device(CanopenNodeDevice, DrivenDevice):
    """Drive (CiA 402), sampled on SYNC: its position is the joint's, velocity and torque are recorded where wanted.

    ``velocity_scale_rad_s``: the drive's unit of velocity; counts a second where not given. ``rated_torque_N_m``: read
    from the drive where not given. ``gear_ratio``: revolutions of the motor in one of the joint, for the torque.
    ``torque_sigma_N_m``: by it the torque is a row, and to the ExIDDM of a free base an instrument, whose friction,
    rotor and offset (``Fc_``, ``Fv_``, ``Ia_<joint>``, ``bias_<device>_torque``) have their sigmas in
    ``[estimation.prior.absolute]``.
    ``driven``: it is sent set points (docs/driving.md); its statusword and every frame that it is sent are recorded.
    """

    driver_configs = (Cia402Config, GuardConfig)
    new_keys = "node = {number}\n" + DrivenDevice.new_keys
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
    torque_sigma_N_m: Annotated[  # noqa: N815
        Positive | None,
        Field(description="Use the torque; 1 sigma of the model's error, smoothed as joints are; needs `torque`."),
    ] = None
    torque_scale_sigma: Annotated[NotNegative, Field(description="Relative 1 sigma of its torque constant.")] = 0.0
    torque_friction: Annotated[
        bool, Field(description="Whether friction and rotor inertia are in it, as unknowns.")
    ] = True
    torque_still_rad_s: Annotated[NotNegative, Field(description="Joint rate below which it is left out.")] = 0.0
    gear_ratio: float = Cia402Config.gear_ratio
    tpdos: tuple[int, ...] = Cia402Config.tpdos

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

    def roles(self, name: str, period_s: float) -> Roles:
        """Its joint's angle, and the torque where ``torque_sigma_N_m`` is given."""
        found = super().roles(name, period_s)
        if self.torque_sigma_N_m is not None:
            row = f"{name}_torque"
            keys = TorqueKeys(
                joint=self.joint,
                sigma_N_m=self.torque_sigma_N_m,
                scale_sigma=self.torque_scale_sigma,
                friction=self.torque_friction,
                still_rad_s=self.torque_still_rad_s,
            )
            torque = roles.scalar(0.0, 0.0, period_s, {b"N m": 1.0})
            found.add(Roles([], [], [LoadCellRole(row, row, keys)], [], [], {row: torque}))
        return found

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``: a row of the torque needs the torque."""
        yield from super().problems(name, around)
        if self.torque_sigma_N_m is not None and not self.torque:
            yield ["device", name, "torque_sigma_N_m"], f"{name!r} does not record its torque; give torque = true"

    def settings(self, name: str) -> Cia402Config:
        """See ``BusDevice``."""
        velocity = f"{name}_velocity" if self.velocity else None
        torque = f"{name}_torque" if self.torque else None
        status = f"{name}_status" if self.driven else None
        return self._settings(Cia402Config, position=name, velocity=velocity, torque=torque, status=status)
