"""Derivatives of a floating vehicle's momentum and wrench by errors of its joints.

Place, encoder zero, scale, delay, and cyclic errors: multiples of given functions of time, such as the sine of a
motor's angle.

A joint's error displaces all that lies beyond it by a small screw S, fixed in the link that carries the joint: a
translation, or a rotation about the joint's axis. With W the twist of that link, ``X = crm(W)``, and I, L, F composite
inertia, momentum and wrench of what lies beyond, all spatial and about the base's origin (Featherstone, Rigid Body
Dynamics Algorithms, 2008, chapter 2), a screw of size e(t) changes twists beyond by ``e S x (V - W) + de S`` and
inertias by ``e (crf(S) I - I crm(S))``, hence (derived here)

    dL = e (K(L) + I X) S + de I S
    dF = d(dL)/dt = e (K(L) X + K(F) + dI X + I (X X + dX)) S + de (K(L) + 2 I X + dI) S + dde I S

with ``K(L) S = crf(S) L``, ``dI = crf(V) I - I crm(V)`` summed over the links beyond, and ``dX = crm(dW/dt)``. In the
axes of a frame that the joint displaces too, and about its origin, dF is without K(F): the frame moves by the same S.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from onboard.dynamics.kinematics import Bodies, Chain, LinkMotion, cross, hat, spatial_inertias, stacked, turned
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray

JOINT_ERRORS = ("place_x", "place_y", "place_z", "zero", "scale", "delay")
PER_JOINT = len(JOINT_ERRORS)
ErrorColumns = Callable[[Bodies, FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


class Readings(NamedTuple):
    """What the encoders say: position, rate, acceleration and its rate of change, (n, joints) each."""

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    jerk: FloatArray
    cyclic: FloatArray  # (n, 3, m) functions that cyclic errors are multiples of, and their two derivatives

    @staticmethod
    def of(
        q: FloatArray, dq: FloatArray, ddq: FloatArray, period_s: float, cyclic: FloatArray | None = None
    ) -> "Readings":
        """With the jerk by differences of the acceleration."""
        cyclic = np.zeros((len(q), 3, 0)) if cyclic is None else cyclic
        return Readings(q, dq, ddq, np.gradient(ddq, period_s, axis=0), cyclic)

    def corrected(
        self, errors: FloatArray, cyclic: FloatArray, turns: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, rate and acceleration with errors taken out: ``q + zero + scale q + delay dq + cyclic functions``.

        Args:
            errors: in the order of :data:`JOINT_ERRORS`, (joints, 6).
            cyclic: multiples of the functions, (m,).
            turns: the joint of each function, as one in its column, (m, joints).
        """
        zero, scale, delay = errors[:, 3:].T
        q, dq, ddq = np.moveaxis((self.cyclic * cyclic) @ turns, 1, 0)
        return (
            self.q * (1.0 + scale) + zero + delay * self.dq + q,
            self.dq * (1.0 + scale) + delay * self.ddq + dq,
            self.ddq * (1.0 + scale) + delay * self.jerk + ddq,
        )


class JointErrors:
    """Errors of the joints of a vehicle.

    Args:
        vehicle: whose joints they are.
        cyclic: the joint of each function that a cyclic error is a multiple of, (m,).
        frame: momentum and wrench are those of what lies beyond this frame, displaced with it; None: of all links.

    Attributes:
        turns: the joints of the functions, each as one in its column, (m, joints).
    """

    def __init__(self, vehicle: VehicleModel, cyclic: Sequence[int] = (), frame: str | None = None) -> None:
        self._cyclic = np.array(cyclic, np.intp)
        self.turns = np.eye(len(vehicle.joints))[self._cyclic]
        links = range(len(vehicle.links)) if frame is None else vehicle.distal_links(frame)
        self._axes = np.array([joint.axis for joint in vehicle.joints])
        self._revolute = np.array([[joint.revolute] for joint in vehicle.joints])
        beyond = np.zeros((len(vehicle.joints), len(vehicle.links)))
        for row, joint in zip(beyond, vehicle.joints, strict=True):
            row[list(vehicle.distal_links(joint.name))] = 1.0
        self._beyond = beyond[:, list(links)]
        displaces = self._beyond.all(axis=1) if frame is not None else np.zeros(len(beyond), np.bool_)
        self._stays = np.where(displaces, 0.0, 1.0)[:, None]

    def along(self, chain: Chain, readings: Readings) -> ErrorColumns:
        """:meth:`columns` of one motion of the vehicle's chain, and what its encoders read."""
        return partial(self.columns, stacked(chain.seats), readings)

    def columns(
        self,
        seats: LinkMotion,
        readings: Readings,
        bodies: Bodies,
        v: FloatArray,
        w: FloatArray,
        f: FloatArray,
        dw: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of momentum and wrench of all links about the base's origin, (n, 6, 6 x joints + m) each.

        Args:
            seats: of the joints, stacked.
            readings: of their encoders.
            bodies: the links, all or those beyond the frame.
            v: velocity of the base's origin, (n, 3), base axes, as all.
            w: its rate, (n, 3).
            f: specific force there, (n, 3).
            dw: its angular acceleration, (n, 3).
        """
        base = np.concatenate([v, w], axis=1)[:, None]
        base_rate = np.concatenate([f - cross(w, v), dw], axis=1)[:, None]
        V, A = _spatial(bodies.motion, base, base_rate)
        each = spatial_inertias(bodies)  # (n, links, 6, 6)
        momentum, along, across = turned(each, V), _crm(V), _crf(V)
        L = self._beyond @ momentum  # (n, joints, 6)
        F = self._beyond @ (turned(each, A) + turned(across, momentum))
        I, dI = self._sums(each), self._sums(across @ each - each @ along)  # noqa: E741
        W, dW = _spatial(seats, base, base_rate)
        X, KL = _crm(W), _coad(L)
        S = self._screws(seats)
        still, IS = KL + I @ X, I @ S
        momenta = still @ S  # (n, joints, 6, 4)
        wrenches = ((KL + dI) @ X + _coad(F * self._stays) + I @ (X @ X + _crm(dW))) @ S
        turn, slide = IS[..., 3], ((still + I @ X + dI) @ S[..., 3:])[..., 0]
        q, dq, ddq, jerk = (x[:, :, None] for x in readings[:4])
        zero, own = momenta[..., 3], wrenches[..., 3]
        H = np.stack([*np.moveaxis(momenta, -1, 0), q * zero + dq * turn, dq * zero + ddq * turn], axis=-1)
        scale, delay = q * own + dq * slide + ddq * turn, dq * own + ddq * slide + jerk * turn
        Y = np.stack([*np.moveaxis(wrenches, -1, 0), scale, delay], axis=-1)
        n, of = len(v), self._cyclic
        H, Y = (x.swapaxes(1, 2).reshape(n, 6, -1) for x in (H, Y))
        if of.size:
            e, de, dde = (readings.cyclic[:, k, :, None] for k in range(3))
            more = e * zero[:, of] + de * turn[:, of], e * own[:, of] + de * slide[:, of] + dde * turn[:, of]
            H, Y = (np.concatenate([x, y.swapaxes(1, 2)], axis=2) for x, y in zip((H, Y), more, strict=True))
        return H, Y

    def _screws(self, seats: LinkMotion) -> FloatArray:
        """Screws of a joint's translation by its axes, and of its own motion, (n, joints, 6, 4)."""
        axis = turned(seats.R, self._axes)
        S = np.zeros((*axis.shape[:2], 6, 4))
        S[..., :3, :3] = seats.R
        S[..., :3, 3] = np.where(self._revolute, cross(seats.p, axis), axis)
        S[..., 3:, 3] = np.where(self._revolute, axis, 0.0)
        return S

    def _sums(self, each: FloatArray) -> FloatArray:
        """Sums over the links beyond each joint, (n, joints, 6, 6)."""
        n, links = each.shape[:2]
        return np.asarray((self._beyond @ each.reshape(n, links, 36)).reshape(n, -1, 6, 6), np.float64)


def _spatial(motion: LinkMotion, base: FloatArray, base_rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Spatial twist and acceleration about the base's origin, (n, k, 6), of what moves relative to the base."""
    own = np.concatenate([motion.v - cross(motion.w, motion.p), motion.w], axis=-1)
    change = motion.a - cross(motion.dw, motion.p) - cross(motion.w, motion.v)
    return base + own, base_rate + turned(_crm(base), own) + np.concatenate([change, motion.dw], axis=-1)


def _crm(V: FloatArray) -> FloatArray:
    """``crm(V) U = V x U`` of motion vectors (linear, angular), (..., 6, 6)."""
    out = np.zeros((*V.shape, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = hat(V[..., 3:])
    out[..., :3, 3:] = hat(V[..., :3])
    return out


def _crf(V: FloatArray) -> FloatArray:
    """``crf(V) F = V x* F`` of force vectors, (..., 6, 6): ``-crm(V)'``."""
    return -_crm(V).swapaxes(-1, -2)


def _coad(L: FloatArray) -> FloatArray:
    """``K(L) S = S x* L``, (..., 6, 6)."""
    out = np.zeros((*L.shape, 6))
    out[..., :3, 3:] = out[..., 3:, :3] = -hat(L[..., :3])
    out[..., 3:, 3:] = -hat(L[..., 3:])
    return out
