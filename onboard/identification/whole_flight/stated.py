"""What a fit of a flight says of links and joints, and what it leans on of all that is stated.

Errors of links and joints are tested together (:func:`onboard.identification.corrections.together`). What is wrong of
one part or one instrument is a hypothesis of its own (:mod:`~onboard.identification.whole_flight.witnesses`).
"""

import numpy as np

from onboard.dynamics.model.payload import body_jacobian, numbers_of
from onboard.estimation.arrays import FloatArray
from onboard.estimation.maximum_likelihood import inverse_of
from onboard.identification.corrections import Together, together
from onboard.identification.free_flyer.prediction.joint_noise import NOISE_KEY
from onboard.identification.leaning import Causes
from onboard.identification.whole_flight.blocks import FlightFit, total_of
from onboard.identification.whole_flight.fit import WholeFlight


def bodies_of(flight: WholeFlight, found: FlightFit) -> Together:
    """Errors of links, joints and thrusters together, in the directions that the flight tells of.

    Args:
        flight: that was fitted.
        found: its fit.
    """
    at, doubt = flight.of_bodies, found.correction.sigma[flight.of_bodies]
    whiten = np.linalg.cholesky(flight.prior_information[np.ix_(at, at)]).T
    left = whiten @ (found.fit.covariance[np.ix_(at, at)] - np.outer(doubt, doubt)) @ whiten.T
    return together(whiten @ found.fit.x[at], left)


def bound_of(flight: WholeFlight, found: FlightFit) -> FloatArray:
    """Cramér-Rao: the least sigmas of the payload's ten numbers at the noise and the sigmas that are stated, (10,).

    By the information of all rows that were used, at the estimate. Where something may be wrong, the sigmas of the fit
    are wider than that.

    Args:
        flight: that was fitted.
        found: its fit.

    Raises:
        SingularError: rows and stated sigmas leave a parameter undetermined.
    """
    rows = total_of(found.blocks, len(found.names)).information
    covariance = inverse_of(rows + np.diag(np.nan_to_num(1.0 / flight.stated**2)))
    D = body_jacobian(found.chi)
    return np.asarray(np.sqrt(np.diag(D @ covariance[:10, :10] @ D.T)), np.float64)


def leans_on(flight: WholeFlight, found: FlightFit) -> tuple[str, ...]:
    """The stated sigmas that each of the payload's ten numbers depends on, with the effect of one sigma.

    See :mod:`onboard.identification.leaning`.

    Args:
        flight: that was fitted.
        found: its fit.
    """
    D = np.zeros((10, found.fit.x.size))
    D[:, :10] = body_jacobian(found.chi)
    keys = [*[""] * 10, *(flight.key_of(name) for name in found.names[10:])]
    sigma = np.sqrt(np.diag(found.payload.covariance))
    size = np.abs(numbers_of(found.payload.body))
    causes = Causes(keys, flight.sigma, [NOISE_KEY])
    effects = causes.effects(D @ found.fit.covariance)
    effects[:, -1] = np.abs(D @ found.correction.sigma)
    return causes.said(effects, sigma, size)
