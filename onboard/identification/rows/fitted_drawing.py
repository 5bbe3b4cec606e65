"""Estimates of the links as a drawing with sigmas, in the form of ``[estimation.prior.link]``.

A vehicle file states for each link how well mass, centre of mass and inertia are known, each independent of all others.
Rows determine sums over links (:mod:`onboard.regressor.base_parameters`): errors of the links are correlated, those of
one link among each other too. So the stated sigmas D are those of the estimates, made wider until no combination of
parameters is stated to be known better than it was found:

    D >= J P J',  with D diagonal,

P being the covariance of the standard parameters, J its transformation to mass, centre of mass and inertia
(:func:`onboard.dynamics.model.payload.body_jacobian`). Of each link D has one sigma for the mass, one for the three
coordinates of the centre, one for the six elements of the inertia. While the largest eigenvalue of
``D^-1/2 J P J' D^-1/2`` is above one, each sigma becomes wider by that to the power of half its share in the
eigenvector (derived here; no least D is sought). By how far the nearest possible body is from an estimate that is none,
P is wider.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_jacobian, standard_of
from onboard.estimation.arrays import FloatArray, eigen
from onboard.identification.rows.standard import LinkEstimate, Posterior

LEAST, MOST = 1e-9, 100.0  # that a vehicle file can state
_KINDS = np.array([0, *[1] * 3, *[2] * 6])  # of mass, centre, inertia
_ENOUGH, _MOST_STEPS = 1e-3, 1000  # largest eigenvalue, beyond one; the rest is taken up by all


class FittedLink(NamedTuple):
    """A link as it was found, and 1 sigma of it as ``[estimation.prior.link.NAME]`` states them."""

    link: str
    body: RigidBody
    mass_relative: float
    centre_m: float
    inertia_relative: float  # of half the tensor's trace

    @property
    def stated(self) -> dict[str, float]:
        """By the keys of the vehicle file."""
        return {key: getattr(self, key) for key in ("mass_relative", "centre_m", "inertia_relative")}


def fitted_drawing(
    vehicle_links: Sequence[str], found: Posterior, links: Sequence[LinkEstimate]
) -> tuple[FittedLink, ...]:
    """The links with a body, each with its sigmas.

    Args:
        vehicle_links: in the order of the standard parameters.
        found: by the rows.
        links: which to state, of those that the rows tell of.
    """
    known = [(one.link, one.body) for one in links if one.body is not None]
    if not known:
        return ()
    at = [slice(10 * (k := vehicle_links.index(link)), 10 * k + 10) for link, _ in known]
    gap = np.concatenate([standard_of(body) - found.mean[own] for (_, body), own in zip(known, at, strict=True)])
    every = np.concatenate([np.arange(own.start, own.stop) for own in at])
    P = found.covariance[np.ix_(every, every)] + np.outer(gap, gap)
    sizes = []
    for k, (_, body) in enumerate(known):
        own = slice(10 * k, 10 * k + 10)
        J = body_jacobian(standard_of(body))
        P[own] = J @ P[own]
        P[:, own] = P[:, own] @ J.T
        sizes.append(_sizes(body))
    size = np.concatenate(sizes)
    each = _covering(P / np.outer(size, size), len(known))
    return tuple(
        FittedLink(link, body, *np.clip(row, LEAST, MOST).tolist())
        for (link, body), row in zip(known, each, strict=True)
    )


def _covering(P: FloatArray, links: int) -> FloatArray:
    """Sigmas by link and kind, (links, 3), whose diagonal covariance is no smaller than ``P``, (10 links, 10 links)."""
    which = np.concatenate([3 * k + _KINDS for k in range(links)])
    sigma = np.zeros(3 * links)
    np.maximum.at(sigma, which, np.sqrt(np.maximum(np.diag(P), 0.0)))
    sigma = np.maximum(sigma, LEAST)
    for _ in range(_MOST_STEPS):
        values, vectors = eigen(P / np.outer(sigma[which], sigma[which]))
        if values[-1] <= 1.0 + _ENOUGH:
            break
        sigma *= values[-1] ** (0.5 * np.bincount(which, vectors[:, -1] ** 2))
    return np.asarray((sigma * max(1.0, values[-1]) ** 0.5).reshape(links, 3), np.float64)


def _sizes(body: RigidBody) -> FloatArray:
    """Of mass, centre, inertia: what their stated sigmas are relative to, (10,)."""
    half_trace = 0.5 * float(np.trace(body.inertia_kg_m2))
    return np.array([body.mass_kg, *[1.0] * 3, *[half_trace] * 6])
