"""Batch fit of a short window of ticks: initialises the recursive filter, and classifies a detected change.

The maximum likelihood of :mod:`onboard.identification.exiddm.batch` on the state of
:mod:`onboard.identification.exiddm.imu_prediction`, from several guesses, with the current estimate of the other
unknowns as prior.
"""

import contextlib
from collections.abc import Iterator
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from onboard.dynamics.payload import standard_of
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError, SingularError
from onboard.estimation.maximum_likelihood import Fit, fit
from onboard.identification.exiddm.guesses import ROUGH_WIDTH_s, guesses
from onboard.identification.exiddm.imu_errors import whitened
from onboard.identification.exiddm.imu_prediction import (
    FIRST_TICKS,
    PAYLOAD,
    RATE,
    ImuPredictor,
    Prediction,
    first_rate,
)
from onboard.identification.exiddm.ticks import Ticks
from onboard.regressor.free_rows import rough_payload

_ITERATIONS = 40
_GOOD_FIT = 1e-2  # chance probability of the misfit above which no further guess is tried
_GLITCH = 1e-9  # chance probability of a tick's residual below which it is an outlier
_FEW = 0.03  # largest share of outliers


class Hypothesis(Enum):
    """Hypothesis on the payload during a window."""

    NOTHING = "nothing held"
    SAME = "the same payload"
    NEW = "a payload of which nothing is known"


class Solved(NamedTuple):
    """Solution of a window under one hypothesis."""

    start: FloatArray  # (p,) at its first tick
    state: FloatArray  # (p,) at its last tick but one
    covariance: FloatArray  # (p, p) of that
    used: int  # ticks
    glitches: int
    chance: float  # of a misfit as large


class WindowFit:
    """A window of ticks with all joints known.

    Args:
        predictor: of the IMU.
        imu_frame: the frame it measures in.
        payload_sigma: of a payload of which nothing is known, (10,).
        ticks: the window, in succession.
        mean: (p,) prior of the state at its first tick, without the rate.
        covariance: (p, p) of that.
    """

    def __init__(
        self,
        predictor: ImuPredictor,
        imu_frame: str,
        payload_sigma: FloatArray,
        ticks: Ticks,
        mean: FloatArray,
        covariance: FloatArray,
    ) -> None:
        self._predictor, self._imu_frame, self._payload_sigma = predictor, imu_frame, payload_sigma
        self._ticks, self._mean, self._covariance = ticks, mean, covariance
        self._sigma = ticks.sigma

    def solve(self, hypothesis: Hypothesis, start: FloatArray | None) -> Solved | None:
        """Fit the window under a hypothesis; None if the fit fails.

        Args:
            hypothesis: payload hypothesis.
            start: (p,) the state at the first tick as it was found before; None: guesses are made.
        """
        p = len(self._mean)
        rest, others, own = slice(PAYLOAD.start, p), np.arange(PAYLOAD.stop, p), np.arange(p)[PAYLOAD]
        mean, information, active = self._mean.copy(), np.zeros((p, p)), np.arange(p)
        if hypothesis is Hypothesis.SAME:
            information[rest, rest] = np.linalg.inv(self._covariance[rest, rest])
        else:
            apart = slice(PAYLOAD.stop, p)
            information[apart, apart] = np.linalg.inv(self._covariance[apart, apart])
            information[own, own] = 1.0 / self._payload_sigma**2
            mean[PAYLOAD] = 0.0
        if hypothesis is Hypothesis.NOTHING:
            active = np.concatenate([np.arange(p)[RATE], others])
        use = np.logical_and.reduce(np.isfinite(self._ticks.measured[1:-1]), axis=1)
        if use[:FIRST_TICKS].sum() < FIRST_TICKS // 2:
            return None
        problem = _Problem(mean, information, active)
        with contextlib.suppress(ConvergenceError, SingularError):
            found = self._from_guesses(problem, hypothesis, use) if start is None else start
            fitted = None if found is None else self._settle(problem, found, use)
            if fitted is None:
                return None
            glitches = 0
            while glitches < _FEW * len(use):  # an outlier distorts the fit: remove them one at a time
                squares = (self._residuals(problem, use, fitted.x)[0].reshape(-1, 6) ** 2).sum(axis=1)
                worst = int(squares.argmax())
                if squares[worst] < chdtri(6.0, _GLITCH):
                    break
                use[np.flatnonzero(use)[worst]] = False
                glitches += 1
                fitted = self._settle(problem, problem.state(fitted.x), use)
            found = problem.state(fitted.x)
            end = self._predict(len(self._ticks.time_s), found)
            F = end.transition[:, active]
            chance = float(chdtrc(6.0 * use.sum(), fitted.residual_sum))
            return Solved(found, end.state, F @ fitted.covariance @ F.T, int(use.sum()), glitches, chance)
        return None

    def _from_guesses(self, problem: "_Problem", hypothesis: Hypothesis, use: NDArray[np.bool_]) -> FloatArray | None:
        """Best fit over the initial guesses, stopping at a good one; starts on the first part of the window."""
        found: Fit | None = None
        for payload in self._guesses(hypothesis):
            x = problem.mean.copy()
            x[PAYLOAD] = payload
            x[RATE] = first_rate(self._predictor, self._ticks, x)
            with contextlib.suppress(ConvergenceError, SingularError):
                tried = self._fit(problem, x, use, 1.0)
                if found is None or tried.residual_sum < found.residual_sum:
                    found = tried
                if chdtrc(6.0 * use.sum(), tried.residual_sum) > _GOOD_FIT:
                    break
        return None if found is None else problem.state(found.x)

    def _settle(self, problem: "_Problem", start: FloatArray, use: NDArray[np.bool_]) -> Fit:
        """Iterate to the minimum; a nearly flat minimum is accepted early."""
        with contextlib.suppress(ConvergenceError):
            return self._fit(problem, start, use, 1e-2)
        return self._fit(problem, start, use, 1.0)

    def _fit(self, problem: "_Problem", start: FloatArray, use: NDArray[np.bool_], tolerance: float) -> Fit:
        active = problem.active
        prior = problem.information[np.ix_(active, active)]
        noise = self._predictor.joint_noise(self._ticks.q, self._ticks.joint_sigma, start)
        self._sigma = np.hypot(self._ticks.sigma, noise)
        residuals = partial(self._residuals, problem, use)
        return fit(residuals, start[active], problem.mean[active], prior, _ITERATIONS, tolerance)

    def _residuals(self, problem: "_Problem", use: NDArray[np.bool_], x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened, predicted less measured, of the ticks to use, and their derivatives by what is active."""
        n = len(use)
        predicted = self._predict(n + 2, problem.state(x))
        sigma = self._sigma[1 : n + 1]
        measured, jacobian = self._ticks.measured[1 : n + 1], predicted.jacobian[:, :, problem.active]
        return whitened(predicted.values, jacobian, measured, sigma, use)

    def _predict(self, ticks: int, state: FloatArray) -> Prediction:
        """Of the first ticks."""
        first = self._ticks.part(slice(0, ticks))
        return self._predictor.predict(first.q, first.dq, first.ddq, state)

    def _guesses(self, hypothesis: Hypothesis) -> Iterator[FloatArray]:
        if hypothesis is not Hypothesis.NEW:
            yield self._mean[PAYLOAD] if hypothesis is Hypothesis.SAME else np.zeros(10)
            return
        vehicle, signals = self._predictor.vehicle, self._ticks.flight(self._predictor.period_s, 1)
        rough = partial(rough_payload, vehicle, self._imu_frame, signals, ROUGH_WIDTH_s, self._payload_sigma)
        yield from (standard_of(guess) for guess in guesses(rough))


class _Problem(NamedTuple):
    mean: FloatArray  # (p,)
    information: FloatArray  # (p, p)
    active: NDArray[np.intp]  # what is estimated; the rest stays as it is in the mean

    def state(self, x: FloatArray) -> FloatArray:
        """The whole state with these values of what is active."""
        state = self.mean.copy()
        state[self.active] = x
        return state
