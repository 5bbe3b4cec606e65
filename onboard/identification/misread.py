"""What columns may be taken for: how the angles of joints may be read otherwise, and how mistakes compete."""

from collections.abc import Iterator, Sequence
from itertools import combinations, permutations, product
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import MISFIT_REFUSED

AXES = tuple(
    np.array(signs)[:, None] * np.eye(3)[list(order)]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
)
"""Orders of three axes with signs; as stated first."""


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


def axes_text(by: FloatArray) -> str:
    """What axes are, if a signed permutation is to be applied to them."""
    order, sign = np.abs(by).argmax(axis=1).tolist(), by.sum(axis=1)
    turned = ["xyz"[k] for k in range(3) if sign[k] < 0.0]
    if order == [0, 1, 2]:
        return f"{' and '.join(turned)} count{'s' if len(turned) == 1 else ''} the other way"
    if (sign > 0.0).all() and sum(at == k for k, at in enumerate(order)) == 1:
        return " and ".join("xyz"[k] for k in range(3) if order[k] != k) + " are exchanged"
    axes = ", ".join(f'"{"+-"[int(sign[k] < 0.0)]}{"xyz"[order[k]]}"' for k in range(3))
    return f"x, y, z are what is read as {axes}"
