"""One prediction over a window of ticks in pieces of bounded size, summed to the window's normal equations; its prior.

A piece is predicted from the state at its first tick, which is the end of the piece before, so that a prediction over
seconds can be interrupted, and nothing as long as the window is ever held. With T the derivative of that state by the
unknowns at the window's first tick, the normal equations of a piece about its own first state, N and g, are those of
the window's unknowns as ``T' N T`` and ``T' g``. Few elements of the state change (rate and biases), so T has the ones
of an identity in all other rows, and only the rows of those few are multiplied. A step inside the window changes
constants from a piece on; its size is one more unknown.

Steps that may be inside are columns G of derivatives from their times on. Those of an instrument's constants are the
columns of these constants. A change of the payload at a tick leaves the rate there as it is and moves it later: what
follows is what another rate and payload at the first tick would have made, ``(-M^-1 N A, A)``, with M and N the
derivatives of the rate at that tick by the first rate and payload, and A the change. Where M is singular, as the
unknowns make the motion diverge, the cost is infinite, and the iteration takes that step back.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from onboard.estimation.arrays import SINGULAR, BoolArray, FloatArray, IndexArray
from onboard.estimation.maximum_likelihood import Normal
from onboard.estimation.policy import LIKELIER
from onboard.identification.corrections import LEAST_TOLD
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, PIECE, RATE, ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, Ticks
from onboard.identification.free_flyer.steps import NO_STEPS, NONE_TAKEN, Inside, StepsTaken

_NO_SIZES = np.zeros(0)
_FIRST = PAYLOAD.stop  # rate and payload


class Pieces:
    """A prediction over the ticks 1 .. n of n + 2.

    Args:
        state: (p,) at the first of them.
        active: the unknowns, (a,), by their place in the state; the others stay as they are.
        ticks: n.
        lines: of each.
        steps: that may be inside.
        taken: steps that are.
        sizes: of these, in their sigmas, (r,).
        tells: what steps do to it is wanted.

    Attributes:
        normal: of what has been predicted, by the unknowns at the first tick and the sizes of steps.
        residual: whitened, predicted less measured, (n, lines); zero for lines that are not used.
        log_sigma: sum of the logarithms of the sigmas of the others, of each given those before it.
        state: (p,) at the last tick predicted.
        steps: that may be inside.
        transition: (p, a + r) derivative of that by the unknowns at the first tick and the sizes of steps.
        over: all ticks are predicted.
    """

    def __init__(
        self,
        state: FloatArray,
        active: IndexArray,
        ticks: int,
        lines: int,
        steps: Inside = NO_STEPS,
        taken: StepsTaken = NONE_TAKEN,
        sizes: FloatArray = _NO_SIZES,
        *,
        tells: bool = True,
    ) -> None:
        a, r = len(active), len(sizes)
        self.state, self._active = state, active
        self.transition = np.pad(np.eye(len(state))[:, active], ((0, 0), (0, r)))
        self.normal = Normal(np.zeros((a + r, a + r)), np.zeros(a + r), 0.0)
        self.residual, self.steps, self.log_sigma = np.zeros((ticks, lines)), steps, 0.0
        self._taken, self._sizes, self._tells = taken, sizes, tells
        parts, kinds = steps.times + steps.begins, steps.of_instruments + _FIRST
        each = (kinds, kinds), (kinds,), (kinds, a + r)
        self._first = np.eye(_FIRST)[:, active[active < _FIRST]].T  # of what is active
        self._rates = np.zeros((parts, 3, 10))  # M^-1 N where each part begins
        self._of_steps: tuple[FloatArray, ...] = tuple(np.zeros((parts, *shape)) for shape in each)
        self._done, self._left = 0, -(-ticks // PIECE)  # ticks, pieces

    @property
    def squares(self) -> FloatArray:
        """Of the residuals, (n, lines)."""
        return np.asarray(self.residual**2, np.float64)

    @property
    def over(self) -> bool:
        """All ticks are predicted."""
        return not self._left

    def advance(self, predictor: ImuPredictor, ticks: Ticks, whitening: FloatArray, use: BoolArray) -> int:
        """Predict the next piece; how many ticks that were.

        Args:
            predictor: of the instruments.
            ticks: the window, (n + 2,).
            whitening: of the lines of each, (n, lines, lines): see :class:`.LineNoise`.
            use: which lines count, (n, lines).
        """
        first = self._done
        for k in np.flatnonzero(self._taken.first == first):
            step = self._taken.along[:, k]
            self.state = self.state.copy()
            self.state[self._taken.at] += self._sizes[k] * step
            self.transition[self._taken.at, len(self._active) + k] += step
        last = first - (-(len(use) - first) // self._left)
        later = self._taken.first[self._taken.first > first].min(initial=len(use))
        # a step begins with a piece, none is of one tick
        self._done = int(later) if later < last + BATCH_TICKS else last
        self._left -= self._done >= last
        own, inner = ticks.part(slice(first, self._done + 2)), slice(first + 1, self._done + 1)
        predicted = predictor.predict(own.q, own.dq, own.ddq, self.state, own.cyclic, own.thrust)
        used, whiten = use[first : self._done], whitening[first : self._done]
        self.log_sigma -= float(np.log(np.einsum("nmm->nm", whiten)[used]).sum())
        residual = (whiten @ np.where(used, predicted.values - ticks.measured[inner], 0.0)[:, :, None])[:, :, 0]
        gyro = predicted.jacobian[:, :3].copy() if self.steps.times else _NO_SIZES
        jacobian = whiten @ predicted.jacobian
        piece = Normal.of(residual.ravel(), jacobian.reshape(residual.size, -1))
        changing, stays = predictor.changing, np.ones(len(self.state), np.bool_)
        stays[changing] = False
        of_state = changing, stays[self._active], self._taken.at[stays[self._taken.at]]
        half = self._by_first(piece.information, *of_state)
        by_first = self._by_first(half.T, *of_state), self._by_first(piece.gradient, *of_state)
        self.normal = self.normal.plus(Normal(*by_first, piece.squares))
        if self.steps.times:
            begin, which = self.steps.starts(first, len(used))
            for k, part, *rows in zip(
                begin, which, *(np.split(x, begin[1:]) for x in (jacobian, residual)), strict=True
            ):
                H, left = rows[0].reshape(rows[1].size, -1), rows[1].ravel()
                if k > 0 or first == part * self.steps.every:  # it begins here
                    now = self._by_start(gyro[k - 1], *of_state[:2]) if k > 0 else self._of_first(self.transition[RATE])
                    if not np.isfinite(now).all() or np.linalg.cond(now[:, RATE]) > SINGULAR:
                        self.normal = self.normal._replace(squares=np.inf)
                        continue
                    self._rates[part] = np.linalg.solve(now[:, RATE], now[:, PAYLOAD])
                if not self._tells:
                    continue
                seen = np.hstack([self.steps.seen(H), self._by_start(H, *of_state[:2])])
                told = seen.T @ seen, left @ seen, self._by_first(seen.T @ H, *of_state)
                for known, more in zip(self._of_steps, told, strict=True):
                    known[part] += more
        self.residual[first : self._done] = residual
        self.state, self.transition[changing] = predicted.state, predicted.transition @ self.transition
        return self._done - first

    @property
    def of_steps(self) -> tuple[FloatArray, ...]:
        """Of what steps do to it: their products, (m, m), those with residuals, (m,), and derivatives, (m, a + r).

        A step is there in the part that begins at its time and all later ones; of two, both are from the later on.
        """
        products, along, across = (np.cumsum(x[::-1], axis=0)[::-1][self.steps.begins :] for x in self._of_steps)
        later, by = np.arange(len(products)), self._by_steps
        both = by.swapaxes(1, 2)[:, None] @ products[np.maximum(later[:, None], later)] @ by
        m = by.shape[2] * len(later)
        of_each = by.swapaxes(1, 2) @ across
        return both.swapaxes(1, 2).reshape(m, m), (along[:, None] @ by).reshape(m), of_each.reshape(m, across.shape[2])

    @property
    def stepped(self) -> FloatArray:
        """By which steps change the state at the last tick predicted, (p, m)."""
        n, changed = self.steps.of_instruments, self.steps.changed(len(self.state))
        each = changed.reshape(len(self.state), self.steps.times, self.steps.along.shape[1])
        each[:, :, n:] = np.einsum("pk,tkc->ptc", self._of_first(self.transition), self._by_steps[:, n:, n:])
        return each.reshape(changed.shape)

    @property
    def _by_steps(self) -> FloatArray:
        """Of what the parts have columns of, by each time's steps, (times, kinds + 13, kinds + payload's)."""
        n, changes, times = self.steps.of_instruments, self.steps.payload, self.steps.times
        out = np.zeros((times, n + _FIRST, n + changes.shape[1]))
        out[:, :n, :n] = np.eye(n)
        if changes.size:
            out[:, n:, n:][:, RATE] = -self._rates[self.steps.begins :] @ changes
            out[:, n:, n:][:, PAYLOAD] = changes
        return out

    def _by_start(self, by_state: FloatArray, changing: IndexArray, stays: BoolArray) -> FloatArray:
        """As :meth:`_by_first`, by the first rate and payload alone, (..., 13)."""
        few = slice(0, len(self._first))
        out = np.asarray(by_state[..., changing] @ self.transition[changing, few], np.float64)
        out += np.where(stays[few], by_state[..., self._active[few]], 0.0)
        return self._of_first(out)

    def _of_first(self, by_unknowns: FloatArray) -> FloatArray:
        """Derivative by the first rate and payload, (..., 13), of one by all unknowns; zero by what is not active."""
        return np.asarray(by_unknowns[..., : len(self._first)] @ self._first, np.float64)

    def _by_first(
        self, by_state: FloatArray, changing: IndexArray, stays: BoolArray, steps_at: IndexArray
    ) -> FloatArray:
        """``X T``: a derivative by the state at a piece's first tick, (..., p), by all unknowns, (..., a + r).

        Of the state, what changes from tick to tick; whether what is active stays; what else has steps.
        """
        a, same = len(self._active), by_state.take(self._active, -1)
        same[..., ~stays] = 0.0
        out = np.asarray(by_state[..., changing] @ self.transition[changing], np.float64)
        out[..., :a] += same
        if len(steps_at):
            out[..., a:] += by_state[..., steps_at] @ self.transition[steps_at, a:]
        return out


class Problem(NamedTuple):
    """A prior, and the parameters that a solve estimates."""

    mean: FloatArray  # (p,)
    information: FloatArray  # (p, p)
    active: NDArray[np.intp]  # what is estimated; the rest stays as it is in the mean

    def as_stated(self, x: FloatArray, told: FloatArray) -> FloatArray | None:
        """The same with what the ticks do not tell at its prior mean; None if that is no likelier than it is.

        A damped iteration from a guess may move two unknowns that cancel each other, as a joint's place and what hangs
        on it, and hardly takes it back, as each has a large effect by itself.

        Args:
            x: of what is active, (a,).
            told: the ticks' information on it, (a, a).
        """
        stated = self.information[np.ix_(self.active, self.active)]
        both = told + stated
        scale = np.sqrt(np.diag(both))
        share, V = eigh(stated / np.outer(scale, scale), both / np.outer(scale, scale))  # V' both V = 1
        untold = V[:, share > 1.0 - LEAST_TOLD]  # the ticks do not tell of these
        away = untold.T @ (both @ (x - self.mean[self.active]) / scale)  # in prior sigmas
        return x - untold @ away / scale if 0.5 * float(away @ away) > -np.log(LIKELIER) else None

    def state(self, x: FloatArray) -> FloatArray:
        """The whole state with these values of what is active."""
        state = self.mean.copy()
        state[self.active] = x
        return state


def evidence_of(
    whole: Pieces, used: IndexArray, left_out: FloatArray, apart: float, informations: tuple[FloatArray, FloatArray]
) -> float:
    """Laplace's evidence of a solution, with the noise of each line scaled to its residuals.

    Noise of the joints in a reading differs from solution to solution, and is not known so well that twice of it could
    tell one from the other: unscaled, 600 ticks preferred a body of -0.4 kg by 220 nats.

    Args:
        whole: the prediction.
        used: readings of each line, (lines,).
        left_out: sigma of each reading that is not used.
        apart: squares of what is left out and of the deviations from the prior.
        informations: on what is active, by the prior and with the ticks, (a, a) each.
    """
    stated, informed = informations
    proper, squares = stated.copy(), whole.squares.sum(axis=0)
    proper[RATE, RATE] += np.eye(3)  # of the rate nothing is known
    mean = np.divide(squares, used, out=np.ones(len(used)), where=squares > 0.0)
    left = used @ (1.0 + np.log(mean)) + 2.0 * (whole.log_sigma + np.log(left_out).sum()) + apart
    return 0.5 * float(np.linalg.slogdet(proper)[1] - np.linalg.slogdet(informed)[1] - left)
