"""Initial guesses of the payload, tried in order until one leads to a good fit."""

import contextlib
from collections.abc import Callable, Iterator

import numpy as np

from onboard.dynamics.errors import SignalError
from onboard.dynamics.inertia import RigidBody
from onboard.estimation.errors import ConvergenceError

ROUGH_WIDTH_s = 0.3  # of the kernel that smooths the base's motion for a least squares on rows


def _ball(mass_kg: float) -> RigidBody:
    """A homogeneous sphere of 500 kg/m^3 touching the payload frame's origin."""
    radius_m = (0.75 * mass_kg / (500.0 * np.pi)) ** (1.0 / 3.0)
    return RigidBody(mass_kg, np.array([0.0, 0.0, radius_m]), 0.4 * mass_kg * radius_m**2 * np.eye(3))


GUESSES = tuple(_ball(mass_kg) for mass_kg in (3.0, 0.5, 15.0))


def guesses(rough: Callable[[], RigidBody]) -> Iterator[RigidBody]:
    """A least squares on rows, and three spheres (chosen here).

    Args:
        rough: the least squares; skipped if its result is not a body.
    """
    with contextlib.suppress(SignalError, ConvergenceError):
        yield rough()
    yield from GUESSES
