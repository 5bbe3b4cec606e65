"""Sensors of a vehicle of one's own: data sheets, over which lies what its vehicle file says of its devices."""

import math
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

from hil_sim.scenario.tables import ScenarioError

_G = 9.80665  # m/s^2, exact by definition
_DEG = math.pi / 180.0
ZERO_RAD = 1e-3  # of an encoder of which the file says nothing


class Sheets(NamedTuple):
    """What a device of a vehicle file measures with.

    Attributes:
        pulse: whether a sync pulse is wired.
        phase_channel: that tells the phases; None without.
        imu_prior: what calibration leaves of the base IMU, as the file states it; empty where it states nothing.
        efforts: largest torque of each joint, N m, by the URDF.
        joint_prior: errors of the joints' encoders as the file states them, by joint.
    """

    pulse: bool
    phase_channel: str | None
    imu_prior: Mapping[str, float]
    efforts: Mapping[str, float]
    joint_prior: Mapping[str, Mapping[str, float]]

    def imu(self, kind: str, said: Mapping[str, Any]) -> dict[str, Any]:
        """An IMU: as it comes, or with what the file says that a calibration has left."""
        table = sheet(kind)
        prior = {key: value for key, value in self.imu_prior.items() if value}
        for triad, sensor, unit in (("accel_g", "accelerometer", _G), ("gyro_deg_s", "gyro", _DEG)):
            bias = prior.get(f"{sensor}_bias_{'m_s2' if sensor == 'accelerometer' else 'rad_s'}")
            if bias is not None:
                table[triad]["bias_sigma"] = [bias / unit] * 3
            scale = prior.get(f"{sensor}_scale", said.get(f"{triad.split('_')[0]}_scale_sigma"))
            if scale is not None:
                table[triad] |= {"scale_sigma": scale, "cross_axis_sigma": prior.get(f"{sensor}_cross_axis", 0.0)}
        turns = [prior[key] for key in ("gyro_misalignment_rad", "accelerometer_misalignment_rad") if key in prior]
        turns = turns or [turn for turn in (said.get("misalignment_sigma_rad"),) if turn]
        if turns or "mounting_rad" in prior:
            table["mounting_sigma_deg"] = prior.get("mounting_rad", min(turns, default=0.0)) / _DEG
        return table

    def encoder(self, name: str, said: Mapping[str, Any]) -> dict[str, Any]:
        """An encoder: zero, counts, gear and cyclic errors of the file, whose rms they are; phases are drawn."""
        counts = said["counts_per_revolution"]
        if counts <= 0:
            raise ScenarioError(f"device.{name}: {counts} counts a revolution; rehearse it with the count's size")
        zero_rad = self.joint_prior.get(said["joint"], {}).get("zero_rad", said.get("zero_sigma_rad", ZERO_RAD))
        return {
            "quantity": "joint_angle",
            "zero_sigma_mrad": 1e3 * zero_rad,
            "counts_per_revolution": counts,
            "gear_ratio": abs(said.get("gear_ratio", 1.0)),
            "eccentricity_urad": 1e6 * math.sqrt(2.0) * said.get("eccentricity_rad", 0.0),
            "transmission_error_urad": 1e6 * math.sqrt(2.0) * said.get("transmission_error_rad", 0.0),
        }

    @staticmethod
    def wheel(said: Mapping[str, Any]) -> dict[str, Any]:
        """A reaction wheel: noise and counts of the file."""
        own = {"noise_rms_rad_s": said["noise_rad_s"], "step_rad_s": abs(said["scale"])}
        return sheet("reaction_wheel") | {"quantity": "wheel_rate"} | own

    @staticmethod
    def thrust(said: Mapping[str, Any]) -> dict[str, Any]:
        """A thruster: counts and calibration of the file."""
        stated = {"scale_sigma": said["scale_sigma"]} if "scale_sigma" in said else {}
        return sheet("thruster") | {"quantity": "thrust", "step_N": abs(said["scale"])} | stated

    @staticmethod
    def pose(said: Mapping[str, Any]) -> dict[str, Any]:
        """A pose tracker: noise of the file."""
        own = {
            "position_noise_mm": 1e3 * said["position_noise_m"],
            "attitude_noise_deg": said["attitude_noise_rad"] / _DEG,
        }
        named = {"scale_sigma": ("scale_sigma", 1.0), "place_sigma_mm": ("place_sigma_m", 1e3)}
        named["mounting_sigma_deg"] = ("misalignment_sigma_rad", 1.0 / _DEG)
        own |= {key: unit * said[key_said] for key, (key_said, unit) in named.items() if key_said in said}
        return sheet("pose_tracker") | {"quantity": "pose"} | own

    @staticmethod
    def load_cell(said: Mapping[str, Any]) -> dict[str, Any]:
        """A load cell: capacity, lever, noise, delay and calibration of the file."""
        table = sheet("load_cell")
        named = {"capacity_N": "capacity_N", "noise_rms_N": "noise_N", "scale_sigma": "scale_sigma"}
        table |= {key: said[own] for key, own in named.items() if said.get(own)}
        table["zero_sigma_N"] *= table["capacity_N"] / 50.0
        table["delay_ms"] = said.get("delay_ms") or 0.5
        table["delay_sigma_ms"] = said.get("delay_sigma_ms", 0.0)
        table["axis"] = said["axis"]
        if said["measures"] == "force":
            return table | {"quantity": "force"}
        lever = {"lever_mm": 1e3 * said.get("lever_m", 1.0), "lever_sigma_mm": 1e3 * said.get("lever_sigma_m", 0.0)}
        return table | {"quantity": "joint_moment"} | lever

    @staticmethod
    def torque(rated_n_m: float, said: Mapping[str, Any]) -> dict[str, Any]:
        """A joint's torque from its motor's current."""
        table = sheet("motor_torque")
        return {
            "quantity": "servo_torque",
            "scale_sigma": said.get("torque_scale_sigma", table["scale_sigma"]),
            "offset_sigma_Nm": rated_n_m * table["offset_of_rated"],
            "noise_rms_Nm": rated_n_m * table["noise_of_rated"],
        }

    def effort_n_m(self, joint: str) -> float:
        """Largest torque of a joint; 10 N m where the URDF says nothing."""
        effort = self.efforts.get(joint, math.inf)
        return effort if math.isfinite(effort) else 10.0


@cache
def _read() -> dict[str, Any]:
    file = resources.files("hil_sim.scenario") / "datasheets.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


def sheet(name: str) -> dict[str, Any]:
    """A copy of a table of ``datasheets.toml``; dots part its name."""
    table: Any = _read()
    for part in name.split("."):
        table = table[part]
    return {key: dict(value) if isinstance(value, dict) else value for key, value in table.items()}
