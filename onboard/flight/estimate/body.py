"""Builds the prediction of a body without joints from its vehicle file."""

from collections.abc import Mapping

import numpy as np

from onboard import config
from onboard.config.bases.table import Body
from onboard.devices.recorded import thrusters_among, tracked_among
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import composite_functional
from onboard.dynamics.model.payload import body_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.policy import MOSTLY
from onboard.flight.estimate.problem.sigma_keys import key_in
from onboard.identification.body.fit import BodyModel
from onboard.identification.body.stated import BodySigmas, Thrusters, Tracker, Valve

_OF_THRUSTERS = {"turn": "turn", "lever": "place", "leak": "leak", "delay": "each_delay"}
_OF_TRACKER = {"turn": "misalignment_sigma_rad", "place": "place_sigma_m", "scale": "scale_sigma"}


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
    own = thrusters_among(vehicle.file.device)
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
    _, pose = tracked_among(vehicle.file.device)
    R_BM, p_BM = model.pose_in_base(pose.frame)
    noise = np.array([pose.position_noise_m, pose.position_noise_m, pose.yaw_noise_rad])
    errors = pose.misalignment_sigma_rad, pose.place_sigma_m, pose.scale_sigma
    tracker = Tracker(p_BM[:2], float(np.arctan2(R_BM[1, 0], R_BM[0, 0])), *errors, noise)
    stated = BodySigmas(**asked.model_dump(exclude={"common_force_sigma"}))
    return BodyModel((mass_kg, centre_m[:2], float(inertia[2, 2])), thrusters, tracker, stated)


def key_of(unknown: str, vehicle: config.Vehicle) -> str:
    """The key of the vehicle file that states an unknown's sigma; empty where none does."""
    kind, _, rest = unknown.partition("_")
    is_of_one = rest in thrusters_among(vehicle.file.device)
    if is_of_one and kind == "scale":
        return f"device.{rest}.scale_sigma"
    if is_of_one and kind in _OF_THRUSTERS:
        return key_in("body", Body, _OF_THRUSTERS[kind])
    if kind == "tracker":
        return f"device.{tracked_among(vehicle.file.device)[0]}.{_OF_TRACKER[rest.split('_')[0]]}"
    if unknown == "mass" and (vehicle.file.body is None or vehicle.file.body.mass_sigma is None):
        return ""
    return key_in("body", Body, "tilt" if kind == "tilt" else unknown)
