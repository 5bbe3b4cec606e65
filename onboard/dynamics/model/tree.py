"""A vehicle's joints and links as a tree of constant arrays. Bodies: the base, then what each joint carries."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from onboard.estimation.arrays import FloatArray
from onboard.native import structures


class Tree(NamedTuple):
    """Which joint carries what, and where."""

    seat_axes: FloatArray  # (joints, 3, 3) axes of each joint's frame at zero, in those of the body that carries it
    axis: FloatArray  # (joints, 3) in the joint's frame
    below: FloatArray  # (joints, joints) one where the column's joint lies between the base and the row's
    compiled: structures.TreeStruct  # what the compiled core moves


class TreeJoint(Protocol):
    """A joint of the vehicle."""

    @property
    def name(self) -> str:
        """In the URDF."""

    @property
    def axis(self) -> tuple[float, float, float]:
        """In its own frame."""

    @property
    def revolute(self) -> bool:
        """Whether it turns; else it slides."""


def tree_of(model: pin.Model, joints: Sequence[TreeJoint], links: Sequence[str]) -> Tree:
    """The tree of a Pinocchio model with a floating base.

    Args:
        model: whose joint 1 is the base's.
        joints: a joint after the one that carries it.
        links: names.
    """
    index = [int(model.getJointId(joint.name)) for joint in joints]
    axes = _stacked([joint.axis for joint in joints], (3,))
    revolute = _stacked([joint.revolute for joint in joints], (1,))
    body = {1: 0} | {joint: column + 1 for column, joint in enumerate(index)}
    parent = np.array([body[int(model.parents[joint])] for joint in index], np.intp)
    places = [model.jointPlacements[joint] for joint in index]
    frames = [model.frames[model.getFrameId(name, pin.FrameType.BODY)] for name in links]
    on = np.array([body[int(frame.parentJoint)] for frame in frames], np.intp)
    path = np.zeros((len(joints) + 1, len(joints)))  # of each body
    for column, carrier in enumerate(parent):
        path[column + 1] = path[carrier]
        path[column + 1, column] = 1.0
    hat = np.cross(np.eye(3), axes[:, None]) * revolute[:, None]
    seat_axes = _stacked([place.rotation for place in places], (3, 3))
    seats = seat_axes, _stacked([place.translation for place in places], (3,))
    # What the sine of a revolute joint's angle, and one less its cosine, add to seat_axes (Rodrigues' formula)
    motion = axes, np.stack([seat_axes @ hat, seat_axes @ hat @ hat]), revolute
    link_axes = _stacked([frame.placement.rotation for frame in frames], (3, 3))
    link_origin = _stacked([frame.placement.translation for frame in frames], (3,))
    compiled = structures.TreeStruct(len(joints), len(links), parent, on, *seats, *motion, link_axes, link_origin)
    return Tree(seat_axes, axes, path[parent], compiled)


def _stacked(parts: Sequence[object], shape: tuple[int, ...]) -> FloatArray:
    return np.array(parts, np.float64).reshape(-1, *shape)
