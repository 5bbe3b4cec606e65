"""Tests whether the rows agree: unexplained readings and steps of an instrument's gain, which no interval contains.

Per instrument, at the estimate of all rows:

- *Gain*: ratio of readings to readings predicted by the estimate, per block of time. A jump of the instrument's scale,
  or an error that begins in the measured motion, is a step of it. The likeliest step is tested by Student's t on the
  scatter of the gains on its two sides, corrected for the number of places tried. A side whose own gains scatter more
  than all do is judged by its own scatter: one block of noise at an end is no step. Rows that read nothing, those
  of a wrench known to be zero, have no gain.
- *Misfit*: residual relative to the noise, as the estimate makes it of the noise of the motion, and to the signal.
- *Response*: readings relative to those predicted from the URDF. A ratio near zero is an unloaded or dead instrument.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.identification.rows.row_blocks import RowBlocks

MOST_UNEXPLAINED = 0.3  # of what was measured, left over by the fit
DOUBTFUL_UNEXPLAINED = 0.15
NOISE = 4.0  # residual sum a row that may still be noise
LEAST_RESPONSE = 0.1  # of what the drawing makes of the motion
_STILL = 0.01  # of the mean of what the drawing makes of the motion: a block in which nothing moves
_OF_STILL = 0.5  # of what is left over: it comes of such blocks
LARGE_STEP, LEAST_STEP, DOUBTFUL_STEP = 0.1, 0.03, 0.015  # of a gain: instruments creep, and gears ripple
STEP_CHANCE, DOUBTFUL_CHANCE = 1e-4, 1e-3  # that a step comes of the scatter of the gains
_FEWEST = 2  # blocks on each side of a step
_LOADED = 0.005  # of the mean information on the gain: a block with less is not asked


class Step(NamedTuple):
    """The likeliest step of an instrument's gain."""

    time_s: float
    size: float  # relative
    chance: float  # that as much comes of the scatter


class InstrumentFit(NamedTuple):
    """How one instrument's rows stand to the estimate of all."""

    instrument: str
    rows: float
    misfit: float  # residual sum over that of the noise at the estimate, of the kind of rows that is explained worst
    unexplained: float  # share of these readings, bias aside, that the estimate leaves over
    response: float  # rms of the readings over that predicted from the URDF; NaN for rows that read nothing
    still: float  # part of what is left over that was read while, by the encoders, nothing moved
    step: Step | None  # None where there is not enough to be cut


def instrument_fits(
    blocks: RowBlocks, mean: FloatArray, drawn: FloatArray, physical: BoolArray, correlation: float
) -> tuple[InstrumentFit, ...]:
    """Gain step, misfit and response of each instrument's rows, by the equations in this module's head.

    Args:
        blocks: the rows.
        mean: the estimate, (p,).
        drawn: base parameters of the drawing, (p,).
        physical: which parameters are of bodies, and not an instrument's bias, (p,).
        correlation: how many neighbouring rows say the same thing: the square of the sigmas' inflation.
    """
    v = np.concatenate([mean, [-1.0, 0.0]])
    found = []
    for number, name in enumerate(blocks.instruments):
        steps, squares, worst, lost = list[Step](), np.zeros(4), (0.0, 0.0), np.zeros(2)
        for held, own in blocks.parts:
            if own != number:
                continue
            N, noise = blocks.of(held, number)
            left, signal, as_drawn, gain = _sums(N, N - noise, mean, drawn, physical)
            rows = float(N[:, -1, -1].sum())
            readings = np.abs((N - noise)[:, -2, -2])
            sums = np.array([rows, signal.sum(), as_drawn.sum(), readings.sum()])
            squares += sums
            lost += left[as_drawn < _STILL * as_drawn.mean()].sum(), left.sum()
            unexplained = np.sqrt(left.sum() / (left.sum() + sums[1])) if sums[1] else 1.0
            expected = blocks.own(held, number) + correlation * max(float(v @ noise.sum(axis=0) @ v), 0.0)
            worst = max(worst, (float(unexplained), float(left.sum() / expected)))
            steps += _steps(blocks.times_s(held, number), gain, signal) if readings.any() else []
        rows, signal_sum, drawn_sum, read = squares.tolist()
        if rows:
            response = np.sqrt(signal_sum / drawn_sum) if drawn_sum > 0.0 and read > 0.0 else np.nan
            step = min(steps, key=lambda one: one.chance, default=None)
            still = float(lost[0] / lost[1]) if lost[1] else 0.0
            found.append(InstrumentFit(name, rows, worst[1], worst[0], float(response), still, step))
    return tuple(found)


def _sums(
    N: FloatArray, clean: FloatArray, mean: FloatArray, drawn: FloatArray, physical: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """By block, (b,) each: residual sum, power of the signal, of the drawing's, and deviation of the gain."""
    v = np.concatenate([mean, [-1.0, 0.0]])
    left = np.maximum(np.einsum("i,bij,j->b", v, N, v), 0.0)
    body, plan = np.where(physical, mean, 0.0), np.where(physical, drawn, 0.0)
    H = clean[:, :-2, :-2]
    signal = np.maximum(np.einsum("i,bij,j->b", body, H, body), 0.0)
    as_drawn = np.maximum(np.einsum("i,bij,j->b", plan, H, plan), 0.0)
    scores = clean[:, :-2, -2] - H @ mean
    gain = np.divide(scores @ body, signal, out=np.zeros_like(signal), where=signal > 0.0)
    return left, signal, as_drawn, gain


def _steps(times_s: FloatArray, gain: FloatArray, weight: FloatArray) -> list[Step]:
    """The likeliest step of the gains of n blocks; none where they are too few to be cut."""
    loaded = weight > _LOADED * weight.mean() if len(weight) else np.zeros(0, np.bool_)
    times_s, gain, weight = times_s[loaded], gain[loaded], weight[loaded]
    n = len(gain)
    best: list[Step] = []
    for cut in range(_FEWEST, n - _FEWEST + 1):
        sides = (gain[:cut], weight[:cut]), (gain[cut:], weight[cut:])
        m = [np.average(g, weights=w) for g, w in sides]
        scatter = [w @ (g - mean) ** 2 for (g, w), mean in zip(sides, m, strict=True)]
        around = max(sum(scatter) / (n - 2), np.finfo(np.float64).tiny)
        both = zip(scatter, sides, strict=True)
        spread = sum(max(around, own / (len(g) - 1)) / w.sum() for own, (g, w) in both)
        t = abs(m[1] - m[0]) / np.sqrt(spread)
        chance = min(1.0, 2.0 * float(stdtr(n - 2, -t)) * (n - 2 * _FEWEST + 1))
        best.append(Step(float(times_s[cut]), float(m[1] - m[0]), chance))
    return [min(best, key=lambda one: one.chance)] if best else []


def judged_fit(fit: InstrumentFit, correlation: float) -> tuple[list[str], list[str]]:
    """Reasons to refuse all estimates, and reasons to weaken them, from one instrument's rows.

    Args:
        fit: at the estimate of all rows.
        correlation: how many neighbouring rows say the same thing: the square of the sigmas' inflation.
    """
    against, doubts, name = list[str](), list[str](), fit.instrument
    if fit.response < LEAST_RESPONSE:
        against.append(f"{name} reads {fit.response:.0%} of what the drawing makes of this motion")
    if fit.misfit * correlation > NOISE and fit.unexplained > DOUBTFUL_UNEXPLAINED:
        said = f"{fit.unexplained:.0%} of what {name} reads is left over"
        if fit.still > _OF_STILL:
            said += ", most of it where no joint moves: is an encoder stuck?"
        (against if fit.unexplained > MOST_UNEXPLAINED else doubts).append(said)
    step = fit.step
    if step is not None and step.chance < DOUBTFUL_CHANCE and abs(step.size) > DOUBTFUL_STEP:
        said = f"{name} reads {step.size:+.0%} of the motion from one time on: it or a joint's sensor has changed"
        is_sure = (step.chance < STEP_CHANCE and abs(step.size) > LEAST_STEP) or abs(step.size) > LARGE_STEP
        (against if is_sure else doubts).append(said)
    return against, doubts
