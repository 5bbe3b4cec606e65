"""Orientation of a link from joint angles and a URDF."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.model.urdf_reading import plain, read
from onboard.estimation.arrays import FloatArray
from onboard.ground.calibrate.weigh.columns import Meaning
from onboard.ground.calibrate.weigh.errors import PosesError


class SensorArm(NamedTuple):
    """A URDF, the frame of the sensor by its index, and the joints that move it, from the root outwards."""

    model: pin.Model
    frame: int
    joints: tuple[str, ...]


def arm(urdf: str, label: str, link: str = "") -> SensorArm:
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
    found = moved(model, model.getFrameId(name, pin.FrameType.BODY))
    if not found.joints:
        raise PosesError(f"{label}: no joint moves link {name!r}; give --link")
    return found


def moved(model: pin.Model, frame: int) -> SensorArm:
    """The arm that moves a frame."""
    parent = model.frames[frame].parentJoint
    return SensorArm(model, frame, tuple(model.names[k] for k in model.supports[parent] if k))


def posed(meaning: Meaning, of: SensorArm) -> Meaning:
    """Angles of joints, (n, joints) rad, as rotation matrices of the link in the root."""
    out = np.full((len(meaning.orientation), 9), np.nan)
    for k, angles in enumerate(meaning.orientation):
        if np.isfinite(angles).all():
            out[k] = orientation(of, angles).ravel()
    return meaning._replace(kind="matrix", orientation=out)


def orientation(of: SensorArm, angles: FloatArray) -> FloatArray:
    """Axes of the link in those of the root, (3, 3), at angles of its joints, rad."""
    data, q = of.model.createData(), pin.neutral(of.model)
    for name, angle in zip(of.joints, angles.tolist(), strict=True):
        place = of.model.joints[of.model.getJointId(name)]
        q[place.idx_q : place.idx_q + place.nq] = angle if place.nq == 1 else (np.cos(angle), np.sin(angle))
    pin.forwardKinematics(of.model, data, q)
    return np.asarray(pin.updateFramePlacement(of.model, data, of.frame).rotation, np.float64)
