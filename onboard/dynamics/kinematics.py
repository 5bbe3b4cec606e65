"""Kinematics, momentum and wrench of a floating vehicle's links, vectorised over ticks.

All vectors are in base axes; moments and momenta are about the base frame's origin. Twists are (linear, angular) of the
base frame; wrenches (force, moment). Everything is linear in the standard parameters: ``momentum = H(v) chi`` and
``wrench = W(v, a) chi``, with the composite spatial inertia the part of them that multiplies the base's twist or
acceleration. Pinocchio computes the same one tick at a time; predicting a whole flight needs 10,000 ticks per initial
guess. Recursion over the chain and Newton-Euler equations: Featherstone, Rigid Body Dynamics Algorithms (2008).

Links of a floating vehicle as bodies that move with it: spatial inertias, momenta, wrenches, and sums of these.

With V the twist of a link, I its spatial inertia and L = I V its momentum, all about the base's origin in base axes
(Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 2), ``dI/dt = crf(V) I - I crm(V)``, and the wrench that
its motion asks for is ``F = I A + crf(V) L``, A the rate of change of V. Computed in ``onboard/native/src/bodies.c``.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import force_transforms, own_inertias
from onboard.estimation.arrays import FloatArray, cross, hat
from onboard.native import library, structures

_TENSOR = np.zeros((3, 18))  # maps a vector to its product with a symmetric tensor, by columns of XX XY YY XZ YZ ZZ
_TENSOR[[0, 1, 2, 0, 1, 2, 0, 1, 2], [0, 1, 3, 7, 8, 10, 15, 16, 17]] = 1.0
PARTS = 31  # of a link or a sum: ten numbers of its inertia, nine of their change, momentum, wrench


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


class Chain(NamedTuple):
    """Motion of a vehicle's links and joints relative to the base."""

    links: Frames  # in the order of the vehicle's links
    seats: Frames  # the frame of each joint at its zero, fixed in the link that carries the joint
    screws: FloatArray  # (n, joints, 6) twist of a joint's unit rate
    axes: FloatArray  # (n, joints + 1, 3, 3) of the bodies: the base, then what each joint carries
    origins: FloatArray  # (n, joints + 1, 3)


def turned(R: FloatArray, a: FloatArray) -> FloatArray:
    """Rotation ``b[k] = R[k] @ a[k]`` for every tick k; ``a`` may be one vector."""
    out: FloatArray = np.einsum("...ij,...j->...i", R, a)
    return out


def link_motions(
    vehicle: VehicleModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, offsets: FloatArray | None = None
) -> tuple[LinkMotion, ...]:
    """The links of :func:`chain_motion`, which has the arguments, one by one."""
    return motions_of(chain_motion(vehicle, q, dq, ddq, offsets).links)


def motions_of(frames: Frames) -> tuple[LinkMotion, ...]:
    """Frames one by one; :func:`frames_of` takes it back."""
    R, p, V, A = frames
    w, dw = V[..., 3:], A[..., 3:]
    v = V[..., :3] + cross(w, p)
    a = A[..., :3] + cross(dw, p) + cross(w, v)
    return tuple(LinkMotion(*(part[:, k] for part in (R, p, v, w, a, dw))) for k in range(p.shape[1]))


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
    return chain_of(out, n, nl, nj)


def chain_of(out: FloatArray, n: int, nl: int, nj: int) -> Chain:
    """The chain of so many links and joints at n ticks as the compiled core has put it."""
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


class Sums(NamedTuple):
    """Sums over groups of bodies."""

    inertia: FloatArray  # (n, groups, 6, 6)
    change: FloatArray  # (n, groups, 6, 6) its rate of change
    momentum: FloatArray  # (n, groups, 6)
    wrench: FloatArray  # (n, groups, 6)


def moving_frames(frames: Frames, chi: FloatArray) -> structures.MovingFrames:
    """Links for the compiled core.

    Args:
        frames: their motion relative to the base.
        chi: standard parameters of all links, (10 x links,).

    Raises:
        ArrayError: shapes that do not fit.
    """
    n, links = frames.p.shape[:2]
    parts = zip(frames, ((3, 3), (3,), (6,), (6,)), strict=True)
    arrays = (library.given(part, n, links, *shape) for part, shape in parts)
    return structures.MovingFrames(n, links, *arrays, library.given(chi, 10 * links))


def motion_size(n: int, links: int) -> int:
    """Length of the array that :class:`Bodies` are made of."""
    return n * (links * (PARTS + 12) + 117)


class Bodies:
    """The links of a vehicle as they move.

    Args:
        frames: their motion relative to the base.
        motion: of them and the base, as the compiled core makes it.

    Attributes:
        frames: as given.
        parts: inertia, its change, momentum and wrench of each link, (n, links, PARTS).
        composite: spatial inertia of all, (n, 6, 6).
        relative_momentum: momentum of all with the base at rest, (n, 6).
        twist: of the base, (n, 6).
        rate: rate of change of that, (n, 6).
        V: twists of the links, (n, links, 6).
        A: rates of change of these.
        inverse: of the composite inertia, (n, 6, 6), where the motion was predicted; NaN of a body without mass.
        momentum: of all, angular, about the centre of mass, (n, 3), where the motion was predicted.
        slope: derivative of the wrench on all links by the base's rate, (n, 6, 3); specific force and angular
            acceleration of the base are held.
        thrust: specific force and angular acceleration of the base, (n, 6).
    """

    def __init__(self, frames: Frames, motion: FloatArray) -> None:
        self.frames = frames
        n, k = frames.p.shape[:2]
        shapes = (n, k, PARTS), (n, 6, 6), (n, 6), (n, 6), (n, 6), (n, k, 6), (n, k, 6)
        parts = library.carved(motion, [*shapes, (n, 6, 6), (n, 3), (n, 6, 3), (n, 6)])
        self.parts, self.composite, self.relative_momentum, self.twist, self.rate, self.V, self.A = parts[:7]
        self.inverse, self.momentum, self.slope, self.thrust = parts[7:]

    @staticmethod
    def of(
        frames: Frames, chi: FloatArray, twist: FloatArray | None = None, thrust: FloatArray | None = None
    ) -> "Bodies":
        """The links where the base has a twist, specific force and angular acceleration; None: it is at rest.

        Args:
            frames: their motion relative to the base.
            chi: standard parameters of all links, (10 x links,).
            twist: of the base, (n, 6).
            thrust: specific force and angular acceleration of the base, (n, 6).

        Raises:
            ArrayError: shapes that do not fit.
        """
        n, links = frames.p.shape[:2]
        moving = moving_frames(frames, chi)
        given = [library.given(np.zeros((n, 6)) if part is None else part, n, 6) for part in (twist, thrust)]
        pointers = [None if twist is None else library.address(part) for part in given]
        out = np.empty(motion_size(n, links))
        return Bodies(frames, library.call("heft_bodies", ctypes.byref(moving), *pointers, out=out))

    @property
    def X(self) -> FloatArray:  # noqa: N802
        """:func:`onboard.dynamics.spatial.force_transforms` of the links, (n, links, 6, 6)."""
        return force_transforms(self.frames.R, self.frames.p)

    def sums(self, groups: FloatArray) -> Sums:
        """Sums over groups: one where a link is in one, (groups, links).

        Raises:
            ArrayError: groups of another number of links.
        """
        (n, links), k = self.frames.p.shape[:2], len(groups)
        weights, out = library.given(groups, k, links), np.empty(84 * n * k)
        library.call("heft_sums", n, links, k, library.address(self.parts), library.address(weights), out=out)
        return Sums(*library.carved(out, [(n, k, 6, 6), (n, k, 6, 6), (n, k, 6), (n, k, 6)]))
