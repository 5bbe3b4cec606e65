"""A floating vehicle's mechanics for many ticks at once: where its links are, what momentum and wrench they need.

All vectors are in base axes; moments and momenta are about the base frame's origin. Twists are (linear, angular) of the
base frame; wrenches (force, moment). Everything is linear in the standard parameters: ``momentum = H(v) chi`` and
``wrench = W(v, a) chi``, with the composite spatial inertia the part of them that multiplies the base's own twist or
acceleration. Pinocchio's kinematics say the same one tick at a time; the prediction of a whole flight needs them at
10,000 ticks for every guess.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from onboard.model.errors import SignalError
from onboard.model.vehicle import Vehicle

FloatArray = NDArray[np.float64]


class LinkMotion(NamedTuple):
    """One link frame relative to the base, in base axes; or several, their axis after that of the ticks."""

    R: FloatArray  # (n, 3, 3) link axes in base axes
    p: FloatArray  # (n, 3) origin
    v: FloatArray  # (n, 3) velocity of the origin
    w: FloatArray  # (n, 3) angular velocity
    a: FloatArray  # (n, 3) acceleration of the origin
    dw: FloatArray  # (n, 3) angular acceleration


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product along the last axis; NumPy's own takes three times as long."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def hat(a: FloatArray) -> FloatArray:
    """Cross-product matrices, (..., 3, 3): ``hat(a) @ b = a x b``."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*a.shape, 3)


def turned(R: FloatArray, a: FloatArray) -> FloatArray:
    """``R[k] @ a[k]`` for every tick k; ``a`` may be one vector."""
    out: FloatArray = np.einsum("...ij,...j->...i", R, a)
    return out


def link_motions(vehicle: Vehicle, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[LinkMotion, ...]:
    """Motion of every link with columns, in the order of ``vehicle.links``; see :func:`frame_motions`."""
    return frame_motions(vehicle, vehicle.links, q, dq, ddq)


def frame_motions(
    vehicle: Vehicle, names: Sequence[str], q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> tuple[LinkMotion, ...]:
    """Motion of frames anywhere on the vehicle.

    Args:
        vehicle: the model.
        names: of links or frames.
        q: joint positions, (n, joints).
        dq: joint rates, (n, joints).
        ddq: joint accelerations, (n, joints).

    Raises:
        SignalError: shapes that do not fit.
        UnknownFrameError: no such frame.
    """
    n, nj = q.shape[0], len(vehicle.joints)
    if any(signal.shape != (n, nj) for signal in (q, dq, ddq)):
        raise SignalError(f"joint signals must be (n, {nj}); they are {q.shape}, {dq.shape}, {ddq.shape}")
    model, zero = vehicle.model, np.zeros((n, 3))
    still = LinkMotion(np.broadcast_to(np.eye(3), (n, 3, 3)), zero, zero, zero, zero, zero)
    of_joint = {1: still}  # by Pinocchio's joint index; 1 is the base
    for column, joint in enumerate(vehicle.joints):
        index = int(model.getJointId(joint.name))
        seat = _fixed(of_joint[int(model.parents[index])], model.jointPlacements[index])
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
    frames = [model.frames[vehicle.frame_id(name)] for name in names]
    return tuple(_fixed(of_joint[int(frame.parentJoint)], frame.placement) for frame in frames)


def _fixed(parent: LinkMotion, placement: pin.SE3) -> LinkMotion:
    """A frame that stands still in its parent."""
    arm = turned(parent.R, np.asarray(placement.translation))
    swing = cross(parent.w, arm)
    return LinkMotion(
        parent.R @ np.asarray(placement.rotation),
        parent.p + arm,
        parent.v + swing,
        parent.w,
        parent.a + cross(parent.dw, arm) + cross(parent.w, swing),
        parent.dw,
    )


def stacked(links: Sequence[LinkMotion]) -> LinkMotion:
    """Several links in one, (n, links, ...): the arithmetic of all of them in one call."""
    return LinkMotion(*(np.stack(parts, axis=1) for parts in zip(*links, strict=True)))


def _inertia_columns(x: FloatArray) -> FloatArray:
    """``I x`` as columns of ``XX XY YY XZ YZ ZZ``, (..., 3, 6)."""
    a, b, c = x[..., 0], x[..., 1], x[..., 2]
    o = np.zeros_like(a)
    rows = np.stack([a, b, o, c, o, o, o, a, b, o, c, o, o, o, o, a, b, c], axis=-1)
    return rows.reshape(*x.shape[:-1], 3, 6)


def momentum_columns(link: LinkMotion, v: FloatArray, w: FloatArray) -> FloatArray:
    """Momentum (linear, angular about the base's origin) of one link as columns of its ten parameters, (n, 6, 10).

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


def wrench_and_slope(
    link: LinkMotion, own: FloatArray, w: FloatArray, f: FloatArray, dw: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """``wrench_columns @ own``, (n, 6), at a third of the price, and its derivative with respect to w, (n, 6, 3).

    Of several links at once with ``own`` (links, 10) and base motion (n, 1, 3): (n, links, 6) and (n, links, 6, 3).
    """
    R, p = link.R, link.p
    m, h = own[..., :1], turned(R, own[..., 1:4])
    I = _in_base_axes(R, own)  # noqa: E741
    wi = link.w + w
    dwi = dw + link.dw + cross(w, link.w)
    sweep = cross(w, p) + 2.0 * link.v
    fi = f + cross(dw, p) + cross(w, sweep) + link.a
    turning, along = cross(wi, h), turned(I, wi)
    out = np.empty((*wi.shape[:-1], 6))
    out[..., :3] = m * fi + cross(dwi, h) + cross(wi, turning)
    out[..., 3:] = cross(h, fi) + turned(I, dwi) + cross(wi, along) + cross(p, out[..., :3])
    H, P, Wi, relative = hat(h), hat(p), hat(wi), hat(link.w)
    d_fi = -hat(sweep) - hat(w) @ P
    slope = np.empty((*wi.shape[:-1], 6, 3))
    slope[..., :3, :] = m[..., None] * d_fi + H @ relative - hat(turning) - Wi @ H
    slope[..., 3:, :] = H @ d_fi - I @ relative - hat(along) + Wi @ I + P @ slope[..., :3, :]
    return out, slope


def _in_base_axes(R: FloatArray, own: FloatArray) -> FloatArray:
    """Inertia tensors of links in base axes, about each one's own origin."""
    tensor = own[..., [4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(*own.shape[:-1], 3, 3)
    return np.asarray(R @ tensor @ R.swapaxes(-1, -2), np.float64)


def composite_inertia(links: Sequence[LinkMotion], chi: FloatArray) -> FloatArray:
    """Spatial inertia of the whole vehicle about the base's origin, (n, 6, 6): its momentum per twist of the base.

    Args:
        links: motions, in the order of the columns.
        chi: standard parameters, (10 x links,).
    """
    return composite_of(stacked(links), chi)


def composite_of(link: LinkMotion, chi: FloatArray) -> FloatArray:
    """:func:`composite_inertia` of links that are :func:`stacked`."""
    own = chi.reshape(-1, 10)
    m, h = own[:, :1], turned(link.R, own[:, 1:4])  # (links, 1), (n, links, 3)
    P = hat(link.p)
    shift = P @ hat(h)
    tensor = _in_base_axes(link.R, own) - shift - shift.swapaxes(-1, -2) - m[..., None] * P @ P
    C = np.zeros((len(link.p), 6, 6))
    C[:, :3, :3] = m.sum() * np.eye(3)
    C[:, 3:, :3] = hat((h + m * link.p).sum(axis=1))
    C[:, :3, 3:] = -C[:, 3:, :3]
    C[:, 3:, 3:] = tensor.sum(axis=1)
    return C
