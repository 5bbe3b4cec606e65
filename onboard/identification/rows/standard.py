"""Standard parameters of the links from an estimate of base parameters, as physically possible bodies.

Rows determine base parameters only. The standard parameters given here are the posterior of the nominal ones with their
Gaussian prior, conditioned on the estimated base parameters (derived here: ``x + K (beta - F x)``, ``K = P F' (F P
F')^-1``); no rows are needed.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.inertia import RigidBody, composite_functional, elements, pseudo_inertia, take_away
from onboard.dynamics.model.payload import body_jacobian, body_of, possible_body, standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.identification.rows.free_body import Whole
from onboard.identification.rows.identifier import Identifier

_SAME = 1e-9  # combinations that differ by less are one


class LinkEstimate(NamedTuple):
    """A link's ten standard parameters, about its frame's origin and in its axes, and the body they stand for."""

    link: str
    mean: FloatArray  # (10,)
    covariance: FloatArray  # (10, 10)
    body: (
        RigidBody | None
    )  # physically possible: the estimate, or the most likely one; None: mass below zero, or not found
    away: float  # distance of the estimate from it, sigmas; zero if the estimate is possible


def link_estimate(link: str, mean: FloatArray, covariance: FloatArray) -> LinkEstimate:
    """Standard parameters with their body, by :func:`onboard.dynamics.model.payload.possible_body`."""
    if not mean[0] > 0.0:
        return LinkEstimate(link, mean, covariance, None, np.inf)
    try:
        body = possible_body(mean, covariance)
    except ConvergenceError:
        return LinkEstimate(link, mean, covariance, None, np.inf)
    if np.linalg.eigvalsh(pseudo_inertia(mean))[0] > 0.0:
        return LinkEstimate(link, mean, covariance, body, 0.0)
    gap = standard_of(body) - mean
    squared = float(gap @ np.linalg.pinv(covariance, hermitian=True) @ gap)
    return LinkEstimate(link, mean, covariance, body, max(squared, 0.0) ** 0.5)


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
    return link_estimate(link, mean, back @ covariance @ back.T)


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
    K = root @ np.asarray(np.linalg.pinv(F @ root, rcond=_SAME))  # (P, k)
    mean = model.chi + K @ (weights @ jackknife.mean - F @ model.chi)
    left = (root - K @ F @ root) @ root.T  # what the rows do not tell
    covariance = left + K @ weights @ jackknife.covariance @ weights.T @ K.T
    own = [slice(10 * index, 10 * index + 10) for index in range(len(model.vehicle.links))]
    links = (link for link, part in zip(model.vehicle.links, own, strict=True) if (F[:, part] @ root[part]).any())
    return Posterior(mean, covariance, tuple(links))


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
        made.append(link_estimate(link, found.mean[own], found.covariance[own, own]))
        held = link == vehicle.spec.payload_link and identifier.payload
        if held and (body := held.body(jackknife)) is not None:  # one body, one number
            made[-1] = made[-1]._replace(body=body)
    return tuple(made)
