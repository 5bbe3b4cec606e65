"""One prediction over a window of ticks in pieces of bounded size, summed to the window's normal equations.

A piece is predicted from the state at its first tick, which is the end of the piece before, so that a prediction over
seconds can be interrupted, and nothing as long as the window is ever held. With T the derivative of that state by the
unknowns at the window's first tick, the normal equations of a piece about its own first state, N and g, are those of
the window's unknowns as ``T' N T`` and ``T' g``. Few elements of the state change (rate and biases), so T has the ones
of an identity in all other rows, and only the rows of those few are multiplied.
"""

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.estimation.maximum_likelihood import Normal
from onboard.identification.exiddm.prediction.imu_prediction import PIECE, ImuPredictor
from onboard.identification.exiddm.prediction.ticks import Ticks
from onboard.identification.exiddm.steps import NO_STEPS, Inside


class Pieces:
    """A prediction over the ticks 1 .. n of n + 2.

    Args:
        state: (p,) at the first of them.
        active: the unknowns, (a,), by their place in the state; the others stay as they are.
        ticks: n.
        lines: of each.
        steps: that may be inside.

    Attributes:
        normal: of what has been predicted, by the unknowns at the first tick.
        of_steps: of what the steps do to it, their products, (m, m), and those with the residuals, (m,), and with the
            derivatives, (m, a).
        residual: whitened, predicted less measured, (n, lines); zero for lines that are not used.
        state: (p,) at the last tick predicted.
        transition: (p, a) derivative of that by the unknowns at the first tick.
        over: all ticks are predicted.
    """

    def __init__(self, state: FloatArray, active: IndexArray, ticks: int, lines: int, steps: Inside = NO_STEPS) -> None:
        self.state, self.transition, self._active = state, np.eye(len(state))[:, active], active
        self.normal = Normal(np.zeros((len(active), len(active))), np.zeros(len(active)), 0.0)
        self.residual, self._steps = np.zeros((ticks, lines)), steps
        m = len(steps.at)
        self.of_steps: tuple[FloatArray, ...] = np.zeros((m, m)), np.zeros(m), np.zeros((m, len(active)))
        self._done, self._left, self._first = 0, -(-ticks // PIECE), True  # ticks, pieces

    @property
    def squares(self) -> FloatArray:
        """Of the residuals, (n, lines)."""
        return np.asarray(self.residual**2, np.float64)

    @property
    def over(self) -> bool:
        """All ticks are predicted."""
        return not self._left

    def advance(self, predictor: ImuPredictor, ticks: Ticks, sigma: FloatArray, use: BoolArray) -> int:
        """Predict the next piece; how many ticks that were.

        Args:
            predictor: of the instruments.
            ticks: the window, (n + 2,).
            sigma: of what was measured, (n + 2, lines).
            use: which lines count, (n, lines).
        """
        first = self._done
        self._done += -(-(len(use) - first) // self._left)
        self._left -= 1
        own, inner = ticks.part(slice(first, self._done + 2)), slice(first + 1, self._done + 1)
        predicted = predictor.predict(own.q, own.dq, own.ddq, self.state, own.cyclic, own.thrust)
        used = use[first : self._done]
        weight = np.divide(1.0, sigma[inner], out=np.zeros(used.shape), where=used)
        residual = np.where(used, predicted.values - ticks.measured[inner], 0.0) * weight
        jacobian = np.multiply(predicted.jacobian, weight[..., None], out=predicted.jacobian)  # megabytes: not copied
        piece = Normal.of(residual.ravel(), jacobian.reshape(residual.size, -1))
        changing = predictor.changing
        stays = ~np.isin(self._active, changing)
        half = self._by_first(piece.information, changing, stays)
        by_first = self._by_first(half.T, changing, stays), self._by_first(piece.gradient, changing, stays)
        self.normal = self.normal.plus(Normal(*by_first, piece.squares))
        if self._steps.at.size:
            rows, left = jacobian[:, self._steps.lines], residual[:, self._steps.lines]
            seen = self._steps.seen(rows, first)
            across = np.einsum("nlm,nlp->mp", seen, rows, optimize=True)
            flat = seen.reshape(-1, seen.shape[2])
            told = flat.T @ flat, left.ravel() @ flat
            both = zip(self.of_steps, (*told, self._by_first(across, changing, stays)), strict=True)
            self.of_steps = tuple(known + more for known, more in both)
        self.residual[first : self._done] = residual
        self.state, self.transition[changing] = predicted.state, predicted.transition @ self.transition
        self._first = False
        return self._done - first

    def _by_first(self, by_state: FloatArray, changing: IndexArray, stays: BoolArray) -> FloatArray:
        """``X T``: a derivative by the state at a piece's first tick, (..., p), by the unknowns, (..., a)."""
        if self._first:
            return by_state[..., self._active]
        kept = np.where(stays, by_state[..., self._active], 0.0)
        return np.asarray(kept + by_state[..., changing] @ self.transition[changing], np.float64)
