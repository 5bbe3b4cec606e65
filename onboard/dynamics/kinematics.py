"""Kinematics, momentum and wrench of a floating vehicle's links, vectorised over ticks.

All vectors are in base axes; moments and momenta are about the base frame's origin. Twists are (linear, angular) of the
base frame; wrenches (force, moment). Everything is linear in the standard parameters: ``momentum = H(v) chi`` and
``wrench = W(v, a) chi``, with the composite spatial inertia the part of them that multiplies the base's own twist or
acceleration. Pinocchio computes the same one tick at a time; predicting a whole flight needs 10,000 ticks per initial
guess. Recursion over the chain and Newton-Euler equations: Featherstone, Rigid Body Dynamics Algorithms (2008).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.errors import SignalError
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray

_NOWHERE = pin.SE3.Identity()
_HAT = np.zeros((3, 9))  # maps a vector's elements to its cross-product matrix
_HAT[[0, 0, 1, 1, 2, 2], [7, 5, 2, 6, 3, 1]] = 1.0, -1.0, 1.0, -1.0, 1.0, -1.0
_TENSOR = np.zeros((3, 18))  # maps a vector to its product with a symmetric tensor, by columns of XX XY YY XZ YZ ZZ
_TENSOR[[0, 1, 2, 0, 1, 2, 0, 1, 2], [0, 1, 3, 7, 8, 10, 15, 16, 17]] = 1.0
_SYMMETRIC = np.array([4, 5, 7, 5, 6, 8, 7, 8, 9])  # XX XY YY XZ YZ ZZ of standard parameters as a tensor


class LinkMotion(NamedTuple):
    """Motion of one link frame relative to the base, base axes; or of several, (n, links, ...)."""

    R: FloatArray  # (n, 3, 3) link axes in base axes
    p: FloatArray  # (n, 3) origin
    v: FloatArray  # (n, 3) velocity of the origin
    w: FloatArray  # (n, 3) angular velocity
    a: FloatArray  # (n, 3) acceleration of the origin
    dw: FloatArray  # (n, 3) angular acceleration


class Chain(NamedTuple):
    """Motion of a vehicle's links and joints relative to the base."""

    links: tuple[LinkMotion, ...]  # in the order of the vehicle's links
    seats: tuple[LinkMotion, ...]  # the frame of each joint at its zero, fixed in the link that carries the joint


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product ``c = a x b`` along the last axis; three times as fast as NumPy's."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    first = y * w - z * v
    out = np.empty((*first.shape, 3))
    out[..., 0] = first
    out[..., 1] = z * u - x * w
    out[..., 2] = x * v - y * u
    return out


def hat(a: FloatArray) -> FloatArray:
    """Cross-product matrices, (..., 3, 3): ``hat(a) @ b = a x b``."""
    out: FloatArray = (a @ _HAT).reshape(*a.shape, 3)
    return out


def turned(R: FloatArray, a: FloatArray) -> FloatArray:
    """Rotation ``b[k] = R[k] @ a[k]`` for every tick k; ``a`` may be one vector."""
    out: FloatArray = np.einsum("...ij,...j->...i", R, a)
    return out


def link_motions(vehicle: VehicleModel, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[LinkMotion, ...]:
    """The links of :func:`chain_motion`, joints where they are drawn."""
    return chain_motion(vehicle, q, dq, ddq).links


def chain_motion(
    vehicle: VehicleModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, offsets: FloatArray | None = None
) -> Chain:
    """Motion of every link with columns, by recursion over the joints (Rodrigues' formula; Featherstone 2008).

    Args:
        vehicle: the model; the links are in the order of its ``links``.
        q: joint positions, (n, joints).
        dq: joint rates, (n, joints).
        ddq: joint accelerations, (n, joints).
        offsets: of each joint from its place in the drawing, (joints, 3), m, in the axes of its frame at zero.

    Raises:
        SignalError: shapes that do not fit.
    """
    n, nj = q.shape[0], len(vehicle.joints)
    if any(signal.shape != (n, nj) for signal in (q, dq, ddq)):
        raise SignalError(f"joint signals must be (n, {nj}); they are {q.shape}, {dq.shape}, {ddq.shape}")
    model, zero = vehicle.model, np.zeros((n, 3))
    still = LinkMotion(np.broadcast_to(np.eye(3), (n, 3, 3)), zero, zero, zero, zero, zero)
    of_joint = {1: still}  # by Pinocchio's joint index; 1 is the base
    seats = []
    for column, joint in enumerate(vehicle.joints):
        index = int(model.getJointId(joint.name))
        seat = _fixed(of_joint[int(model.parents[index])], model.jointPlacements[index])
        if offsets is not None:
            seat = _moved(seat, seat.R @ offsets[column])
        seats.append(seat)
        axis = turned(seat.R, np.asarray(joint.axis))
        x, dx, ddx = (signal[:, column, None] for signal in (q, dq, ddq))
        if joint.revolute:
            K = hat(np.asarray(joint.axis))
            turn = np.eye(3) + np.sin(x)[..., None] * K + (1.0 - np.cos(x))[..., None] * (K @ K)  # Rodrigues
            spin = cross(seat.w, axis) * dx
            of_joint[index] = LinkMotion(
                seat.R @ turn, seat.p, seat.v, seat.w + axis * dx, seat.a, seat.dw + axis * ddx + spin
            )
        else:
            out = axis * x
            swing = cross(seat.w, out)
            v = seat.v + swing + axis * dx
            a = seat.a + axis * ddx + 2.0 * cross(seat.w, axis * dx) + cross(seat.dw, out) + cross(seat.w, swing)
            of_joint[index] = LinkMotion(seat.R, seat.p + out, v, seat.w, a, seat.dw)
    frames = [model.frames[vehicle.frame_id(name)] for name in vehicle.links]
    links = tuple(_fixed(of_joint[int(frame.parentJoint)], frame.placement) for frame in frames)
    return Chain(links, tuple(seats))


def _fixed(parent: LinkMotion, placement: pin.SE3) -> LinkMotion:
    """Motion of a frame fixed in its parent."""
    if placement == _NOWHERE:
        return parent
    moved = _moved(parent, turned(parent.R, np.asarray(placement.translation)))
    return moved._replace(R=parent.R @ np.asarray(placement.rotation))


def _moved(frame: LinkMotion, arm: FloatArray) -> LinkMotion:
    """Motion of a frame fixed in another, its axes alike, its origin ``arm`` away, (n, 3), base axes."""
    swing = cross(frame.w, arm)
    return frame._replace(p=frame.p + arm, v=frame.v + swing, a=frame.a + cross(frame.dw, arm) + cross(frame.w, swing))


def first_ticks(links: Sequence[LinkMotion], ticks: int) -> tuple[LinkMotion, ...]:
    """The first ``ticks`` ticks of some links' motion."""
    return tuple(LinkMotion(*(part[:ticks] for part in link)) for link in links)


def stacked(links: Sequence[LinkMotion]) -> LinkMotion:
    """Motions of several links stacked, (n, links, ...), for vectorised arithmetic."""
    return LinkMotion(*(np.stack(parts, axis=1) for parts in zip(*links, strict=True)))


def _inertia_columns(x: FloatArray) -> FloatArray:
    """``I x`` as columns of ``XX XY YY XZ YZ ZZ``, (..., 3, 6)."""
    columns: FloatArray = (x @ _TENSOR).reshape(*x.shape[:-1], 3, 6)
    return columns


def momentum_columns(link: LinkMotion, v: FloatArray, w: FloatArray) -> FloatArray:
    """Momentum (linear, angular about the base's origin) of one link as columns of its ten parameters, (n, 6, 10).

    ``l = m v_Lo + w_L x h``, ``k_Lo = I w_L + h x v_Lo``, moved to the base's origin; h: first moment.

    Args:
        link: its motion relative to the base.
        v: velocity of the base's origin, (n, 3).
        w: rate of the base, (n, 3).
    """
    wi = link.w + w
    vi = v + link.v + cross(w, link.p)
    Rt = link.R.swapaxes(-1, -2)
    own, along = turned(Rt, wi), turned(Rt, vi)
    H = np.zeros((*wi.shape[:-1], 6, 10))
    H[..., :3, 0] = vi
    H[..., :3, 1:4] = link.R @ hat(own)
    H[..., 3:, 0] = cross(link.p, vi)
    H[..., 3:, 1:4] = hat(link.p) @ H[..., :3, 1:4] - link.R @ hat(along)
    H[..., 3:, 4:] = link.R @ _inertia_columns(own)
    return H


def wrench_columns(link: LinkMotion, w: FloatArray, f: FloatArray, dw: FloatArray) -> FloatArray:
    """Wrench on one link, about the base's origin, as columns of its ten parameters, (n, 6, 10).

    Newton-Euler, linear in the parameters (Atkeson, An and Hollerbach 1986; Limparis 2.132).

    Args:
        link: its motion relative to the base.
        w: rate of the base, (n, 3).
        f: specific force at the base's origin, (n, 3).
        dw: angular acceleration of the base, (n, 3).
    """
    wi = link.w + w
    dwi = dw + link.dw + cross(w, link.w)
    fi = f + cross(dw, link.p) + cross(w, cross(w, link.p) + 2.0 * link.v) + link.a
    Rt = link.R.swapaxes(-1, -2)
    own, spin, force = turned(Rt, wi), turned(Rt, dwi), turned(Rt, fi)
    turning = hat(own)
    W = np.zeros((*wi.shape[:-1], 6, 10))
    W[..., :3, 0] = fi
    W[..., :3, 1:4] = link.R @ (hat(spin) + turning @ turning)
    W[..., 3:, 0] = cross(link.p, fi)
    W[..., 3:, 1:4] = hat(link.p) @ W[..., :3, 1:4] - link.R @ hat(force)
    W[..., 3:, 4:] = link.R @ (_inertia_columns(spin) + turning @ _inertia_columns(own))
    return W


class Bodies(NamedTuple):
    """Links with their standard parameters, in base axes, each about its own origin."""

    motion: LinkMotion  # stacked
    mass: FloatArray  # (links, 1)
    first: FloatArray  # (n, links, 3) first moment
    inertia: FloatArray  # (n, links, 3, 3)
    arm: FloatArray  # (n, links, 3, 3) cross-product matrix of where it is
    offset: FloatArray  # (n, links, 3, 3) and of its first moment


def bodies_of(links: LinkMotion, chi: FloatArray) -> Bodies:
    """:func:`stacked` links with their standard parameters, (10 x links,), rotated to base axes."""
    own, R = chi.reshape(-1, 10), links.R
    tensor = own[:, _SYMMETRIC].reshape(-1, 3, 3)
    first = turned(R, own[:, 1:4])
    return Bodies(links, own[:, :1], first, R @ tensor @ R.swapaxes(-1, -2), hat(links.p), hat(first))


def relative_momentum(bodies: Bodies) -> FloatArray:
    """Momentum of the links with the base at rest, (n, 6): ``mu`` of :mod:`onboard.dynamics.free_flight`."""
    links, m, h = bodies.motion, bodies.mass, bodies.first
    linear = m * links.v + cross(links.w, h)
    angular = cross(h, links.v) + turned(bodies.inertia, links.w) + cross(links.p, linear)
    return np.concatenate([linear.sum(axis=1), angular.sum(axis=1)], axis=1)


def wrench_and_slope(bodies: Bodies, w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Wrench on all links while the base only turns, (n, 6), and its derivative with respect to w, (n, 6, 3).

    Newton-Euler without the terms of the base's specific force and angular acceleration, which do not depend on w.

    Args:
        bodies: the links.
        w: rate of the base, (n, 1, 3).
    """
    links, m, h, I = bodies.motion, bodies.mass, bodies.first, bodies.inertia  # noqa: E741
    P, H = bodies.arm, bodies.offset
    wi = links.w + w
    dwi = links.dw + cross(w, links.w)
    sweep = cross(w, links.p) + 2.0 * links.v
    fi = cross(w, sweep) + links.a
    turning, along = cross(wi, h), turned(I, wi)
    out = np.empty((*wi.shape[:-1], 6))
    force = out[..., :3]
    force[:] = m * fi + cross(dwi, h) + cross(wi, turning)
    out[..., 3:] = cross(h, fi) + turned(I, dwi) + cross(wi, along) + cross(links.p, force)
    Wi, relative = hat(wi), hat(links.w)
    d_fi = -hat(sweep) - hat(w) @ P
    slope = np.empty((*wi.shape[:-1], 6, 3))
    slope[..., :3, :] = m[..., None] * d_fi + H @ relative - hat(turning) - Wi @ H
    slope[..., 3:, :] = H @ d_fi - I @ relative - hat(along) + Wi @ I + P @ slope[..., :3, :]
    return out.sum(axis=1), slope.sum(axis=1)


def composite_inertia(links: Sequence[LinkMotion], chi: FloatArray) -> FloatArray:
    """Composite spatial inertia of the vehicle about the base's origin, (n, 6, 6) (Featherstone 2008).

    Args:
        links: motions, in the order of the columns.
        chi: standard parameters, (10 x links,).
    """
    return composite_of(bodies_of(stacked(links), chi))


def composite_of(bodies: Bodies) -> FloatArray:
    """:func:`composite_inertia` of bodies."""
    return np.asarray(spatial_inertias(bodies).sum(axis=1), np.float64)


def spatial_inertias(bodies: Bodies) -> FloatArray:
    """Spatial inertia of each link about the base's origin, (n, links, 6, 6) (Featherstone 2008)."""
    m, P = bodies.mass, bodies.arm
    shift = P @ bodies.offset
    C = np.zeros((*P.shape[:2], 6, 6))
    C[..., :3, :3] = m[..., None] * np.eye(3)
    C[..., 3:, :3] = hat(bodies.first + m * bodies.motion.p)
    C[..., :3, 3:] = -C[..., 3:, :3]
    C[..., 3:, 3:] = bodies.inertia - shift - shift.swapaxes(-1, -2) - m[..., None] * P @ P
    return C
