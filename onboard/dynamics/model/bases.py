"""Kinds of base: what each lets the base do, and which wrench acts on it.

A new kind is an entry of :data:`BASES`; another package adds its own by an entry point of the group ``heft.bases``.
"""

from dataclasses import dataclass
from typing import ClassVar

_ALL = (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True)
class BaseKind:
    """A kind of base.

    Attributes:
        name: in vehicle.toml.
        about: in words, for a new vehicle file.
        moves: components of its motion that are not fixed, in its axes: along x, y, z, then about them.
        floats: no wrench acts on these components, but for drag and disturbances.
        follows: its motion follows from the arm's by masses and inertias, so it has to have some.
        in_gravity: it carries the arm in gravity, which is constant in its axes.
    """

    name: str
    about: str
    moves: tuple[int, ...] = ()
    floats: bool = False
    follows: bool = False
    in_gravity: bool = False

    FREE: ClassVar["BaseKind"]
    PLANAR: ClassVar["BaseKind"]
    PRESCRIBED: ClassVar["BaseKind"]
    PIVOT: ClassVar["BaseKind"]
    FIXED: ClassVar["BaseKind"]

    @property
    def falls(self) -> bool:
        """It floats in all six components and feels no gravity: momentum is conserved."""
        return self.floats and self.moves == _ALL and not self.in_gravity

    def __str__(self) -> str:
        """Its name."""
        return self.name


BaseKind.FREE = BaseKind("free", "floats freely: its motion is predicted from the arm's", _ALL, True, True)
BaseKind.PRESCRIBED = BaseKind("prescribed", "moves as something larger does: its motion is measured", _ALL)
BaseKind.FIXED = BaseKind("fixed", "stands still, in gravity", in_gravity=True)
BaseKind.PLANAR = BaseKind(
    "planar", "floats on an air-bearing table: x, y and yaw are free", (0, 1, 5), True, True, True
)
BaseKind.PIVOT = BaseKind(
    "pivot", "turns about its origin on a spherical air bearing, in gravity", (3, 4, 5), False, True
)
_PACKAGED = BaseKind.FREE, BaseKind.PRESCRIBED, BaseKind.FIXED, BaseKind.PLANAR, BaseKind.PIVOT
BASES: dict[str, BaseKind] = {kind.name: kind for kind in _PACKAGED}
