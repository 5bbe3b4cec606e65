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

MINIMUM = 1e-2
"""Promised decrease of the whitened sum of squares, the square of the way to the minimum in sigmas: a tenth of one."""
NEAR_MINIMUM = 3.0
"""The same where another step follows or is taken, which is as good as the promise: of a guess, a stage, a search."""
ROUGH_MINIMUM = 50.0
"""The same before data or unknowns are added."""
ROUNDS = 3  # of a model that is nearly linear about the result of the last
OPEN = 1e3  # stated sigmas of an error that may be of any size
ITERATIONS = 50  # predictions, at most, of a fit that converges: it takes 3 to 30, more along a curved valley
DAMPING = 1e-3  # of the first step, relative to the information's diagonal
_LIGHTER = 0.1  # damping after a step that has lowered the sum of squares, relative to that before
_HEAVIEST = 1e9  # damping
BEYOND = 4  # steps, at most, from the end of one that has not lowered the sum of squares
_BACK = 1e3  # damping of these, relative to that of the step: back to the floor of a valley, hardly along it
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


def _scale_of(information: FloatArray) -> FloatArray:
    """Roots of an information's diagonal, (p,). Raises SingularError: of a parameter that nothing depends on."""
    scale: FloatArray = np.sqrt(np.diag(information))
    if not (scale > 0.0).all():
        raise SingularError(f"nothing measured depends on {np.sum(~(scale > 0.0))} of {len(scale)} parameters")
    return scale


def inverse_of(information: FloatArray) -> FloatArray:
    """Inverse of a positive definite information matrix of any units, (p, p).

    Raises:
        SingularError: a direction without information.
    """
    scale = _scale_of(information)
    try:
        factor = cho_factor(information / np.outer(scale, scale))
    except LinAlgError as error:
        raise SingularError("the rows do not determine all parameters; give a prior, or move more") from error
    covariance: FloatArray = cho_solve(factor, np.eye(scale.size)) / np.outer(scale, scale)
    return covariance


class Descent:
    """Levenberg-Marquardt iteration on ``|r(x)|^2 + (x - x0)' L (x - x0)``, one prediction at a time.

    It ends where the step without damping promises less than the tolerance: a damped step promises little in a narrow
    valley long before its end. In a bent valley a long step ends on the wall, and the next one leads back to the floor,
    further down. A step that does not lower the sum of squares is therefore followed by more from where it ends, as
    long as each lowers it; only where these end above the start is it taken back and the damping raised.

    Whoever runs it predicts at ``at`` and hands the result to :meth:`take` until there is ``found``. Its attributes are
    values, so that it can be written to a checkpoint between two predictions.

    Args:
        start: where to begin, (p,).
        prior_mean: x0, (p,).
        prior_information: L, (p, p), positive semi-definite.
        iterations: predictions after the first, at most.
        tolerance: decrease of the whitened sum of squares, predicted for a step without damping, below which the
            iteration stops.
        damping: of the first step, relative to the information's diagonal.
        beyond: steps, at most, from the end of one that has not lowered it.

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
        iterations: int = ITERATIONS,
        tolerance: float = MINIMUM,
        damping: float = DAMPING,
        beyond: int = BEYOND,
    ) -> None:
        self.at: FloatArray = np.asarray(start, np.float64).copy()
        self.found: Fit | None = None
        self._mean, self._prior, self._most_beyond = prior_mean, prior_information, beyond
        self._iterations, self._tolerance = iterations, tolerance
        self.best, self._now = self.at, Normal(prior_information, np.zeros_like(self.at), np.inf)
        self.iteration, self._tries, self._damping, self._promised = 0, 0, damping, np.inf
        self._beyond, self._wall = 0, np.inf  # steps since the one that did not lower it, and the sum of squares there
        self._newton = self.at  # step without damping from the best point

    @property
    def squares(self) -> float:
        """The least sum of squares so far."""
        return self._now.squares if self.found is None else self.found.residual_sum

    @property
    def prospect(self) -> float:
        """The sum of squares that it would reach if each iteration left lowered it as the next one is to.

        Minus infinity where the damping is so large that the next step says little about those after it.
        """
        left = self._iterations - self._tries
        return self._now.squares - left * self._promised if self._damping <= _MILD else -np.inf

    def short_of_the_minimum(self) -> Fit:
        """The best point so far as a result: the step without damping from there is part of its covariance.

        Raises:
            SingularError: as :func:`inverse_of`.
        """
        covariance = inverse_of(self._now.information) + np.outer(self._newton, self._newton)
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
        lower = self._now.squares - tried.squares
        self._tries += 1
        if not self.iteration:
            if not np.isfinite(tried.squares):
                raise RowError("the prediction from the starting values is not finite; check signals and sigmas")
            self._next(tried)
        elif lower >= 0.1 * (min(self._promised, self._tolerance) if self._beyond else self._promised):
            self._damping = max(self._damping * _LIGHTER, 1e-12)
            self._next(tried)
        elif self._beyond < self._most_beyond and tried.squares < self._wall:
            self._beyond, self._wall = self._beyond + 1, tried.squares
            self._step(tried, _BACK * self._damping)
        else:
            self._back()
        if self.found is None and self._tries > self._iterations:
            text = f"not converged after {self._iterations} predictions; the motion may not determine the parameters"
            raise ConvergenceError(text)

    def _next(self, now: Normal) -> None:
        """The next iteration, from ``at``."""
        self.best, self._now, self._beyond, self._wall = self.at, now, 0, np.inf
        self.iteration += 1
        scale = _scale_of(now.information)
        try:
            factor = cho_factor(now.information / np.outer(scale, scale))
            self._newton = -cho_solve(factor, now.gradient / scale) / scale
            promised = -float(now.gradient @ self._newton)
        except (LinAlgError, ValueError):
            promised = np.inf
        if abs(promised) < self._tolerance:
            x = self.best + self._newton
            self.found = Fit(x, inverse_of(now.information), now.squares - promised, self.iteration)
            return
        self._promised = self._step(now, self._damping)

    def _back(self) -> None:
        """Take the step from the best point back, and try a shorter one."""
        scale = _scale_of(self._now.information)
        scaled = self._now.information / np.outer(scale, scale)
        least = np.linalg.eigvalsh(scaled)[0] if self._damping < 1.0 else 1.0  # at most: ones are on the diagonal
        self._damping = max(self._damping * 10.0, 10.0 * float(least))
        self.at, self._beyond, self._wall = self.best, 0, np.inf
        if self._damping > _HEAVIEST:
            raise ConvergenceError("no step, however short, lowers the sum of squares")
        self._promised = self._step(self._now, self._damping)

    def _step(self, now: Normal, damping: float) -> float:
        """Go on from ``at``, where these are the normal equations; the decrease under the linear model."""
        scale = _scale_of(now.information)
        with np.errstate(invalid="ignore"):
            scaled, downhill = now.information / np.outer(scale, scale), -now.gradient / scale
            try:
                step = np.linalg.solve(scaled + damping * np.eye(scale.size), downhill)
            except np.linalg.LinAlgError as error:
                raise SingularError("the rows do not determine all parameters; give a prior, or move more") from error
            promised = float(2.0 * downhill @ step - step @ scaled @ step)
        if not np.isfinite(promised):
            raise ConvergenceError("the derivative of the prediction is not finite; check the signals")
        self.at = self.at + step / scale
        return promised


def fit(
    predict: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    start: FloatArray,
    prior_mean: FloatArray,
    prior_information: FloatArray,
    iterations: int = ITERATIONS,
    tolerance: float = MINIMUM,
) -> Fit:
    """:func:`fit_normal` of whitened residuals (m,), predicted less measured, and their derivative (m, p), at x."""
    return fit_normal(lambda x: Normal.of(*predict(x)), start, prior_mean, prior_information, iterations, tolerance)


def fit_normal(
    evaluate: Callable[[FloatArray], Normal],
    start: FloatArray,
    prior_mean: FloatArray,
    prior_information: FloatArray,
    iterations: int = ITERATIONS,
    tolerance: float = MINIMUM,
    damping: float = DAMPING,
) -> Fit:
    """Minimises ``|r(x)|^2 + (x - x0)' L (x - x0)`` by a :class:`Descent`.

    Args:
        evaluate: normal equations of the whitened residuals, predicted less measured, at x.
        start: where to begin, (p,).
        prior_mean: x0, (p,).
        prior_information: L, (p, p), positive semi-definite.
        iterations: predictions after the first, at most.
        tolerance: decrease of the whitened sum of squares, predicted for a step without damping, below which it stops.
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
