"""Kinds of base: what each lets the base do, and which wrench acts on it. A new kind is a member here."""

from enum import StrEnum

_ALL = (0, 1, 2, 3, 4, 5)


class BaseKind(StrEnum):
    """A kind of base.

    Attributes:
        about: in words, for a new vehicle file.
        moves: components of its motion that are not fixed, in its axes: along x, y, z, then about them.
        floats: no wrench acts on these components, but for drag and disturbances.
        follows: its motion follows from the arm's by masses and inertias, so it has to have some.
        in_gravity: it carries the arm in gravity, which is constant in its axes.
    """

    about: str
    moves: tuple[int, ...]
    floats: bool
    follows: bool
    in_gravity: bool

    def __new__(
        cls,
        name: str,
        about: str = "",
        moves: tuple[int, ...] = (),
        floats: bool = False,
        follows: bool = False,
        in_gravity: bool = False,
    ) -> "BaseKind":
        """A member, whose value is its name in vehicle.toml."""
        kind = str.__new__(cls, name)
        kind._value_, kind.about, kind.moves = name, about, moves
        kind.floats, kind.follows, kind.in_gravity = floats, follows, in_gravity
        return kind

    FREE = "free", "floats freely: its motion is predicted from the arm's", _ALL, True, True, False
    PLANAR = "planar", "floats on an air-bearing table: x, y and yaw are free", (0, 1, 5), True, True, True
    PRESCRIBED = "prescribed", "moves as something larger does: its motion is measured", _ALL, False, False, False
    PIVOT = "pivot", "turns about its origin on a spherical air bearing, in gravity", (3, 4, 5), False, True, False
    FIXED = "fixed", "stands still, in gravity", (), False, False, True
