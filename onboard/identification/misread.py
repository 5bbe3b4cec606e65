"""What columns may be taken for: how the angles of joints may be read otherwise, and how mistakes compete."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import MISFIT_REFUSED


def score(left: float, mistakes: int) -> float:
    """The smaller, the likelier: a further mistake leaves half of the squares, at the most."""
    return left * MISFIT_REFUSED**mistakes


class JointReading(NamedTuple):
    """A way to read angles."""

    order: tuple[int, ...]  # of each joint, whose angles are its own
    factor: FloatArray  # (joints,) of these
    shift_rad: FloatArray  # (joints,) added

    @staticmethod
    def stated(joints: int) -> "JointReading":
        """As the file says."""
        return JointReading(tuple(range(joints)), np.ones(joints), np.zeros(joints))

    def joints(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angles, rates and accelerations as they are then, (n, joints) each."""
        at = list(self.order)
        return self.factor * q[:, at] + self.shift_rad, self.factor * dq[:, at], self.factor * ddq[:, at]

    def in_other_units(self) -> Iterator[tuple[str, "JointReading"]]:
        """Units of all angles, with what is said of them."""
        for factor, unit in ((np.pi / 180.0, "deg"), (180.0 / np.pi, "rad, and not in deg")):
            yield f"all angles are in {unit}", self._replace(factor=factor * self.factor)

    def from_other_zeros(self, names: Sequence[str]) -> Iterator[tuple[str, "JointReading"]]:
        """The zero of one joint elsewhere, to its nearest of 23 places: such a way counts as two mistakes."""
        for own, name in zip(np.eye(len(names)), names, strict=True):
            for turn_deg in range(-165, 181, 15):
                if turn_deg:
                    shift = self.shift_rad + np.deg2rad(turn_deg) * own
                    yield f"{name} is about {turn_deg:+d} deg from what is read", self._replace(shift_rad=shift)


def exchanged(order: Sequence[int], names: Sequence[str]) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Orders in which two are exchanged, with the names of both."""
    for i, j in combinations(range(len(order)), 2):
        other = [*order]
        other[i], other[j] = order[j], order[i]
        yield f"{names[i]} and {names[j]}", tuple(other)


def turned(count: int) -> FloatArray:
    """Factors of which one is negative, (count, count)."""
    return 1.0 - 2.0 * np.eye(count)
