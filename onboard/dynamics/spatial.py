"""Spatial algebra over many ticks: twists (linear, angular), wrenches (force, moment), about the base frame's origin.

A link's momentum and wrench are linear in its ten standard parameters. In its own axes and about its own origin they
are constant maps of its twist and of that twist's rate of change, so that the columns of many links at many ticks are a
few products of small matrices (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 2).
"""

from collections.abc import Sequence

import numpy as np

from onboard.estimation.arrays import FloatArray, cross, hat
from onboard.native import library, structures


def _maps() -> tuple[FloatArray, ...]:
    """Constant maps of a vector's elements to its matrices, and of a twist's to a link's momentum columns."""
    hats = hat(np.eye(3))
    crm, momentum = np.zeros((6, 6, 6)), np.zeros((6, 6, 10))
    crm[:3, :3, 3:] = crm[3:, :3, :3] = crm[3:, 3:, 3:] = hats
    momentum[[0, 1, 2], [0, 1, 2], 0] = 1.0  # l = m v + w x h, k = I w - v x h
    momentum[3:, :3, 1:4], momentum[:3, 3:, 1:4] = hats, -hats
    of, to = np.repeat([3, 4, 5], 3), np.tile([3, 4, 5], 3)
    momentum[of, to, [4, 5, 7, 5, 6, 8, 7, 8, 9]] = 1.0  # XX XY YY XZ YZ ZZ
    return crm.reshape(6, 36), momentum


_CRM, MOMENTUM = _maps()


def crm(V: FloatArray) -> FloatArray:
    """``crm(V) U = V x U`` of motion vectors, (..., 6, 6)."""
    out: FloatArray = (V @ _CRM).reshape(*V.shape, 6)
    return out


def force_cross(V: FloatArray, F: FloatArray) -> FloatArray:
    """``V x* F`` of a twist and a force vector along the last axis, (..., 6): ``-crm(V)' F``."""
    v, w, f = V[..., :3], V[..., 3:], F[..., :3]
    return np.concatenate([cross(w, f), cross(w, F[..., 3:]) + cross(v, f)], axis=-1)


def times(M: FloatArray, a: FloatArray) -> FloatArray:
    """``b = M a`` for every tick: matrices (..., i, j), vectors (..., j)."""
    out: FloatArray = np.matmul(M, a[..., None])[..., 0]
    return out


def force_transforms(R: FloatArray, p: FloatArray) -> FloatArray:
    """Wrenches in a frame's axes about its origin to base axes about the base's, (..., 6, 6); transposed: twists back.

    Args:
        R: the frame's axes in base axes, (..., 3, 3).
        p: its origin, (..., 3).
    """
    X = np.zeros((*p.shape, 2, 6)).reshape(*p.shape[:-1], 6, 6)
    X[..., :3, :3] = X[..., 3:, 3:] = R
    X[..., 3:, :3] = hat(p) @ R
    return X


def own_inertias(chi: FloatArray) -> FloatArray:
    """Spatial inertias of links in their own axes about their own origins, (links, 6, 6), from (10 x links,)."""
    return np.asarray(np.einsum("aij,kj->kia", MOMENTUM, chi.reshape(-1, 10)), np.float64)


class Columns:
    """Columns of links whose parameters are unknown.

    Args:
        links: their indices.
        bases: ten directions of each link's parameters, (10, 10); None: the parameters themselves.
    """

    def __init__(self, links: tuple[int, ...], bases: Sequence[FloatArray] | None = None) -> None:
        self.links = links
        each = [np.eye(10)] * len(links) if bases is None else bases
        self.bases = library.given(np.array(each, np.float64).reshape(-1, 10, 10), len(links), 10, 10)

    def compiled(self, count: int) -> structures.ColumnsStruct:
        """The columns for the compiled core, of a vehicle with so many links.

        Raises:
            ArrayError: it has fewer links than these are of.
        """
        return structures.ColumnsStruct(
            len(self.links), library.indices(np.array(self.links, np.intp), count), self.bases
        )
