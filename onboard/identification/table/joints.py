"""Errors of the joints, cyclic ones of their encoders too, as further unknowns of a run on an air-bearing table.

They are milliradians and millimetres, so the residuals are linear in them: with J the derivative of the whitened
residuals r by the fitted parameters x, G that by the errors z (by differences of their stated sigmas), and L and Z the
prior information about zero, one Gauss-Newton step

    [dx; z] = -[J'J + L, J'G; G'J, G'G + Z]^-1 [J'r + L x; G'r]

gives the estimate with the errors fitted too, and the inverse is the covariance of both (derived here).
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.joint_errors import PER_JOINT
from onboard.estimation.arrays import FloatArray
from onboard.estimation.maximum_likelihood import Fit, inverse_of
from onboard.identification.corrections import expected_sigma
from onboard.identification.table.air_bearing import TableFit


class JointCorrections(NamedTuple):
    """Fitted errors of joints, k of them."""

    names: tuple[str, ...]
    values: FloatArray  # (k,)
    stated: FloatArray  # (k,) their sigmas before the run
    sigma: FloatArray  # (k,) after it

    @property
    def in_stated_sigmas(self) -> dict[str, float]:
        """By name."""
        return dict(zip(self.names, (self.values / self.stated).tolist(), strict=True))

    @property
    def in_told_sigmas(self) -> dict[str, float]:
        """By name, in sigmas of what the data tell: :mod:`onboard.identification.corrections`."""
        return dict(
            zip(self.names, (self.values / expected_sigma(self.stated**2, self.sigma**2)).tolist(), strict=True)
        )


class Step(NamedTuple):
    """One Gauss-Newton step of parameters and errors of joints, and of c further errors of one sigma each."""

    fit: Fit  # of the parameters, (p,)
    joints: JointCorrections
    covariance: FloatArray  # (p + k + c, p + k + c)
    left: FloatArray  # (m,) residuals after it
    derivative: FloatArray  # (m, p + k + c) of these
    further: FloatArray  # (c,) sizes of the further errors, beyond those that they are at


def step(run: TableFit, found: Fit, further: FloatArray | None = None, at: FloatArray | None = None) -> Step:
    """The step, as this module's head says.

    Args:
        run: its fit.
        found: its fit of all ticks, joints exact.
        further: (m, c) derivative of the residuals by the further errors.
        at: (c,) of which size they are in ``run``, in sigmas.

    Raises:
        SingularError: errors that cannot be separated.
    """
    x, p = found.x, found.x.size
    names, stated = _unknown(run)
    r, both, information = _normal(run, x, further)
    gradient = both.T @ r
    gradient[:p] += run.prior_information @ x
    if at is not None:
        gradient[p + len(names) :] += at
    covariance = inverse_of(information)
    moved = -covariance @ gradient
    z, sigma = moved[p : p + len(names)], np.sqrt(np.diag(covariance)[p : p + len(names)])
    squares = found.residual_sum + float(gradient @ moved)
    fit = found._replace(x=x + moved[:p], covariance=covariance[:p, :p], residual_sum=squares)
    corrections = JointCorrections(names, z, stated, sigma)
    return Step(fit, corrections, covariance, r + both @ moved, both, moved[p + len(names) :])


def bound(run: TableFit, x: FloatArray) -> FloatArray:
    """Covariance of the parameters (p, p) with the errors of the joints unknown, at parameters ``x``, (p,).

    Raises:
        SingularError: a direction determined by neither rows nor prior.
    """
    return inverse_of(_normal(run, x, None)[2])[: x.size, : x.size]


def _unknown(run: TableFit) -> tuple[tuple[str, ...], FloatArray]:
    """Names of the errors that have a sigma, and these, (k,)."""
    names, sigma = (*run.joints.names, *run.cyclic.names), np.append(run.joints.sigma, run.cyclic.sigma)
    own = np.flatnonzero(sigma > 0.0)
    return tuple(names[k] for k in own), sigma[own]


def _normal(run: TableFit, x: FloatArray, further: FloatArray | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (m,), their derivative by parameters and errors, (m, p + k + c), and the information on these."""
    sigma, (r, J), own = (np.append(run.joints.sigma, run.cyclic.sigma), run.residuals(x), run.joints.sigma.size)
    columns = [J]
    for place in np.flatnonzero(sigma > 0.0):
        each = np.where(np.arange(sigma.size) == place, sigma, 0.0)
        wrong = run.with_errors(each[:own].reshape(-1, PER_JOINT), multiples=each[own:])
        columns.append(((wrong.left(x) - r) / sigma[place])[:, None])
    both = np.concatenate([*columns, *([] if further is None else [further])], axis=1)
    information = both.T @ both
    information[: x.size, : x.size] += run.prior_information
    stated = _unknown(run)[1]
    information[x.size :, x.size :] += np.diag(np.append(stated**-2, np.ones(both.shape[1] - x.size - stated.size)))
    return r, both, information
