"""Standard parameters of the links from an estimate of base parameters, as physically possible bodies.

Rows determine base parameters only. The standard parameters given here are the posterior of the nominal ones with their
Gaussian prior, conditioned on the estimated base parameters (derived here: ``x + K (beta - F x)``, ``K = P F' (F P
F')^-1``); no rows are needed.
"""

from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc

from onboard.dynamics.model.inertia import RigidBody, composite_functional, elements, pseudo_inertia, take_away
from onboard.dynamics.model.payload import body_jacobian, body_of, possible_body, standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import ROUNDING, FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.policy import sigmas
from onboard.estimation.recursive.consistency import JackknifeEstimate
from onboard.identification.rows.free_body import Whole
from onboard.identification.rows.identifier import Identifier

_MOMENTS = 6
_RAREST = float(np.finfo(np.float64).tiny)


class LinkEstimate(NamedTuple):
    """A link's ten standard parameters, about its frame's origin and in its axes, and the body they stand for."""

    link: str
    mean: FloatArray  # (10,)
    covariance: FloatArray  # (10, 10)
    body: RigidBody | None  # the estimate, or the likeliest possible body; None: mass below zero, or not found
    away: float  # sigmas of a normal that are as rare as the estimate is of any body; zero if possible; inf: none found


def link_estimate(
    link: str, mean: FloatArray, covariance: FloatArray, freedom: Callable[[FloatArray], float] = lambda along: np.inf
) -> LinkEstimate:
    """Standard parameters with their body, by :func:`onboard.dynamics.model.payload.possible_body`.

    Mass and centre of mass may be any, so what the nearest body is away lies in the six moments of inertia. Its square,
    in the metric of the covariance, is at most Hotelling's of so many dimensions (Ann. Math. Stat. 2, 1931), which is
    that of a point: of a body that is as thin as can be in every direction. A mass below zero is as many sigmas away as
    zero is, by Student's distribution.

    Args:
        link: its name.
        mean: its standard parameters, (10,).
        covariance: of these, (10, 10).
        freedom: degrees of freedom with which the covariance is known along a direction, (10,).
    """
    if not mean[0] > 0.0:
        squared = mean[0] ** 2 / covariance[0, 0] if covariance[0, 0] > 0.0 else np.inf
        return LinkEstimate(link, mean, covariance, None, _as_rare(squared, freedom(np.eye(10)[0]), 1))
    try:
        body = possible_body(mean, covariance)
    except ConvergenceError:
        return LinkEstimate(link, mean, covariance, None, np.inf)
    if np.linalg.eigvalsh(pseudo_inertia(mean))[0] > 0.0:
        return LinkEstimate(link, mean, covariance, body, 0.0)
    gap = standard_of(body) - mean
    along = np.linalg.pinv(covariance, hermitian=True) @ gap
    return LinkEstimate(link, mean, covariance, body, _as_rare(max(float(gap @ along), 0.0), freedom(along), _MOMENTS))


def _as_rare(squared: float, freedom: float, dimensions: int) -> float:
    """Sigmas of a normal as rare as Hotelling's statistic with a covariance of so many degrees of freedom."""
    rest = freedom - dimensions + 1.0
    if not rest > 0.0:
        return 0.0
    estimated = rest < np.inf
    scaled = squared * rest / (freedom * dimensions) if estimated else squared
    chance = fdtrc(dimensions, rest, scaled) if estimated else chdtrc(dimensions, scaled)
    return sigmas(max(float(chance), _RAREST))


def whole_estimate(link: str, whole: Whole, scale_sigma: float) -> LinkEstimate:
    """A free body with its rotors, locked, as one link; its mass is taken for exact.

    Args:
        link: the vehicle's base.
        whole: what was found.
        scale_sigma: relative, of the scale of all of its inertia.
    """
    mean = standard_of(whole.body)
    inertia = np.concatenate([np.zeros(4), elements(whole.body.inertia_kg_m2)])
    covariance = scale_sigma**2 * np.outer(inertia, inertia)
    covariance[1:, 1:] += whole.weights @ whole.jackknife.covariance @ whole.weights.T
    back = np.linalg.inv(body_jacobian(mean))
    of_rows = back[:, 1:] @ whole.weights  # (10, p)
    return link_estimate(
        link, mean, covariance := back @ covariance @ back.T, _freedom(whole.jackknife, of_rows, covariance)
    )


def without_rotors(vehicle: VehicleModel, whole: RigidBody) -> RigidBody:
    """The base link of a free body estimated as one: the whole minus the URDF's other links."""
    others = vehicle.chi.copy()
    base = 10 * vehicle.links.index(vehicle.base_body())
    others[base : base + 10] = 0.0
    return take_away(whole, body_of(composite_functional(vehicle) @ others))


class Posterior(NamedTuple):
    """Standard parameters of all columns after the rows, by the equation at the head of this module."""

    mean: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    links: tuple[str, ...]  # those in determined base parameters or quantities
    of_rows: FloatArray  # (P, p) derivative of the mean by the base parameters that the rows tell


def standard_posterior(identifier: Identifier, nuisance: Collection[str] = ()) -> Posterior:
    """Standard parameters conditioned on the determined base parameters and quantities.

    Args:
        identifier: after its rows.
        nuisance: nuisance base parameters, left out.
    """
    model, base, root = identifier.model, identifier.base, identifier.taken.prior_root
    jackknife, estimate = identifier.block_jackknife(), identifier.estimate()
    told = [
        *(estimate.supported & ~np.isin(base.names, list(nuisance))),
        *(q.supported for q in estimate.quantities[: len(identifier.quantities)]),
    ]
    weights = np.vstack([np.eye(len(base.names)), *(q.weights for q in identifier.quantities)])[told]  # (k, p)
    F = weights @ base.grouping  # (k, P)
    K = root @ np.asarray(np.linalg.pinv(F @ root, rcond=ROUNDING))  # (P, k)
    mean = model.chi + K @ (weights @ jackknife.mean - F @ model.chi)
    left = (root - K @ F @ root) @ root.T  # what the rows do not tell
    of_rows, unstated = K @ weights, identifier.unstated(jackknife).covariance()
    covariance = left + of_rows @ (jackknife.covariance + unstated) @ of_rows.T
    own = [slice(10 * index, 10 * index + 10) for index in range(len(model.vehicle.links))]
    links = (link for link, part in zip(model.vehicle.links, own, strict=True) if (F[:, part] @ root[part]).any())
    return Posterior(mean, covariance, tuple(links), of_rows)


def identified_links(identifier: Identifier, found: Posterior) -> tuple[LinkEstimate, ...]:
    """Each link that the rows tell of.

    Args:
        identifier: after its rows.
        found: by them.
    """
    vehicle, jackknife, made = identifier.model.vehicle, identifier.block_jackknife(), []
    for link in found.links:
        first = 10 * vehicle.links.index(link)
        own = slice(first, first + 10)
        covariance = found.covariance[own, own]
        freedom = _freedom(jackknife, found.of_rows[own], covariance)
        made.append(link_estimate(link, found.mean[own], covariance, freedom))
        held = link == vehicle.spec.payload_link and identifier.payload
        if held and (body := held.body(jackknife)) is not None:  # one body, one number
            made[-1] = made[-1]._replace(body=body)
    return tuple(made)


def _freedom(
    jackknife: JackknifeEstimate, of_rows: FloatArray, covariance: FloatArray
) -> Callable[[FloatArray], float]:
    """Degrees of freedom of a covariance, (10, 10), along any direction (Welch, Biometrika 34, 1947).

    The scatter of the rows has the jackknife's; what else is in the covariance is known.

    Args:
        jackknife: the estimate of the base parameters.
        of_rows: derivative of the standard parameters by these, (10, p).
        covariance: of the standard parameters.
    """

    def along(direction: FloatArray) -> float:
        told = direction @ of_rows
        of_scatter = float(jackknife.parts(told)[0][0]) ** 2
        share = of_scatter / float(direction @ covariance @ direction)
        return float(jackknife.combination(told).degrees_of_freedom[0]) / share**2 if share else np.inf

    return along
