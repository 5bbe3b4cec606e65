"""Covariance of what is asked as a function of the motion: the bound of the flight's estimator, at coarse ticks.

A free-flyer's comes from one prediction of the whole motion: readings' derivatives by all unknowns, whitened, with the
covariance at the motion's start as prior, so that what biases, misalignment, links and joints take away is taken away.
Of other bases :func:`onboard.ground.before.foresee.foresee.foresee` gives each quantity's sigma by itself.
"""

from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.free_flight import predict_base_from_rate
from onboard.dynamics.kinematics import link_motions
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.flight.estimate.problem.model import build_model
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.free import FilterNoise, body_covariance, fly
from onboard.ground.before.foresee.plan import MotionPlan
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.quantities import BODY
from onboard.regressor.rows import BaseMotion, standing

_ANY_RATE_rad_s = 0.1  # of the base: standard deviation before anything is known
TICK_HZ = 5.0  # of the search; what is promised is of the estimator's ticks


class MotionBound(NamedTuple):
    """Of a motion."""

    covariance: FloatArray  # (k, k) of the quantities
    base: BaseMotion  # at the motion's ticks


class FreeBound:
    """Bound of a motion that goes into a plan, for a free-flyer.

    Attributes:
        names: of the quantities, in the order of the covariance.
        scales: sizes against which each is judged, (k,), in its unit.
        unknowns: names of the p unknowns of the estimator.
        prior_sigma: of these before the flight, (p,).

    Args:
        vehicle: with coarse ticks.
        plan: of the whole flight at these ticks.
        first: tick of the motion; the payload is held from before it.
        still: vehicle and payload have no momentum when it begins.
    """

    def __init__(self, vehicle: config.Vehicle, plan: MotionPlan, first: int, *, still: bool = False) -> None:
        before = fly(vehicle, plan.part(slice(0, first)))
        if before is None or plan.payload is None:
            raise config.ConfigError("nothing is held before the planned motion; let [capture] come earlier")
        if still:
            before.state[RATE] = 0.0
        self._before, self._model, self._payload = before, before.model, plan.payload
        self._predictor = before.identifier.ekf.predictor
        self._prior = np.linalg.inv(before.covariance)
        self._noise = FilterNoise(vehicle, before.model, self._predictor.further)
        self._chi = self._model.chi.copy()
        self._chi[self._model.payload_columns()] = standard_of(plan.payload)
        self.names = tuple(f"{kind}_{self._model.spec.payload_link}" for kind in BODY)
        self.scales = body_scales(plan.payload)
        self.unknowns = tuple(self._predictor.names)
        self.prior_sigma = np.nan_to_num(self._predictor.sigma)
        self.prior_sigma[RATE] = _ANY_RATE_rad_s
        self.prior_sigma[PAYLOAD] = before.identifier.ekf.payload_sigma

    def of(self, moved: FloatArray) -> MotionBound:
        """For angle, rate and acceleration at the motion's ticks, (3, n, joints)."""
        flat = self.whitened(moved)
        information = self._prior + flat.T @ flat
        return MotionBound(self._body(information), self.base(moved, self._predictor.period_s))

    def along(self, moved: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Ticks, (m,), and sigmas of the quantities when the motion ended there, (m, k)."""
        rows, at = self._rows(moved), np.unique(np.linspace(0, len(moved[0]) - 2, 60).astype(np.intp))
        sums = np.cumsum(np.swapaxes(rows, 1, 2) @ rows, axis=0)
        covariances = [self._body(self._prior + (sums[k - 1] if k else 0.0)) for k in at.tolist()]
        return at, np.sqrt(np.stack([np.diag(covariance) for covariance in covariances]))

    def base(self, moved: FloatArray, period_s: float) -> BaseMotion:
        """The base's motion at other ticks of the motion."""
        return _floating(self._model, moved, period_s, self._chi, self._before.state[RATE])

    def whitened(self, moved: FloatArray) -> FloatArray:
        """Whitened derivatives of all readings by all unknowns at the motion's start, (readings, p)."""
        rows = self._rows(moved)
        return rows.reshape(-1, rows.shape[2])

    def _rows(self, moved: FloatArray) -> FloatArray:
        """Whitened derivatives of the readings, (n - 2, lines, p)."""
        sigma, cyclic = self.noise(moved)
        q, dq, ddq = moved
        now = self._predictor.predict(q, dq, ddq, self._before.state, cyclic)
        return np.asarray(now.jacobian / sigma[:, :, None], np.float64)

    def noise(self, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the readings, (n - 2, lines), and functions of the joints' cyclic errors, (n, 3, m)."""
        q, dq, _ = moved
        joints = self._predictor.joint_noise(q, self._noise.of_joints(dq), self._before.state)
        sigma = np.hypot(self._noise.of_lines(dq), joints)[1:-1]
        return np.asarray(sigma, np.float64), self._noise.cyclic(q, dq)

    def _body(self, information: FloatArray) -> FloatArray:
        covariance: FloatArray = np.asarray(np.linalg.inv(information)[PAYLOAD, PAYLOAD], np.float64)
        return body_covariance(self._payload, covariance)


class RowsBound:
    """For every other vehicle: a whole bound for each motion.

    Args:
        vehicle: with coarse ticks.
        plan: of the whole flight at these ticks.
        ticks: of the motion.
    """

    def __init__(self, vehicle: config.Vehicle, plan: MotionPlan, ticks: slice) -> None:
        plan = plan.by_base()[0]  # one of many likely motions of a prescribed base: eight take eight times as long
        self._vehicle, self._plan, self._ticks, self._model = vehicle, plan, ticks, build_model(vehicle)
        self._chi = self._model.chi.copy()
        if plan.payload is not None:
            self._chi[self._model.payload_columns()] = standard_of(plan.payload)
        answers = foresee(vehicle, plan, coarse=True).answers
        self.names = tuple(answer.name for answer in answers)
        body = dict(zip((f"{kind}_{self._model.spec.payload_link}" for kind in BODY), range(10), strict=True))
        of_payload = np.ones(10) if plan.payload is None else body_scales(plan.payload)
        self.scales = np.array(
            [of_payload[body[a.name]] if a.name in body else max(abs(a.value), a.sigma) for a in answers]
        )

    def of(self, moved: FloatArray) -> MotionBound:
        """See :class:`FreeBound`."""
        sigma = self._sigma(moved, self._ticks.stop)
        return MotionBound(np.diag(sigma**2), self.base(moved, 1.0 / TICK_HZ))

    def along(self, moved: FloatArray) -> tuple[IndexArray, FloatArray]:
        """See :class:`FreeBound`."""
        n = self._ticks.stop - self._ticks.start
        at = np.unique(np.linspace(n // 8, n, 8).astype(np.intp))
        return at, np.stack([self._sigma(moved, self._ticks.start + k) for k in at.tolist()])

    def base(self, moved: FloatArray, period_s: float) -> BaseMotion:
        """See :class:`FreeBound`."""
        n, plan = moved.shape[1], self._plan
        if plan.bases:  # prescribed: between the coarse ticks a straight line
            coarse = plan.time_s[self._ticks]
            time_s = coarse[0] + period_s * np.arange(n)
            signals = (signal[self._ticks] for signal in plan.bases[0])
            lines = (np.stack([np.interp(time_s, coarse, axis) for axis in x.T], axis=1) for x in signals)
            return BaseMotion(*lines)
        if not self._model.spec.base.moves:
            return standing(self._model, n)
        return _floating(self._model, moved, period_s, self._chi, plan.rate_rad_s)

    def _sigma(self, moved: FloatArray, end: int) -> FloatArray:
        """Of the quantities when the flight ended at a tick."""
        plan = self._plan.moved(self._ticks, moved).part(slice(0, end))
        foreseen = foresee(self._vehicle, plan, coarse=True)
        return np.array([answer.sigma for answer in foreseen.answers])


Bound = FreeBound | RowsBound


def body_scales(payload: RigidBody) -> FloatArray:
    """Sizes of a body's ten numbers, (10,): mass; radius of gyration; half the trace of its inertia."""
    half = 0.5 * float(np.trace(payload.inertia_kg_m2))
    radius = float(np.sqrt(half / payload.mass_kg))
    return np.array([payload.mass_kg, *[radius] * 3, *[half] * 6])


def _floating(model: VehicleModel, moved: FloatArray, period_s: float, chi: FloatArray, rate: FloatArray) -> BaseMotion:
    """What the joints make of a base that starts with a rate, (3,)."""
    base = predict_base_from_rate(link_motions(model, *moved), period_s, chi, rate, ())
    return BaseMotion(base.rate, base.acceleration, base.specific_force)
