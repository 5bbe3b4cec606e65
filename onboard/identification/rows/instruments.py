"""Instruments for the rows of a free base: the rows of the motion predicted by the estimate so far.

A poor estimate gives weak instruments. The instruments of the rows of the first seconds are therefore recomputed, at
growing intervals, while the estimate settles; later rows get theirs once. (Janot, Vandanjon and Gautier 2014.)

Known limits: recomputing the instruments of the first ten seconds takes 30 ms, some ten times per flight.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import ROUNDING, BoolArray, FloatArray
from onboard.estimation.policy import AGAIN
from onboard.estimation.recursive.instrumental import RecursiveInstrumental
from onboard.identification.rows.predicted_motion import PredictedMotion
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import RowFold, RowModel

_LEAST_S, _MOST_S = 0.5, 10.0  # between one correction and the next; of flight after which instruments are final


class MotionRows(NamedTuple):
    """Rows of n ticks, and their motion."""

    time_s: FloatArray  # (n,)
    q: FloatArray  # (n, joints)
    dq: FloatArray
    ddq: FloatArray
    rate: FloatArray  # (n, 3) base axes
    held: BoolArray  # (n,)
    used: BoolArray  # (n, rows) which rows are; r in all
    Y: FloatArray  # (r, p)
    y: FloatArray  # (r,)
    sigma: FloatArray  # (r,) of the left-hand sides by themselves
    noise: FloatArray | None  # (groups, rows, s, p + 1) change of row and left-hand side per sigma of a signal
    group: NDArray[np.intp]  # (n,) of each tick
    C: FloatArray | None  # (r, k)


def whitening(rows: MotionRows, mean: FloatArray) -> tuple[FloatArray, list[tuple[NDArray[np.intp], FloatArray]]]:
    """Whitening of the rows of a tick, whose errors come from common signals.

    Args:
        rows: with the noise of their signals.
        mean: base parameters that say what it does to the rows, (p,).

    Returns:
        ``(sigma, parts)``: (r,) each row's by itself; and, for all ticks with m rows, the rows' places, (t, m),
        and the inverse of a square root of their covariance, (t, m, m). No parts for rows without noise.
    """
    if rows.noise is None:
        return rows.sigma, []
    effect = (rows.noise @ np.append(mean, -1.0))[rows.group][rows.used]  # (r, s)
    sigma = np.sqrt(rows.sigma**2 + np.einsum("rs,rs->r", effect, effect))
    scaled = effect / sigma[:, None]
    sizes = rows.used.sum(axis=1)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    parts = []
    for size in np.unique(sizes[sizes > 0]):
        index = starts[sizes == size][:, None] + np.arange(size)  # (t, m)
        E = scaled[index]
        S = E @ E.swapaxes(1, 2)
        S[:, np.arange(size), np.arange(size)] = 1.0 + ROUNDING
        parts.append((index, np.linalg.inv(np.linalg.cholesky(S))))
    return sigma, parts


class Instruments:
    """Computes the instruments of rows and adds both to the recursion.

    Args:
        recursion: where they go.
        model: the rows.
        fold: their base columns, and what is known last.
        base: the base parameters.
        prior_root: of the standard parameters' covariance, (P, P): which of those that the base parameters sum up
            gives way.
        lag_s: the smoothing kernel's width.

    Raises:
        SignalError: a lag that is not positive, or a base that is not free.
    """

    def __init__(
        self,
        recursion: RecursiveInstrumental,
        model: RowModel,
        fold: RowFold,
        base: BaseParameters,
        prior_root: FloatArray,
        lag_s: float,
    ) -> None:
        self._recursion, self._model, self._fold, self._base = recursion, model, fold, base
        if not model.vehicle.spec.base.falls:
            raise SignalError(f"a {model.vehicle.spec.base} base has no predicted motion; free bases only")
        self._motion = PredictedMotion(model.vehicle, lag_s)
        spread = base.grouping @ prior_root @ prior_root.T  # (p, P)
        self._standard = np.linalg.solve(spread @ base.grouping.T, spread).T  # (P, p) standard of base parameters
        self._start_s: float | None = None
        self._due_s = 0.0
        self._waiting: list[MotionRows] | None = []  # None once the estimate is settled
        self._mean: FloatArray | None = None  # base parameters that are predicted with

    def take(self, rows: MotionRows) -> None:
        """Takes rows already added to the least squares."""
        now_s = float(rows.time_s[-1])
        if self._start_s is None:
            self._start_s, self._due_s = now_s, now_s + 2.0 * _LEAST_S
        elapsed = now_s - self._start_s
        due, settled = now_s >= self._due_s, elapsed > _MOST_S
        if due:
            self._correct()
            self._due_s = now_s + min(max((AGAIN - 1.0) * elapsed, _LEAST_S), _MOST_S)
        if self._waiting is None:
            self._instrument(rows, True)
            return
        self._waiting.append(rows)
        if due:
            self._recursion.unsettle(settled)
            self._motion.forget()
            for some in self._waiting:
                self._instrument(some, settled)
            if settled:
                self._waiting = None
        elif self._mean is not None:
            self._instrument(rows, False)

    def _correct(self) -> None:
        """Predicts with the estimate so far from here on; with the least squares' as long as there is no other."""
        by_instruments = self._recursion.instruments.count > 0
        mean = self._recursion.mean if by_instruments else self._recursion.least_squares()
        chi = self._model.chi + self._standard @ (mean - self._base.value(self._model.chi))
        if self._motion.set(chi[: self._model.vehicle.chi.size]) or self._mean is None:
            self._mean = mean

    def _instrument(self, rows: MotionRows, settled: bool) -> None:
        assert self._mean is not None
        motion = self._motion.predict(rows.time_s, rows.q, rows.dq, rows.ddq, rows.rate, rows.held)
        none = np.zeros(rows.used.shape)
        Z = self._model.regressor(rows.q, rows.dq, rows.ddq, motion, rows.held, predicted=none, fold=self._fold)
        sigma, parts = whitening(rows, self._mean)
        columns = [rows.Y, rows.y[:, None], Z[..., :-1][rows.used]]
        p, k = rows.Y.shape[1], 0 if rows.C is None else rows.C.shape[1]
        whole = np.concatenate([*columns, *(() if rows.C is None else (rows.C,))], axis=1) / sigma[:, None]
        for index, inverse in parts:
            whole[index] = inverse @ whole[index]
        Y, y, instruments, C = whole[:, :p], whole[:, p], whole[:, p + 1 : 2 * p + 1], whole[:, 2 * p + 1 :]
        times = np.repeat(rows.time_s, rows.used.sum(axis=1))
        self._recursion.add_instruments(times, Y, y, np.ones(len(y)), instruments, C if k else None, settled)
