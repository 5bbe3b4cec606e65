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
) -> Fit:
    """Minimises ``|r(x)|^2 + (x - x0)' L (x - x0)``.

    Args:
        evaluate: normal equations of the whitened residuals, predicted less measured, at x.
        start: where to begin, (p,).
        prior_mean: x0, (p,).
        prior_information: L, (p, p), positive semi-definite.
        iterations: at most.
        tolerance: predicted decrease of the whitened sum of squares below which the iteration stops.

    Raises:
        ConvergenceError: no minimum within ``iterations``.
        SingularError: as :func:`inverse_of`.
        RowError: a residual at the start that is not finite.
    """
    x = np.asarray(start, np.float64).copy()

    def complete(at: FloatArray) -> Normal:
        with np.errstate(over="ignore", invalid="ignore"):  # an overflowing step has infinite cost and is refused
            away = at - prior_mean
            toward = prior_information @ away
            return evaluate(at).plus(Normal(prior_information, toward, float(away @ toward)))

    now = complete(x)
    if not np.isfinite(now.squares):
        raise RowError("the prediction from the starting values is not finite; check signals and sigmas")
    damping = 1e-3
    for iteration in range(1, iterations + 1):
        scale = np.sqrt(np.diag(now.information))
        if not (scale > 0.0).all():
            raise SingularError(f"nothing measured depends on parameter {np.flatnonzero(~(scale > 0.0))}; leave it out")
        scaled, downhill = now.information / np.outer(scale, scale), -now.gradient / scale
        while True:
            step = np.linalg.solve(scaled + damping * np.eye(x.size), downhill)
            promised = float(2.0 * downhill @ step - step @ scaled @ step)  # decrease under the linear model
            if promised < tolerance and damping < _LIGHT:
                return Fit(x + step / scale, inverse_of(now.information), now.squares - promised, iteration)
            tried = complete(x + step / scale)
            if now.squares - tried.squares >= 0.1 * promised:
                break
            if promised < tolerance:
                return Fit(x, inverse_of(now.information), now.squares, iteration)
            damping *= 10.0
        x, now = x + step / scale, tried
        damping = max(damping * 0.1, 1e-12)
        if promised < tolerance:
            return Fit(x, inverse_of(now.information), now.squares, iteration)
    raise ConvergenceError(f"not converged after {iterations} iterations; the motion may not determine the parameters")
