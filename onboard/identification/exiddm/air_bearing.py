"""The payload of a vehicle on an air bearing: the one that makes the predicted base IMU agree with the measured one.

Nothing measures velocity, and drag depends on it: it is predicted (:mod:`onboard.dynamics.air_bearing`) from the joints
and from what is unknown: payload, velocity at the start, each puck's drag, the table's tilt, the IMU's errors, and the
other links as far as they are doubted. Rows of a least squares would carry the IMU's noise in their columns and an
integrated velocity besides; the noise of a prediction biases nothing.

Known wart: an accelerometer does not feel gravity along the table; its tilt shows by the velocity alone, and weakly.
"""

import contextlib
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.dynamics.air_bearing import PlanarColumns, PlanarDrag, planar_columns, predict_planar
from onboard.dynamics.errors import SignalError, UnknownFrameError
from onboard.dynamics.free_flight import at_sensor
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.kinematics import hat
from onboard.dynamics.payload import BodyEstimate, body_estimate, possible_body, standard_of
from onboard.dynamics.ticks import FlightSignals
from onboard.dynamics.vehicle import STANDARD, BaseKind, VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import Fit, fit
from onboard.identification.exiddm.batch import CERTAIN, GUESSES, ImuPrior
from onboard.regressor.free_rows import measured_base

_ROUGH_WIDTH_s = 0.3
_EARLY_s = 4.0  # of a run that the guesses are tried on
_PATIENT = 200  # iterations over all ticks: velocity and Coulomb's drag lie along a curved valley
_GOOD_FIT = 1.3  # whitened residual sum per row of a guess that needs no other
_PAYLOAD = slice(3, 13)
WORST_MISFIT = 1.3  # whitened residual sum by its degrees of freedom
MOST_PUSHING = 3.5  # sigmas of a drag below zero
MOST_DOUBTED = 0.1  # of the mass, one sigma


class DragPrior(NamedTuple):
    """Standard deviations, about none, of how much a puck may drag on the table."""

    viscous_N_s_m: float  # noqa: N815
    coulomb_N: float  # noqa: N815


class AirBearingPrior(NamedTuple):
    """Standard deviations of what is not known of a run beside payload and links."""

    velocity_m_s: float  # at the start, of each axis
    rate_rad_s: float
    pucks: Mapping[str, DragPrior]  # by frame, fixed in the base
    tilt_m_s2: float  # gravity along the table
    imu: ImuPrior = CERTAIN


class PlanarFit(NamedTuple):
    """The maximum-likelihood payload and drag.

    Attributes:
        reason: why it is not to be used; empty if it is.
    """

    payload: BodyEstimate  # in the payload link's frame
    drag: FloatArray  # (2 x pucks,) Fv, N s/m, and Fc, N, of each puck
    drag_sigma: FloatArray
    fit: Fit
    names: tuple[str, ...]  # of the parameters fitted
    freedom: int  # of the whitened residual sum
    reason: str


class PlanarExiddm:
    """Predicts the base IMU of one run on the table; fits payload and drag to it.

    Args:
        vehicle: of base kind planar, with a payload link; its standard parameters are the prior of all other links.
        imu_frame: the IMU's frame, fixed in the base.
        signals: the run.
        payload_sigma: standard deviations of the payload's standard parameters about none at all, (10,); wide.
        link_covariance: of the standard parameters of other links by name, (10, 10) each; as drawn, where not named.
        doubt: what else is not known.

    Raises:
        UnknownFrameError: no payload link, or a name that the URDF does not have.
        SignalError: another kind of base, shapes that do not fit, or joints that are not finite.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        imu_frame: str,
        signals: FlightSignals,
        payload_sigma: FloatArray,
        link_covariance: Mapping[str, FloatArray],
        doubt: AirBearingPrior,
    ) -> None:
        payload = vehicle.spec.payload_link
        if payload is None:
            raise UnknownFrameError("this vehicle has no payload link; name one")
        if vehicle.spec.base is not BaseKind.PLANAR:
            raise SignalError(f"the base is {vehicle.spec.base.value}; this is for a planar one")
        others = set(link_covariance) - (set(vehicle.links) - {payload})
        if others:
            raise UnknownFrameError(f"covariances are for links other than the payload; {', '.join(others)} is none")
        if not all(np.isfinite(joint).all() for joint in (signals.q, signals.dq, signals.ddq)):
            raise SignalError("joints must be known at every tick; cut the run where they are not")
        n = len(signals.q)
        if signals.rate.shape != (n, 3) or signals.specific_force.shape != (n, 3):
            raise SignalError(f"{n} ticks of joints need ({n}, 3) rates and specific forces")
        self.vehicle, self.signals, self.doubt = vehicle, signals, doubt
        self._imu_frame, self._payload_sigma = imu_frame, payload_sigma
        self._columns = planar_columns(vehicle, signals)
        self._R, self._p = vehicle.pose_in_base(imu_frame)
        self._pucks = np.array([vehicle.pose_in_base(frame)[1][:2] for frame in doubt.pucks]).reshape(-1, 2)
        self._measured = np.concatenate([signals.rate, signals.specific_force], axis=1)  # (n, 6)
        self._valid: NDArray[np.bool_] = np.isfinite(self._measured).all(axis=1)
        self._sigma = np.concatenate([signals.rate_sigma, signals.specific_force_sigma])
        if np.count_nonzero(self._valid) < n // 2:
            raise SignalError("more than half of the run has no IMU; cut it to where it has")
        doubted = [k for k, link in enumerate(vehicle.links) if link in link_covariance]
        own = vehicle.payload_columns()
        self._chi: NDArray[np.intp] = np.r_[own, *(np.arange(10 * k, 10 * k + 10) for k in doubted)].astype(np.intp)
        names = ["velocity_x", "velocity_y", "rate_z"]
        names += [f"{STANDARD[k % 10]}_{vehicle.links[k // 10]}" for k in self._chi]
        names += [f"{kind}_{frame}" for frame in doubt.pucks for kind in ("Fv", "Fc")]
        names += ["tilt_x", "tilt_y"]
        self._errors = len(names)
        spread = [doubt.velocity_m_s, doubt.velocity_m_s, doubt.rate_rad_s, *payload_sigma]
        spread += [0.0] * (10 * len(doubted))
        spread += [sigma for puck in doubt.pucks.values() for sigma in puck]
        spread += [doubt.tilt_m_s2, doubt.tilt_m_s2]
        for kind, value in doubt.imu._asdict().items():
            if kind in ("delay_s", "stretch"):
                continue
            names += [f"{kind}_{axis}" for axis in "xyz"]
            spread += [value] * 3
        names.append("delay_s")
        spread.append(doubt.imu.delay_s)
        sigma = np.array(spread)
        blocks = {13 + 10 * k: np.linalg.inv(link_covariance[vehicle.links[index]]) for k, index in enumerate(doubted)}
        free = sigma > 0.0
        free[13 : 13 + 10 * len(doubted)] = True
        self._kept = np.flatnonzero(free)
        self.names = tuple(names[k] for k in self._kept)
        information = np.diag([1.0 / s**2 if s > 0.0 else 0.0 for s in spread])
        for first, block in blocks.items():
            information[first : first + 10, first : first + 10] = block
        self.prior_information = information[np.ix_(self._kept, self._kept)]

    def start(self, body: RigidBody) -> FloatArray:
        """Parameters to begin with: this payload, at rest, all else as drawn."""
        x = np.zeros(self._errors + 25)
        x[_PAYLOAD] = standard_of(body)
        return np.asarray(x[self._kept], np.float64)

    def fit(self) -> PlanarFit:
        """Maximum likelihood: of the first seconds from one guess after the other, then of more, then of all.

        Raises:
            ConvergenceError, SingularError, RowError: see :func:`onboard.estimation.maximum_likelihood.fit`.
            SignalError: a payload without a mass.
        """
        n = len(self.signals.q)
        early = min(n, round(_EARLY_s / self.signals.period_s))
        found: Fit | None = None
        for guess in self._guesses():
            try:
                tried = self._fit(self.start(guess), early, 3.0)
            except ConvergenceError:
                continue
            if found is None or tried.residual_sum < found.residual_sum:
                found = tried
            if found.residual_sum < _GOOD_FIT * 6 * early:
                break
        if found is None:
            raise ConvergenceError("no guess leads anywhere; check frames, signs and units of joints and IMU")
        found = self._fit(self._fit(found.x, max(early, n // 3), 3.0).x, n, 1e-2, _PATIENT)
        return self.estimate(found)

    def estimate(self, found: Fit) -> PlanarFit:
        """What a fit says of payload and drag."""
        places = [self.names.index(f"{kind}_{frame}") for frame in self.doubt.pucks for kind in ("Fv", "Fc")]
        known = int(np.count_nonzero(np.diag(self.prior_information)))
        freedom = 6 * int(self._valid.sum()) + known - found.x.size
        payload = body_estimate(found.x[_PAYLOAD], found.covariance[_PAYLOAD, _PAYLOAD])
        mass, sigma = payload.body.mass_kg, float(np.sqrt(payload.covariance[0, 0]))
        drag, spread = found.x[places], np.sqrt(np.diag(found.covariance)[places])
        pushing = [self.names[k] for k, off in zip(places, drag / spread, strict=True) if off < -MOST_PUSHING]
        reason = ""
        if found.residual_sum > WORST_MISFIT * freedom:
            times = np.sqrt(found.residual_sum / freedom)
            reason = f"IMU and joints contradict each other: {times:.1f} times the noise is left; check their signs"
        elif pushing:
            reason = f"pucks drag and do not push, but {', '.join(pushing)} came out negative; check pucks and motion"
        elif sigma > MOST_DOUBTED * mass:
            reason = f"the motion does not determine the payload: {mass:.3g} kg, give or take {sigma:.2g} kg; move more"
        return PlanarFit(payload, drag, spread, found, self.names, freedom, reason)

    def residuals(self, parameters: FloatArray, ticks: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Whitened, predicted less measured, (6 v,), and their derivative (6 v, p); v ticks with an IMU."""
        x = np.zeros(self._errors + 25)
        x[self._kept] = parameters
        predicted, derivative = self._predict(x, len(self.signals.q) if ticks is None else ticks)
        valid = self._valid[:ticks]
        residual = (predicted[valid] - self._measured[:ticks][valid]) / self._sigma
        jacobian = derivative[valid][:, :, self._kept] / self._sigma[:, None]
        return residual.ravel(), jacobian.reshape(residual.size, -1)

    def _fit(self, x: FloatArray, ticks: int, tolerance: float, iterations: int = 60) -> Fit:
        return fit(
            lambda at: self.residuals(at, ticks), x, np.zeros_like(x), self.prior_information, iterations, tolerance
        )

    def _predict(self, x: FloatArray, ticks: int) -> tuple[FloatArray, FloatArray]:
        """What the IMU shows, (n, 6), and its derivative, (n, 6, all parameters)."""
        chi = self.vehicle.chi.copy()
        c = 3 + self._chi.size
        chi[self._chi] += x[3:c]
        chi[self.vehicle.payload_columns()] = x[_PAYLOAD]
        pulls = x[c : self._errors - 2].reshape(-1, 2)
        drag = PlanarDrag(self._pucks, pulls[:, 0], pulls[:, 1])
        columns = self._columns._replace(T=self._columns.T[: 2 * ticks - 1])
        found = predict_planar(columns, x[:3], chi, drag, x[self._errors - 2 : self._errors], self._chi)
        true, d_true = at_sensor(found.base, self._R, self._p)
        return self._with_errors(true, d_true, x[self._errors :])

    def _with_errors(self, true: FloatArray, d_true: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bias, drift, scale and turn of gyro and accelerometer, and the delay of both, on top."""
        n, e, period_s = len(true), self._errors, self.signals.period_s
        time = period_s * (np.arange(n) - 0.5 * (len(self.signals.q) - 1))
        out, jacobian = np.empty((n, 6)), np.zeros((n, 6, e + 25))
        change = np.gradient(true, period_s, axis=0)
        for k, (bias, drift, scale, turn) in enumerate(x[:24].reshape(2, 4, 3)):
            part = slice(3 * k, 3 * k + 3)
            late = true[:, part] - x[24] * change[:, part]
            E = np.eye(3) + np.diag(scale) - hat(turn)
            out[:, part] = late @ E.T + bias + time[:, None] * drift
            jacobian[:, part, :e] = E @ d_true[:, part]
            own = jacobian[:, part, e + 12 * k : e + 12 * k + 12]
            own[:, :, :3] = np.eye(3)
            own[:, :, 3:6] = time[:, None, None] * np.eye(3)
            own[:, :, 6:9] = late[:, :, None] * np.eye(3)
            own[:, :, 9:] = hat(late)
            jacobian[:, part, -1] = -change[:, part] @ E.T
        return out, jacobian

    def _guesses(self) -> Iterator[RigidBody]:
        with contextlib.suppress(SignalError, ConvergenceError):  # noise may make it no body at all; the others are
            yield self.rough()
        yield from GUESSES

    def rough(self) -> RigidBody:
        """The payload of a plain least squares on rows, drag taken for none: a start, biased.

        Raises:
            SignalError: a mass that is not positive.
        """
        Y, y = planar_rows(self.vehicle, self._imu_frame, self.signals, self._columns, _ROUGH_WIDTH_s)
        mean, noise = np.zeros(10), 1.0
        for _ in range(3):
            information = Y.T @ Y / noise + np.diag(1.0 / self._payload_sigma**2)
            covariance = np.asarray(np.linalg.inv(information), np.float64)
            mean = covariance @ (Y.T @ y) / noise
            noise = float(np.mean((y - Y @ mean) ** 2))
        return possible_body(mean, covariance)


def planar_rows(
    vehicle: VehicleModel, imu_frame: str, signals: FlightSignals, columns: PlanarColumns, width_s: float
) -> tuple[FloatArray, FloatArray]:
    """Rows ``y = Y chi_payload`` of force x, y and moment z, drag taken for none: Y (3 v, 10), y (3 v,).

    Args:
        vehicle: with a payload link.
        imu_frame: the IMU's frame.
        signals: the run.
        columns: of its joints.
        width_s: of the kernel that smooths the base's motion.
    """
    base = measured_base(vehicle, imu_frame, signals, width_s)
    whole = np.isfinite(base.specific_force).all(axis=1) & np.isfinite(base.acceleration).all(axis=1)
    w = base.rate[whole, 2]
    basis = np.column_stack([base.specific_force[whole, :2], base.acceleration[whole, 2], np.ones(len(w)), w, w * w])
    W = np.einsum("mijp,mj->mip", columns.T[::2][whole], basis)
    own, chi = vehicle.payload_columns(), vehicle.chi.copy()
    chi[own] = 0.0
    return W[:, :, own].reshape(-1, 10), -(W @ chi).ravel()
