"""Builds the prediction of a body without joints from its vehicle file."""

from collections.abc import Mapping

import numpy as np

from onboard import config
from onboard.config.bases.table import Body
from onboard.devices.recorded import PoseKeys, ThrusterKeys, thrusters_among, tracked_among
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import composite_functional
from onboard.dynamics.model.payload import body_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.policy import MOSTLY
from onboard.identification.body.fit import BodyModel
from onboard.identification.body.stated import BodySigmas, Thrusters, Tracker
from onboard.identification.body.valves import Valve

_OF_BODY = {
    "mass": "body.mass_sigma",
    "common_force": "body.common_force_sigma",
    "loss": "body.loss_sigma_ms",
    "drag": "body.drag_sigma_1_s",
} | {"spin_drag": "body.spin_drag_sigma_1_s", "tilt": "body.tilt_sigma_m_s2"}
_OF_THRUSTERS = {
    "scale": "device.{}.scale_sigma",
    "turn": "body.turn_sigma_rad",
    "lever": "body.place_sigma_m",
    "leak": "body.leak_sigma",
    "delay": "body.each_delay_sigma_ms",
}
_OF_TRACKER = {"turn": "misalignment_sigma_rad", "place": "place_sigma_m", "scale": "scale_sigma"}


def thrusters_of(vehicle: config.Vehicle) -> dict[str, ThrusterKeys]:
    """Its thrusters by name."""
    return thrusters_among(vehicle.file.device)


def tracker_of(vehicle: config.Vehicle) -> tuple[str, PoseKeys]:
    """Its tracked pose."""
    return tracked_among(vehicle.file.device)


def body_model(vehicle: config.Vehicle, model: VehicleModel, valves: Mapping[str, Valve]) -> BodyModel:
    """What predicts the tracked pose.

    Args:
        vehicle: its file.
        model: under it.
        valves: commanded state by thruster.

    Raises:
        SignalError: there are joints, or a thruster that does not push along the table.
        ModelError: a name that the URDF does not have.
    """
    if model.joints:
        raise SignalError(f"joint {model.joints[0].name!r} moves: a body of [body] has none; use [planar] with an arm")
    asked = vehicle.file.body or Body()
    mass_kg, centre_m, inertia = body_of(composite_functional(model) @ model.chi)
    own = thrusters_of(vehicle)
    places, pushes = list[object](), list[complex]()
    for name, thruster in own.items():
        R_BF, p_BF = model.pose_in_base(thruster.frame)
        axis = R_BF @ np.array(thruster.axis) / np.linalg.norm(thruster.axis)
        if np.hypot(*axis[:2]) < MOSTLY:
            raise SignalError(f"device.{name}: its axis stands on the table's plane; give the direction of its force")
        places.append(p_BF[:2])
        pushes.append(complex(*axis[:2]))
    thrusters = Thrusters(
        tuple(own),
        np.array([one.force_N for one in own.values()]) * np.abs(pushes),
        np.array(places, np.float64),
        np.angle(pushes),
        scale_sigma := np.array([one.scale_sigma for one in own.values()]),
        float(np.mean(scale_sigma)) if asked.common_force_sigma is None else asked.common_force_sigma,
        tuple(valves[name] for name in own),
    )
    _, pose = tracker_of(vehicle)
    R_BM, p_BM = model.pose_in_base(pose.frame)
    noise = np.array([pose.position_noise_m, pose.position_noise_m, pose.yaw_noise_rad])
    errors = pose.misalignment_sigma_rad, pose.place_sigma_m, pose.scale_sigma
    tracker = Tracker(p_BM[:2], float(np.arctan2(R_BM[1, 0], R_BM[0, 0])), *errors, noise)
    low, high = asked.delay_ms
    stated = BodySigmas(
        asked.mass_sigma,
        asked.tilt_sigma_m_s2,
        asked.uneven_sigma_m_s2,
        asked.turning_sigma_rad_s2,
        asked.drag_sigma_1_s,
        asked.spin_drag_sigma_1_s,
        asked.place_sigma_m,
        asked.turn_sigma_rad,
        asked.leak_sigma,
        (1e-3 * low, 1e-3 * high),
        1e-3 * asked.each_delay_sigma_ms,
        1e-3 * asked.loss_sigma_ms,
    )
    return BodyModel((mass_kg, centre_m[:2], float(inertia[2, 2])), thrusters, tracker, stated)


def key_of(unknown: str, vehicle: config.Vehicle) -> str:
    """The key of the vehicle file that states an unknown's sigma; empty where none does."""
    kind, _, rest = unknown.partition("_")
    if kind in _OF_THRUSTERS and rest in thrusters_of(vehicle):
        return _OF_THRUSTERS[kind].format(rest)
    if kind == "tracker":
        return f"device.{tracker_of(vehicle)[0]}.{_OF_TRACKER[rest.split('_')[0]]}"
    if unknown == "mass" and (vehicle.file.body is None or vehicle.file.body.mass_sigma is None):
        return ""
    return _OF_BODY.get(unknown, _OF_BODY.get(kind, "") if kind == "tilt" else "")
