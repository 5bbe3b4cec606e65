"""On which stated sigmas an answer leans: those of the vehicle file that its own sigma would change with.

A shift of a prior's mean by one sigma s moves an estimate by its covariance P with that parameter over s; this is also
what the prior adds to its variance: ``dP / d(ln s) = 2 (P / s)^2``. Parameters of one key are summed as squares.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.exiddm.prediction.further import OF_FRICTION, Further, FurtherCell, Thruster
from onboard.identification.exiddm.prediction.imu_errors import ImuPrior

PART = 0.2  # of a sigma: from which on a cause of it is named
_OF_JOINTS = {"zero": "zero_rad", "scale": "scale", "delay": "delay_s"} | {
    f"place_{axis}": "position_m" for axis in "xyz"
}
_OF_CELLS = {
    "scale": "scale_sigma",
    "bias": "zero_sigma_N",
    "drift": "zero_drift_N_s",
    "delay_s": "delay_sigma_ms",
}


class Causes:
    """The keys that answers may lean on.

    Args:
        keys: of each parameter; empty for what has none.
        sigma: stated, of each parameter, (p,).

    Attributes:
        names: of the c keys.
        at: of each parameter's key among these; -1 for none.
    """

    def __init__(self, keys: Sequence[str], sigma: FloatArray) -> None:
        stated = [key if np.isfinite(s) and s > 0.0 else "" for key, s in zip(keys, sigma.tolist(), strict=True)]
        self.names = tuple(dict.fromkeys(key for key in stated if key))
        self.at = np.array([self.names.index(key) if key else -1 for key in stated], np.intp)
        self._of = np.zeros((len(keys), len(self.names)))
        some = np.flatnonzero(self.at >= 0)
        self._of[some, self.at[some]] = 1.0 / sigma[some] ** 2

    def effects(self, along: FloatArray) -> FloatArray:
        """What one sigma of each key does to some answers, (k, c).

        Args:
            along: covariance of the answers with each parameter, (k, p).
        """
        return np.asarray(np.sqrt(along**2 @ self._of), np.float64)

    def said(self, effects: FloatArray, sigma: FloatArray, size: FloatArray, most: int = 3) -> tuple[str, ...]:
        """Of each answer the keys that make up a good part of its sigma, with their effects in per cent; else empty.

        Args:
            effects: of each key, (k, c).
            sigma: of the answers, (k,).
            size: that effects are shown over, (k,); over zero they are not shown.
            most: keys that are said.
        """
        found = []
        for each, one, whole in zip(effects, sigma.tolist(), size.tolist(), strict=True):
            large = [c for c in np.argsort(-each)[:most].tolist() if each[c] > PART * one]
            told = ", ".join(self.names[c] + (f" ({100.0 * each[c] / whole:.2g} %)" if whole else "") for c in large)
            found.append(f"leans on {told}" if told else "")
        return tuple(found)


class Keys(NamedTuple):
    """The keys of a vehicle's file."""

    further: Sequence[Further]  # instruments besides the first IMU
    thrusters: Sequence[Thruster]
    joints: Sequence[str]

    def of(self, parameter: str) -> str:
        """The key of a parameter's sigma; empty for one that has none."""
        link, inertial, _ = parameter.partition("_inertial_")
        if inertial:
            return f"prior.link.{link}"
        device, correction = self.correction_of(parameter)
        if device and isinstance(one := self.further[device - 1], FurtherCell):
            return self._of_cell(one, correction)
        if parameter.removeprefix("scale_") in {thruster.name for thruster in self.thrusters}:
            return f"device.{parameter.removeprefix('scale_')}.scale_sigma"
        for kind, key in _OF_JOINTS.items():
            if (joint := parameter.removeprefix(f"{kind}_")) != parameter and joint in self.joints:
                return f"prior.joint.{joint}.{key}"
        own = correction[:-2] if correction.endswith(("_x", "_y", "_z")) else correction
        if own == "place":
            return "imu_prior.position_m"
        return f"imu_prior.{own}" if own in ImuPrior._fields else ""

    def _of_cell(self, cell: FurtherCell, correction: str) -> str:
        """The same of a load cell or the torque of a joint, which a drive (CiA 402) sends in a channel of its own."""
        if cell.friction is None:
            return f"device.{cell.name}.{_OF_CELLS[correction]}" if correction in _OF_CELLS else ""
        if correction in OF_FRICTION:
            return f"prior.absolute.{correction}_{self.joints[cell.friction.joint]}"
        drive = cell.name.removesuffix("_torque")
        scale = f"device.{cell.name}.scale_sigma" if drive == cell.name else f"device.{drive}.torque_scale_sigma"
        return {"bias": f"prior.absolute.bias_{cell.name}", "scale": scale}.get(correction, "")

    def correction_of(self, parameter: str) -> tuple[int, str]:
        """The instrument of a parameter by its number, and the name without it; 0 for what is no instrument's."""
        for device, one in enumerate(self.further, 1):
            if parameter.endswith(f"_{one.name}"):
                return device, parameter.removesuffix(f"_{one.name}")
        return 0, parameter.removesuffix("_imu")
