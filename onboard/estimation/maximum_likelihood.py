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
    information = jacobian.T @ jacobian + prior_information
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
    """Minimises ``|r(x)|^2 + (x - x0)' L (x - x0)``.

    Args:
        predict: whitened residuals (m,), predicted less measured, and their derivative (m, p), at x.
        start: where to begin, (p,).
        prior_mean: x0, (p,).
        prior_information: L, (p, p), positive semi-definite.
        iterations: at most.
        tolerance: predicted decrease of the whitened sum of squares below which the iteration stops.

    Raises:
        ConvergenceError: no minimum within ``iterations``.
        SingularError: as :func:`covariance_of`.
        RowError: a residual at the start that is not finite.
    """
    x = np.asarray(start, np.float64).copy()

    def evaluate(at: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        with np.errstate(over="ignore", invalid="ignore"):  # an overflowing step has infinite cost and is refused
            residual, jacobian = predict(at)
            away = at - prior_mean
            return residual, jacobian, float(residual @ residual + away @ prior_information @ away)

    residual, jacobian, cost = evaluate(x)
    if not np.isfinite(cost):
        raise RowError("the prediction from the starting values is not finite; check signals and sigmas")
    damping = 1e-3
    for iteration in range(1, iterations + 1):
        information = jacobian.T @ jacobian + prior_information
        gradient = jacobian.T @ residual + prior_information @ (x - prior_mean)
        scale = np.sqrt(np.diag(information))
        if not (scale > 0.0).all():
            raise SingularError(f"nothing measured depends on parameter {np.flatnonzero(~(scale > 0.0))}; leave it out")
        scaled, downhill = information / np.outer(scale, scale), -gradient / scale
        while True:
            step = np.linalg.solve(scaled + damping * np.eye(x.size), downhill)
            promised = float(2.0 * downhill @ step - step @ scaled @ step)  # decrease under the linear model
            tried = evaluate(x + step / scale)
            if cost - tried[2] >= 0.1 * promised:
                break
            if promised < tolerance:
                return Fit(x, covariance_of(jacobian, prior_information), cost, iteration)
            damping *= 10.0
        x = x + step / scale
        residual, jacobian, cost = tried
        damping = max(damping * 0.1, 1e-12)
        if promised < tolerance:
            return Fit(x, covariance_of(jacobian, prior_information), cost, iteration)
    raise ConvergenceError(f"not converged after {iterations} iterations; the motion may not determine the parameters")
