"""Joints with a motor: keys of its velocity and torque, and those that say that it is sent set points."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar

from pydantic import Field

from drivers.play.axis import AxisConfig
from onboard.devices import roles
from onboard.devices.base import JointDevice, Problem, Surroundings
from onboard.devices.roles import LoadCellRole, Roles, TorqueKeys
from onboard.section import NotNegative, Positive


class MotorDevice(JointDevice):
    """It measures a joint, and its motor's velocity and torque where wanted.

    ``torque_sigma_N_m``: by it the torque is a row, and to the prediction of a free base an instrument, whose friction,
    rotor and offset (``Fc_``, ``Fv_``, ``Ia_<joint>``, ``bias_<device>_torque``) have their sigmas in
    ``[estimation.prior.absolute]``.
    """

    new_torque: ClassVar[str] = "torque_scale_sigma = 0.01      # yours: of the torque constant, relative\n"
    velocity: Annotated[bool, Field(description="Record its velocity too, as `NAME_velocity`.")] = False
    torque: Annotated[bool, Field(description="Record its torque too, as `NAME_torque`.")] = False
    torque_sigma_N_m: Annotated[  # noqa: N815
        Positive | None,
        Field(description="Use the torque; 1 sigma of the model's error, smoothed as joints are; needs `torque`."),
    ] = None
    torque_scale_sigma: Annotated[NotNegative, Field(description="Relative 1 sigma of its torque constant.")] = 0.0
    torque_friction: Annotated[
        bool, Field(description="Whether friction and rotor inertia are in it, as unknowns.")
    ] = True
    torque_still_rad_s: Annotated[NotNegative, Field(description="Joint rate below which it is left out.")] = 0.0

    @property
    def torque_units(self) -> Mapping[bytes, float]:
        """N m in each unit that its torque may be given in."""
        return {b"N m": 1.0}

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
            torque = roles.scalar(0.0, 0.0, period_s, self.torque_units)
            found.add(Roles([], [], [LoadCellRole(row, row, keys)], [], [], {row: torque}))
        return found

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``: a row of the torque needs the torque."""
        yield from super().problems(name, around)
        if self.torque_sigma_N_m is not None and not self.torque:
            yield ["device", name, "torque_sigma_N_m"], f"{name!r} does not record its torque; give torque = true"


class DrivenDevice(JointDevice):
    """It measures a joint and, where ``driven``, moves it as ``[drive]`` says."""

    new_driven: ClassVar[str] = "driven = true                  # it plays the motion of [drive]\n"
    new_drive: ClassVar[str] = ""  # keys of its own in [drive]
    driven: Annotated[
        bool, Field(description="It plays the motion of `[drive]`; `NAME_status` and `NAME_sent` are recorded.")
    ] = False

    def axis(self, name: str, limits: Mapping[str, Any], master_node: int) -> AxisConfig:
        """How it is driven.

        Args:
            name: Of the device.
            limits: Fields of its ``AxisConfig`` that do not depend on its kind.
            master_node: Our node number, on a bus that has them.

        Raises:
            ConfigurationError: It cannot be driven within them.
        """
        raise NotImplementedError
