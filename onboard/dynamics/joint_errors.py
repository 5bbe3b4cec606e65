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

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.bodies import Bodies, Sums
from onboard.dynamics.kinematics import Chain
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import coad, crm
from onboard.estimation.arrays import FloatArray

JOINT_ERRORS = ("place_x", "place_y", "place_z", "zero", "scale", "delay")
PER_JOINT = len(JOINT_ERRORS)


class Readings(NamedTuple):
    """What the encoders say: position, rate, acceleration and its rate of change, (n, joints) each."""

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    jerk: FloatArray
    cyclic: FloatArray  # (n, 4, m) functions that cyclic errors are multiples of, and their three derivatives

    @staticmethod
    def of(
        q: FloatArray, dq: FloatArray, ddq: FloatArray, period_s: float, cyclic: FloatArray | None = None
    ) -> "Readings":
        """With the third derivatives by differences of the second; ``cyclic``: functions and two, (n, 3, m)."""
        cyclic = np.zeros((len(q), 3, 0)) if cyclic is None else cyclic
        functions = np.concatenate([cyclic, _change(cyclic[:, 2:], period_s)], axis=1)
        return Readings(q, dq, ddq, _change(ddq, period_s), functions)

    def without_cyclic(self, errors: FloatArray, cyclic: FloatArray, turns: FloatArray) -> "Readings":
        """With cyclic errors taken out, and the functions as scale and delay change what these do to the position.

        What a late encoder says is a former angle with the error at that angle. Of ripples that are no motion a delay
        tells nothing: beside them in the rates that it multiplies it would be found too small.

        Args:
            errors: in the order of :data:`JOINT_ERRORS`, (joints, 6).
            cyclic: multiples of the first k functions, (k,); the others stay.
            turns: the joint of each function, as one in its column, (m, joints).
        """
        k = len(cyclic)
        own, (_, scale, delay) = turns[:k], errors[:, 3:].T
        q, dq, ddq, jerk = ((self.cyclic[..., :k] * cyclic) @ own).swapaxes(0, 1)
        functions = self.cyclic.copy()
        functions[..., :k] *= 1.0 + own @ scale
        functions[:, :3, :k] += self.cyclic[:, 1:, :k] * (own @ delay)
        return Readings(self.q + q, self.dq + dq, self.ddq + ddq, self.jerk + jerk, functions)

    def corrected(self, errors: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, rate and acceleration with errors taken out: ``q + zero + scale q + delay dq``.

        Args:
            errors: in the order of :data:`JOINT_ERRORS`, (joints, 6).
        """
        zero, scale, delay = errors[:, 3:].T
        return (
            self.q * (1.0 + scale) + zero + delay * self.dq,
            self.dq * (1.0 + scale) + delay * self.ddq,
            self.ddq * (1.0 + scale) + delay * self.jerk,
        )


def _change(values: FloatArray, period_s: float) -> FloatArray:
    """Rate of change by differences, at all ticks, (n, ...)."""
    out = np.empty_like(values)
    out[1:-1] = (values[2:] - values[:-2]) / (2.0 * period_s)
    out[0], out[-1] = (values[1] - values[0]) / period_s, (values[-1] - values[-2]) / period_s
    return out


class Displaced(NamedTuple):
    """Screws of a joint's translations along its axes and of its own motion, and what they become with its seat."""

    screws: FloatArray  # (n, joints, 6, 12): S, X S, (X X + dX) S, four columns each
    functions: FloatArray  # (n, 3 x joints, f) of time that scale, delay and cyclic errors multiply, and derivatives


class JointErrors:
    """Errors of the joints of a vehicle.

    Args:
        vehicle: whose joints they are.
        cyclic: the joint of each function that a cyclic error is a multiple of, (m,).
        frame: momentum and wrench are those of what lies beyond this frame, displaced with it; None: of all links.

    Attributes:
        turns: the joints of the functions, each as one in its column, (m, joints).
        columns: number of the errors, 6 x joints + m.
    """

    def __init__(self, vehicle: VehicleModel, cyclic: Sequence[int] = (), frame: str | None = None) -> None:
        joints = len(vehicle.joints)
        self.turns = np.eye(joints)[np.array(cyclic, np.intp)]
        links = range(len(vehicle.links)) if frame is None else vehicle.distal_links(frame)
        self._axes = vehicle.tree.axis
        self._beyond = np.zeros((joints, len(vehicle.links)))
        for row, joint in zip(self._beyond, vehicle.joints, strict=True):
            row[[link for link in vehicle.distal_links(joint.name) if link in links]] = 1.0
        displaces = self._beyond.sum(axis=1) == len(links) if frame is not None else np.zeros(joints, np.bool_)
        self._stays = np.where(displaces, 0.0, 1.0)[:, None]
        self.columns = PER_JOINT * joints + len(cyclic)
        each = np.arange(joints)
        self._of = np.concatenate([each, each, np.array(cyclic, np.intp)])  # joint of each error that is a function

    def along(self, chain: Chain, readings: Readings, local: int = 0) -> "ErrorsAlong":
        """The errors of one motion of the vehicle's chain, and what its encoders read; see :class:`ErrorsAlong`."""
        return ErrorsAlong(self, chain, readings, local)

    def functions(self, readings: Readings) -> FloatArray:
        """The functions of time, each in the rows of its joint, (n, 3 x joints, f): values, then two derivatives."""
        every = np.stack([readings.q, readings.dq, readings.ddq, readings.jerk], axis=1)
        f = np.concatenate([every[:, :3], every[:, 1:], readings.cyclic[:, :3]], axis=2)  # (n, 3, f)
        out = np.zeros((len(f), 3, every.shape[2], f.shape[2]))
        out[:, :, self._of, np.arange(f.shape[2])] = f
        return out.reshape(len(f), -1, f.shape[2])

    def beyond(self, bodies: Bodies) -> Sums:
        """Sums over the links beyond each joint, those beyond the frame alone."""
        return bodies.sums(self._beyond)

    def of_moment(self, displaced: Displaced, bodies: Bodies) -> FloatArray:
        """Derivative of the sum of mass times place of the links, base axes, (n, 3, columns): ``I S`` of those beyond.

        Args:
            displaced: by the errors.
            bodies: all links.
        """
        moved = self.beyond(bodies).inertia[..., :3, :] @ displaced.screws[..., :4]  # (n, joints, 3, 4)
        out = np.empty((len(moved), 3, self.columns))
        _put(out, moved, moved[..., 3].swapaxes(1, 2) @ displaced.functions[:, : moved.shape[1]])
        return out

    def into(self, displaced: Displaced, bodies: Bodies, H: FloatArray | None, Y: FloatArray) -> None:
        """Derivatives of momentum and wrench of the links about the base's origin, (n, 6, columns) each.

        Args:
            displaced: by the errors.
            bodies: all links, with the base's motion.
            H: where that of the momentum is put; None: it is not wanted.
            Y: where that of the wrench is put.
        """
        U, f = displaced.screws, displaced.functions
        joints = U.shape[1]
        sums = self.beyond(bodies)
        I = sums.inertia @ U[..., 3:]  # noqa: E741
        K = coad(sums.momentum) @ U[..., :8]
        D = sums.change @ U[..., 3:8]
        wrenches = K[..., 4:] + D[..., 1:] + I[..., 5:] + coad(sums.wrench * self._stays) @ U[..., :4]
        turn, slide = I[..., 0], K[..., 3] + 2.0 * I[..., 4] + D[..., 0]
        _put(Y, wrenches, np.concatenate([wrenches[..., 3], slide, turn], axis=1).swapaxes(1, 2) @ f)
        if H is None:
            return
        momenta = K[..., :4] + I[..., 1:5]
        _put(H, momenta, np.concatenate([momenta[..., 3], turn], axis=1).swapaxes(1, 2) @ f[:, : 2 * joints])


def _put(out: FloatArray, still: FloatArray, moving: FloatArray) -> None:
    """Columns of places and zeros, (n, joints, r, 4), and of the functions, (n, r, f), in the order of the errors."""
    n, joints, rows = still.shape[:3]
    own, two = out[:, :, : PER_JOINT * joints].reshape(n, rows, joints, PER_JOINT), 2 * joints
    own[..., :4] = still.transpose(0, 2, 1, 3)
    own[..., 4:] = moving[:, :, :two].reshape(n, rows, 2, joints).swapaxes(2, 3)
    out[:, :, PER_JOINT * joints :] = moving[:, :, two:]


class ErrorsAlong(NamedTuple):
    """Errors of the joints along one motion."""

    errors: JointErrors
    chain: Chain
    readings: Readings
    local: int = 0  # so many of the last columns are errors at each tick by itself, not along the motion

    @property
    def columns(self) -> int:
        """How many they are."""
        return self.errors.columns

    def displaced(self, bodies: Bodies) -> Displaced:
        """What they displace, with the base moving as the bodies do."""
        seats, n = self.chain.seats, len(bodies.twist)
        U = np.zeros((n, seats.p.shape[1], 6, 12))
        U[..., :3, :3] = seats.R
        U[..., 3] = self.chain.screws
        X = crm(seats.V + bodies.twist[:, None])
        change = seats.A + bodies.rate[:, None] + seats.V @ crm(bodies.twist).swapaxes(1, 2)
        np.matmul(X, U[..., :4], out=U[..., 4:8])
        U[..., 8:] = X @ U[..., 4:8] + crm(change) @ U[..., :4]
        return Displaced(U, self.errors.functions(self.readings))

    def into(self, displaced: Displaced, bodies: Bodies, H: FloatArray, Y: FloatArray) -> None:
        """See :meth:`JointErrors.into`."""
        self.errors.into(displaced, bodies, H, Y)
