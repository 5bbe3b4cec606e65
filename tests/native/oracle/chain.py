"""Motion of a vehicle's links in NumPy: axes by recursion, the rest by sums along the tree."""

import numpy as np

from onboard.dynamics.kinematics import Chain, Frames
from onboard.dynamics.spatial import times
from onboard.estimation.arrays import cross


def chain_motion(vehicle, q, dq, ddq, offsets=None):
    """As :func:`onboard.dynamics.kinematics.chain_motion`."""
    compiled = vehicle.tree.compiled
    parent, body, seat_axes, seat_origin, tree_axis, turned, revolute, link_axes, link_origin = compiled.kept
    n, nj = q.shape
    path = np.zeros((nj + 1, nj))
    for column, carrier in enumerate(parent):
        path[column + 1] = path[carrier]
        path[column + 1, column] = 1.0
    below, moved = path[parent], path[body]
    arms = seat_origin if offsets is None else seat_origin + times(seat_axes, offsets)
    angle = q[:, :, None, None]
    seated = seat_axes + np.sin(angle) * turned[0] + (1.0 - np.cos(angle)) * turned[1]
    axes = np.empty((n, nj + 1, 3, 3))  # of the bodies
    axes[:, 0] = np.eye(3)
    for joint, carrier in enumerate(parent.tolist()):
        np.matmul(axes[:, carrier], seated[:, joint], out=axes[:, joint + 1])
    carriers = axes[:, parent]
    seat_R = carriers @ seat_axes
    axis, steps = times(seat_R, tree_axis), times(carriers, arms)  # (n, joints, 3)
    slides = axis * q[..., None] * (1.0 - revolute)
    seat_p = steps + below @ (steps + slides)
    origins = np.zeros((n, nj + 1, 3))
    origins[:, 1:] = seat_p + slides
    screws = np.empty((n, nj, 6))
    screws[..., :3] = cross(seat_p, axis) * revolute + axis * (1.0 - revolute)
    screws[..., 3:] = axis * revolute
    moves = screws * dq[..., None]
    W = below @ moves
    rates = screws * ddq[..., None]
    rates[..., :3] += cross(W[..., 3:], moves[..., :3]) + cross(W[..., :3], moves[..., 3:])
    rates[..., 3:] += cross(W[..., 3:], moves[..., 3:])
    on = axes[:, body]
    p = origins[:, body] + times(on, link_origin)
    links = Frames(on @ link_axes, p, moved @ moves, moved @ rates)
    return Chain(links, Frames(seat_R, seat_p, W, below @ rates), screws, axes, origins)
