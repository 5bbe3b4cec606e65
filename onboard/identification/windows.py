"""Fits of a body whose state begins anew in every window of time: the windows' normal equations, joined and judged.

Unknowns are p of the body and its instruments, then the state of each window in turn. What a window contributes is a
:class:`Part`; windows meet in the first p unknowns alone.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.estimation.maximum_likelihood import Fit, Normal
from onboard.estimation.policy import MOST_CONTRADICTED
from onboard.estimation.recursive.consistency import NoiseScale, noise_scale

WINDOW_s = 5.0  # of a state that begins anew: what a guess is off by grows in it, where a body tumbles
SHORTEST = round(1.0 / MOST_CONTRADICTED)  # ticks, poses or steps that tell something: of fewer, one is a larger share
STAGES_s = (4.0,)  # parts of a segment or run that are fitted first: from a poor guess most fits of all get nowhere


class Part(NamedTuple):
    """Of one window: whitened residuals, predicted less measured, their derivative, and the sensor of each."""

    residuals: FloatArray  # (u,)
    derivative: FloatArray  # (u, p + state)
    sensor: IndexArray  # (u,)


class WindowedFit(NamedTuple):
    """A fit."""

    fit: Fit
    globals: int  # unknowns before those of the windows
    by_sensor: tuple[float, ...]  # residual sum over its rows
    noise: NoiseScale  # scatter of the windows' scores
    rows: int

    @property
    def wider(self) -> float:
        """Factor on the variances."""
        return max(1.0, *self.by_sensor, self.noise.variance)

    def variances(self, sigma: FloatArray) -> FloatArray:
        """Of the first p unknowns where the noise's variance is larger by f, and what was stated is not, (p,).

        With C the covariance of the fit and L the stated information, the diagonal of ``C (f (C^-1 - L) + L) C``; at
        least that of C.

        Args:
            sigma: stated, (p,).
        """
        C = self.fit.covariance[: self.globals, : self.globals]
        stated = np.diag((C / sigma**2) @ C)
        return np.asarray(np.diag(C) + (self.wider - 1.0) * np.maximum(np.diag(C) - stated, 0.0), np.float64)


def summed(parts: Iterable[tuple[IndexArray, Normal]], size: int) -> Normal:
    """Normal equations of all parts, each of the unknowns at some places among ``size``."""
    information, gradient, squares = np.zeros((size, size)), np.zeros(size), 0.0
    for at, normal in parts:
        information[np.ix_(at, at)] += normal.information
        gradient[at] += normal.gradient
        squares += normal.squares
    return Normal(information, gradient, squares)


def total(parts: Iterable[Part], p: int, size: int) -> Normal:
    """Normal equations of all windows, of ``size`` unknowns, the first p of which they share."""

    def placed() -> Iterator[tuple[IndexArray, Normal]]:
        for k, (r, J, _) in enumerate(parts):
            state = J.shape[1] - p
            yield np.concatenate([np.arange(p), p + state * k + np.arange(state)]), Normal.of(r, J)

    return summed(placed(), size)


def judged(found: Fit, parts: Iterable[Part], p: int, sensors: int) -> WindowedFit:
    """A fit with what is left over of each sensor, and by how much the windows' scores scatter.

    Args:
        found: the minimum.
        parts: of all windows, there.
        p: unknowns that they share.
        sensors: how many.
    """
    normal, scores, squares, rows = [], [], np.zeros(sensors), np.zeros(sensors)
    for r, J, sensor in parts:
        own, H, g = slice(p, J.shape[1]), J.T @ J, J.T @ r
        across = np.linalg.solve(H[own, own], H[own]).T  # (p + state, state)
        normal.append((H - across @ H[own])[:p, :p])
        scores.append((g - across @ g[own])[:p])
        squares += np.bincount(sensor, r * r, sensors)
        rows += np.bincount(sensor, minlength=sensors)
    scatter = noise_scale(np.array(normal), np.array(scores), found.covariance[:p, :p])
    share = squares / np.maximum(rows * (1.0 - found.x.size / rows.sum()), 1.0)
    return WindowedFit(found, p, tuple(share.tolist()), scatter, int(rows.sum()))
