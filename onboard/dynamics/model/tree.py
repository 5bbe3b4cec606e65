"""A vehicle's joints and links as a tree of constant arrays, for arithmetic over all of them and many ticks at once."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from onboard.estimation.arrays import FloatArray, IndexArray


class Tree(NamedTuple):
    """Which joint carries what, and where. Bodies: the base (0), then what each joint carries (column + 1)."""

    parent: IndexArray  # (joints,) the body that carries each joint; always a smaller number than its own
    seat_axes: FloatArray  # (joints, 3, 3) axes of each joint's frame at zero, in that body's
    seat_origin: FloatArray  # (joints, 3) its origin
    axis: FloatArray  # (joints, 3) in the joint's frame
    turned: FloatArray  # (2, joints, 3, 3) what the sine of a revolute joint's angle, and one less its cosine, add to
    # seat_axes (Rodrigues' formula); zero of a prismatic one
    revolute: FloatArray  # (joints, 1) one or zero
    below: FloatArray  # (joints, joints) one where the column's joint lies between the base and the row's
    moved: FloatArray  # (links, joints) one where the column's joint moves the row's link
    body: IndexArray  # (links,) the body that each link is fixed to
    link_axes: FloatArray  # (links, 3, 3) its axes in that body's
    link_origin: FloatArray  # (links, 3) its origin


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
    return Tree(
        parent,
        seat_axes,
        _stacked([place.translation for place in places], (3,)),
        axes,
        np.stack([seat_axes @ hat, seat_axes @ hat @ hat]),
        revolute,
        path[parent],
        path[on],
        on,
        _stacked([frame.placement.rotation for frame in frames], (3, 3)),
        _stacked([frame.placement.translation for frame in frames], (3,)),
    )


def _stacked(parts: Sequence[object], shape: tuple[int, ...]) -> FloatArray:
    return np.array(parts, np.float64).reshape(-1, *shape)
