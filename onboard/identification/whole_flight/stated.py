"""What a fit of a flight says of links and joints, and what it leans on of all that is stated.

Under the stated covariance C the fitted corrections c, of covariance P, are ``c ~ N(0, C - P)`` (the difference of an
efficient estimate and its prior; Hausman, Econometrica 46, 1978). Errors of links and joints are tested together in the
directions that the flight tells of, which are some seventy of more than a hundred. What is wrong of one part or one
instrument is a hypothesis of its own (:mod:`~onboard.identification.whole_flight.witnesses`).
"""

import numpy as np

from onboard.dynamics.model.inertia import elements
from onboard.dynamics.model.payload import body_jacobian
from onboard.estimation.arrays import FloatArray
from onboard.estimation.maximum_likelihood import inverse_of
from onboard.identification.free_flyer.prediction.joint_noise import NOISE_KEY
from onboard.identification.leaning import Causes
from onboard.identification.whole_flight.blocks import FlightFit, total_of
from onboard.identification.whole_flight.chance import Chance, squares_of
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.windows import LEAST_TOLD


def bodies_of(flight: WholeFlight, found: FlightFit) -> Chance:
    """Errors of links, joints and thrusters together, in the directions that the flight tells of.

    Args:
        flight: that was fitted.
        found: its fit.
    """
    at = flight.of_bodies
    sigma, both = flight.sigma[at], np.ix_(at, at)
    expected = inverse_of(flight.prior_information[both]) - found.fit.covariance[both]
    doubt = found.correction.sigma[at]
    told = (expected + np.outer(doubt, doubt)) / np.outer(sigma, sigma)
    return Chance(*squares_of(found.fit.x[at] / sigma, told, LEAST_TOLD))


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
    body = found.payload.body
    size = np.abs([body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)])
    causes = Causes(keys, flight.sigma, [NOISE_KEY])
    effects = causes.effects(D @ found.fit.covariance)
    effects[:, -1] = np.abs(D @ found.correction.sigma)
    return causes.said(effects, sigma, size)
