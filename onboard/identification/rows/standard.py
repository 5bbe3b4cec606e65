"""Bodies from an estimate of base parameters: each link as physically possible, and a free body with its load.

Rows determine base parameters only. The standard parameters given here are the posterior of the nominal ones with their
Gaussian prior, conditioned on the estimated base parameters (derived here: ``x + K (beta - F x)``, ``K = P F' (F P
F')^-1``); no rows are needed.

A free body with balanced rotors is one rigid body. Torque-free motion determines the centre of mass (force rows: the
point of zero specific force) and the inertia about it (moment rows), but neither the mass nor the scale of the inertia,
as every left-hand side is zero. Masses are weighed; the scale is the spinning rotors' inertia, calibrated by throws of
a known body (:func:`calibrate_rotor`).

What the carrier itself weighs is subtracted (:func:`without_carrier`). Principal moments are not linear in the base
parameters; their intervals are linearised at the estimate.

Estimates of the links are a drawing with sigmas, in the form of ``[estimation.prior.link]``. A vehicle file states for
each link how well mass, centre of mass and inertia are known, each independent of all others. Rows determine sums over
links (:mod:`onboard.regressor.base_parameters`): errors of the links are correlated, those of one link among each other
too. So the stated sigmas D are those of the estimates, made wider until no combination of parameters is stated to be
known better than it was found:

    D >= J P J',  with D diagonal,

P being the covariance of the standard parameters, J its transformation to mass, centre of mass and inertia
(:func:`onboard.dynamics.model.payload.body_jacobian`). Of each link D has one sigma for the mass, one for the three
coordinates of the centre, one for the six elements of the inertia. While the largest eigenvalue of
``D^-1/2 J P J' D^-1/2`` is above one, each sigma becomes wider by that to the power of half its share in the
eigenvector (derived here; no least D is sought). By how far the nearest possible body is from an estimate that is none,
P is wider.
"""

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import (
    RigidBody,
    composite_functional,
    elements,
    parallel_axis,
    principal_moments,
    pseudo_inertia,
    symmetric,
    take_away,
)
from onboard.dynamics.model.payload import body_jacobian, body_of, possible_body, standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import ROUNDING, FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.policy import HALF, sigmas
from onboard.estimation.recursive.consistency import JackknifeEstimate
from onboard.identification.quantities import Quantity
from onboard.identification.rows.identifier import Identifier
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import RowModel

CENTRE_OF_MASS = ("com_x", "com_y", "com_z")
INERTIA = ("I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
FREE_BODY = (*CENTRE_OF_MASS, *INERTIA)
_KNOWN_MASS = 1e-4  # relative sigma of the whole's mass in the prior, at most


class Whole(NamedTuple):
    """A whole vehicle as a rigid body, its rotors locked."""

    body: RigidBody
    weights: FloatArray  # (9, p) its centre of mass and the six elements of its inertia, on the base parameters
    jackknife: JackknifeEstimate

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation of the centre of mass and the inertia's elements, (9,), the rotors taken for exact."""
        return self.jackknife.combination(self.weights).sigma


class KnownBody(NamedTuple):
    """A rigid body measured before; errors of its numbers are taken as independent."""

    body: RigidBody
    sigma: FloatArray  # (9,) of the centre of mass and of the inertia's elements


class PrincipalMoments(NamedTuple):
    """Principal moments of inertia, ascending, with two-sided intervals, kg m^2."""

    moments: FloatArray  # (3,)
    sigma: FloatArray  # (3,)
    low: FloatArray  # (3,)
    high: FloatArray  # (3,)

    @property
    def away(self) -> float:
        """Sigmas from moments that a body can have: none below zero, none above the sum of the other two."""
        excess = float(self.moments[2] - self.moments[0] - self.moments[1])
        negative = float(-self.moments[0] / self.sigma[0])
        return max(0.0, excess / float(np.hypot.reduce(self.sigma)), negative)


class RotorCalibration(NamedTuple):
    """Calibration of the rotors' inertia by throws of a known body."""

    factor: float  # on the inertia that was assumed
    sigma: float  # of the factor, relative, from the misfit
    misfit: float  # norm of what is left over the norm of what was expected


def free_body_quantities(model: RowModel, base: BaseParameters, prior_root: FloatArray) -> tuple[Quantity, ...]:
    """Centre of mass, m in base axes, and inertia about it, kg m^2, of the whole vehicle, joints locked at zero.

    Functionals of the base parameters by :func:`onboard.dynamics.model.inertia.composite_functional`.

    Args:
        model: force and moment rows of a free base.
        base: their base parameters.
        prior_root: of the standard parameters' covariance, (P, P). In free fall the force rows tell the first moments
            in units of the mass only, so the prior has to hold the mass (to the URDF's, whatever the truth is: it
            cancels).

    Raises:
        SignalError: a vehicle whose joints move its centre of mass, a mass that nothing holds, or rows that can never
            tell these quantities.
    """
    vehicle = model.vehicle
    if not vehicle.centre_of_mass_is_fixed():
        raise SignalError("a joint moves this vehicle's centre of mass; a free body may have balanced rotors only")
    functional = composite_functional(vehicle)
    functional = np.pad(functional, ((0, 0), (0, len(model.names) - functional.shape[1])))  # (10, P)
    mass = float(functional[0] @ model.chi)
    if not np.linalg.norm(functional[0] @ prior_root) <= _KNOWN_MASS * mass:
        raise SignalError(
            f"free fall does not show the mass, and the prior leaves it open; give M_{vehicle.spec.base_link} an "
            f"absolute sigma, and every rotor a relative sigma, {0.1 * _KNOWN_MASS:g} of the mass or less"
        )
    rows = np.vstack([functional[1:4] / mass, functional[4:]])
    units = ("m",) * 3 + ("kg m^2",) * 6
    note = "the rotors' inertia is taken for exact"
    return tuple(
        Quantity(name, unit, base.weights(row), note) for name, unit, row in zip(FREE_BODY, units, rows, strict=True)
    )


def whole_body(identifier: Identifier, mass_kg: float, exact: bool = False) -> Whole:
    """The vehicle as a rigid body, by the identifier's current estimate.

    Args:
        identifier: with the quantities of :func:`free_body_quantities`.
        mass_kg: weighed, of the whole.
        exact: the instruments are taken as they are: a calibration, since which their errors are stated.

    Raises:
        SignalError: an identifier without those quantities, or without rows.
    """
    weights = {quantity.name: quantity.weights for quantity in identifier.quantities}
    if not set(FREE_BODY) <= set(weights):
        raise SignalError("this identifier has no free-body quantities; give its vehicle a [free_body] section")
    if not identifier.rows_used:
        raise SignalError("no row could be used; see what the gates say")
    stacked = np.array([weights[name] for name in FREE_BODY])
    jackknife = identifier.block_jackknife(exact=exact)
    found = stacked @ jackknife.mean
    return Whole(RigidBody(mass_kg, found[:3], symmetric(found[3:])), stacked, jackknife)


def without_carrier(
    whole: Whole, carrier: KnownBody | None, rotor_sigma: float = 0.0
) -> tuple[RigidBody, PrincipalMoments]:
    """A vehicle minus its carrier (:func:`onboard.dynamics.model.inertia.take_away`) and its principal moments.

    Args:
        whole: carrier and load.
        carrier: the carrier alone; nothing is subtracted where not given.
        rotor_sigma: relative, of the rotors' calibration, by which whole and carrier scale alike.

    Raises:
        SignalError: a carrier that is not lighter than the whole.
    """

    def moments(x: FloatArray, y: FloatArray, scale: float) -> FloatArray:
        return principal_moments(_load(_scaled(whole.body, x, scale), carrier, y, scale))

    x = _vector(whole.body)
    y = np.zeros(9) if carrier is None else _vector(carrier.body)
    J_x = _jacobian(lambda v: moments(v, y, 1.0), x, whole.sigma)  # (3, 9)
    J_s = _jacobian(lambda v: moments(x, y, float(v[0])), np.ones(1), np.full(1, 1e-3))  # (3, 1)
    other = (J_s[:, 0] * rotor_sigma) ** 2  # (3,)
    if carrier is not None:
        J_y = _jacobian(lambda v: moments(x, v, 1.0), y, carrier.sigma)  # (3, 9)
        other += (J_y**2) @ carrier.sigma**2
    rows = whole.jackknife.combination(J_x @ whole.weights)
    load = _load(whole.body, carrier, y, 1.0)
    found = principal_moments(load)
    half = np.sqrt((rows.high - rows.mean) ** 2 + HALF**2 * other)
    return load, PrincipalMoments(found, np.sqrt(rows.sigma**2 + other), found - half, found + half)


def calibrate_rotor(device: RigidBody, proof: RigidBody, known: RigidBody) -> RotorCalibration:
    """Factor on the rotor's assumed inertia from throws with a known body.

    All inertias estimated from free rotation scale with the rotor's. The factor is the least-squares projection over
    the six elements of ``I(proof) - I(device)`` on what the known body adds to it; the five redundant elements give its
    sigma (derived here).

    Args:
        device: the device alone, with the assumed rotor.
        proof: the device with the known body.
        known: mass and inertia about its own centre of mass, in the device's axes; where it sits comes from the throws.
    """
    shift = proof.centre_of_mass_m - device.centre_of_mass_m
    ratio = device.mass_kg / known.mass_kg
    expected = elements(
        known.inertia_kg_m2 + parallel_axis(device.mass_kg, shift) + parallel_axis(known.mass_kg, ratio * shift)
    )
    found = elements(proof.inertia_kg_m2 - device.inertia_kg_m2)
    factor = float(found @ expected / (found @ found))
    misfit = float(np.linalg.norm(factor * found - expected) / np.linalg.norm(expected))
    return RotorCalibration(factor, misfit / float(np.sqrt(expected.size - 1)), misfit)


def _load(whole: RigidBody, carrier: KnownBody | None, y: FloatArray, scale: float) -> RigidBody:
    return whole if carrier is None else take_away(whole, _scaled(carrier.body, y, scale))


def _vector(body: RigidBody) -> FloatArray:
    return np.concatenate([body.centre_of_mass_m, elements(body.inertia_kg_m2)])


def _scaled(body: RigidBody, x: FloatArray, scale: float) -> RigidBody:
    """A body of the same mass with centre of mass and inertia from ``x`` (9,), the inertia times ``scale``."""
    return RigidBody(body.mass_kg, x[:3], scale * symmetric(x[3:]))


def _jacobian(function: Callable[[FloatArray], FloatArray], at: FloatArray, steps: FloatArray) -> FloatArray:
    """Central differences of a function of (k,) that gives (3,), one step a side; (3, k), zero where a step is zero."""
    J = np.zeros((3, at.size))
    for column, step in enumerate(steps):
        if step > 0.0:
            shift = np.zeros(at.size)
            shift[column] = step
            J[:, column] = (function(at + shift) - function(at - shift)) / (2.0 * step)
    return J


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
        values, vectors = np.linalg.eigh(P / np.outer(sigma[which], sigma[which]))
        if values[-1] <= 1.0 + _ENOUGH:
            break
        sigma *= values[-1] ** (0.5 * np.bincount(which, vectors[:, -1] ** 2))
    return np.asarray((sigma * max(1.0, values[-1]) ** 0.5).reshape(links, 3), np.float64)


def _sizes(body: RigidBody) -> FloatArray:
    """Of mass, centre, inertia: what their stated sigmas are relative to, (10,)."""
    half_trace = 0.5 * float(np.trace(body.inertia_kg_m2))
    return np.array([body.mass_kg, *[1.0] * 3, *[half_trace] * 6])
