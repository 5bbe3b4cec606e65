"""Non-linear ExIDDM: the payload that makes the predicted gyro and accelerometer agree with the measured ones.

Least squares on measurement rows puts the measured base motion into the regressor, and its noise biases the answer.
Here the base's motion is a prediction (:mod:`onboard.dynamics.free_flight`) from the joints and from what is unknown:
the payload, the momentum at the start, and, as far as they are doubted, the other links, the IMU's errors and its time.
Maximum likelihood on that is unbiased to first order and reaches the Cramer-Rao bound.

Samples are taken in as means over whole ticks, which loses nothing: the prediction is averaged the same way (the mean
over a tick of a signal sampled D times in it is the middle value plus ``(1 - 1/D^2) / 24`` of the second difference).

Known wart: the joints' own noise is not modelled; behind a 100:1 gear it is 1/300 of the gyro's at 1 Hz.
"""

import contextlib
from collections.abc import Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.dynamics.errors import SignalError, UnknownFrameError
from onboard.dynamics.free_flight import at_sensor, predict_base
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.kinematics import LinkMotion, hat, link_motions
from onboard.dynamics.payload import BodyEstimate, body_estimate, standard_of
from onboard.dynamics.ticks import FlightSignals
from onboard.dynamics.vehicle import STANDARD, VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import Fit, covariance_of, fit
from onboard.regressor.free_rows import rough_payload

_GOOD_FIT = 1.3  # whitened residual sum per row of a guess that needs no other
_ROUGH_WIDTH_s = 0.3
_PATIENCE = 60  # iterations: the valley of a payload on a weak motion is flat
_FIRST_TICKS = 10  # that tell the momentum to begin with


def _ball(mass_kg: float) -> RigidBody:
    """Of half the density of water, a hand's breadth off."""
    radius_m = (0.75 * mass_kg / (500.0 * np.pi)) ** (1.0 / 3.0)
    return RigidBody(mass_kg, np.array([0.0, 0.0, radius_m]), 0.4 * mass_kg * radius_m**2 * np.eye(3))


GUESSES = tuple(_ball(mass_kg) for mass_kg in (3.0, 0.5, 15.0))


class ImuPrior(NamedTuple):
    """Standard deviations of what may be wrong with the IMU, by axis; zero for what is taken for certain."""

    gyro_bias_rad_s: float
    gyro_drift_rad_s2: float
    gyro_scale: float
    gyro_turn_rad: float  # small rotation of its axes
    accelerometer_bias_m_s2: float
    accelerometer_drift_m_s3: float
    accelerometer_scale: float
    accelerometer_turn_rad: float
    delay_s: float  # of both, against the joints
    stretch: float = 0.0  # how much longer the same time is by their clock than by the joints', relative


CERTAIN = ImuPrior(*[0.0] * 9)


class PayloadFit(NamedTuple):
    """The maximum-likelihood payload."""

    payload: BodyEstimate  # in the payload link's frame
    fit: Fit
    names: tuple[str, ...]  # of the parameters fitted
    freedom: int  # of the whitened residual sum


class NonLinearExiddm:
    """Predicts the IMU of one flight; fits the payload to it.

    Args:
        vehicle: with a payload link; its standard parameters are the prior of all other links.
        imu_frame: the IMU's frame, fixed in the base.
        signals: the flight.
        payload_sigma: how much of a payload there could be: standard deviations of its standard parameters about none
            at all, (10,); wide.
        link_covariance: of the standard parameters of other links by name, (10, 10) each, positive definite (see
            :func:`onboard.dynamics.payload.standard_covariance`); links that are not named are taken for certain.
        doubt: what may be wrong with the IMU.

    Raises:
        UnknownFrameError: no payload link, or a name that the URDF does not have.
        SignalError: shapes that do not fit, or joints that are not finite.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        imu_frame: str,
        signals: FlightSignals,
        payload_sigma: FloatArray,
        link_covariance: Mapping[str, FloatArray],
        doubt: ImuPrior = CERTAIN,
    ) -> None:
        payload = vehicle.spec.payload_link
        if payload is None:
            raise UnknownFrameError("this vehicle has no payload link; name one")
        unknown = set(link_covariance) - set(vehicle.links) | ({payload} & set(link_covariance))
        if unknown:
            raise UnknownFrameError(f"covariances are for links other than the payload; {', '.join(unknown)} is none")
        if not all(np.isfinite(joint).all() for joint in (signals.q, signals.dq, signals.ddq)):
            raise SignalError("joints must be known at every tick; cut the flight where they are not")
        n = signals.q.shape[0]
        if signals.rate.shape != (n, 3) or signals.specific_force.shape != (n, 3):
            raise SignalError(f"{n} ticks of joints need ({n}, 3) rates and specific forces")
        self.vehicle, self.signals = vehicle, signals
        self._links = link_motions(vehicle, signals.q, signals.dq, signals.ddq)
        self._payload = vehicle.payload_columns()
        self._others = [k for k, link in enumerate(vehicle.links) if link in link_covariance]
        self._free = (vehicle.links.index(payload), *self._others)
        self._measured = np.concatenate([signals.rate, signals.specific_force], axis=1)  # (n, 6)
        self._imu_frame, self._payload_sigma = imu_frame, payload_sigma
        self._R, self._p = vehicle.pose_in_base(imu_frame)
        self._valid: NDArray[np.bool_] = np.isfinite(self._measured).all(axis=1)
        self._sigma = np.concatenate([signals.rate_sigma, signals.specific_force_sigma])
        names = [f"momentum_{axis}" for axis in "xyz"] + [f"{kind}_{payload}" for kind in STANDARD]
        names += [f"{kind}_{vehicle.links[k]}" for k in self._others for kind in STANDARD]
        self._first_error = len(names)
        sigma: list[float] = []
        for kind, value in doubt._asdict().items():
            size = 1 if kind in ("delay_s", "stretch") else 3
            sigma += [value] * size
            names += [kind] if size == 1 else [f"{kind}_{axis}" for axis in "xyz"]
        self._size = len(names)
        doubted = self._first_error + np.flatnonzero(sigma)
        self._kept: NDArray[np.int64] = np.concatenate([np.arange(self._first_error), doubted])
        self.names = tuple(names[k] for k in self._kept)
        self.prior_information = np.zeros((len(self._kept), len(self._kept)))
        own = np.arange(3, 13)
        self.prior_information[own, own] = 1.0 / payload_sigma**2
        for index, k in enumerate(self._others):
            block = slice(13 + 10 * index, 23 + 10 * index)
            self.prior_information[block, block] = np.linalg.inv(link_covariance[vehicle.links[k]])
        rest = np.arange(self._first_error, len(self._kept))
        self.prior_information[rest, rest] = [1.0 / value**2 for value in sigma if value]

    def start(self, body: RigidBody) -> FloatArray:
        """Parameters to begin with: this payload, the momentum it means at the first ticks, all else as drawn."""
        x = np.zeros(self._size)
        x[3:13] = standard_of(body)
        few = _first(self._links, _FIRST_TICKS)
        base = predict_base(few, self.signals.period_s, self._chi(x), np.zeros(3), ())  # momentum zero: eta stays so
        gap = self.signals.rate[:_FIRST_TICKS] @ self._R.T - base.rate
        seen = self._valid[:_FIRST_TICKS]
        if not seen.any():
            raise SignalError(f"none of the first {_FIRST_TICKS} ticks has an IMU; begin the flight where it has")
        x[:3] = np.linalg.lstsq(base.d_rate[seen, :, :3].reshape(-1, 3), gap[seen].ravel())[0]
        return np.asarray(x[self._kept], np.float64)

    def parameters(self, momentum: FloatArray, body: RigidBody) -> FloatArray:
        """The parameter vector of this payload and momentum, all else as drawn; at the truth, where the bound is."""
        x = np.zeros(self._size)
        x[:3], x[3:13] = momentum, standard_of(body)
        return np.asarray(x[self._kept], np.float64)

    def fit(self) -> PayloadFit:
        """Maximum likelihood: of the first seconds from one guess after the other, then of more, then of all.

        The first guess is a plain least squares. A wrong one drifts off over a long flight, and its fit with it; over a
        short one it finds the way.

        Raises:
            ConvergenceError, SingularError, RowError: see :func:`onboard.estimation.maximum_likelihood.fit`.
            SignalError: a payload without a mass.
        """
        n = len(self.signals.q)
        found: Fit | None = None
        for guess in self._guesses():
            try:
                tried = self._fit(self.start(guess), n // 8, 1.0)
            except ConvergenceError:
                continue
            if found is None or tried.residual_sum < found.residual_sum:
                found = tried
            if found.residual_sum < _GOOD_FIT * 6 * (n // 8):
                break
        if found is None:
            raise ConvergenceError("no guess leads anywhere; check frames, signs and units of joints and IMU")
        found = self._fit(self._fit(found.x, n // 3, 1.0).x, n, 1e-4)
        rows = 6 * int(self._valid.sum())
        known = int(np.count_nonzero(np.diag(self.prior_information)))
        return PayloadFit(self._estimate(found.x, found.covariance), found, self.names, rows + known - found.x.size)

    def _guesses(self) -> Iterator[RigidBody]:
        with contextlib.suppress(SignalError, ConvergenceError):  # noise may make it no body at all; the others are
            yield rough_payload(self.vehicle, self._imu_frame, self.signals, _ROUGH_WIDTH_s, self._payload_sigma)
        yield from GUESSES

    def _fit(self, x: FloatArray, ticks: int, tolerance: float) -> Fit:
        early = partial(self.residuals, ticks=ticks)
        return fit(early, x, np.zeros_like(x), self.prior_information, _PATIENCE, tolerance)

    def bound(self, truth: FloatArray) -> BodyEstimate:
        """The payload at ``truth`` with the Cramer-Rao bound of this motion as its covariance."""
        return self._estimate(truth, covariance_of(self.residuals(truth)[1], self.prior_information))

    def residuals(self, parameters: FloatArray, ticks: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Whitened, predicted less measured, (6 v,), and their derivative (6 v, p); v ticks with an IMU.

        Args:
            parameters: (p,).
            ticks: only the first so many; all, where not given.
        """
        x = np.zeros(self._size)
        x[self._kept] = parameters
        predicted, derivative = self._predict(x, ticks)
        valid = self._valid[:ticks]
        residual = (predicted[valid] - self._measured[:ticks][valid]) / self._sigma
        jacobian = derivative[valid][:, :, self._kept] / self._sigma[:, None]
        return residual.ravel(), jacobian.reshape(residual.size, -1)

    def _estimate(self, x: FloatArray, covariance: FloatArray) -> BodyEstimate:
        return body_estimate(x[3:13], covariance[3:13, 3:13])

    def _chi(self, x: FloatArray) -> FloatArray:
        chi = self.vehicle.chi.copy()
        chi[self._payload] = x[3:13]
        for index, k in enumerate(self._others):
            chi[10 * k : 10 * k + 10] += x[13 + 10 * index : 23 + 10 * index]
        return chi

    def _predict(self, x: FloatArray, ticks: int | None) -> tuple[FloatArray, FloatArray]:
        """What the IMU shows, (n, 6), and its derivative, (n, 6, all parameters)."""
        base = predict_base(_first(self._links, ticks), self.signals.period_s, self._chi(x), x[:3], self._free)
        true, d_true = at_sensor(base, self._R, self._p)
        n = len(true)
        e = self._first_error
        gyro, accelerometer = x[e : e + 12].reshape(4, 3), x[e + 12 : e + 24].reshape(4, 3)
        delay_s, stretch = x[-2:]
        time = self.signals.period_s * (np.arange(n) - 0.5 * (len(self.signals.q) - 1))
        out, jacobian = np.empty((n, 6)), np.zeros((n, 6, self._size))
        change = np.gradient(true, self.signals.period_s, axis=0)
        for k, (bias, drift, scale, turn) in enumerate((gyro, accelerometer)):
            part = slice(3 * k, 3 * k + 3)
            late = delay_s + stretch * time[:, None]
            # a rate by a clock that runs otherwise is another rate; an acceleration twice so
            own = true[:, part] - late * change[:, part] - (1 + k) * stretch * true[:, part]
            E = np.eye(3) + np.diag(scale) - hat(turn)
            out[:, part] = own @ E.T + bias + time[:, None] * drift
            jacobian[:, part, :e] = E @ d_true[:, part]
            columns = jacobian[:, part, e + 12 * k : e + 12 * k + 12]
            columns[:, :, :3] = np.eye(3)
            columns[:, :, 3:6] = time[:, None, None] * np.eye(3)
            columns[:, :, 6:9] = own[:, :, None] * np.eye(3)
            columns[:, :, 9:] = hat(own)
            jacobian[:, part, -2] = -change[:, part] @ E.T
            jacobian[:, part, -1] = -(time[:, None] * change[:, part] + (1 + k) * true[:, part]) @ E.T
        return _tick_mean(out, self.signals.samples), _tick_mean(jacobian, self.signals.samples)


def _first(links: tuple[LinkMotion, ...], ticks: int | None) -> tuple[LinkMotion, ...]:
    return tuple(LinkMotion(*(part[:ticks] for part in link)) for link in links)


def _tick_mean(x: FloatArray, samples: int) -> FloatArray:
    """The mean over each tick of a signal known at the middle of every tick, sampled ``samples`` times in each."""
    c = (1.0 - 1.0 / samples**2) / 24.0
    out = x.copy()
    out[1:-1] += c * (x[2:] - 2.0 * x[1:-1] + x[:-2])
    return out
