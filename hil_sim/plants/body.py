"""A rigid body's inertial parameters, and how one is drawn about its drawing."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil_sim.arrays import FloatArray


@dataclass(frozen=True)
class Solid:
    """Inertial parameters in the body's frame."""

    mass_kg: float
    centre_of_mass_m: FloatArray  # (3,)
    inertia_kg_m2: FloatArray  # (3, 3) about the centre of mass

    @staticmethod
    def box(mass_kg: float, size_m: Sequence[float], centre_of_mass_m: Sequence[float]) -> "Solid":
        """A solid box along the frame's axes."""
        squares = np.square(np.asarray(size_m, np.float64))
        inertia = np.diag(mass_kg / 12.0 * (squares.sum() - squares))
        return Solid(mass_kg, np.asarray(centre_of_mass_m, np.float64), inertia)

    def grown(self, mass_kg: float) -> "Solid":
        """The body scaled about its frame's origin to another mass at the same density."""
        factor = (mass_kg / self.mass_kg) ** (1.0 / 3.0)
        return Solid(mass_kg, self.centre_of_mass_m * factor, self.inertia_kg_m2 * factor**5)

    def without(self, mass_kg: float, at_m: Sequence[float]) -> "Solid":
        """What is left when a mass that lies in a point comes off; negative: it is added there."""
        left_kg, at = self.mass_kg - mass_kg, np.asarray(at_m, np.float64)
        centre = (self.mass_kg * self.centre_of_mass_m - mass_kg * at) / left_kg
        about = (
            self.inertia_kg_m2 + self.mass_kg * _spread(self.centre_of_mass_m - centre) - mass_kg * _spread(at - centre)
        )
        return Solid(left_kg, centre, about)

    def turned(self, R: FloatArray) -> "Solid":
        """The body with its inertia turned about its centre of mass by ``R`` (3, 3)."""
        return Solid(self.mass_kg, self.centre_of_mass_m, R @ self.inertia_kg_m2 @ R.T)

    def as_truth(self) -> dict[str, Any]:
        """For the truth of a flight."""
        return {"mass_kg": self.mass_kg, "centre_of_mass_m": self.centre_of_mass_m, "inertia_kg_m2": self.inertia_kg_m2}

    @property
    def principal_kg_m2(self) -> FloatArray:
        """Principal moments of inertia, rising, (3,)."""
        return np.asarray(np.linalg.eigvalsh(self.inertia_kg_m2))

    @property
    def is_possible(self) -> bool:
        """Whether a body of these parameters can exist: no principal moment exceeds the sum of the others."""
        least, middle, most = self.principal_kg_m2
        return bool(self.mass_kg >= 0.0 and least >= 0.0 and most <= least + middle + 1e-12)


def _spread(r_m: FloatArray) -> FloatArray:
    """Inertia of 1 kg in a point, (3, 3), about one so far from it."""
    return np.asarray((r_m @ r_m) * np.eye(3) - np.outer(r_m, r_m), np.float64)


def built(
    drawn: Solid, mass_relative: float, centre_m: float, inertia_relative: float, rng: np.random.Generator
) -> Solid:
    """A part with its as-built errors.

    Args:
        drawn: the drawing.
        mass_relative: standard deviation of the mass.
        centre_m: of each coordinate of the centre of mass.
        inertia_relative: of each element of the inertia, relative to half its trace.
        rng: draws mass, centre and inertia, in this order.
    """
    change = np.zeros((3, 3))
    half_trace = 0.5 * np.trace(drawn.inertia_kg_m2)
    mass_kg = drawn.mass_kg * (1.0 + mass_relative * rng.standard_normal())
    centre = drawn.centre_of_mass_m + centre_m * rng.standard_normal(3)
    change[np.triu_indices(3)] = inertia_relative * half_trace * rng.standard_normal(6)
    return Solid(mass_kg, centre, drawn.inertia_kg_m2 + change + np.triu(change, 1).T)
