"""Faults of a drawn body, as directions in the errors of its prior."""

import numpy as np

from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_of, standard_of
from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import LIKELY_SIZE

EACH = 10.0
"""Size, in stated sigmas, of each parameter of a body or element of an instrument's matrix, when all may be wrong."""

CHANGES = 5
"""Columns of :func:`changes`."""


def ways(chi: FloatArray, half: FloatArray) -> tuple[FloatArray, ...]:
    """Effect of one sigma of each fault on the errors of a body's prior: (10, 1), (10, 1), (10, 1), (10, 3), (10, 11).

    Mass and inertia by one factor; the mass alone; the inertia alone; the centre of mass; the factor together with
    each parameter by itself.

    Args:
        chi: standard parameters as drawn, (10,).
        half: L of their prior covariance ``L L'``, (10, 10).
    """
    changes = np.column_stack([chi, of_mass(chi), of_centre(chi)])
    along = np.asarray(LIKELY_SIZE * np.linalg.solve(half, changes), np.float64)
    both, mass, centre = along[:, :1], along[:, 1:2], along[:, 2:]
    return both, mass, both - mass, centre, np.hstack([both, EACH * np.eye(len(both))])


def of_mass(chi: FloatArray) -> FloatArray:
    """Change of a body's standard parameters, (10,), with its mass, for a mass twice as large and the same inertia."""
    mass, centre, inertia = body_of(chi)
    return standard_of(RigidBody(2.0 * mass, centre, inertia)) - chi


def of_centre(chi: FloatArray) -> FloatArray:
    """Change of a body's standard parameters with its centre of mass, (10, 3), for the rms distance of its mass."""
    mass, centre, inertia = body_of(chi)
    size, few = np.sqrt(max(0.5 * float(np.trace(inertia)) / mass, 0.0)), 1e-6
    moved = [standard_of(RigidBody(mass, centre + few * size * axis, inertia)) for axis in np.eye(3)]
    return (np.array(moved).T - chi[:, None]) / few


def changes(chi: FloatArray) -> FloatArray:
    """Effect of one sigma of each change of what is held, (10, 5): a part that comes off, or propellant that is used.

    Of the mass, the inertia about the centre of mass, and the coordinates of that; zeros of what has no mass.
    """
    if not chi[0] > 0.0:
        return np.zeros((len(chi), CHANGES))
    return LIKELY_SIZE * np.column_stack([mass := of_mass(chi), chi - mass, of_centre(chi)])
