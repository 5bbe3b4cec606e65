"""The links of a vehicle as bodies, in NumPy, with spatial inertias of (6, 6)."""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.kinematics import spatial_inertias
from onboard.dynamics.spatial import MOMENTUM, crm, force_cross, force_transforms, times
from onboard.estimation.arrays import cross, hat

_PARTS = 84  # of a body: I, dI, L, F
_I, _DI, _L, _F = slice(0, 36), slice(36, 72), slice(72, 78), slice(78, 84)


def coad(L):
    """``coad(L) S = S x* L``, (..., 6, 6)."""
    force, moment, out = hat(L[..., :3]), hat(L[..., 3:]), np.zeros((*L.shape, 6))
    out[..., :3, 3:] = out[..., 3:, :3] = -force
    out[..., 3:, 3:] = -moment
    return out


class Sums(NamedTuple):
    """Sums over groups of bodies."""

    inertia: np.ndarray  # (n, groups, 6, 6)
    change: np.ndarray  # (n, groups, 6, 6) its rate of change
    momentum: np.ndarray  # (n, groups, 6)
    wrench: np.ndarray  # (n, groups, 6)

    def slope(self, twist):
        """Derivative of the wrenches by the base's rate, (n, groups, 6, 3).

        ``dF/dw = [dI/dt + K(L)] + 2 I_l hat(v) + I_a hat(w)`` (derived here), the angular columns of what is in
        brackets, I_l and I_a the linear and angular columns of I, v and w of the base, K of
        :func:`coad`; specific force and angular acceleration of the base are held.

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

    def __init__(self, frames, chi):
        self.frames = frames
        self.X = force_transforms(frames.R, frames.p)
        n, links = frames.p.shape[:2]
        self._parts = np.zeros((n, links, _PARTS))
        self._inertias = spatial_inertias(self.X, chi)
        self._parts[..., _I] = self._inertias.reshape(n, links, 36)
        self._parts[..., _L] = times(self._inertias, frames.V)
        self._every = np.ones((1, links))
        of_all = self._every @ self._parts  # faster than NumPy's sum
        self.composite = of_all[:, 0, _I].reshape(n, 6, 6)
        self.relative_momentum = of_all[:, 0, _L]
        self.twist = self.rate = np.zeros((n, 6))
        self.V, self.A = frames.V, frames.A

    def moved(self, twist):
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

    def pushed(self, thrust):
        """Let the base have this specific force and angular acceleration as well, (n, 6)."""
        self.rate = self.rate + thrust
        self.A = self.A + thrust[:, None]
        self._parts[..., _F] += times(self._inertias, thrust[:, None])

    def sums(self, groups):
        """Sums over groups: one where a link is in one, (groups, links)."""
        n, k = len(self._parts), len(groups)
        each = groups @ self._parts
        I, dI = (each[..., part].reshape(n, k, 6, 6) for part in (_I, _DI))  # noqa: E741
        return Sums(I, dI, each[..., _L], each[..., _F])


class Columns:
    """Columns of links whose parameters are unknown.

    Args:
        links: their indices.
        bases: ten directions of each link's parameters, (10, 10); None: the parameters themselves.
    """

    def __init__(self, links, bases=None):
        self.links = links
        each = [np.eye(10)] * len(links) if bases is None else bases
        self._of_twist = np.array([MOMENTUM @ basis for basis in each]).reshape(len(links), 6, 60)

    def into(self, out, X, V, A=None):
        """Momentum, or with the rates of change ``A`` the wrench, of all links, base axes.

        Args:
            out: where the columns are put, (n, 6, 10 x unknown links).
            X: :func:`force_transforms` of all links, (n, links, 6, 6).
            V: their twists, (n, links, 6).
            A: rate of change of these.
        """
        if not self.links:
            return
        if self.links != tuple(range(X.shape[1])):
            which = list(self.links)
            X, V, A = X[:, which], V[:, which], A if A is None else A[:, which]
        back = X.swapaxes(-1, -2)
        own = times(back, V)
        columns = self._of(own)
        if A is not None:
            columns = force_cross(own[..., None, :], columns.swapaxes(-1, -2)).swapaxes(-1, -2)
            columns += self._of(times(back, A))
        n, k = X.shape[:2]
        out.reshape(n, 6, k, 10)[:] = (X @ columns).swapaxes(1, 2)

    def _of(self, own):
        """Momentum columns in each link's axes, (n, k, 6, 10)."""
        n, k = own.shape[:2]
        columns = np.matmul(own[:, :, None], self._of_twist).reshape(n, k, 6, 10)
        return columns
