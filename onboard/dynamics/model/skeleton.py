"""Places of a vehicle's frames over time, as points and lines to draw: the URDF's links without their shapes."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray


class Skeleton(NamedTuple):
    """Points of a vehicle, and which of them a line joins.

    A line goes from each joint to the frames and joints that it carries, and to its link's centre of mass where it
    carries none.
    """

    names: tuple[str, ...]  # (n,) of the points; empty for a centre of mass
    lines: tuple[tuple[int, int], ...]  # pairs of points
    moving: tuple[bool, ...]  # (n,) whether a joint moves the point
    p_m: FloatArray  # (t, n, 3) base axes


def skeleton(vehicle: VehicleModel, q: FloatArray) -> Skeleton:
    """The vehicle at joint positions ``q``, (t, joints), rad or m, the base at rest (forward kinematics)."""
    model, data = vehicle.model, vehicle.model.createData()
    frames = [(frame.name, frame.parentJoint, frame.placement) for frame in model.frames if frame.parentJoint >= 1]
    own = {model.names[joint] for joint in range(1, model.njoints)}
    points: list[tuple[str, int, FloatArray]] = []  # name, joint that carries it, place in its frame
    points += [(model.names[joint] if joint > 1 else vehicle.spec.base_link, joint, np.zeros(3)) for joint in
               range(1, model.njoints)]  # fmt: skip
    for name, joint, placement in frames:
        place = np.array(placement.translation)
        taken = any(j == joint and np.allclose(p, place, atol=1e-6) for _, j, p in points)
        if name not in own and not taken:
            points.append((name, joint, place))
    lines = [(int(model.parents[joint]) - 1, joint - 1) for joint in range(2, model.njoints)]
    lines += [(joint - 1, index) for index, (_, joint, _) in enumerate(points) if index >= model.njoints - 1]
    for joint in range(2, model.njoints):
        if not any(one == joint - 1 for one, _ in lines):
            lines.append((joint - 1, len(points)))
            points.append(("", joint, np.array(model.inertias[joint].lever)))
    p_m = np.empty((len(q), len(points), 3))
    full = pin.neutral(model)
    for tick, positions in enumerate(q):
        for joint, value in zip(vehicle.joints, positions, strict=True):
            at = slice(joint.q_index, joint.q_index + joint.q_size)
            full[at] = value if joint.q_size == 1 else (np.cos(value), np.sin(value))
        pin.forwardKinematics(model, data, full)
        for index, (_, joint, place) in enumerate(points):
            p_m[tick, index] = data.oMi[joint].act(place)
    moving = tuple(joint > 1 for _, joint, _ in points)
    return Skeleton(tuple(name for name, _, _ in points), tuple(lines), moving, p_m)
