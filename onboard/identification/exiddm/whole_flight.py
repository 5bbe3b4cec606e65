"""Batch fit of a whole flight: segments with the payload held and segments without, one set of instruments and links.

The likelihood of :mod:`onboard.identification.exiddm.recursive` without its linearisation errors: all unknowns are
constant over the flight, but the base's rate at the start of each segment and the IMU's biases, and every iteration
predicts the whole flight anew about the same estimate (Gauss-Newton, :mod:`onboard.estimation.maximum_likelihood`).
What is flown free determines biases, scales, links and joints, and so narrows the payload's interval.

A bias is a straight line over the flight with a kink every ``KINK_s``: the sigma of a kink's change of slope is that of
the random walk of the filter's drift, ``drift sqrt(2 KINK_s / DRIFT_MEMORY_s)``.

Normal equations are kept for each block of ticks and each instrument, so that agreement of parts of the flight
(:mod:`onboard.identification.exiddm.parts`) costs no further prediction, and memory hardly grows with the flight.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from onboard.dynamics.payload import BodyEstimate, body_estimate
from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import Fit, Normal, fit_normal
from onboard.identification.exiddm.imu_errors import whitened
from onboard.identification.exiddm.imu_prediction import PAYLOAD, RATE, DRIFT_MEMORY_s, ImuPredictor, first_rate
from onboard.identification.exiddm.ticks import Ticks

INSTRUMENTS = ("gyro", "accelerometer")
KINK_s = 5.0
_BLOCK_TICKS = 200
_SHORTEST_TICKS, _FEWEST_TICKS = 20, 4  # of a segment, of a prediction
_CHANCE = 1e-5  # of a block's residual sum: what is exceeded more rarely counts
_GLITCH = 1e-9  # chance probability of a tick's residual below which it is an outlier
_MOST_GLITCHES = 0.1  # share of the ticks that may be left out as outliers
_EVALUATIONS = 25  # predictions of the flight in a stage
_ROUGH, _FINE = 10.0, 0.03  # decrease of the residual sum at which a stage ends


class Segment(NamedTuple):
    """Ticks in succession, joints known, with one payload held or nothing."""

    ticks: Ticks
    held: bool


class Block(NamedTuple):
    """Normal equations of some ticks of one instrument at an estimate."""

    normal: Normal
    rows: int
    instrument: str
    held: bool
    middle_s: float


class FlightFit(NamedTuple):
    """The maximum likelihood estimate of a whole flight."""

    payload: BodyEstimate  # in the payload link's frame
    fit: Fit
    names: tuple[str, ...]  # of the parameters fitted
    chi: FloatArray  # (10,) standard parameters of the payload
    chi_covariance: FloatArray  # (10, 10)
    blocks: tuple[Block, ...]  # at the estimate
    misfit: float  # residual sum over its degrees of freedom
    by_instrument: dict[str, float]  # the same of each instrument: the larger of all its rows and its worst part
    glitches: int  # ticks left out


class _Along(NamedTuple):
    """Prediction of b ticks of a segment."""

    ticks: slice
    values: FloatArray  # (b, 6)
    jacobian: FloatArray  # (b, 6, predictor's p), by the state at the block's start
    d_rate: FloatArray  # (3, predictor's p) of the rate there by the state at the segment's start
    lines: FloatArray  # (b, 2 + kinks)


class WholeFlight:
    """Predicts the base IMU in every segment of a flight and fits the unknowns to it.

    Args:
        predictor: of the vehicle's IMU.
        payload_sigma: wide prior: standard deviations of the payload's standard parameters about zero, (10,).
        segments: in the order of their times; too short ones are left out.

    Attributes:
        names: of the p parameters: those of the predictor without the rate, rates, kinks of biases.
        sigma: (p,) before the flight; NaN where nothing is known.
        segments: those that are fitted.
        of_a_part: indices of the parameters that differ from part to part of a flight: rates and biases.
    """

    def __init__(self, predictor: ImuPredictor, payload_sigma: FloatArray, segments: Sequence[Segment]) -> None:
        self._predictor = predictor
        self.segments = [one for one in segments if len(one.ticks.time_s) >= _SHORTEST_TICKS]
        self._begin_s = min((float(one.ticks.time_s[0]) for one in self.segments), default=0.0)
        end_s = max((float(one.ticks.time_s[-1]) for one in self.segments), default=0.0)
        self._kinks_s = np.arange(1, int((end_s - self._begin_s) / KINK_s)) * KINK_s
        constant = slice(PAYLOAD.start, None)
        walk = np.sqrt(2.0 * KINK_s / DRIFT_MEMORY_s)
        drifts = [drift_at for _, drift_at in predictor.biases]
        self._constants = len(predictor.names) - PAYLOAD.start
        self.names: tuple[str, ...] = (
            *predictor.names[constant],
            *(f"{name}_{k}" for k in range(len(self.segments)) for name in predictor.names[RATE]),
            *(f"{predictor.names[at]}_kink_{k}" for k in range(len(self._kinks_s)) for at in drifts),
        )
        self.sigma = np.concatenate(
            [
                payload_sigma,
                predictor.sigma[PAYLOAD.stop :],
                np.full(3 * len(self.segments), np.nan),
                np.tile(walk * predictor.sigma[drifts], len(self._kinks_s)),
            ]
        )
        pairs, kinks = len(drifts), len(self._kinks_s)
        first = self._constants + 3 * len(self.segments)
        self._of_lines: list[IndexArray] = [
            np.array([bias_at - 3, drift_at - 3, *(first + i + pairs * np.arange(kinks))], np.intp)
            for i, (bias_at, drift_at) in enumerate(predictor.biases)
        ]
        self.of_a_part = np.setdiff1d(
            np.concatenate([np.arange(self._constants, len(self.names)), *self._of_lines]), []
        ).astype(np.intp)
        self._use: list[BoolArray] = [
            np.logical_and.reduce(np.isfinite(one.ticks.measured), axis=1) for one in self.segments
        ]
        self._sigma = [one.ticks.sigma for one in self.segments]
        self._squares: list[FloatArray] = []  # of the whitened residuals of each tick, at the last evaluation

    @property
    def prior_information(self) -> FloatArray:
        """(p, p), about zero."""
        return np.diag(np.nan_to_num(1.0 / self.sigma**2))

    def start(self, constants: FloatArray) -> FloatArray:
        """Initial parameters, (p,): constants of the predictor's state, rates by the first readings of each segment."""
        x = np.zeros(len(self.names))
        x[: self._constants] = constants
        for k, one in enumerate(self.segments):
            at = self._constants + 3 * k
            x[at : at + 3] = first_rate(self._predictor, one.ticks, self._state(x, k))
        return x

    def widen(self, parameters: IndexArray, factor: float) -> None:
        """Take the prior sigmas of some parameters for so many times as large."""
        self.sigma[np.unique(parameters)] *= factor

    def fit(self, start: FloatArray, stages_s: Sequence[float] = ()) -> FlightFit:
        """Maximum likelihood, first of the parts of each segment up to so many seconds, then of all ticks.

        Args:
            start: (p,), see :meth:`start`.
            stages_s: lengths of these parts.

        Raises:
            ConvergenceError, SingularError, RowError: see :func:`onboard.estimation.maximum_likelihood.fit_normal`.
            SignalError: a payload without a mass.
        """
        x = start
        for length_s in stages_s:
            x = self._settle(x, _ROUGH, length_s)[0].x
            x = self.start(np.concatenate([start[:10], x[10 : self._constants]]))
        found, blocks = self._settle(x, _FINE)
        if glitches := self._leave_out():
            found, blocks = self._settle(found.x, _FINE)
        chi, covariance = found.x[:10], found.covariance[:10, :10]
        known = int(np.isfinite(self.sigma).sum())
        freedom = sum(block.rows for block in blocks) + known - found.x.size
        misfit = found.residual_sum / max(freedom, 1)
        return FlightFit(
            body_estimate(chi, covariance),
            found,
            self.names,
            chi,
            covariance,
            blocks,
            misfit,
            _by_instrument(blocks),
            glitches,
        )

    def blocks(self, x: FloatArray, length_s: float = np.inf) -> list[Block]:
        """Normal equations of all ticks up to so many seconds after the start of each segment, at x, (p,)."""
        found = []
        self._squares = [np.zeros(len(one.ticks.time_s)) for one in self.segments]
        for k, one in enumerate(self.segments):
            for along in self._along(x, k, length_s):
                use = self._use[k][along.ticks]
                if not use.any():
                    continue
                measured, sigma = one.ticks.measured[along.ticks], self._sigma[k][along.ticks]
                r, J = whitened(along.values, self._jacobian(along, k), measured, sigma, use)
                self._squares[k][np.arange(along.ticks.start, along.ticks.stop)[use]] = (r.reshape(-1, 6) ** 2).sum(
                    axis=1
                )
                middle_s = float(one.ticks.time_s[along.ticks].mean())
                of_row = np.arange(r.size) % 6 // 3
                for number, instrument in enumerate(INSTRUMENTS):
                    own = of_row == number
                    normal = Normal.of(r[own], J[own])
                    found.append(Block(normal, int(own.sum()), instrument, one.held, middle_s))
        return found

    def residuals(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened, predicted less measured, of all segments at x, (p,): times (n,), (n, 6) with NaN where not used."""
        every = [np.full((len(one.ticks.time_s), 6), np.nan) for one in self.segments]
        for k, (one, left) in enumerate(zip(self.segments, every, strict=True)):
            for along in self._along(x, k, np.inf):
                here = (along.values - one.ticks.measured[along.ticks]) / self._sigma[k][along.ticks]
                left[along.ticks] = np.where(self._use[k][along.ticks, None], here, np.nan)
        return np.concatenate([one.ticks.time_s for one in self.segments]), np.concatenate(every)

    def without_payload(self, x: FloatArray) -> list[Block]:
        """Normal equations if nothing were held, all else as in x, (p,), rates by the first readings."""
        bare = x[: self._constants].copy()
        bare[:10] = 0.0
        return self.blocks(self.start(bare))

    def _settle(self, x: FloatArray, tolerance: float, length_s: float = np.inf) -> tuple[Fit, tuple[Block, ...]]:
        self._weigh(x)
        best = np.inf, tuple[Block, ...](), self._squares

        evaluations = 0

        def evaluate(at: FloatArray) -> Normal:
            nonlocal best, evaluations
            evaluations += 1
            if evaluations > _EVALUATIONS:
                raise ConvergenceError(f"not converged after {_EVALUATIONS} predictions of the flight")
            blocks = tuple(self.blocks(at, length_s))
            total = total_of(blocks, len(self.names))
            cost = total.squares + float(np.nansum((at / self.sigma) ** 2))
            if cost < best[0]:
                best = cost, blocks, self._squares
            return total

        found = fit_normal(evaluate, x, np.zeros_like(x), self.prior_information, _EVALUATIONS, tolerance)
        self._squares = best[2]
        return found, best[1]

    def _weigh(self, x: FloatArray) -> None:
        """Add the effect of the joints' noise, with the payload of x, to the IMU's."""
        for k, one in enumerate(self.segments):
            noise = self._predictor.joint_noise(one.ticks.q, one.ticks.joint_sigma, self._state(x, k))
            self._sigma[k] = np.hypot(one.ticks.sigma, noise)

    def _leave_out(self) -> int:
        """Leave out ticks that the last fit contradicts, if these are few; returns their number."""
        limit = float(chdtri(6.0, _GLITCH))
        kept = [use & ~(squares > limit) for use, squares in zip(self._use, self._squares, strict=True)]
        out = sum(int(use.sum() - own.sum()) for use, own in zip(self._use, kept, strict=True))
        if out > _MOST_GLITCHES * sum(int(use.sum()) for use in self._use):
            return 0
        self._use = kept
        return out

    def _state(self, x: FloatArray, segment: int) -> FloatArray:
        """The predictor's state at the start of a segment, without the biases' lines; (predictor's p,)."""
        at = self._constants + 3 * segment
        state = np.concatenate([x[at : at + 3], x[: self._constants]])
        if not self.segments[segment].held:
            state[PAYLOAD] = 0.0
        for bias_at, drift_at in self._predictor.biases:
            state[bias_at] = state[drift_at] = 0.0
        return state

    def _along(self, x: FloatArray, segment: int, length_s: float) -> Iterator[_Along]:
        """Block by block along a segment."""
        ticks, p = self.segments[segment].ticks, len(self._predictor.names)
        last = min(len(ticks.time_s), max(_SHORTEST_TICKS, round(min(length_s, 1e6) / self._predictor.period_s)))
        state, d_rate, first = self._state(x, segment), np.eye(3, p), 0
        while last - first >= _FEWEST_TICKS:
            end = last if last - first < 2 * _BLOCK_TICKS else first + _BLOCK_TICKS + 2
            some = ticks.part(slice(first, end))
            predicted = self._predictor.predict(some.q, some.dq, some.ddq, state, some.cyclic)
            here = slice(first + 1, end - 1)
            lines, values = self._lines(ticks.time_s[here]), predicted.values
            for at, (bias_at, _) in zip(self._of_lines, self._predictor.biases, strict=True):
                values = values + (lines @ x[at])[:, None] * predicted.jacobian[:, :, bias_at]
            yield _Along(here, values, predicted.jacobian, d_rate, lines)
            transition = predicted.transition[RATE].copy()
            transition[:, RATE] = 0.0
            d_rate = predicted.transition[RATE, RATE] @ d_rate + transition
            state = state.copy()
            state[RATE] = predicted.state[RATE]
            first = end - 2

    def _lines(self, time_s: FloatArray) -> FloatArray:
        """Offset, slope and kinks of a bias at some times, (n, 2 + kinks)."""
        t = time_s - self._begin_s
        return np.column_stack([np.ones_like(t), t, np.maximum(0.0, t[:, None] - self._kinks_s)])

    def _jacobian(self, along: _Along, segment: int) -> FloatArray:
        """By all parameters, (b, 6, p)."""
        J = np.zeros((*along.values.shape, len(self.names)))
        J[:, :, : self._constants] = along.jacobian[:, :, RATE.stop :]
        by_rate = along.jacobian[:, :, RATE]
        J[:, :, : self._constants] += by_rate @ along.d_rate[:, RATE.stop :]
        at = self._constants + 3 * segment
        J[:, :, at : at + 3] = by_rate @ along.d_rate[:, RATE]
        for columns, (bias_at, _) in zip(self._of_lines, self._predictor.biases, strict=True):
            J[:, :, columns] = along.jacobian[:, :, bias_at, None] * along.lines[:, None]
        if not self.segments[segment].held:
            J[:, :, :10] = 0.0
        return J


def total_of(blocks: Sequence[Block], parameters: int) -> Normal:
    """Normal equations of all blocks together."""
    information, gradient, squares = np.zeros((parameters, parameters)), np.zeros(parameters), 0.0
    for block in blocks:
        information += block.normal.information
        gradient += block.normal.gradient
        squares += block.normal.squares
    return Normal(information, gradient, squares)


def _by_instrument(blocks: Sequence[Block]) -> dict[str, float]:
    """Residual sum over the number of rows, of all rows or of the part in which it is largest beyond chance."""
    found = {}
    for instrument in INSTRUMENTS:
        own = [block for block in blocks if block.instrument == instrument]
        of_all = sum(block.normal.squares for block in own) / max(1, sum(block.rows for block in own))
        parts = [block.normal.squares / float(chdtri(block.rows, _CHANCE)) for block in own if block.rows]
        found[instrument] = max([of_all, *parts])
    return found
