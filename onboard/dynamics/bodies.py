"""Links of a floating vehicle as bodies that move with it: spatial inertias, momenta, wrenches, and sums of these.

With V the twist of a link, I its spatial inertia and L = I V its momentum, all about the base's origin in base axes
(Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 2), ``dI/dt = crf(V) I - I crm(V)``, and the wrench that
its motion asks for is ``F = I A + crf(V) L``, A the rate of change of V.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.kinematics import Frames, cross, spatial_inertias
from onboard.dynamics.spatial import coad, crm, force_transforms, hat, times
from onboard.estimation.arrays import FloatArray

_PARTS = 84  # of a body: I, dI, L, F
_I, _DI, _L, _F = slice(0, 36), slice(36, 72), slice(72, 78), slice(78, 84)


class Sums(NamedTuple):
    """Sums over groups of bodies."""

    inertia: FloatArray  # (n, groups, 6, 6)
    change: FloatArray  # (n, groups, 6, 6) its rate of change
    momentum: FloatArray  # (n, groups, 6)
    wrench: FloatArray  # (n, groups, 6)

    def slope(self, twist: FloatArray) -> FloatArray:
        """Derivative of the wrenches by the base's rate, (n, groups, 6, 3).

        ``dF/dw = [dI/dt + K(L)] + 2 I_l hat(v) + I_a hat(w)`` (derived here), the angular columns of what is in
        brackets, I_l and I_a the linear and angular columns of I, v and w of the base, K of
        :func:`onboard.dynamics.spatial.coad`; specific force and angular acceleration of the base are held.

        Args:
            twist: of the base, (n, 6).
        """
        V = np.concatenate([2.0 * hat(twist[:, :3]), hat(twist[:, 3:])], axis=1)[:, None]
        return np.asarray(self.change[..., 3:] + coad(self.momentum)[..., 3:] + self.inertia @ V, np.float64)


class Bodies:
    """The links of a vehicle; first as they move relative to the base.

    Args:
        frames: their motion relative to the base.
        chi: standard parameters of all links, (10 x links,).

    Attributes:
        frames: as given.
        X: :func:`onboard.dynamics.spatial.force_transforms` of the links, (n, links, 6, 6).
        composite: spatial inertia of all, (n, 6, 6).
        relative_momentum: momentum of all with the base at rest, (n, 6).
        twist: of the base, (n, 6).
        rate: rate of change of that, (n, 6).
        V: twists of the links, (n, links, 6).
        A: rates of change of these.
    """

    def __init__(self, frames: Frames, chi: FloatArray) -> None:
        self.frames = frames
        self.X = force_transforms(frames.R, frames.p)
        n, links = frames.p.shape[:2]
        self._parts = np.zeros((n, links, _PARTS))
        self._inertias = spatial_inertias(self.X, chi)
        self._parts[..., _I] = self._inertias.reshape(n, links, 36)
        self._parts[..., _L] = times(self._inertias, frames.V)
        self._every = np.ones((1, links))
        of_all = self._every @ self._parts  # faster than NumPy's sum
        self.composite: FloatArray = of_all[:, 0, _I].reshape(n, 6, 6)
        self.relative_momentum: FloatArray = of_all[:, 0, _L]
        self.twist = self.rate = np.zeros((n, 6))
        self.V, self.A = frames.V, frames.A

    def moved(self, twist: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Let the base move with a twist, (n, 6), without specific force and angular acceleration at its origin.

        Returns:
            The wrench on all links, (n, 6), and its derivative with respect to the rate of the base, (n, 6, 3).
        """
        frames, I, parts = self.frames, self._inertias, self._parts  # noqa: E741
        n, links = frames.p.shape[:2]
        self.twist, self.rate = twist, np.zeros_like(twist)
        self.rate[:, :3] = cross(twist[:, :3], twist[:, 3:])  # less w x v
        self.V = frames.V + twist[:, None]
        self.A = frames.A + self.rate[:, None] + frames.V @ crm(twist).swapaxes(1, 2)
        X = crm(self.V)
        half = I @ X
        parts[..., _DI] = -(half + half.swapaxes(-1, -2)).reshape(n, links, 36)
        parts[..., _L] = L = times(I, self.V)
        parts[..., _F] = times(I, self.A) - times(X.swapaxes(-1, -2), L)
        every = self.sums(self._every)
        return every.wrench[:, 0], every.slope(twist)[:, 0]

    def pushed(self, thrust: FloatArray) -> None:
        """Let the base have this specific force and angular acceleration as well, (n, 6)."""
        self.rate = self.rate + thrust
        self.A = self.A + thrust[:, None]
        self._parts[..., _F] += times(self._inertias, thrust[:, None])

    def sums(self, groups: FloatArray) -> Sums:
        """Sums over groups: one where a link is in one, (groups, links)."""
        n, k = len(self._parts), len(groups)
        each = groups @ self._parts
        I, dI = (each[..., part].reshape(n, k, 6, 6) for part in (_I, _DI))  # noqa: E741
        return Sums(I, dI, each[..., _L], each[..., _F])
