"""Links of a floating vehicle as bodies that move with it: spatial inertias, momenta, wrenches, and sums of these.

With V the twist of a link, I its spatial inertia and L = I V its momentum, all about the base's origin in base axes
(Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 2), ``dI/dt = crf(V) I - I crm(V)``, and the wrench that
its motion asks for is ``F = I A + crf(V) L``, A the rate of change of V. Computed in ``onboard/native/src/bodies.c``.
"""

import ctypes
from typing import NamedTuple

import numpy as np

from onboard.dynamics.kinematics import Frames
from onboard.dynamics.spatial import force_transforms
from onboard.estimation.arrays import FloatArray
from onboard.native import library, structures

PARTS = 31  # of a link or a sum: ten numbers of its inertia, nine of their change, momentum, wrench


class Sums(NamedTuple):
    """Sums over groups of bodies."""

    inertia: FloatArray  # (n, groups, 6, 6)
    change: FloatArray  # (n, groups, 6, 6) its rate of change
    momentum: FloatArray  # (n, groups, 6)
    wrench: FloatArray  # (n, groups, 6)


def moving_frames(frames: Frames, chi: FloatArray) -> structures.MovingFrames:
    """Links for the compiled core.

    Args:
        frames: their motion relative to the base.
        chi: standard parameters of all links, (10 x links,).

    Raises:
        ArrayError: shapes that do not fit.
    """
    n, links = frames.p.shape[:2]
    parts = zip(frames, ((3, 3), (3,), (6,), (6,)), strict=True)
    arrays = (library.given(part, n, links, *shape) for part, shape in parts)
    return structures.MovingFrames(n, links, *arrays, library.given(chi, 10 * links))


def motion_size(n: int, links: int) -> int:
    """Length of the array that :class:`Bodies` are made of."""
    return n * (links * (PARTS + 12) + 117)


class Bodies:
    """The links of a vehicle as they move.

    Args:
        frames: their motion relative to the base.
        motion: of them and the base, as the compiled core makes it.

    Attributes:
        frames: as given.
        parts: inertia, its change, momentum and wrench of each link, (n, links, PARTS).
        composite: spatial inertia of all, (n, 6, 6).
        relative_momentum: momentum of all with the base at rest, (n, 6).
        twist: of the base, (n, 6).
        rate: rate of change of that, (n, 6).
        V: twists of the links, (n, links, 6).
        A: rates of change of these.
        inverse: of the composite inertia, (n, 6, 6), where the motion was predicted; NaN of a body without mass.
        momentum: of all, angular, about the centre of mass, (n, 3), where the motion was predicted.
        slope: derivative of the wrench on all links by the base's rate, (n, 6, 3); specific force and angular
            acceleration of the base are held.
        thrust: specific force and angular acceleration of the base, (n, 6).
    """

    def __init__(self, frames: Frames, motion: FloatArray) -> None:
        self.frames = frames
        n, k = frames.p.shape[:2]
        shapes = (n, k, PARTS), (n, 6, 6), (n, 6), (n, 6), (n, 6), (n, k, 6), (n, k, 6)
        parts = library.carved(motion, [*shapes, (n, 6, 6), (n, 3), (n, 6, 3), (n, 6)])
        self.parts, self.composite, self.relative_momentum, self.twist, self.rate, self.V, self.A = parts[:7]
        self.inverse, self.momentum, self.slope, self.thrust = parts[7:]

    @staticmethod
    def of(
        frames: Frames, chi: FloatArray, twist: FloatArray | None = None, thrust: FloatArray | None = None
    ) -> "Bodies":
        """The links where the base has a twist, specific force and angular acceleration; None: it is at rest.

        Args:
            frames: their motion relative to the base.
            chi: standard parameters of all links, (10 x links,).
            twist: of the base, (n, 6).
            thrust: specific force and angular acceleration of the base, (n, 6).

        Raises:
            ArrayError: shapes that do not fit.
        """
        n, links = frames.p.shape[:2]
        moving = moving_frames(frames, chi)
        given = [library.given(np.zeros((n, 6)) if part is None else part, n, 6) for part in (twist, thrust)]
        pointers = [None if twist is None else library.address(part) for part in given]
        out = np.empty(motion_size(n, links))
        return Bodies(frames, library.call("heft_bodies", ctypes.byref(moving), *pointers, out=out))

    @property
    def X(self) -> FloatArray:  # noqa: N802
        """:func:`onboard.dynamics.spatial.force_transforms` of the links, (n, links, 6, 6)."""
        return force_transforms(self.frames.R, self.frames.p)

    def sums(self, groups: FloatArray) -> Sums:
        """Sums over groups: one where a link is in one, (groups, links).

        Raises:
            ArrayError: groups of another number of links.
        """
        (n, links), k = self.frames.p.shape[:2], len(groups)
        weights, out = library.given(groups, k, links), np.empty(84 * n * k)
        library.call("heft_sums", n, links, k, library.address(self.parts), library.address(weights), out=out)
        return Sums(*library.carved(out, [(n, k, 6, 6), (n, k, 6, 6), (n, k, 6), (n, k, 6)]))
