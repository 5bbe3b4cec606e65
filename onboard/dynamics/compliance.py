"""Joints that give way between drive and link: the bend of each, a spring and a damper, as a floating vehicle moves.

The encoder is on the drive. The link is turned further by the bend b, whose torque balance is

    t(q + b, dq + db, ddq + ddb) + K b + D db = 0,

t the torque that the motion of all that lies beyond the joint asks for, base and payload free to move (Spong, Modeling
and Control of Elastic Joint Robots, 1987, with the drive's motion given). With M the inertia of the joints while the
base gives way, t = M ddb + h, and h depends on bends little: so all ticks are solved at once, again and again, each
time ``M ddb + D db + K b = -h`` with h as the last motion has it, until it does not change. From tick to tick that is
exact by a matrix exponential, with h linear in between: a mode may swing faster than the ticks come.

To the rest of the vehicle a bend is an error of the joint's angle that varies in time, of which
:mod:`onboard.dynamics.joint_errors` has the effect on momenta and wrenches, and so on a joint's torque, too. The bends'
derivatives by all unknowns follow from the same balance, linear. A bend turns the base, and so the momentum in its
axes; what that does to the bends is of second order, and is added to their derivatives once.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.kinematics import Bodies, chain_motion
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import times
from onboard.estimation.arrays import FloatArray, IndexArray

_SETTLED_rad_s2 = 1e-3  # largest change of an acceleration at which the motion is found
_ABSURD_rad_s2 = 1e6
_MOST = 30  # iterations
_POSTURES_rad = np.linspace(0.0, 0.5 * np.pi, 4)  # of all joints: stretched out, and more and more bent
_TERMS, _SMALL = 9, 0.5  # of an exponential's series, and the norm for which it has so many


class Bend(NamedTuple):
    """Of f joints at n ticks: angle, rate, acceleration, (n, f) each."""

    b: FloatArray
    db: FloatArray
    ddb: FloatArray


class Springs(NamedTuple):
    """Of f joints."""

    stiffness: FloatArray  # (f,) N m/rad
    damping: FloatArray  # (f,) N m s/rad


class BentVehicle(NamedTuple):
    """The vehicle as it moves with some bends."""

    bodies: Bodies
    screws: FloatArray  # (n, joints, 6)


class StateColumns(NamedTuple):
    """Which unknown, by its place in the state, has which of the columns that the base's motion has."""

    of_motion: Sequence[tuple[slice | IndexArray, slice | IndexArray]]
    stiffness: IndexArray  # (f,) places of relative errors of the springs
    damping: IndexArray
    bends: IndexArray  # (2 f,) angles, then rates, at the first tick
    size: int  # of the state


class Compliance:
    """Joints of a vehicle that give way.

    Args:
        vehicle: the model.
        joints: which of its joints, in their order.
        free: links whose columns the base's prediction has.
        cyclic: the joint of each function of a cyclic error, without the bends'.

    Attributes:
        joints: as given.
        functions: the joint of each function that stands for a bend: angle of all, rate of all, acceleration of all.
    """

    def __init__(
        self, vehicle: VehicleModel, joints: Sequence[int], free: tuple[int, ...], cyclic: Sequence[int] = ()
    ) -> None:
        self._vehicle, self.joints = vehicle, np.array(joints, np.intp)
        self.functions: list[int] = [*joints] * 3
        beyond = [vehicle.distal_links(vehicle.joints[k].name) for k in joints]
        self._beyond = np.array([[float(link in own) for link in range(len(vehicle.links))] for own in beyond])
        every = [*cyclic, *self.functions]
        cuts = [(vehicle.joints[k].name, np.array([0.0, 0.0, 0.0, *vehicle.joints[k].axis])) for k in joints]
        self._cuts = [CutWrench(vehicle, name, weights, free, every) for name, weights in cuts]
        path = vehicle.tree.below + np.eye(len(vehicle.joints))
        self._carries: FloatArray = path[np.ix_(joints, joints)]  # one where the row's is moved by the column's

    @property
    def count(self) -> int:
        """Of the joints that give way, f."""
        return len(self.joints)

    def unit_functions(self, ticks: int) -> FloatArray:
        """Functions of time of which a bend is a multiple at each tick by itself, (n, 3, 3 f)."""
        return np.tile(np.kron(np.eye(3), np.ones(self.count)), (ticks, 1, 1))

    def stiff(self, ticks: int) -> Bend:
        """No bend."""
        return Bend(*np.zeros((3, ticks, self.count)))

    def added(self, motion: Sequence[FloatArray], bend: Bend) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions, rates and accelerations, (n, joints) each, with the bends."""
        q, dq, ddq = (part.copy() for part in motion)
        for part, more in zip((q, dq, ddq), bend, strict=True):
            part[:, self.joints] += more
        return q, dq, ddq

    def inertia(self, bodies: Bodies, screws: FloatArray) -> FloatArray:
        """Of the joints while the base gives way, (n, f, f).

        Args:
            bodies: the links.
            screws: of all joints, (n, joints, 6).
        """
        S = screws[:, self.joints]
        P = times(bodies.sums(self._beyond).inertia, S)  # (n, f, 6)
        both = P @ S.swapaxes(1, 2)  # of row's and column's, what lies beyond the row's
        M = both * self._carries
        M = M + (both * (self._carries - np.eye(self.count))).swapaxes(1, 2)
        return np.asarray(M - P @ np.linalg.solve(bodies.composite, P.swapaxes(1, 2)), np.float64)

    def torque(self, bodies: Bodies, screws: FloatArray) -> FloatArray:
        """That the motion beyond each joint asks for, (n, f); arguments as of :meth:`inertia`."""
        wrench = bodies.sums(self._beyond).wrench
        return np.asarray((wrench * screws[:, self.joints]).sum(axis=2), np.float64)

    def largest(self, chi: FloatArray) -> FloatArray:
        """Inertia that the bend of each joint accelerates by itself, base free, (f,): the largest of some postures.

        Args:
            chi: standard parameters of all links, (10 x links,).
        """
        still = np.zeros((len(_POSTURES_rad), len(self._vehicle.joints)))
        chain = chain_motion(self._vehicle, still + _POSTURES_rad[:, None], still, still)
        each = np.diagonal(self.inertia(Bodies.of(chain.links, chi), chain.screws), axis1=1, axis2=2)
        return np.asarray(each.max(axis=0), np.float64)

    def follow(
        self, start: FloatArray, springs: Springs, period_s: float, ticks: int, move: Callable[[Bend], BentVehicle]
    ) -> Bend:
        """The bends along a motion.

        Args:
            start: angles and rates at the first tick, (2 f,).
            springs: of the joints.
            period_s: between ticks.
            ticks: n.
            move: the vehicle with some bends.

        Returns:
            They; NaN where no motion is found, as with springs so soft that the arm turns over.
        """
        f = self.count
        bend = self.stiff(ticks)._replace(b=np.tile(start[:f], (ticks, 1)))
        for _ in range(_MOST):
            moved = move(bend)
            M = self.inertia(*moved)
            if not np.isfinite(M).all():
                break
            W = np.asarray(np.linalg.inv(M), np.float64)
            load = bend.ddb - times(W, self.torque(*moved))
            K, D = W * springs.stiffness, W * springs.damping
            own = _propagated(_steps(K, D, period_s), start[:, None], load[..., None])[..., 0]
            found = Bend(own[:, :f], own[:, f:], load - times(K, own[:, :f]) - times(D, own[:, f:]))
            change = float(np.abs(found.ddb - bend.ddb).max())
            bend = found
            if change < _SETTLED_rad_s2:
                return bend
            if not change < _ABSURD_rad_s2:  # NaN too
                break
        return Bend(*np.full((3, ticks, f), np.nan))

    def derivatives(
        self, base: BasePrediction, bend: Bend, springs: Springs, stated: Springs, period_s: float, told: StateColumns
    ) -> FloatArray:
        """Of angles, rates and accelerations of the bends, and of the momentum that they turn, by all, (n, 3 f + 3, p).

        Args:
            base: motion with these bends; ``ErrorsAlong.local`` of its columns are theirs.
            bend: of the joints.
            springs: their values.
            stated: values to which relative errors are.
            period_s: between ticks.
            told: where the unknowns stand.
        """
        f, n = self.count, len(bend.b)
        by_all = np.stack([cut.predict(base).d_values for cut in self._cuts], axis=1)  # (n, f, columns)
        by_bend = by_all[:, :, base.local]
        M, G, C = by_bend[..., 2 * f :], by_bend[..., :f], by_bend[..., f : 2 * f]
        Q = np.zeros((n, f, told.size))
        for here, there in told.of_motion:
            Q[:, :, here] = by_all[:, :, there]
        Q[:, :, told.bends] += by_all[:, :, base.at_first][..., : 2 * f]
        each = np.arange(f)
        Q[:, each, told.stiffness] += stated.stiffness * bend.b
        Q[:, each, told.damping] += stated.damping * bend.db
        W = -np.linalg.inv(M)
        K, D = W @ (G + np.diag(springs.stiffness)), W @ (C + np.diag(springs.damping))
        start = np.zeros((2 * f, told.size))
        start[np.arange(2 * f), told.bends] = 1.0
        steps, of_momentum = _steps(-K, -D, period_s), by_all[:, :, base.of_momentum]
        turned = np.zeros((n, 3, told.size))
        for _ in range(2):
            load = W @ (Q + of_momentum @ turned)
            own = _propagated(steps, start, load)
            by_local = np.concatenate([own, load + K @ own[:, :f] + D @ own[:, f:]], axis=1)
            turned = base.turned_momentum(by_local, period_s)
        return np.concatenate([by_local, turned], axis=1)


class _Steps(NamedTuple):
    """From each tick to the next: of the state, of the load at the first, of its change."""

    state: FloatArray  # (n - 1, 2 f, 2 f)
    load: FloatArray  # (n - 1, 2 f, f)
    change: FloatArray  # (n - 1, 2 f, f)


def _steps(K: FloatArray, D: FloatArray, h: float) -> _Steps:
    """Exact steps of ``ddb = -K b - D db + g``, matrices (n, f, f) constant in between ticks, g linear."""
    n, f = len(K) - 1, K.shape[1]
    K, D = 0.5 * (K[1:] + K[:-1]), 0.5 * (D[1:] + D[:-1])
    fast = np.sqrt(max(float(np.abs(K).sum(axis=2).max()), 1.0 / h**2))  # rad/s: rates count in these
    A = np.zeros((n, 4 * f, 4 * f))
    one = np.eye(f)
    A[:, :f, f : 2 * f], A[:, f : 2 * f, :f], A[:, f : 2 * f, f : 2 * f] = fast * h * one, -h / fast * K, -h * D
    A[:, f : 2 * f, 2 * f : 3 * f], A[:, 2 * f : 3 * f, 3 * f :] = h / fast * one, one
    E = _exponential(A)[:, : 2 * f]
    E[:, f:] *= fast
    E[:, :, f : 2 * f] /= fast
    return _Steps(E[..., : 2 * f], E[..., 2 * f : 3 * f], E[..., 3 * f :])


def _exponential(A: FloatArray) -> FloatArray:
    """Of square matrices, by series and squaring (Moler and Van Loan 2003, method 3)."""
    squarings = max(0, int(np.ceil(np.log2(max(float(np.abs(A).sum(axis=2).max()), 1e-300) / _SMALL))))
    A, one = A / 2.0**squarings, np.eye(A.shape[1])
    out: FloatArray = one + A / _TERMS
    for k in range(_TERMS - 1, 0, -1):
        out = one + A @ out / k
    for _ in range(squarings):
        out = out @ out
    return out


def _propagated(steps: _Steps, start: FloatArray, load: FloatArray) -> FloatArray:
    """State at every tick, (n, 2 f, k), from the first, (2 f, k), and loads, (n, f, k)."""
    push = steps.load @ load[:-1] + steps.change @ (load[1:] - load[:-1])
    out = np.empty((len(load), *start.shape))
    out[0] = start
    for i, step in enumerate(steps.state):
        np.matmul(step, out[i], out=out[i + 1])
        out[i + 1] += push[i]
    return out
