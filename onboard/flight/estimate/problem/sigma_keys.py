"""Keys of the vehicle file that state the sigma of a parameter of a prediction."""

from collections.abc import Sequence
from typing import NamedTuple

from pydantic import BaseModel

from onboard.identification.free_flyer.prediction.further import (
    OF_FRICTION,
    Further,
    FurtherCell,
    Thruster,
    instrument_of,
)
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior

_OF_JOINTS = {"zero": "zero_rad", "scale": "scale", "delay": "delay_s"} | {
    f"place_{axis}": "position_m" for axis in "xyz"
}
_OF_CELLS = {"scale": "scale_sigma", "bias": "zero_sigma_N", "drift": "zero_drift_N_s", "delay_s": "delay_sigma_ms"}


def key_in(table: str, section: type[BaseModel], unknown: str) -> str:
    """``drag`` in ``[pivot]``: ``pivot.drag_sigma_N_m_s``; empty where the section states no sigma of it."""
    return next((f"{table}.{key}" for key in section.model_fields if key.startswith(f"{unknown}_sigma")), "")


class SigmaKeys(NamedTuple):
    """The keys of a vehicle's file."""

    further: Sequence[Further]  # instruments besides the first IMU
    thrusters: Sequence[Thruster]
    joints: Sequence[str]

    def of(self, parameter: str) -> str:
        """The key of a parameter's sigma; empty for a parameter without one."""
        link, inertial, _ = parameter.partition("_inertial_")
        if inertial:
            return f"prior.link.{link}"
        device, correction = instrument_of(parameter, self.further)
        if device and isinstance(cell := self.further[device - 1], FurtherCell):
            return self._of_cell(cell, correction)
        if parameter.removeprefix("scale_") in {thruster.name for thruster in self.thrusters}:
            return f"device.{parameter.removeprefix('scale_')}.scale_sigma"
        for kind, key in _OF_JOINTS.items():
            if (joint := parameter.removeprefix(f"{kind}_")) != parameter and joint in self.joints:
                return f"prior.joint.{joint}.{key}"
        field = correction[:-2] if correction.endswith(("_x", "_y", "_z")) else correction
        if field == "place":
            return "imu_prior.position_m"
        return f"imu_prior.{field}" if field in ImuPrior._fields else ""

    def _of_cell(self, cell: FurtherCell, correction: str) -> str:
        """The same of a load cell or the torque of a joint, which a drive (CiA 402) sends in a channel of its own."""
        if cell.friction is None:
            return f"device.{cell.name}.{_OF_CELLS[correction]}" if correction in _OF_CELLS else ""
        if correction in OF_FRICTION:
            return f"prior.absolute.{correction}_{self.joints[cell.friction.joint]}"
        drive = cell.name.removesuffix("_torque")
        scale = f"device.{cell.name}.scale_sigma" if drive == cell.name else f"device.{drive}.torque_scale_sigma"
        return {"bias": f"prior.absolute.bias_{cell.name}", "scale": scale}.get(correction, "")
