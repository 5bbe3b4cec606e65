"""Kinematics, momentum and wrench of a floating vehicle's links, vectorised over ticks.

All vectors are in base axes; moments and momenta are about the base frame's origin. Twists are (linear, angular) of the
base frame; wrenches (force, moment). Everything is linear in the standard parameters: ``momentum = H(v) chi`` and
``wrench = W(v, a) chi``, with the composite spatial inertia the part of them that multiplies the base's twist or
acceleration. Pinocchio computes the same one tick at a time; predicting a whole flight needs 10,000 ticks per initial
guess. Recursion over the chain and Newton-Euler equations: Featherstone, Rigid Body Dynamics Algorithms (2008).
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import force_transforms, own_inertias
from onboard.estimation.arrays import FloatArray, hat
from onboard.native import library

_TENSOR = np.zeros((3, 18))  # maps a vector to its product with a symmetric tensor, by columns of XX XY YY XZ YZ ZZ
_TENSOR[[0, 1, 2, 0, 1, 2, 0, 1, 2], [0, 1, 3, 7, 8, 10, 15, 16, 17]] = 1.0


class LinkMotion(NamedTuple):
    """Motion of one link frame relative to the base, base axes."""

    R: FloatArray  # (n, 3, 3) link axes in base axes
    p: FloatArray  # (n, 3) origin
    v: FloatArray  # (n, 3) velocity of the origin
    w: FloatArray  # (n, 3) angular velocity
    a: FloatArray  # (n, 3) acceleration of the origin
    dw: FloatArray  # (n, 3) angular acceleration


class Frames(NamedTuple):
    """Motion of k frames relative to the base."""

    R: FloatArray  # (n, k, 3, 3) axes in base axes
    p: FloatArray  # (n, k, 3) origins
    V: FloatArray  # (n, k, 6) spatial twists: the linear part is that of the point at the base's origin
    A: FloatArray  # (n, k, 6) their rates of change

    def first(self, ticks: int) -> "Frames":
        """The first ticks."""
        return Frames(*(part[:ticks] for part in self))


class Chain(NamedTuple):
    """Motion of a vehicle's links and joints relative to the base."""

    links: Frames  # in the order of the vehicle's links
    seats: Frames  # the frame of each joint at its zero, fixed in the link that carries the joint
    screws: FloatArray  # (n, joints, 6) twist of a joint's unit rate
    axes: FloatArray  # (n, joints + 1, 3, 3) of the bodies: the base, then what each joint carries
    origins: FloatArray  # (n, joints + 1, 3)


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


def turned(R: FloatArray, a: FloatArray) -> FloatArray:
    """Rotation ``b[k] = R[k] @ a[k]`` for every tick k; ``a`` may be one vector."""
    out: FloatArray = np.einsum("...ij,...j->...i", R, a)
    return out


def link_motions(
    vehicle: VehicleModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, offsets: FloatArray | None = None
) -> tuple[LinkMotion, ...]:
    """The links of :func:`chain_motion`, which has the arguments, one by one."""
    R, p, V, A = chain_motion(vehicle, q, dq, ddq, offsets).links
    w, dw = V[..., 3:], A[..., 3:]
    v = V[..., :3] + cross(w, p)
    a = A[..., :3] + cross(dw, p) + cross(w, v)
    return tuple(LinkMotion(*(part[:, k] for part in (R, p, v, w, a, dw))) for k in range(len(vehicle.links)))


def chain_motion(
    vehicle: VehicleModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, offsets: FloatArray | None = None
) -> Chain:
    """Motion of every link and joint (Rodrigues' formula; Featherstone 2008), by recursion from the base outwards.

    Args:
        vehicle: the model; the links are in the order of its ``links``.
        q: joint positions, (n, joints).
        dq: joint rates, (n, joints).
        ddq: joint accelerations, (n, joints).
        offsets: of each joint from its place in the drawing, (joints, 3), m, in the axes of its frame at zero.

    Raises:
        SignalError: shapes that do not fit.
        ArrayError: offsets of another shape.
    """
    n, nj, nl, tree = q.shape[0], len(vehicle.joints), len(vehicle.links), vehicle.tree
    if any(signal.shape != (n, nj) for signal in (q, dq, ddq)):
        raise SignalError(f"joint signals must be (n, {nj}); they are {q.shape}, {dq.shape}, {ddq.shape}")
    moved = None if offsets is None else library.given(offsets, nj, 3)
    motion = [library.given(part, n, nj) for part in (q, dq, ddq)]
    out = np.empty(n * (24 * nl + 30 * nj + 12 * (nj + 1)))
    pointers = (library.address(part) for part in (*motion, moved))
    library.call("heft_chain", ctypes.byref(tree.compiled), n, *pointers, out=out)
    shapes = [(n, count, *own) for count in (nl, nj) for own in ((3, 3), (3,), (6,), (6,))]
    parts = library.carved(out, [*shapes, (n, nj, 6), (n, nj + 1, 3, 3), (n, nj + 1, 3)])
    return Chain(Frames(*parts[:4]), Frames(*parts[4:8]), *parts[8:])


def frames_of(links: Sequence[LinkMotion]) -> Frames:
    """Motions of several links as frames."""
    R, p, v, w, a, dw = (np.stack(parts, axis=1) for parts in zip(*links, strict=True))
    linear, change = v - cross(w, p), a - cross(dw, p) - cross(w, v)
    return Frames(R, p, np.concatenate([linear, w], axis=-1), np.concatenate([change, dw], axis=-1))


def first_ticks(links: Sequence[LinkMotion], ticks: int) -> tuple[LinkMotion, ...]:
    """The first ``ticks`` ticks of some links' motion."""
    return tuple(LinkMotion(*(part[:ticks] for part in link)) for link in links)


def inertia_columns(x: FloatArray) -> FloatArray:
    """``I x`` as columns of ``XX XY YY XZ YZ ZZ``, (..., 3, 6)."""
    columns: FloatArray = (x @ _TENSOR).reshape(*x.shape[:-1], 3, 6)
    return columns


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
    W[..., 3:, 4:] = link.R @ (inertia_columns(spin) + turning @ inertia_columns(own))
    return W


def composite_inertia(links: Sequence[LinkMotion], chi: FloatArray) -> FloatArray:
    """Composite spatial inertia of the vehicle about the base's origin, (n, 6, 6) (Featherstone 2008).

    Args:
        links: motions, in the order of the columns.
        chi: standard parameters, (10 x links,).
    """
    X = force_transforms(np.stack([link.R for link in links], axis=1), np.stack([link.p for link in links], axis=1))
    return np.asarray(spatial_inertias(X, chi).sum(axis=1), np.float64)


def spatial_inertias(X: FloatArray, chi: FloatArray) -> FloatArray:
    """Spatial inertia of each link about the base's origin, (n, links, 6, 6) (Featherstone 2008).

    Args:
        X: :func:`onboard.dynamics.spatial.force_transforms` of the links, (n, links, 6, 6).
        chi: standard parameters, (10 x links,).
    """
    out: FloatArray = X @ own_inertias(chi) @ X.swapaxes(-1, -2)
    return out
