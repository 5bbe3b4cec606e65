"""Orientation of a link from joint angles and a URDF."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.urdf_reading import plain, read
from onboard.estimation.arrays import FloatArray
from onboard.offline.weigh.columns import Meaning
from onboard.offline.weigh.errors import PosesError


class Arm(NamedTuple):
    """A URDF, the link that the sensor is on, and the joints that move it, from the root outwards."""

    model: pin.Model
    link: str
    joints: tuple[str, ...]


def arm(urdf: str, label: str, link: str = "") -> Arm:
    """Read a URDF; without a link, the one farthest from the root.

    Raises:
        PosesError: no such link, or one that no joint moves.
        UrdfError: the URDF cannot be used.
    """
    drawing = read(urdf, label)
    model = pin.buildModelFromXML(plain(drawing))
    bodies = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    name = link or bodies[-1].name
    frame = next((one for one in bodies if one.name == name), None)
    if frame is None:
        raise PosesError(f"{label} has no link {link!r}; it has {', '.join(one.name for one in bodies)}")
    joints = [model.names[k] for k in model.supports[frame.parentJoint] if k]
    if not joints:
        raise PosesError(f"{label}: no joint moves link {name!r}; give --link")
    return Arm(model, name, tuple(joints))


def posed(meaning: Meaning, of: Arm) -> Meaning:
    """Angles of joints, (n, joints) rad, as rotation matrices of the link in the root."""
    data, frame = of.model.createData(), of.model.getFrameId(of.link, pin.FrameType.BODY)
    out = np.full((len(meaning.orientation), 9), np.nan)
    places = [of.model.joints[of.model.getJointId(name)] for name in of.joints]
    for k, angles in enumerate(meaning.orientation):
        if np.isfinite(angles).all():
            q = pin.neutral(of.model)
            for place, angle in zip(places, angles.tolist(), strict=True):
                q[place.idx_q : place.idx_q + place.nq] = angle if place.nq == 1 else (np.cos(angle), np.sin(angle))
            pin.forwardKinematics(of.model, data, q)
            out[k] = _rotation(of.model, data, frame).ravel()
    return meaning._replace(kind="matrix", orientation=out)


def _rotation(model: pin.Model, data: pin.Data, frame: int) -> FloatArray:
    return np.asarray(pin.updateFramePlacement(model, data, frame).rotation, np.float64)
