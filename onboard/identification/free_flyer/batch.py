"""Batch fit: maximum likelihood payload from predicted gyro and accelerometer signals of a flight.

Least squares on measurement rows has the measured base motion in the regressor, whose noise biases the estimate. Here
the base's motion is predicted from the joints and the unknowns: payload, state of the motion at the first tick and, if
uncertain, the other links, the IMU's errors and its clock. The maximum likelihood estimate is unbiased to first order
and reaches the Cramer-Rao bound. (The non-linear ExIDDM that Limparis proposes as further research; momentum equations
2.84-2.93, 3.6-3.8.)

A kind of base (:class:`FreeBase`: by the joints and the initial angular momentum;
:class:`onboard.identification.table.floating_base.AirBearingBase`) contributes the prediction of its motion; unknowns,
residuals, prior, guesses and held-out halves are common.

Known limit: the joints' noise is modelled on a table only; behind a 100:1 gear it is 1/300 of the gyro's at 1 Hz.
"""

from collections.abc import Mapping
from copy import copy
from functools import partial
from typing import NamedTuple, Protocol, Self

import numpy as np

from onboard.dynamics.free_flight import BasePrediction, predict_base, sensor_in_base
from onboard.dynamics.kinematics import first_ticks, link_motions
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import BodyEstimate, body_estimate, standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import ITERATIONS, MINIMUM, NEAR_MINIMUM, Fit, covariance_of, fit
from onboard.estimation.policy import MISFIT_DOUBTED
from onboard.identification.free_flyer.guesses import FIRST_TICKS, ROUGH_WIDTH_s, guesses
from onboard.identification.free_flyer.prediction.imu_errors import (
    BIASES,
    CERTAIN,
    ImuPrior,
    ImuReading,
    imu_blocks,
    imu_reading,
    tick_mean,
    whitened,
)
from onboard.identification.free_flyer.prediction.parameters import UncertainLinks, UnknownLayout, Unknowns
from onboard.identification.rows.checks.prediction import HeldOutFit
from onboard.identification.rows.held_out import HeldOut
from onboard.regressor.free_rows import rough_payload

_NOTHING = standard_of(RigidBody(1e-9, np.zeros(3), 1e-9 * np.eye(3)))


class Schedule(NamedTuple):
    """Stages of a fit: first ticks (every guess), a third of the flight, all ticks."""

    early: int  # ticks
    iterations: int  # of the last: weak motion makes a flat minimum


class BaseModel(Protocol):
    """Predicts the motion of one kind of base during one flight."""

    vehicle: VehicleModel
    signals: FlightSignals
    start: Unknowns  # the motion's state at the first tick
    others: Mapping[str, Unknowns]  # unknowns besides start, payload and links
    of_a_run: tuple[str, ...]  # blocks with different values in another part of the flight
    schedule: Schedule

    def predict(
        self, start: FloatArray, chi: FloatArray, others: Mapping[str, FloatArray], links: tuple[int, ...], ticks: int
    ) -> BasePrediction:
        """The first ticks' motion, with its derivatives by start, the ten columns of each of ``links``, others."""

    def first_state(self, chi: FloatArray, rate_B: FloatArray) -> FloatArray | None:
        """State at the first tick from the gyro in base axes (n, 3); None if the gyro does not determine it."""

    def rough_payload(self, imu_frame: str, payload_sigma: FloatArray) -> RigidBody:
        """Payload by plain least squares on rows: a biased initial guess."""


class PayloadFit(NamedTuple):
    """The maximum-likelihood payload."""

    payload: BodyEstimate  # in the payload link's frame
    fit: Fit
    names: tuple[str, ...]  # of the parameters fitted
    freedom: int  # of the whitened residual sum
    chi: FloatArray  # (10,) standard parameters of the payload
    chi_covariance: FloatArray  # (10, 10)

    @property
    def misfit(self) -> float:
        """Whitened residual sum over its degrees of freedom: 1 if only noise remains."""
        return self.fit.residual_sum / self.freedom


class MotionFit:
    """Predicts the base IMU of one flight and fits the payload to it.

    Args:
        base: predicts the base's motion.
        imu_frame: the IMU's frame S, fixed in the base B.
        payload_sigma: wide prior: standard deviations of the payload's standard parameters about zero, (10,).
        link_covariance: see :class:`onboard.identification.free_flyer.prediction.parameters.UncertainLinks`.
        imu_prior: on instrument errors.

    Attributes:
        names: of the p parameters that are fitted.
        prior_information: (p, p), about zero.
        layout: of these among all unknowns.

    Raises:
        UnknownFrameError: no payload link, or a name that the URDF does not have.
        SignalError: shapes that do not fit, joints that are not finite, or an IMU that is missing for most of the time.
    """

    def __init__(
        self,
        base: BaseModel,
        imu_frame: str,
        payload_sigma: FloatArray,
        link_covariance: Mapping[str, FloatArray],
        imu_prior: ImuPrior = CERTAIN,
    ) -> None:
        self._imu_frame, self._payload_sigma = imu_frame, payload_sigma
        self._links = UncertainLinks(base.vehicle, link_covariance)
        self._R_BS, self._p_BoSo_B = base.vehicle.pose_in_base(imu_frame)
        self._take(base)
        if np.count_nonzero(self.valid) < len(self.valid) // 2:
            raise SignalError("more than half of the flight has no IMU; cut it to where it has")
        widths = [np.sqrt(np.diag(block)) for block in self._links.covariances]
        imu = imu_blocks(imu_prior)
        self.layout = layout = UnknownLayout(
            {
                "start": base.start,
                "payload": Unknowns(self._links.payload_names, payload_sigma),
                "links": Unknowns(self._links.names, np.concatenate([np.zeros(0), *widths])),
                **base.others,
                **imu,
            }
        )
        self.names = layout.names
        self._errors = slice(layout[next(iter(imu))].start, layout.size)
        self._payload, at = layout.estimated("payload"), layout.estimated("links")
        self.prior_information = np.diag(np.nan_to_num(1.0 / layout.sigma**2))
        for block, covariance in zip(at.reshape(-1, 10), self._links.covariances, strict=True):
            self.prior_information[np.ix_(block, block)] = np.linalg.inv(covariance)

    def _take(self, base: BaseModel) -> None:
        signals, self._base = base.signals, base
        self._measured = np.concatenate([signals.rate, signals.specific_force], axis=1)  # (n, 6)
        self.valid: BoolArray = np.isfinite(self._measured).all(axis=1)
        sigma = np.concatenate([signals.rate_sigma, signals.specific_force_sigma])
        self._sigma = np.asarray(np.hypot(sigma, self._of_joints()), np.float64)  # (n, 6)

    def _of_joints(self) -> FloatArray:
        """What the noise of the joints does to each line, one sigma, (n, 6)."""
        return np.zeros_like(self._measured)

    def of(self, base: BaseModel) -> Self:
        """The same unknowns and priors of another run of the vehicle, or of another model of it."""
        other = copy(self)
        other._take(base)
        return other

    def start(self, body: RigidBody) -> FloatArray:
        """Initial parameters: this payload, the state it implies at the first ticks, all else nominal, (p,)."""
        return self._with_first_state(self.parameters(np.zeros(3), body))

    def parameters(self, start: FloatArray, body: RigidBody) -> FloatArray:
        """Parameters of this payload and state at the first tick, (3,), all else nominal, (p,)."""
        every = np.zeros(self.layout.size)
        every[self.layout["start"]], every[self.layout["payload"]] = start, standard_of(body)
        return np.asarray(every[self.layout.kept], np.float64)

    def fit(self) -> PayloadFit:
        """Maximum likelihood fit: of the first seconds from several guesses, then of longer parts, then of all ticks.

        The first guess is a plain least squares. From a poor guess a fit of the whole flight diverges; a fit of a short
        part converges.

        Raises:
            ConvergenceError, SingularError, RowError: see :func:`onboard.estimation.maximum_likelihood.fit`.
            SignalError: a payload without a mass.
        """
        n, plan = len(self.valid), self._base.schedule
        found: Fit | None = None
        for guess in guesses(self.rough):
            try:
                tried = self._fit(self.start(guess), plan.early, NEAR_MINIMUM)
            except ConvergenceError:
                continue
            if found is None or tried.residual_sum < found.residual_sum:
                found = tried
            if found.residual_sum < MISFIT_DOUBTED * 6 * plan.early:
                break
        if found is None:
            raise ConvergenceError("no guess leads anywhere; check frames, signs and units of joints and IMU")
        found = self._fit(found.x, max(plan.early, n // 3), NEAR_MINIMUM)
        return self.found(self._fit(found.x, n, MINIMUM, plan.iterations))

    def found(self, found: Fit) -> PayloadFit:
        """The payload of a fit of all ticks.

        Raises:
            SignalError: a payload without a mass.
        """
        known = int(np.count_nonzero(np.diag(self.prior_information)))
        freedom = 6 * int(self.valid.sum()) + known - found.x.size
        chi, covariance = found.x[self._payload], found.covariance[np.ix_(self._payload, self._payload)]
        return PayloadFit(body_estimate(chi, covariance), found, self.names, freedom, chi, covariance)

    def rough(self) -> RigidBody:
        """Payload by plain least squares on rows: a biased initial guess.

        Raises:
            SignalError: a mass that is not positive.
        """
        return self._base.rough_payload(self._imu_frame, self._payload_sigma)

    def bound(self, truth: FloatArray) -> BodyEstimate:
        """The payload at ``truth``, (p,), with the Cramer-Rao bound of this motion as its covariance."""
        covariance = covariance_of(self.residuals(truth)[1], self.prior_information)
        return body_estimate(truth[self._payload], covariance[np.ix_(self._payload, self._payload)])

    def residuals(self, parameters: FloatArray, ticks: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Whitened, predicted less measured, (6 v,), and their derivative (6 v, p); v ticks with an IMU.

        Args:
            parameters: (p,).
            ticks: only the first so many; all, where not given.
        """
        n, samples = len(self.valid) if ticks is None else ticks, self._base.signals.samples
        x = self.layout.whole(parameters)
        shown, motion = self._shown(x, n, self._links.indices)
        told, which = (self._measured[:n], self._sigma[:n]), (self.layout.kept, self.valid[:n])
        return whitened(shown, x[self._errors], motion, samples, told, which)

    def left(self, parameters: FloatArray) -> FloatArray:
        """The residuals alone, (6 v,)."""
        shown, _ = self._shown(self.layout.whole(parameters), len(self.valid), ())
        values = tick_mean(shown.values, self._base.signals.samples)
        return np.asarray(((values - self._measured) / self._sigma)[self.valid].ravel(), np.float64)

    def _shown(self, x: FloatArray, n: int, links: tuple[int, ...]) -> tuple[ImuReading, tuple[FloatArray, FloatArray]]:
        """Of the first n ticks with all unknowns as in ``x``; derivatives by the motion, (n, 6, 9), and of that."""
        layout, period_s = self.layout, self._base.signals.period_s
        others = {name: x[layout[name]] for name in self._base.others}
        base = self._base.predict(x[layout["start"]], self._chi(x), others, links, n)
        sensor = sensor_in_base(base, self._R_BS, self._p_BoSo_B)
        time_s = np.asarray(period_s * (np.arange(n) - 0.5 * (len(self.valid) - 1)), np.float64)
        change = np.gradient(sensor.values, period_s, axis=0)
        return imu_reading(sensor.values, change, time_s, x[self._errors]), (sensor.gain, base.along)

    def residuals_by_tick(self, parameters: FloatArray) -> FloatArray:
        """As :meth:`residuals`, (n, 6), NaN at ticks without an IMU."""
        left = np.full((len(self.valid), 6), np.nan)
        left[self.valid] = self.left(parameters).reshape(-1, 6)
        return left

    def predicted(self, x: FloatArray, own: FloatArray) -> HeldOutFit:
        """Residual of this flight for parameters found elsewhere, relative to that without a payload.

        Unknowns specific to a part of the flight (initial state, biases) are re-estimated.

        Args:
            x: parameters, (p,).
            own: initial values of the specific ones, (p,).
        """
        anew = self.layout.estimated("start", *self._base.of_a_run, *BIASES)
        tried = x.copy()

        def residuals(z: FloatArray) -> tuple[FloatArray, FloatArray]:
            tried[anew] = z
            r, J = self.residuals(tried)
            return r, J[:, anew]

        prior = self.prior_information[np.ix_(anew, anew)]
        done = fit(residuals, own[anew], np.zeros(anew.size), prior, tolerance=NEAR_MINIMUM)
        tried[anew], tried[self._payload] = done.x, _NOTHING
        none = self.left(self._with_first_state(tried))
        return HeldOutFit(float(np.sqrt(done.residual_sum / (none @ none))), done.residual_sum / none.size)

    def _fit(self, x: FloatArray, ticks: int, tolerance: float, iterations: int = ITERATIONS) -> Fit:
        early = partial(self.residuals, ticks=ticks)
        return fit(early, x, np.zeros_like(x), self.prior_information, iterations, tolerance)

    def _with_first_state(self, x: FloatArray) -> FloatArray:
        every = self.layout.whole(x)
        told = self._base.first_state(self._chi(every), self._base.signals.rate @ self._R_BS.T)
        if told is not None:
            every[self.layout["start"]] = told
        return np.asarray(every[self.layout.kept], np.float64)

    def _chi(self, every: FloatArray) -> FloatArray:
        return self._links.chi(every[self.layout["payload"]], every[self.layout["links"]])


def held_out(whole: MotionFit, earlier: MotionFit, later: MotionFit, found: PayloadFit) -> HeldOut:
    """Prediction of each half of a flight with the parameters of the other.

    Args:
        whole: the flight.
        earlier: its first half.
        later: its second half.
        found: of the whole.

    Raises:
        ConvergenceError, SingularError, RowError, SignalError: see :meth:`MotionFit.fit`.
    """
    first, second, x = earlier.fit().fit.x, later.fit().fit.x, found.fit.x
    return HeldOut(later.predicted(first, second), earlier.predicted(second, first), whole.predicted(x, x))


def checked(signals: FlightSignals) -> FlightSignals:
    """Signals of one flight after a check of shapes and joints.

    Raises:
        SignalError: shapes that do not fit, or joints that are not finite.
    """
    if not all(np.isfinite(joint).all() for joint in (signals.q, signals.dq, signals.ddq)):
        raise SignalError("joints must be known at every tick; cut the flight where they are not")
    n = len(signals.q)
    if signals.rate.shape != (n, 3) or signals.specific_force.shape != (n, 3):
        raise SignalError(f"{n} ticks of joints need ({n}, 3) rates and specific forces")
    return signals


class FreeBase:
    """:class:`onboard.identification.free_flyer.batch.BaseModel` without an external wrench.

    Args:
        vehicle: with a payload link.
        signals: the flight.

    Raises:
        SignalError: shapes that do not fit, or joints that are not finite.
    """

    def __init__(self, vehicle: VehicleModel, signals: FlightSignals) -> None:
        self.vehicle, self.signals = vehicle, checked(signals)
        self._motions = link_motions(vehicle, signals.q, signals.dq, signals.ddq)
        self.start = Unknowns(tuple(f"momentum_{axis}" for axis in "xyz"), np.full(3, np.nan))
        self.others: Mapping[str, Unknowns] = {}
        self.of_a_run: tuple[str, ...] = ()
        self.schedule = Schedule(len(signals.q) // 8, ITERATIONS)

    def predict(
        self, start: FloatArray, chi: FloatArray, others: Mapping[str, FloatArray], links: tuple[int, ...], ticks: int
    ) -> BasePrediction:
        """See :func:`onboard.dynamics.free_flight.predict_base`."""
        return predict_base(first_ticks(self._motions, ticks), self.signals.period_s, chi, start, links)

    def first_state(self, chi: FloatArray, rate_B: FloatArray) -> FloatArray:
        """Momentum from the first gyro readings, to which the rate is affine.

        Raises:
            SignalError: no tick among the first has an IMU.
        """
        base = self.predict(np.zeros(3), chi, {}, (), FIRST_TICKS)
        gap = rate_B[:FIRST_TICKS] - base.rate
        seen = np.isfinite(gap).all(axis=1)
        if not seen.any():
            raise SignalError(f"none of the first {FIRST_TICKS} ticks has an IMU; begin the flight where it has")
        return np.asarray(np.linalg.lstsq(base.d_rate[seen, :, :3].reshape(-1, 3), gap[seen].ravel())[0], np.float64)

    def rough_payload(self, imu_frame: str, payload_sigma: FloatArray) -> RigidBody:
        """See :func:`onboard.regressor.free_rows.rough_payload`."""
        return rough_payload(self.vehicle, imu_frame, self.signals, ROUGH_WIDTH_s, payload_sigma)
