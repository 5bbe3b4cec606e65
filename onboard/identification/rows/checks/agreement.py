"""Tests whether the rows agree: unexplained readings and steps of an instrument's gain, which no interval contains.

Per instrument, at the estimate of all rows:

- *Gain*: a step of it, and an error of it against the other instruments
  (:mod:`onboard.identification.rows.checks.gain`), all considered errors but gains estimated beside it: a drift of a
  zero is no step. Rows that read nothing, those of a wrench known to be zero, have no gain.
- *Between recordings*: an arm that was recorded without its load and later with it has cooled down or warmed up, and
  what its gears lose with it. Where a step between the recordings is nearly as likely as the likeliest, it is that one;
  it is reported, its effect is in the intervals, and nothing is refused for it.
- *Misfit*: residual relative to the noise, and to the signal, of the worst kind of rows that noise does not explain.
  The noise of the motion is computed at the estimate, at most that at the plain least squares' or at the drawing: of
  parameters that no row tells, the correction for this noise may go so far that the noise explains any residual.
- *Response*: readings relative to those predicted from the URDF. A ratio near zero is an unloaded or dead instrument.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import FARTHEST_SIZE, LIKELY_SIZE, MISFIT_PART, MOSTLY, REFUSE, of_each
from onboard.identification.rows.checks.gain import Blocks, GainError, GainTests
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import OF_GAIN, Considered

_NONE, _EXACT = np.zeros(0), 1e-12  # no considered errors; sigma of one of which the file states none
MOST_UNEXPLAINED = FARTHEST_SIZE * LIKELY_SIZE  # of what was measured, left over by the fit: by the farthest scale


class InstrumentFit(NamedTuple):
    """How one instrument's rows stand to the estimate of all."""

    instrument: str
    rows: float
    misfit: float  # residual sum over that of the noise at the estimate, of the kind of rows that is explained worst
    unexplained: float  # share of these readings, bias aside, that the estimate leaves over; of rows that read nothing,
    # of what the known bodies alone leave over
    response: float  # rms of the readings over that predicted from the URDF; NaN for rows that read nothing
    step: GainError | None  # None where there is not enough to be cut
    gain: GainError | None = None  # its error against the others; None where no other tells of it

    @property
    def suspected(self) -> tuple[FloatArray, ...]:
        """What a step of its gain, and an error of it, do to the estimate beyond chance, (p,) each."""
        return tuple(one.suspected for one in (self.step, self.gain) if one is not None)


def instrument_fits(
    blocks: RowBlocks,
    mean: FloatArray,
    plain: FloatArray,
    drawn: FloatArray,
    known: FloatArray,
    physical: BoolArray,
    prior: FloatArray,
    correlation: float,
    recorded_apart: bool = False,
    considered: FloatArray = _NONE,
) -> tuple[InstrumentFit, ...]:
    """Gain step, misfit and response of each instrument's rows, by the equations in this module's head.

    Args:
        blocks: the rows.
        mean: the estimate, (p,).
        plain: that of the plain least squares, (p,).
        drawn: base parameters of the drawing, (p,).
        known: those of the drawing without the unknown body, (p,): what it leaves of rows of a wrench that is zero.
        physical: which parameters are of bodies, and not of an instrument, (p,).
        prior: information on the parameters before the rows, (p, p).
        correlation: how many neighbouring rows say the same thing: the square of the sigmas' inflation.
        recorded_apart: rows with the payload and those without are of different recordings.
        considered: sigmas of the considered errors, (k,): of those with one, what else may explain a gain.
    """
    none = np.zeros(len(considered))
    v, *others = (np.concatenate([one, none, [-1.0, 0.0]]) for one in (mean, plain, drawn))
    rows_of = {part: blocks.with_errors(*part) for part in blocks.parts}
    judged = {part: _part(blocks.times_s(*part), *rows_of[part], v, correlation) for part in blocks.parts}
    every = block_diag(prior, np.diag(correlation / np.maximum(considered, _EXACT) ** 2))
    every += sum(part.H.sum(axis=0) for part in judged.values())
    if len(none) and judged:
        v[:-2] += _beside(every, sum(part.scores.sum(axis=0) for part in judged.values()), len(mean))
        judged = {part: _part(blocks.times_s(*part), *rows_of[part], v, correlation) for part in blocks.parts}
    body, plan = np.append(np.where(physical, v[: len(mean)], 0.0), none), np.where(physical, drawn, 0.0)
    found = []
    begins = [
        min((part.times_s.min() for (held, _), part in judged.items() if held is own), default=np.inf)
        for own in (True, False)
    ]
    another_s = max(begins) if recorded_apart else np.inf  # when the second of the recordings begins
    for number, name in enumerate(blocks.instruments):
        parts, squares, worst = list[Blocks](), np.zeros(4), (False, 0.0, 0.0)
        for held, own in blocks.parts:
            if own != number:
                continue
            (of_rows, noise), left = rows_of[held, number], judged[held, number].left
            signal, as_drawn = (_sums(of_rows, one) for one in (body, plan))
            rows = float((of_rows[:, -1, -1] + noise[:, -1, -1]).sum())
            readings = np.abs(of_rows[:, -2, -2])
            sums = np.array([rows, signal.sum(), as_drawn.sum(), readings.sum()])
            squares += sums
            whole = left.sum() + sums[1] if sums[3] else _sums(of_rows + noise, known).sum()
            unexplained = min(1.0, np.sqrt(left.sum() / whole)) if whole else 1.0
            of_motion = [max(float(one @ noise.sum(axis=0) @ one), 0.0) for one in (v, *others)]
            expected = blocks.own(held, number) + correlation * min(of_motion[0], max(of_motion[1:]))
            misfit = float(left.sum() / expected)
            worst = max(worst, (misfit * correlation > MISFIT_PART, float(unexplained), misfit))
            if readings.any():
                parts.append(judged[held, own])
        rows, signal_sum, drawn_sum, read = squares.tolist()
        if rows:
            response = np.sqrt(signal_sum / drawn_sum) if drawn_sum > 0.0 and read > 0.0 else np.nan
            beside = [part for (_, own), part in judged.items() if own != number]
            gains = GainTests(parts, beside, body, every) if parts else None
            step, gain = (gains.step(another_s), gains.error()) if gains else (None, None)
            step, gain = (one and one._replace(moved=one.moved[: len(mean)]) for one in (step, gain))
            found.append(InstrumentFit(name, rows, worst[2], worst[1], float(response), step, gain))
    return tuple(found)


def _beside(every: FloatArray, scores: FloatArray, parameters: int) -> FloatArray:
    """By how much an estimate of p parameters alone, and errors of zero, are off that of both, (p + k,).

    Args:
        every: information on both, (p + k, p + k).
        scores: sum of all rows' scores at that estimate, (p + k,).
        parameters: p.
    """
    return np.asarray(np.linalg.solve(every, np.append(np.zeros(parameters), scores[parameters:])), np.float64)


def _sums(N: FloatArray, v: FloatArray) -> FloatArray:
    """``v' N v`` of each block, (b,), not below zero; of its first parameters where ``v`` has no more."""
    n = v.size
    return np.asarray(np.maximum(N[:, :n, :n] @ v @ v, 0.0))


def _part(times_s: FloatArray, of_rows: FloatArray, noise: FloatArray, v: FloatArray, correlation: float) -> Blocks:
    """One instrument's blocks, with the payload or without, at the estimate ``v``, (p + 2,)."""
    N, read = of_rows + noise, of_rows @ v
    scores, left = -read[:, :-2], np.maximum((read + noise @ v) @ v, 0.0)
    return Blocks(times_s, N[:, :-2, :-2], scores, left, correlation / N[:, -1, -1])


def but_gains(sigma: FloatArray, considered: Sequence[Considered]) -> FloatArray:
    """Sigmas of considered errors, (k,), those of gains zero."""
    return np.where([cause.effect in OF_GAIN for cause in considered], 0.0, sigma)


def with_stated(fits: Sequence[InstrumentFit], considered: Sequence[Considered]) -> tuple[InstrumentFit, ...]:
    """The same with the sigmas that are stated: of a step between recordings, and of a scale against another's."""
    between = {one.row: one.sigma for one in considered if one.effect == "held_scale"}
    scale = float(np.hypot.reduce([one.sigma for one in considered if one.effect == "scale" and one.row], initial=0.0))
    return tuple(
        fit._replace(
            step=fit.step and fit.step._replace(stated=between.get(fit.instrument, 0.0)),
            gain=fit.gain and fit.gain._replace(stated=scale),
        )
        for fit in fits
    )


def judged_fit(fit: InstrumentFit, correlation: float) -> tuple[list[str], list[str]]:
    """Reasons to refuse all estimates and reasons to weaken them, from the rows of one instrument.

    Args:
        fit: at the estimate of all rows.
        correlation: how many neighbouring rows say the same thing: the square of the sigmas' inflation.
    """
    against, doubts, name = list[str](), list[str](), fit.instrument
    if fit.response < LIKELY_SIZE:  # no more than what a drawing may be wrong by
        against.append(f"{name} reads {fit.response:.0%} of what the drawing makes of this motion")
    if fit.misfit * correlation > MISFIT_PART and fit.unexplained > MOSTLY * MOST_UNEXPLAINED:
        said = f"{fit.unexplained:.0%} of what {name} reads is left over"
        (against if fit.unexplained > MOST_UNEXPLAINED else doubts).append(said)
    step = fit.step
    if step is not None and step.is_significant and not step.between:
        said = f"{name} reads {step.size:+.0%} of the motion from {step.since_s:.1f} s after its first row on"
        said += ": it or a joint's sensor has changed"
        (against if step.chance < of_each(REFUSE) else doubts).append(said)
    return against, doubts


def judged_between(fits: Sequence[InstrumentFit]) -> tuple[list[str], list[str], list[str]]:
    """The same, and remarks, of what differs between the recordings; instruments of the same level share a sentence."""
    doubts, told, alike = list[str](), list[str](), dict[tuple[bool, bool], list[tuple[str, GainError]]]()
    for fit in fits:
        if (step := fit.step) is not None and step.is_significant and step.between:
            alike.setdefault((step.is_as_stated, abs(step.size) > LIKELY_SIZE), []).append((fit.instrument, step))
    for (as_stated, large), some in alike.items():
        names = ", ".join(f"{name} {step.size:+.0%}" for name, step in some)
        said = f"of the same motion the recording with the payload, from {some[0][1].since_s:.1f} s on, reads {names}"
        if as_stated:
            told.append(f"{said}: within what is stated between recordings")
            continue
        said += ": gains or friction have changed between the recordings, and the intervals hold what that does"
        (doubts if large else told).append(said)
    return [], doubts, told
