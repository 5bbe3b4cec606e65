"""Batch fit of a short window of ticks: initialises the recursive filter, and classifies a detected change.

The maximum likelihood of :mod:`onboard.identification.free_flyer.batch` on the state of
:mod:`onboard.identification.free_flyer.prediction.imu_prediction`, from several guesses, with the current estimate of
the other unknowns as prior.

A window that nothing explains takes hundreds of predictions, seconds of CPU time. A solve is therefore an object that
predicts one piece of the window at a time and can be written to a checkpoint in between.
"""

from collections.abc import Iterator
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtrc, chdtri

from onboard.dynamics.model.payload import standard_of
from onboard.estimation.arrays import ROUNDING, FloatArray
from onboard.estimation.errors import ConvergenceError, RowError, SingularError
from onboard.estimation.maximum_likelihood import BEYOND, DAMPING, ITERATIONS, MINIMUM, NEAR_MINIMUM, Descent, Fit
from onboard.estimation.policy import DOUBT, HALF, READING
from onboard.identification.evidence.bank import Changed
from onboard.identification.free_flyer.guesses import FIRST_TICKS, ROUGH_WIDTH_s, first_state, guesses
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import LineNoise, NoiseAdded, correction_of
from onboard.identification.free_flyer.prediction.noise_in_gradient import NoiseInPieces
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.free_flyer.recursion.pieces import Pieces, Problem, evidence_of
from onboard.identification.free_flyer.recursion.solved import EXPLAINED, HeldPayload, Solved
from onboard.identification.free_flyer.steps import NO_STEPS, NONE_TAKEN, Inside, StepsTaken
from onboard.regressor.free_rows import rough_payload

_FEW = 0.03  # largest share of outliers
_SETTLING = 8  # predictions to a minimum that the ticks determine: it takes 3 to 6
_HOPELESS_AFTER = 3  # iterations from a guess after which it is judged whether they can get there
_DRIVEN = 100.0  # by how much a window of flexible joints overstates its information: noise drives their bends


class _Stage(Enum):
    """What the iteration that is under way is for."""

    GUESS = "from a guess"
    SETTLE = "to the minimum"
    SETTLE_ROUGHLY = "to a nearly flat minimum"


class _Ending(NamedTuple):
    """A fit that is a result."""

    fitted: Fit
    whole: Pieces
    noise: NoiseInPieces  # that of the joints


class WindowSolve:
    """The solution of a window of ticks with all joints known, under the first hypothesis that explains it.

    Nothing held, or the payload of before where nothing may be held, is kept only if the next one does not explain the
    window better (:meth:`Solved.contradicts`).

    Attributes:
        over: there is nothing more to do.
        found: the solution; None if no hypothesis explains the window, and while it is not over.
        nearest: of solutions that do not explain it the one of the least cost.
        prior: as below.
        payload_sigma: as below.
        left: whitened residuals of the IMU that guesses are made of, where they were least, (n, 6); None before a fit.

    Args:
        predictor: of the IMU.
        payload_sigma: of a payload of which nothing is known, (10,).
        ticks: the window, in succession.
        prior: of the state at its first tick, without the rate: mean (p,) and covariance (p, p).
        hypotheses: in the order in which they are tried.
        start: (p,) the state at the first tick as it was found before; None: guesses are made.
        imu: the one of which guesses are made.
        steps: that may be inside.
        taken: steps that are, r of them.
        noise: of the joints, what it has added to the prior.
        released: root of the stated information that the prior does not have, (p, r).
    """

    def __init__(
        self,
        predictor: ImuPredictor,
        payload_sigma: FloatArray,
        ticks: Ticks,
        prior: tuple[FloatArray, FloatArray],
        hypotheses: tuple[HeldPayload, ...],
        start: FloatArray | None,
        imu: int = 0,
        steps: Inside = NO_STEPS,
        taken: StepsTaken = NONE_TAKEN,
        noise: NoiseAdded | None = None,
        released: FloatArray | None = None,
    ) -> None:
        self._predictor, self.payload_sigma = predictor, payload_sigma
        self._noise = NoiseAdded.none(len(predictor.names)) if noise is None else noise
        self._steps, self._taken, self._released = steps, taken, released
        self._imu, self._own = imu, predictor.lines[imu]
        self._ticks, self.prior, self._given = ticks, prior, start
        self.over = False
        self.found: Solved | None = None
        self.nearest: Solved | None = None
        self.left: FloatArray | None = None
        self._least = np.inf  # squares of the residuals of all instruments, of that fit
        self._left = list(hypotheses)
        self._kept: Solved | None = None  # under the hypothesis before this one, where that explains the window
        self._descent: Descent | None = None
        self._pieces: Pieces | None = None  # of the prediction under way
        self._ending: _Ending | None = None  # a result, of which what noise of the joints has added is computed
        with np.errstate(over="ignore", invalid="ignore"):  # an infinite cost is refused
            self._begin()

    def advance(self) -> int:
        """Predicts a piece of the window, and goes on from there; how many ticks were predicted."""
        with np.errstate(over="ignore", invalid="ignore"):  # an infinite cost is refused
            if self._ending is not None:
                ticks = self._ending.noise.advance()
                self._end()
                return ticks
            assert self._pieces is not None
            ticks = self._pieces.advance(self._predictor, self._ticks, self._whitening, self._use)
            if self._pieces.over:
                self._predicted(self._pieces)
        return ticks

    def _predicted(self, whole: Pieces) -> None:
        """The window is predicted where the iteration wants it."""
        descent = self._descent
        assert descent is not None
        if whole.normal.squares < self._least:
            self._least, self.left = whole.normal.squares, whole.residual[:, self._own]
        before = descent.iteration
        try:
            descent.take(whole.normal)
        except (ConvergenceError, SingularError, RowError) as error:
            nearly = isinstance(error, ConvergenceError)
            if nearly and self._explains(descent.squares):
                self._stopped(descent, whole)
            else:
                self._failed(nearly=nearly)
            return
        if descent.found is not None:
            self._fitted(descent.found, whole, at_minimum=True)
        elif descent.iteration > max(before, _HOPELESS_AFTER) and self._is_hopeless(descent.prospect):
            self._give_up(descent, whole)
        else:
            self._predict(descent.at)

    def _is_hopeless(self, prospect: float) -> bool:
        """Whether the iteration from a guess will not come so far that it explains the window."""
        guessing = self._stage is _Stage.GUESS and self._hypothesis is not HeldPayload.SAME  # of it one is made
        return guessing and prospect > float(chdtri(float(self._use.sum()), EXPLAINED))

    def _give_up(self, descent: Descent, whole: Pieces) -> None:
        """Go on without the worst outlier, which may be why, or with the next guess and all ticks."""
        if self._leaves_out(whole):
            self._descend(_Stage.GUESS, self._problem.state(descent.best), NEAR_MINIMUM)
        else:
            self._use, self._glitches = np.isfinite(self._ticks.measured[1:-1]), 0
            self._failed(nearly=False)

    def _predict(self, x: FloatArray) -> None:
        """Begin to predict the window with these values of what is active."""
        self._at = x
        ticks, lines = self._use.shape
        (state, sizes), r = self._parted(self._problem.state(x)), len(self._taken.first)
        active = self._problem.active[: len(x) - r]
        steps = self._steps.about(state), self._taken, sizes
        self._pieces = Pieces(state, active, ticks, lines, *steps, tells=self._stage is not _Stage.GUESS)

    def _parted(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """State of the vehicle, (p,), and sizes of the steps that are taken, (r,)."""
        return state[: len(self.prior[0])], state[len(self.prior[0]) :]

    # ------------------------------------------------------------------ a hypothesis

    def _begin(self) -> None:
        """Go on to the next hypothesis, or end."""
        use = np.isfinite(self._ticks.measured[1:-1])  # (n, m)
        if not self._left or use[:FIRST_TICKS, self._own.start].sum() < FIRST_TICKS // 2:
            self.found, self.over, self._descent = self._kept, True, None
            return
        # whether the iteration moved what the ticks do not tell is yet to be checked
        self._hypothesis, self._use, self._glitches, self._checked = self._left.pop(0), use, 0, False
        self._problem: Problem = self._problem_of(self._hypothesis)
        self._best: Fit | None = None
        self._stopped_at: Fit | None = None  # short of a minimum, where no guess leads to one
        if self._given is None:
            self._guesses = list(self._guessed())
            self._next_guess()
        else:
            self._settle(np.append(self._given, np.zeros(len(self._taken.first))))

    def _problem_of(self, hypothesis: HeldPayload) -> Problem:
        (mean, covariance), p = self._predictor.anew(*self.prior), len(self.prior[0])
        rest, others, own = slice(PAYLOAD.start, p), np.arange(PAYLOAD.stop, p), np.arange(p)[PAYLOAD]
        mean, information, active = mean.copy(), np.zeros((p, p)), np.arange(p)
        if hypothesis is HeldPayload.SAME:
            information[rest, rest] = np.linalg.inv(covariance[rest, rest])
        else:
            apart = slice(PAYLOAD.stop, p)
            information[apart, apart] = np.linalg.inv(covariance[apart, apart])
            information[own, own] = 1.0 / self.payload_sigma**2
            mean[PAYLOAD] = 0.0
        if hypothesis is HeldPayload.NOTHING:
            active = np.concatenate([np.arange(p)[RATE], others])
        r = len(self._taken.first)
        return Problem(
            np.append(mean, np.zeros(r)), block_diag(information, np.eye(r)), np.append(active, p + np.arange(r))
        )

    def _next_guess(self) -> None:
        """Fit from the next guess, stopping at a good fit; settle on the best one."""
        best = self._best or self._stopped_at
        if best is not None and chdtrc(float(self._use.sum()), best.residual_sum) > DOUBT:
            self._guesses.clear()
        if self._guesses:
            x, sizes = self._parted(self._problem.mean.copy())
            x[PAYLOAD] = self._guesses.pop(0)
            start = first_state(self._predictor, self._ticks, x, self._imu)
            if start is None:
                self._next_guess()
            else:
                self._descend(_Stage.GUESS, np.append(start, sizes), NEAR_MINIMUM)
        elif best is not None:
            self._settle(self._problem.state(best.x))
        else:
            self._begin()

    def _settle(self, start: FloatArray) -> None:
        """Iterate to the minimum; a nearly flat one, where that takes long, is accepted early."""
        self._descend(_Stage.SETTLE, start, MINIMUM, _SETTLING, ROUNDING)

    def _descend(
        self, stage: _Stage, start: FloatArray, tolerance: float, iterations: int = ITERATIONS, damping: float = DAMPING
    ) -> None:
        self._stage, active = stage, self._problem.active
        prior = self._problem.information[np.ix_(active, active)]
        (noise,) = self._predictor.joint_noises(self._ticks.q, self._parted(start)[0], self._ticks.joint_sigma)
        self._lines = LineNoise.of(self._ticks.sigma, noise).part(slice(1, -1))
        self._whitening = self._lines.whitening(self._use)
        beyond = 0 if stage is _Stage.GUESS else BEYOND  # far from a minimum a step that leads up leads nowhere
        self._descent = Descent(
            start[active], self._problem.mean[active], prior, iterations, tolerance, damping, beyond
        )
        self._predict(self._descent.at)

    def _failed(self, *, nearly: bool) -> None:
        """The iteration that was under way has no result; ``nearly``: it was still descending."""
        if self._stage is _Stage.GUESS:
            self._next_guess()
        elif nearly and self._given is not None:  # the ticks since then contradict it
            self._given, self._guesses = None, list(self._guessed())
            self._next_guess()
        elif self._stage is _Stage.SETTLE and nearly:
            assert self._descent is not None
            self._descend(_Stage.SETTLE_ROUGHLY, self._problem.state(self._descent.best), 1.0)
        else:
            self._begin()

    def _fitted(self, fitted: Fit, whole: Pieces, *, at_minimum: bool) -> None:
        """The iteration that was under way has this result, so near to the last prediction that it is not repeated."""
        if self._stage is not _Stage.GUESS:
            self._check(fitted, whole)
            return
        before = self._best if at_minimum else self._stopped_at
        if before is None or fitted.residual_sum < before.residual_sum:
            assert self._descent is not None
            if at_minimum:
                self._best = fitted._replace(x=self._descent.best)  # the last step is long
            else:
                self._stopped_at = fitted
        self._next_guess()

    def _stopped(self, descent: Descent, whole: Pieces) -> None:
        """The iteration is not at a minimum; where it stopped explains the window, and the minimum does even better.

        Where the ticks tell little of a light payload, the minimum lies in a long flat valley.
        """
        try:
            fitted = descent.short_of_the_minimum()
        except SingularError:
            self._failed(nearly=False)
        else:
            self._fitted(fitted, whole, at_minimum=False)

    def _explains(self, squares: float) -> bool:
        """Whether residuals and deviations from the prior of this sum are no worse than chance."""
        return float(chdtrc(float(self._use.sum()), squares)) > EXPLAINED

    def _check(self, fitted: Fit, whole: Pieces) -> None:
        """Remove the worst outlier, which distorts the fit, and fit again; without one the fit is a result."""
        if not np.isfinite(whole.normal.squares):  # the last prediction, near the result, has no motion
            self._failed(nearly=False)
        elif self._leaves_out(whole):
            self._settle(self._problem.state(fitted.x))
        elif (near := self._taken_back(fitted, whole)) is not None:
            self._settle(self._problem.state(near))
        else:
            start, _ = self._parted(self._problem.state(fitted.x))
            noise = NoiseInPieces(self._predictor, self._ticks, self._lines, self._use, start, each=True)
            self._ending = _Ending(fitted, whole, noise)
            self._end()

    def _taken_back(self, fitted: Fit, whole: Pieces) -> FloatArray | None:
        """Where to go on from, once, if the ticks tell a payload and the iteration moved what they do not tell."""
        mass, variance = fitted.x[PAYLOAD.start], fitted.covariance[PAYLOAD.start, PAYLOAD.start]
        if self._checked or self._hypothesis is not HeldPayload.NEW or not HALF * np.sqrt(variance) < mass:
            return None
        self._checked = True
        return self._problem.as_stated(fitted.x, whole.normal.information)

    def _leaves_out(self, whole: Pieces) -> bool:
        """Whether there was an outlier and one more may be left out: the worst one is not used from now on."""
        lines = self._predictor.lines
        each = [whole.squares[:, own].sum(axis=1) / chdtri(own.stop - own.start, READING) for own in lines]
        worst = int(np.argmax([beyond.max() for beyond in each]))
        tick = int(each[worst].argmax())
        if self._glitches >= _FEW * len(self._use) or each[worst][tick] < 1.0:
            return False
        self._use[tick, lines[worst]] = False
        self._glitches += 1
        return True

    def _end(self) -> None:
        """End with this result if it explains the window; where nothing may be held, the next is tried beside it."""
        ending = self._ending
        if ending is None or not ending.noise.over:
            return
        solved, kept, self._ending = self._solution(*ending), self._kept, None
        if not self._explains(ending.fitted.residual_sum):
            self.nearest = solved if self.nearest is None or solved.cost < self.nearest.cost else self.nearest
            self._begin()
        elif kept is None and self._left and HeldPayload.NOTHING in (self._hypothesis, self._left[0]):
            self._kept, self._left = solved, self._left[:1]
            self._begin()
        else:
            stays = kept is not None and not solved.contradicts(kept)
            self.found, self.over, self._descent = kept if stays else solved, True, None

    def _solution(self, fitted: Fit, whole: Pieces, added: NoiseInPieces) -> Solved:
        (start, _), F, use = self._parted(self._problem.state(fitted.x)), whole.transition, self._use
        used, glitches, covariance = int(use[:, self._own.start].sum()), self._glitches, F @ fitted.covariance @ F.T
        squares = float(whole.squares.sum())
        strained = fitted.residual_sum - squares + max(0.0, squares - float(chdtri(float(use.sum()), DOUBT)))
        end = whole.state + F @ (fitted.x - self._at)
        cost = fitted.residual_sum + glitches * float(chdtri(1.0, READING))
        active, kept = self._problem.active, covariance
        stated = self._problem.information[np.ix_(active, active)]
        if self._predictor.bends.size:  # what drives them is not exact: hardly a window's period counts
            kept = F @ np.asarray(np.linalg.inv(whole.normal.information / _DRIVEN + stated), np.float64) @ F.T
        (products, along, across), informed = whole.of_steps, whole.normal.information + stated
        # where the iteration stops short of a minimum, its covariance is wider than that of these derivatives
        moves, of_each = np.linalg.solve(informed, across.T), self._steps._replace(times=1).changed(len(start))
        uphill = whole.normal.gradient + stated @ (self._at - self._problem.mean[active])
        before, lasting = self._noise, self._predictor.lasting
        if self._hypothesis is not HeldPayload.SAME:
            before = before.but_for(PAYLOAD, self.prior[0])
        noise = added.added.moved(-lasting * start).plus(before)
        here, d = noise.moved(lasting * start), uphill @ moves - along
        if here.gradient.any():
            of_active = np.append(here.gradient, np.zeros(len(self._taken.first)))[active]  # zero for sizes of steps
            d += whole.steps.along_with(added.by_tick) - across @ fitted.covariance @ of_active
        steps = Changed(whole.stepped - F @ moves, d, products - across @ moves, of_each)
        told = strained, cost, whole.residual[:, self._own].copy(), kept, steps
        left_out = self._lines.sigma[np.isfinite(self._ticks.measured[1:-1]) & ~use]
        evidence = evidence_of(whole, use.sum(axis=0), left_out, cost - squares, (stated, informed))
        by = correction_of((end, covariance), noise.moved(lasting * end), self._predictor.constant, self._released)
        known = end + by.shift, covariance + by.root @ by.root.T
        return Solved(self._hypothesis, start, end, covariance, used, glitches, *told, noise, known, evidence)

    def _guessed(self) -> Iterator[FloatArray]:
        """Standard parameters of the payload, (10,) each."""
        if self._hypothesis is not HeldPayload.NEW:
            yield self.prior[0][PAYLOAD] if self._hypothesis is HeldPayload.SAME else np.zeros(10)
            return
        vehicle, signals = self._predictor.vehicle, self._ticks.flight(self._predictor.period_s, 1, self._own)
        frame = self._predictor.imu_frames[self._imu]
        rough = partial(rough_payload, vehicle, frame, signals, ROUGH_WIDTH_s, self.payload_sigma)
        yield from (standard_of(guess) for guess in guesses(rough))
