"""Predicts base IMU and further instruments over a batch of ticks from a state propagated between batches.

The state has the unknowns of a free flight: current rate of the base, payload, current IMU biases and their drifts,
scale, misalignment and delay, uncertain links, the IMU's place, errors of the joints' places and encoders, and the
errors of further IMUs and load cells (:mod:`onboard.identification.exiddm.further`). All but the rate
(:mod:`onboard.dynamics.free_flight`) and the biases are constant.

Cyclic errors of an encoder behind a gear are functions of its angle (eccentricity, transmission error); as noise they
would make the payload too light (errors in variables). Their functions come through the same smoothing as the joints.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.free_flight import BasePrediction, at_sensor, predict_base_from_rate
from onboard.dynamics.joint_errors import PER_JOINT, JointErrors, Readings
from onboard.dynamics.kinematics import (
    Chain,
    bodies_of,
    chain_motion,
    composite_of,
    cross,
    hat,
    link_motions,
    relative_momentum,
    stacked,
    turned,
)
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.identification.exiddm.further import Further, FurtherCell
from onboard.identification.exiddm.imu_errors import BIASES, DRIFTS, SIZE, ImuPrior, imu_blocks, imu_reading, tick_mean
from onboard.identification.exiddm.parameters import EXACT_GEOMETRY, Block, GeometryPrior, Layout, UncertainLinks
from onboard.identification.exiddm.ticks import Ticks

RATE, PAYLOAD = slice(0, 3), slice(3, 13)  # of the state: unknown, so always estimated
FIRST_TICKS = 10  # for the initial rate
DRIFT_MEMORY_s = 20.0  # correlation time of a bias drift: that of a chip that warms up
_IMMODERATE = 1e12  # of a prediction in SI units
_POSTURE_TICKS = 10  # over which the arm's posture is constant in the effect of its noise


class Prediction(NamedTuple):
    """Prediction of the ticks 1 .. b of b + 2, from a state at tick 0."""

    values: FloatArray  # (b, m) rate and specific force in the first IMU's axes, then what further instruments show
    jacobian: FloatArray  # (b, m, p)
    state: FloatArray  # (p,) propagated to tick b
    transition: FloatArray  # (p, p) derivative of that

    @property
    def moderate(self) -> bool:
        """Whether no square of it overflows; else the joints' signals are nonsense."""
        parts = self.values, self.jacobian, self.state, self.transition
        return all(bool((np.abs(part) < _IMMODERATE).all()) for part in parts)  # False for NaN


class _Motion(NamedTuple):
    """Of base and arm with the unknowns as they are estimated."""

    base: BasePrediction
    chain: Chain
    chi: FloatArray
    readings: Readings | None  # None: the joints are exact


class _Imu(NamedTuple):
    """An IMU, and where its unknowns stand among all."""

    R_BS: FloatArray
    p_BoSo_B: FloatArray  # noqa: N815
    samples: int
    errors: slice
    place: slice


class ImuPredictor:
    """Predicts the instruments of a vehicle, the first of them its base IMU.

    Args:
        vehicle: with a payload link; its standard parameters are the prior of all other links.
        imu_frame: the first IMU's frame S, fixed in the base B.
        period_s: between ticks.
        samples: of that IMU in each tick's mean.
        link_covariance: see :class:`onboard.identification.exiddm.parameters.UncertainLinks`.
        imu_prior: on instrument errors; the clock rate error is taken for none.
        geometry: prior on places of IMU and joints, and on encoder errors.
        further: instruments besides that IMU.

    Attributes:
        names: of the p parameters.
        sigma: (p,) before the flight; NaN for rate and payload, of which nothing is known.
        biases: where each bias stands in the state, and where its drift.
        further: instruments besides the first IMU.
        lines: of what is predicted by instrument, the first IMU first.
        of_further: where the errors of each further instrument stand in the state: of a cell its scale alone.
        stated: (p,) as ``sigma``, of biases as they may be after their drift.
        wandering: where the delays stand that wander, and the correlation time of each.

    Raises:
        UnknownFrameError: no payload link, or a name that the URDF does not have.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        imu_frame: str,
        period_s: float,
        samples: int,
        link_covariance: Mapping[str, FloatArray],
        imu_prior: ImuPrior,
        geometry: GeometryPrior = EXACT_GEOMETRY,
        further: Sequence[Further] = (),
    ) -> None:
        self.vehicle, self.period_s = vehicle, period_s
        self.further = tuple(sorted(further, key=lambda one: isinstance(one, FurtherCell)))
        self._links = UncertainLinks(vehicle, link_covariance)
        halves = [np.linalg.cholesky(block) for block in self._links.covariances]
        self._basis = block_diag(*halves) if halves else np.zeros((0, 0))  # of the links, one sigma long each
        r = len(self._basis)
        blocks = {
            "start": Block(tuple(f"rate_{axis}" for axis in "xyz"), np.full(3, np.nan)),
            "payload": Block(self._links.payload_names, np.full(10, np.nan)),
            **imu_blocks(imu_prior._replace(clock_rate_error=0.0)),
            "links": Block(self._links.inertial_names, np.ones(r)),
            **geometry.blocks(vehicle),
        }
        for one in self.further:
            blocks |= _blocks_of(one)
        layout = Layout(blocks)
        self._layout, self.names, self.sigma = layout, layout.names, layout.sigma
        first, of_cyclic = slice(PAYLOAD.stop, PAYLOAD.stop + SIZE), geometry.cyclic_joints(vehicle)
        self._imus = [_Imu(*vehicle.pose_in_base(imu_frame), samples, first, layout["imu_place"])]
        self._cells: list[tuple[FurtherCell, CutWrench]] = []
        self.wandering: list[tuple[int, float]] = []
        for one in self.further:
            if isinstance(one, FurtherCell):
                projection = np.array(one.projection, np.float64)
                self._cells.append((one, CutWrench(vehicle, one.frame, projection, self._links.indices, of_cyclic)))
                continue
            at = layout[f"gyro_bias_rad_s {one.name}"].start
            errors, place = slice(at, at + SIZE), layout[f"place {one.name}"]
            self._imus.append(_Imu(*vehicle.pose_in_base(one.frame), one.samples, errors, place))
            if np.isfinite(one.delay_memory_s):
                self.wandering += [(at, one.delay_memory_s) for at in layout.estimated(f"delay_s {one.name}").tolist()]
        self.of_further = [
            _named(layout, f"scale_{one.name}" if isinstance(one, FurtherCell) else f"_{one.name}")
            for one in self.further
        ]
        ends = np.cumsum([0, 6, *(one.width for one in self.further)]).tolist()
        self.lines = tuple(slice(a, b) for a, b in pairwise(ends))
        self._joint_errors = JointErrors(vehicle, of_cyclic)
        self._in_links, self._in_joints = layout.estimated("links"), layout.estimated("joints", "cyclic")
        self._joint_columns = 13 + r + layout.kept[self._in_joints] - layout["joints"].start  # of the base's motion
        self.biases = [
            (at, self.names.index(of)) for at, name in enumerate(self.names) if (of := _drift(name)) in self.names
        ]
        self._changing = np.array([*range(3), *(at for at, _ in self.biases)], np.intp)  # but for random walks
        self.stated = self.sigma.copy()
        for bias_at, drift_at in self.biases:
            self.stated[bias_at] = np.hypot(self.sigma[bias_at], DRIFT_MEMORY_s * self.sigma[drift_at])

    def rate_in_base(self, rate_S: FloatArray) -> FloatArray:
        """A rate in the IMU's axes, (3,), in those of the base: ``w_B = R_BS w_S``."""
        return np.asarray(self._imus[0].R_BS @ rate_S, np.float64)

    def joint_noise(self, q: FloatArray, joint_sigma: FloatArray, state: FloatArray) -> FloatArray:
        """Effect of the joints' noise on the prediction, one sigma, (n, m).

        From the momentum equation of :mod:`onboard.dynamics.free_flight` with eta = 0: the error of the base's twist is
        ``-C^-1 M`` times that of the joint rates, the error of its acceleration the same times that of the joint
        accelerations. Products of rates are neglected.

        Args:
            q: joint positions, (n, joints).
            joint_sigma: of joint rates and accelerations, (n, 2, joints).
            state: (p,).
        """
        if not joint_sigma.any():
            return np.zeros((len(q), self.lines[-1].stop))
        effect = self.joint_effect(q[::_POSTURE_TICKS], state)
        variance = np.einsum("njkm,nkj->nm", effect[np.arange(len(q)) // _POSTURE_TICKS] ** 2, joint_sigma**2)
        return np.asarray(np.sqrt(variance), np.float64)

    def joint_effect(self, q: FloatArray, state: FloatArray) -> FloatArray:
        """Effect of an error of one in the rate and in the acceleration of each joint, (n, joints, 2, lines)."""
        n, joints = q.shape
        one = np.tile(np.eye(joints), (n, 1))  # each joint's unit rate by itself
        links = link_motions(self.vehicle, np.repeat(q, joints, axis=0), one, np.zeros_like(one))
        chi = self._chi(state)
        bodies = bodies_of(stacked(links), chi)
        twist = -turned(np.asarray(np.linalg.inv(composite_of(bodies)), np.float64), relative_momentum(bodies))
        effect = np.zeros((n, joints, 2, self.lines[-1].stop))
        for imu, own in zip(self._imus, self.lines, strict=False):
            force = twist[:, :3] + cross(twist[:, 3:], imu.p_BoSo_B)
            effect[:, :, 0, own.start : own.start + 3] = (twist[:, 3:] @ imu.R_BS).reshape(n, joints, 3)
            effect[:, :, 1, own.start + 3 : own.stop] = (force @ imu.R_BS).reshape(n, joints, 3)
        for (_, cut), own in zip(self._cells, self.lines[len(self._imus) :], strict=True):
            effect[:, :, 1, own.start] = cut.of_joint_accelerations(links, chi, twist).reshape(n, joints)
        return effect

    def predict(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, state: FloatArray, cyclic: FloatArray | None = None
    ) -> Prediction:
        """From a state at the first of b + 2 ticks.

        Args:
            q: joint positions at these ticks as read, (b + 2, joints).
            dq: joint rates.
            ddq: joint accelerations.
            state: (p,) at the first of them.
            cyclic: functions of the joints' cyclic errors and their derivatives, (b + 2, 3, m); None: zero.

        Raises:
            SignalError: fewer than four ticks.
        """
        n, layout, m = len(q), self._layout, self.lines[-1].stop
        x = layout.whole(state)
        readings = Readings.of(q, dq, ddq, self.period_s, self._functions(n, cyclic))
        motion = self._move(readings, x, self.period_s)
        time_s = np.asarray(self.period_s * np.arange(n)[1:-1], np.float64)
        values, jacobian = np.empty((n - 2, m)), np.zeros((n - 2, m, layout.size))
        for imu, own in zip(self._imus, self.lines, strict=False):
            true, d_true = at_sensor(motion.base, imu.R_BS, imu.p_BoSo_B + x[imu.place])
            change = (true[2:] - true[:-2]) / (2.0 * self.period_s)
            means = (tick_mean(part, imu.samples)[1:-1] for part in (true, d_true, self._by_place(motion.base, imu)))
            own_true, own_d, by_place = means
            by_motion = np.concatenate([own_d, by_place], axis=2)
            shown = imu_reading(own_true, by_motion, change, time_s, x[imu.errors])
            values[:, own] = shown.values
            self._spread(shown.d_motion[:, :, :-3], jacobian[:, own])
            jacobian[:, own, imu.place] = shown.d_motion[:, :, -3:]
            jacobian[:, own, imu.errors] = shown.d_errors
        for (cell, cut), own in zip(self._cells, self.lines[len(self._imus) :], strict=True):
            reading = cut.predict(motion.chain, motion.chi, motion.base, motion.readings)
            shown_N, by_motion_N, by_errors = cell.shown(reading, self.period_s, x[layout[cell.name]])
            values[:, own.start] = shown_N
            self._spread(by_motion_N[:, None], jacobian[:, own])
            jacobian[:, own.start, layout[cell.name]] = by_errors
        carried, transition = state.copy(), np.eye(len(state))
        carried[RATE] = motion.base.rate[-2]
        self._into(transition, motion.base.d_rate[-2])
        for bias_at, drift_at in self.biases:
            carried[bias_at] += time_s[-1] * state[drift_at]
            transition[bias_at, drift_at] = time_s[-1]
        return Prediction(values, jacobian[:, :, layout.kept], carried, transition)

    def _by_place(self, base: BasePrediction, imu: "_Imu") -> FloatArray:
        """Derivative of an IMU's rate and specific force by its place in the base, (n, 6, 3)."""
        d_place = np.zeros((len(base.rate), 6, 3))
        d_place[:, 3:] = imu.R_BS.T @ (hat(base.acceleration) + hat(base.rate) @ hat(base.rate))
        return d_place

    def _spread(self, by_motion: FloatArray, jacobian: FloatArray) -> None:
        """Put derivatives by what the base's motion depends on, (b, k, c), where they belong among all unknowns."""
        r, at = len(self._basis), self._layout
        jacobian[:, :, : PAYLOAD.stop] = by_motion[:, :, : PAYLOAD.stop]
        jacobian[:, :, at["links"]] = by_motion[:, :, PAYLOAD.stop : PAYLOAD.stop + r] @ self._basis
        if self._in_joints.size:  # joints without errors have no columns
            jacobian[:, :, at["joints"].start : at["cyclic"].stop] = by_motion[:, :, PAYLOAD.stop + r :]

    def carried(
        self, predicted: Prediction, start: FloatArray, state: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """State, (p,), and covariance, (p, p), at the last predicted tick.

        Args:
            predicted: the batch.
            start: the state that it was predicted from, (p,).
            state: as the batch's measurements have corrected it at the first tick, (p,).
            covariance: of that, (p, p).
        """
        c, F, P = self._changing, predicted.transition, covariance.copy()
        P[c] = F[c] @ covariance
        P[:, c] = P @ F[c].T
        return predicted.state + F @ (state - start), self.aged(P, len(predicted.values))

    def aged(self, covariance: FloatArray, ticks: int) -> FloatArray:
        """The state's covariance, (p, p), after the random walks of so many ticks: of drifts, and of a clock's time."""
        aged_s, P = ticks * self.period_s, covariance.copy()
        for at, memory_s in [*((at, DRIFT_MEMORY_s) for _, at in self.biases), *self.wandering]:
            P[at, at] += 2.0 * aged_s / memory_s * self.sigma[at] ** 2
        return P

    def bridge(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, state: FloatArray, cyclic: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Propagate the state over a gap of the joints, with the momentum constant in base axes.

        Args:
            q: joint positions as read at the tick of the state and at a later one, (2, joints).
            dq: joint rates.
            ddq: joint accelerations.
            state: (p,).
            cyclic: see :meth:`predict`, (2, 3, m).

        Returns:
            The state at the later tick, its derivative (p, p), and the rate's covariance, (3, 3), for a rotation of
            the momentum by 1 rad, one sigma.
        """
        parts = q, dq, ddq, np.zeros_like(q), self._functions(2, cyclic)
        readings = Readings(*(np.repeat(part, 2, axis=0) for part in parts))
        base = self._move(readings, self._layout.whole(state), 0.0).base
        carried, transition = state.copy(), np.eye(len(state))
        carried[RATE] = base.rate[-1]
        self._into(transition, base.d_rate[-1])
        turned = np.linalg.norm(base.momentum[-1]) * base.d_rate[-1, :, :3] @ np.linalg.inv(base.d_momentum[-1, :, :3])
        return carried, transition, turned @ turned.T

    def _move(self, readings: Readings, x: FloatArray, period_s: float) -> _Motion:
        """With all unknowns (every one, :meth:`Layout.whole`) as they are estimated."""
        vehicle, at = self.vehicle, self._layout
        chi = self._links.chi(x[PAYLOAD], self._basis @ x[at["links"]])
        if not self._in_joints.size:
            chain = chain_motion(vehicle, *readings[:3])
            base = predict_base_from_rate(chain.links, period_s, chi, x[RATE], self._links.indices)
            return _Motion(base, chain, chi, None)
        own = x[at["joints"]].reshape(-1, PER_JOINT)
        corrected = readings.corrected(own, x[at["cyclic"]], self._joint_errors.turns)
        chain = chain_motion(vehicle, *corrected, own[:, :3])
        errors = self._joint_errors.along(chain, readings)
        base = predict_base_from_rate(chain.links, period_s, chi, x[RATE], self._links.indices, errors)
        return _Motion(base, chain, chi, readings)

    def _functions(self, ticks: int, cyclic: FloatArray | None) -> FloatArray:
        return np.zeros((ticks, 3, len(self._joint_errors.turns))) if cyclic is None else cyclic

    def _into(self, transition: FloatArray, d_rate: FloatArray) -> None:
        transition[RATE, : PAYLOAD.stop] = d_rate[:, :13]
        transition[RATE, self._in_links] = d_rate[:, 13 : 13 + len(self._basis)] @ self._basis
        transition[RATE, self._in_joints] = d_rate[:, self._joint_columns]

    def _chi(self, state: FloatArray) -> FloatArray:
        """Standard parameters of all links, (10 x links,)."""
        return self._links.chi(state[PAYLOAD], self._basis @ state[self._in_links])


def first_rate(predictor: ImuPredictor, ticks: Ticks, state: FloatArray) -> FloatArray:
    """Rate of the base at the first tick, (3,), by least squares on the first gyro readings, with all else of a state.

    Args:
        predictor: of the IMU.
        ticks: in succession, :data:`FIRST_TICKS` + 2 of them at least.
        state: (p,).
    """
    state, some = state.copy(), ticks.part(slice(0, FIRST_TICKS + 2))
    seen = np.isfinite(some.measured[1:-1, :3]).all(axis=1)
    if not seen.any():
        return np.zeros(3)
    state[RATE] = predictor.rate_in_base(some.measured[1:-1, :3][seen].mean(axis=0))
    predicted = predictor.predict(some.q, some.dq, some.ddq, state, some.cyclic)
    gap = some.measured[1:-1, :3] - predicted.values[:, :3]
    J = predicted.jacobian[seen, :3, RATE].reshape(-1, 3)
    return np.asarray(state[RATE] + np.linalg.lstsq(J, gap[seen].ravel())[0], np.float64)


def _blocks_of(one: Further) -> dict[str, Block]:
    """Unknowns of a further instrument, its name after each of theirs."""
    if isinstance(one, FurtherCell):
        return {one.name: one.block()}
    prior = one.prior._replace(clock_rate_error=0.0)
    blocks = {
        f"{kind} {one.name}": Block(tuple(f"{name}_{one.name}" for name in block.names), block.sigma)
        for kind, block in imu_blocks(prior).items()
    }
    places = tuple(f"place_{axis}_{one.name}" for axis in "xyz")
    return {**blocks, f"place {one.name}": Block(places, np.full(3, one.place_m))}


def _named(layout: Layout, end: str) -> IndexArray:
    """Estimated unknowns whose names end so."""
    return np.array([at for at, known in enumerate(layout.names) if known.endswith(end)], np.intp)


def _drift(name: str) -> str:
    """The drift of a bias, by their names; empty for what is no bias."""
    for bias, drift in (*zip(BIASES, DRIFTS, strict=True), ("bias_", "drift_")):
        if name.startswith(bias):
            return drift + name.removeprefix(bias)
    return ""
