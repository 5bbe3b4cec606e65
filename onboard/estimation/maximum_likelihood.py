"""Non-linear least squares with a prior: maximum likelihood fit and Cramer-Rao bound.

Levenberg-Marquardt iteration on whitened residuals. With residuals in units of their own sigma the inverse of
``J' J`` (prior rows included) is the covariance at the solution, and at the true parameters the Cramer-Rao bound.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError, RowError, SingularError

_LIGHT = 1e-4  # damping that hardly shortens a step
_MILD = 0.1  # damping that shortens steps along well determined directions by a tenth at most


class Normal(NamedTuple):
    """Normal equations of whitened residuals r(x), (m,), with derivative J, (m, p)."""

    information: FloatArray  # J' J, (p, p)
    gradient: FloatArray  # J' r, (p,)
    squares: float  # r' r

    @staticmethod
    def of(residual: FloatArray, jacobian: FloatArray) -> "Normal":
        """Of residuals (m,) and their derivative (m, p)."""
        return Normal(jacobian.T @ jacobian, jacobian.T @ residual, float(residual @ residual))

    def plus(self, more: "Normal") -> "Normal":
        """Of these residuals and more."""
        return Normal(self.information + more.information, self.gradient + more.gradient, self.squares + more.squares)


class Fit(NamedTuple):
    """Minimum of the sum of squares."""

    x: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    residual_sum: float  # whitened, prior rows included
    iterations: int


def covariance_of(jacobian: FloatArray, prior_information: FloatArray) -> FloatArray:
    """``(J' J + prior)^-1``, (p, p): the covariance of the fit; the Cramer-Rao bound where J is taken at the truth.

    Args:
        jacobian: of the whitened residuals, (m, p).
        prior_information: (p, p); zero where nothing is known.

    Raises:
        SingularError: a direction determined by neither rows nor prior.
    """
    return inverse_of(jacobian.T @ jacobian + prior_information)


def inverse_of(information: FloatArray) -> FloatArray:
    """Inverse of a positive definite information matrix of any units, (p, p).

    Raises:
        SingularError: a direction without information.
    """
    scale = np.sqrt(np.diag(information))
    if not (scale > 0.0).all():
        raise SingularError(f"nothing measured depends on parameter {np.flatnonzero(~(scale > 0.0))}; leave it out")
    try:
        factor = cho_factor(information / np.outer(scale, scale))
    except LinAlgError as error:
        raise SingularError("the rows do not determine all parameters; give a prior, or move more") from error
    covariance: FloatArray = cho_solve(factor, np.eye(scale.size)) / np.outer(scale, scale)
    return covariance


class Descent:
    """Levenberg-Marquardt iteration on ``|r(x)|^2 + (x - x0)' L (x - x0)``, one prediction at a time.

    Whoever runs it predicts at ``at`` and hands the result to :meth:`take` until there is ``found``. Its attributes are
    values, so that it can be written to a checkpoint between two predictions.

    Args:
        start: where to begin, (p,).
        prior_mean: x0, (p,).
        prior_information: L, (p, p), positive semi-definite.
        iterations: at most.
        tolerance: predicted decrease of the whitened sum of squares below which the iteration stops.
        damping: of the first step, relative to the information's diagonal.

    Attributes:
        at: (p,) where the next prediction is wanted.
        best: (p,) where the sum of squares was least so far.
        found: the minimum; None before it is reached.
        iteration: of those that have lowered the sum of squares, the start included.
    """

    def __init__(
        self,
        start: FloatArray,
        prior_mean: FloatArray,
        prior_information: FloatArray,
        iterations: int = 50,
        tolerance: float = 1e-4,
        damping: float = 1e-3,
    ) -> None:
        self.at: FloatArray = np.asarray(start, np.float64).copy()
        self.found: Fit | None = None
        self._mean, self._prior = prior_mean, prior_information
        self._iterations, self._tolerance = iterations, tolerance
        self.best, self._now = self.at, Normal(prior_information, np.zeros_like(self.at), np.inf)
        self.iteration, self._damping, self._promised = 0, damping, np.inf

    @property
    def squares(self) -> float:
        """The least sum of squares so far."""
        return self._now.squares if self.found is None else self.found.residual_sum

    @property
    def prospect(self) -> float:
        """The sum of squares that it would reach if each iteration left lowered it as the next one is to.

        Minus infinity where the damping is so large that the next step says little about those after it.
        """
        left = self._iterations - self.iteration
        return self._now.squares - left * self._promised if self._damping <= _MILD else -np.inf

    def short_of_the_minimum(self) -> Fit:
        """The best point so far as a result: the step that is promised from there is part of its covariance.

        Raises:
            SingularError: as :func:`inverse_of`.
        """
        step = self.at - self.best
        covariance = inverse_of(self._now.information) + np.outer(step, step)
        return Fit(self.best, covariance, self._now.squares, self.iteration)

    def take(self, predicted: Normal) -> None:
        """Takes the normal equations of the whitened residuals, predicted less measured, at ``at``.

        Raises:
            ConvergenceError: no minimum within the iterations, or a derivative that is not finite.
            SingularError: as :func:`inverse_of`.
            RowError: a residual at the start that is not finite.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # an overflowing step has infinite cost and is refused
            away = self.at - self._mean
            toward = self._prior @ away
            tried = predicted.plus(Normal(self._prior, toward, float(away @ toward)))
        if not self.iteration:
            if not np.isfinite(tried.squares):
                raise RowError("the prediction from the starting values is not finite; check signals and sigmas")
            self._next(tried)
        elif self._now.squares - tried.squares >= 0.1 * self._promised:
            self._damping = max(self._damping * 0.1, 1e-12)
            if self._promised < self._tolerance:
                self._end(self.at, tried, tried.squares)
            else:
                self._next(tried)
        elif self._promised < self._tolerance:
            self._end(self.best, self._now, self._now.squares)
        else:
            self._damping *= 10.0
            self._step()

    def _next(self, now: Normal) -> None:
        """The next iteration, from ``at``."""
        self.best, self._now = self.at, now
        over = self.iteration == self._iterations
        self.iteration += not over
        self._step()
        if over and self.found is None:
            text = f"not converged after {self._iterations} iterations; the motion may not determine the parameters"
            raise ConvergenceError(text)

    def _step(self) -> None:
        scale = np.sqrt(np.diag(self._now.information))
        if not (scale > 0.0).all():
            raise SingularError(f"nothing measured depends on parameter {np.flatnonzero(~(scale > 0.0))}; leave it out")
        with np.errstate(invalid="ignore"):
            scaled, downhill = self._now.information / np.outer(scale, scale), -self._now.gradient / scale
            try:
                step = np.linalg.solve(scaled + self._damping * np.eye(scale.size), downhill)
            except np.linalg.LinAlgError as error:
                raise SingularError("the rows do not determine all parameters; give a prior, or move more") from error
            # decrease under the linear model
            self._promised = float(2.0 * downhill @ step - step @ scaled @ step)
        if not np.isfinite(self._promised):
            raise ConvergenceError("the derivative of the prediction is not finite; check the signals")
        self.at = self.best + step / scale
        if self._promised < self._tolerance and self._damping < _LIGHT:
            self._end(self.at, self._now, self._now.squares - self._promised)

    def _end(self, x: FloatArray, now: Normal, residual_sum: float) -> None:
        self.found = Fit(x, inverse_of(now.information), residual_sum, self.iteration)


def fit(
    predict: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    start: FloatArray,
    prior_mean: FloatArray,
    prior_information: FloatArray,
    iterations: int = 50,
    tolerance: float = 1e-4,
) -> Fit:
    """:func:`fit_normal` of whitened residuals (m,), predicted less measured, and their derivative (m, p), at x."""
    return fit_normal(lambda x: Normal.of(*predict(x)), start, prior_mean, prior_information, iterations, tolerance)


def fit_normal(
    evaluate: Callable[[FloatArray], Normal],
    start: FloatArray,
    prior_mean: FloatArray,
    prior_information: FloatArray,
    iterations: int = 50,
    tolerance: float = 1e-4,
    damping: float = 1e-3,
) -> Fit:
    """Minimises ``|r(x)|^2 + (x - x0)' L (x - x0)`` by a :class:`Descent`.

    Args:
        evaluate: normal equations of the whitened residuals, predicted less measured, at x.
        start: where to begin, (p,).
        prior_mean: x0, (p,).
        prior_information: L, (p, p), positive semi-definite.
        iterations: at most.
        tolerance: predicted decrease of the whitened sum of squares below which the iteration stops.
        damping: of the first step, relative to the information's diagonal.

    Raises:
        ConvergenceError: no minimum within ``iterations``.
        SingularError: as :func:`inverse_of`.
        RowError: a residual at the start that is not finite.
    """
    descent = Descent(start, prior_mean, prior_information, iterations, tolerance, damping)
    while descent.found is None:
        with np.errstate(over="ignore", invalid="ignore"):
            predicted = evaluate(descent.at)
        descent.take(predicted)
    return descent.found
