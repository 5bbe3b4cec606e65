"""A free body with balanced rotors as one rigid body, and its load after subtraction of the carrier.

Torque-free motion determines the centre of mass (force rows: the point of zero specific force) and the inertia about it
(moment rows), but neither the mass nor the scale of the inertia, as every left-hand side is zero. Masses are weighed;
the scale is the spinning rotors' inertia, calibrated by throws of a known body (:func:`calibrate_rotor`).

What the carrier itself weighs is subtracted (:func:`without_carrier`). Principal moments are not linear in the base
parameters; their intervals are linearised at the estimate.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import (
    RigidBody,
    composite_functional,
    elements,
    parallel_axis,
    principal_moments,
    symmetric,
    take_away,
)
from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import HALF
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
