"""Inertial parameters of composite bodies: change of frame, sum, and subtraction of a known carrier.

Inertial parameters of rigidly joined bodies add when written about one origin in one set of axes.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray

_ROWS, _COLUMNS = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)  # XX XY YY XZ YZ ZZ
_ONE = np.eye(3)


class RigidBody(NamedTuple):
    """Mass, centre of mass and inertia about it, in one frame's axes."""

    mass_kg: float
    centre_of_mass_m: FloatArray  # (3,)
    inertia_kg_m2: FloatArray  # (3, 3) about the centre of mass


def sphere_radius_m(mass_kg: float) -> float:
    """Of a sphere of 500 kg/m^3, half water's density: the guess of a body of unknown size; zero without a mass."""
    return float((0.75 * max(mass_kg, 0.0) / (np.pi * 500.0)) ** (1.0 / 3.0))


def symmetric(elements: FloatArray) -> FloatArray:
    """Elements ``XX XY YY XZ YZ ZZ``, (6,), as a tensor, (3, 3); the order of :mod:`onboard.dynamics.model.vehicle`."""
    xx, xy, yy, xz, yz, zz = elements
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], np.float64)


def elements(tensor: FloatArray) -> FloatArray:
    """Symmetric tensors, (..., 3, 3), as ``XX XY YY XZ YZ ZZ``, (..., 6): the inverse of :func:`symmetric`."""
    return np.asarray(tensor[..., _ROWS, _COLUMNS], np.float64)


def parallel_axis(mass_kg: float, offset_m: FloatArray) -> FloatArray:
    """Parallel-axis theorem: inertia of a point mass at ``offset_m``, (3,), (3, 3): ``m (r.r 1 - r r')``."""
    return np.asarray(mass_kg * (offset_m @ offset_m * _ONE - offset_m[:, None] * offset_m), np.float64)


def take_away(total: RigidBody, carrier: RigidBody) -> RigidBody:
    """Body minus a rigidly joined part, same frame: by the parallel-axis theorem about one origin.

    Args:
        total: the whole body.
        carrier: the known part.

    Raises:
        SignalError: the carrier is not lighter than the whole.
    """
    mass = total.mass_kg - carrier.mass_kg
    if not mass > 0.0:
        raise SignalError(f"the carrier weighs {carrier.mass_kg} kg, the whole {total.mass_kg} kg; check the masses")
    c = (total.mass_kg * total.centre_of_mass_m - carrier.mass_kg * carrier.centre_of_mass_m) / mass
    about_total = carrier.inertia_kg_m2 + parallel_axis(
        carrier.mass_kg, carrier.centre_of_mass_m - total.centre_of_mass_m
    )
    inertia = total.inertia_kg_m2 - about_total - parallel_axis(mass, c - total.centre_of_mass_m)
    return RigidBody(mass, c, inertia)


def principal_moments(body: RigidBody) -> FloatArray:
    """Principal moments of inertia (eigenvalues of the tensor), (3,), ascending, kg m^2."""
    return np.asarray(np.linalg.eigvalsh(body.inertia_kg_m2), np.float64)


def composite_functional(vehicle: VehicleModel) -> FloatArray:
    """The whole vehicle's ten parameters about the base frame, joints at zero, as functionals of the links', (10, P).

    Each link's pseudo-inertia ``[[Sigma, h], [h', m]]`` (4, 4) transforms with its pose T as ``T P T'``, linear in the
    parameters (Wensing, Kim and Slotine 2018).
    """
    model = vehicle.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    functional = np.zeros((10, vehicle.chi.size))
    for link, name in enumerate(vehicle.links):
        pose = data.oMf[vehicle.frame_id(name)].homogeneous
        functional[:, 10 * link : 10 * link + 10] = moved_to(pose)
    return functional


def pseudo_inertia(chi: FloatArray) -> FloatArray:
    """Pseudo-inertia ``[[Sigma, h], [h', m]]``, (4, 4), of ten standard parameters.

    Positive definite for physical bodies (Wensing, Kim and Slotine 2018).
    """
    inertia = symmetric(chi[4:])
    P = np.empty((4, 4))
    P[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    P[:3, 3] = P[3, :3] = chi[1:4]
    P[3, 3] = chi[0]
    return P


def parameters_of(P: FloatArray) -> FloatArray:
    """The ten standard parameters, (..., 10), of pseudo-inertias, (..., 4, 4): inverse of :func:`pseudo_inertia`."""
    Sigma = P[..., :3, :3]
    inertia = np.trace(Sigma, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - Sigma
    return np.concatenate([P[..., 3:, 3], P[..., :3, 3], elements(inertia)], axis=-1)


_UNITS = np.stack([pseudo_inertia(unit) for unit in np.eye(10)])


def moved_to(pose: FloatArray) -> FloatArray:
    """Map of a body's ten parameters from one frame to another, (10, 10), by its pose there, (4, 4): ``T P T'``."""
    return parameters_of(pose @ _UNITS @ pose.T).T
