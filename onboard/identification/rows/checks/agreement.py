"""Tests whether the rows agree: unexplained readings and steps of an instrument's gain, which no interval contains.

Per instrument, at the estimate of all rows:

- *Gain*: a jump of the instrument's scale, or an error that begins in the measured motion, is a step of the ratio of
  readings to those predicted, with the payload and without it. It is estimated together with a constant error of the
  gain and all parameters, which take up part of it, for each time at which it could be. The likeliest is tested by
  Student's t, corrected for the number of places tried, with the variance that the blocks' scores show and at least
  that of the stated noise, and of what is left over besides the step in the very blocks that tell of it: a few blocks
  at an end, alike by chance in what vibration leaves, are no step, and vibration of a fast sweep hides no step that a
  slow one shows. What other instruments leave over counts too, as far as they tell of what takes up part of the step.
  A block that carries much of the step is given its leverage: one block of noise at an end is none.
  Degrees of freedom are twice the blocks that tell of it, in effect ``(sum I_b)^2 / sum I_b^2`` by the information I_b
  of each (Kish, Survey Sampling, 1965): a block is two kernels long. After a release few tell of the rows without it.
  Rows that read nothing, those of a wrench known to be zero, have no gain.
- *Between recordings*: an arm that was recorded without its load and later with it has cooled down or warmed up, and
  what its gears lose with it. Where a step between the recordings is nearly as likely as the likeliest, it is that one;
  it is reported and its effect is in the intervals, and what is found is not refused for it.
- *Suspicion*: a step that few blocks tell of is no reason to refuse, but may be one. By the scatter of all blocks its
  variance is known better, and intervals contain what it does to the estimate, beyond what chance is expected to do.
- *Misfit*: residual relative to the noise, and to the signal, of the worst kind of rows that noise does not explain.
  What the noise of the motion makes is taken at the estimate, but is no more than at the plain least squares' or at the
  drawing: what no row tells, the correction for this noise may carry off until the noise "explains" any residual.
- *Response*: readings relative to those predicted from the URDF. A ratio near zero is an unloaded or dead instrument.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from onboard.dynamics.spatial import times
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import (
    DOUBT,
    HALF,
    INTERVAL,
    LIKELY_SIZE,
    MISFIT_PART,
    MOST_SHARE,
    MOSTLY,
    REFUSE,
    of_each,
)
from onboard.identification.rows.row_blocks import RowBlocks

MOST_UNEXPLAINED = 0.3  # of what was measured, left over by the fit
LEAST_RESPONSE = 0.1  # of what the drawing makes of the motion
_STILL = 0.01  # of the mean of what the drawing makes of the motion: a block in which nothing moves
_ABSORBED = 0.01  # of a step's information: what the parameters leave of one at the release of a payload
LEAST_STEP = 0.03  # of a gain: instruments creep, and gears ripple; intervals contain smaller ones
_NEARLY = 0.8  # of the likeliest step's chi-squared: as Student's t of those few blocks it is as likely


class GainStep(NamedTuple):
    """The likeliest step of an instrument's gain."""

    time_s: float
    size: float  # relative
    chance: float  # that as much comes of the scatter of the blocks that tell of it
    sigmas: float  # of the scatter of all blocks, each relative to what is left over in it
    expected: float  # so many sigmas, or more, by a chance of 5 %
    moved: FloatArray  # (p,) of the estimate, by the step
    since_s: float = 0.0  # the first of the rows, until the step
    between: bool = False  # the recording without the payload, and that with it
    stated: float = 0.0  # sigma of such a step that the vehicle file states, and that intervals hold

    @property
    def is_one(self) -> bool:
        """Whether it is larger than what intervals contain, and not by chance."""
        return self.chance < of_each(DOUBT) and abs(self.size) > LEAST_STEP

    @property
    def is_as_stated(self) -> bool:
        """Whether it lies between the recordings, and within two of the sigmas stated for that."""
        return self.between and abs(self.size) <= HALF * self.stated

    @property
    def suspected(self) -> FloatArray:
        """What it does to the estimate, beyond what scatter is expected to do, (p,); nothing if it is as stated."""
        if self.is_as_stated:
            return np.zeros_like(self.moved)
        beyond = max(0.0, 1.0 - (self.expected / self.sigmas) ** 2) if self.sigmas else 0.0
        return np.asarray(self.moved * np.sqrt(beyond), np.float64)


class InstrumentFit(NamedTuple):
    """How one instrument's rows stand to the estimate of all."""

    instrument: str
    rows: float
    misfit: float  # residual sum over that of the noise at the estimate, of the kind of rows that is explained worst
    unexplained: float  # share of these readings, bias aside, that the estimate leaves over; of rows that read nothing,
    # of what the known bodies alone leave over
    response: float  # rms of the readings over that predicted from the URDF; NaN for rows that read nothing
    still: float  # part of what is left over that was read while, by the encoders, nothing moved
    step: GainStep | None  # None where there is not enough to be cut


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
    """
    v, *others = (np.concatenate([one, [-1.0, 0.0]]) for one in (mean, plain, drawn))
    rows_of = {part: blocks.apart(*part) for part in blocks.parts}
    judged = {part: _part(blocks.times_s(*part), *rows_of[part], v, correlation) for part in blocks.parts}
    every = prior + sum(part.H.sum(axis=0) for part in judged.values())
    body, plan = np.where(physical, mean, 0.0), np.where(physical, drawn, 0.0)
    found = []
    begins = [
        min((part.times_s.min() for (held, _), part in judged.items() if held is own), default=np.inf)
        for own in (True, False)
    ]
    another_s = max(begins) if recorded_apart else np.inf  # when the second of the recordings begins
    for number, name in enumerate(blocks.instruments):
        parts, squares, worst, lost = list[_Part](), np.zeros(4), (False, 0.0, 0.0), np.zeros(2)
        for held, own in blocks.parts:
            if own != number:
                continue
            (of_rows, noise), left = rows_of[held, number], judged[held, number].left
            signal, as_drawn = (_sums(of_rows, one) for one in (body, plan))
            rows = float((of_rows[:, -1, -1] + noise[:, -1, -1]).sum())
            readings = np.abs(of_rows[:, -2, -2])
            sums = np.array([rows, signal.sum(), as_drawn.sum(), readings.sum()])
            squares += sums
            lost += left[as_drawn < _STILL * as_drawn.mean()].sum(), left.sum()
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
            step = _step(parts, beside, body, every, another_s) if parts else None
            still = float(lost[0] / lost[1]) if lost[1] else 0.0
            found.append(InstrumentFit(name, rows, worst[2], worst[1], float(response), still, step))
    return tuple(found)


def _sums(N: FloatArray, v: FloatArray) -> FloatArray:
    """``v' N v`` of each block, (b,), not below zero; of its first parameters where ``v`` has no more."""
    n = v.size
    return np.asarray(np.maximum(N[:, :n, :n] @ v @ v, 0.0))


class _Part(NamedTuple):
    """Blocks of an instrument's rows."""

    times_s: FloatArray  # when each begins, (b,)
    H: FloatArray  # information of each, (b, p, p)
    scores: FloatArray  # derivative of each one's log likelihood at the estimate, (b, p)
    left: FloatArray  # residual sum of each, (b,)
    of_noise: FloatArray  # what makes it one of their stated noise, (b,)


def _part(times_s: FloatArray, of_rows: FloatArray, noise: FloatArray, v: FloatArray, correlation: float) -> _Part:
    """One instrument's blocks, with the payload or without, at the estimate ``v``, (p + 2,)."""
    N, read = of_rows + noise, of_rows @ v
    scores, left = -read[:, :-2], np.maximum((read + noise @ v) @ v, 0.0)
    return _Part(times_s, N[:, :-2, :-2], scores, left, correlation / N[:, -1, -1])


def _step(
    parts: Sequence[_Part], others: Sequence[_Part], body: FloatArray, every: FloatArray, recorded_s: float
) -> GainStep | None:
    """The likeliest step of an instrument's gain; None where its blocks are too few to be cut.

    Readings after a cut k are predicted as ``(1 + g + G) Y body``, those before as ``(1 + G) Y body``. All parameters
    are estimated again with g and G, by one step of Newton's from the estimate, where the scores of all rows add up to
    zero:

        a_k = every^-1 sum_(b >= k) H_b body,  E_jk = sum_(b >= j, b >= k) body' H_b body - a_j' sum_(b >= k) H_b body
        r = E_0k / E_00,  c_b = ([b >= k] - r) body - (a_k - r a_0),  g = sum_b ([b >= k] - r) body' scores_b / I

    with ``I = E_kk - r E_0k``.

    Args:
        parts: its rows, with the payload and without.
        others: those of the other instruments, which tell of the parameters that take up part of the step.
        body: the estimate's parameters of bodies, (p,).
        every: information of all rows and the prior, (p, p).
        recorded_s: when another recording begins.
    """
    times_s = np.concatenate([part.times_s for part in parts])
    order = np.argsort(times_s, kind="stable")
    times_s, n = times_s[order], len(times_s)
    of_body, scores, left, of_noise = (
        np.concatenate(column)[order] for column in zip(*((part.H @ body, *part[2:]) for part in parts), strict=True)
    )
    if n < 3 or not body.any():
        return None
    later = np.cumsum(of_body[::-1], axis=0)[::-1]  # (k, p) sums over the blocks from a cut on
    unit = 1.0 / np.sqrt(np.diag(every))
    a = np.linalg.solve(every * np.outer(unit, unit), (later * unit).T).T * unit
    of_cut = later @ body - np.einsum("kp,kp->k", later, a)
    of_all = later @ body - a @ later[0]
    share = of_all / (of_cut[0] + LIKELY_SIZE**-2)
    scored = np.cumsum((scores @ body)[::-1])[::-1]
    information = of_cut - share * of_all
    information = np.where(information > _ABSORBED * (later @ body), information, 0.0)
    moved = scored - share * scored[0]
    information[0] = 0.0
    likely = np.divide(moved * moved, information, out=np.zeros(n), where=information > 0.0)
    k = int(np.argmax(likely))
    apart = [cut for cut in range(1, n) if times_s[cut - 1] < recorded_s <= times_s[cut]]
    between = bool(apart and likely[apart[0]] > _NEARLY * likely[k])
    k = apart[0] if between else k
    if not information[k] > 0.0:
        return None
    size = float(moved[k] / information[k])
    taken_up = share[k] * a[0] - a[k]
    c = np.outer((np.arange(n) >= k) - share[k], body) + taken_up
    unsorted, ends = np.empty_like(c), np.cumsum([len(part.times_s) for part in parts])[:-1]
    unsorted[order] = c
    shares = np.concatenate([_squares(part.H, own) for part, own in zip(parts, np.split(unsorted, ends), strict=True)])
    shares, told = shares[order], (c * scores).sum(axis=1)
    if others:
        shares = np.concatenate([shares, *(part.H @ taken_up @ taken_up for part in others)])
        told = np.concatenate([told, *(part.scores @ taken_up for part in others)])
        left, of_noise = (
            np.concatenate([one, *more])
            for one, *more in zip((left, of_noise), *(part[3:] for part in others), strict=True)
        )
    unexplained = np.maximum(1.0, (left - 2.0 * size * told + size**2 * shares) * of_noise)  # besides the step
    around = (told - shares * size) ** 2  # of each block, scattered by ``shares`` times what is unexplained
    leverage, tells = np.minimum(shares / information[k], MOST_SHARE), shares > 0.0
    noise = float(shares @ unexplained)
    scatter = float((around[tells] / (shares * unexplained * (1.0 - leverage))[tells]).mean())
    tried, told_k = int(np.count_nonzero(information)), abs(size) * information[k]
    surely = told_k / np.sqrt(max(float((around / (1.0 - leverage) ** 2).sum()), noise))
    freedom = 2.0 * float(shares.sum() ** 2 / (shares @ shares))
    chance = min(1.0, 2.0 * float(stdtr(freedom, -surely)) * tried)
    sigmas = float(told_k / np.sqrt(max(1.0, scatter) * noise))
    expected = -float(stdtrit(n - 2, 0.5 * (1.0 - INTERVAL) / tried))
    since_s = float(times_s[k] - times_s[0])
    return GainStep(float(times_s[k]), size, chance, sigmas, expected, a[k] * size, since_s, between)


def _squares(H: FloatArray, c: FloatArray) -> FloatArray:
    """``c' H c`` of each, (b,): matrices (b, p, p), vectors (b, p)."""
    return np.asarray((times(H, c) * c).sum(axis=1), np.float64)


def with_stated(fits: Sequence[InstrumentFit], stated: Mapping[str, float]) -> tuple[InstrumentFit, ...]:
    """The same with the sigma that is stated of a step between recordings, by instrument."""
    return tuple(
        fit._replace(step=fit.step._replace(stated=stated.get(fit.instrument, 0.0))) if fit.step else fit
        for fit in fits
    )


def judged_fit(fit: InstrumentFit, correlation: float) -> tuple[list[str], list[str], list[str]]:
    """Reasons to refuse all estimates, reasons to weaken them, and remarks, from the rows of one instrument.

    Args:
        fit: at the estimate of all rows.
        correlation: how many neighbouring rows say the same thing: the square of the sigmas' inflation.
    """
    against, doubts, told, name = list[str](), list[str](), list[str](), fit.instrument
    if fit.response < LEAST_RESPONSE:
        against.append(f"{name} reads {fit.response:.0%} of what the drawing makes of this motion")
    if fit.misfit * correlation > MISFIT_PART and fit.unexplained > MOSTLY * MOST_UNEXPLAINED:
        said = f"{fit.unexplained:.0%} of what {name} reads is left over"
        if fit.still > MOSTLY:
            said += ", most of it where no joint moves: is an encoder stuck?"
        (against if fit.unexplained > MOST_UNEXPLAINED else doubts).append(said)
    step = fit.step
    if step is not None and step.is_one and not step.between:
        said = f"{name} reads {step.size:+.0%} of the motion from {step.since_s:.1f} s after its first row on"
        said += ": it or a joint's sensor has changed"
        (against if step.chance < of_each(REFUSE) else doubts).append(said)
    return against, doubts, told


def judged_between(fits: Sequence[InstrumentFit]) -> tuple[list[str], list[str], list[str]]:
    """The same of what differs between the recordings, in one sentence for instruments of which it is as bad."""
    doubts, told, alike = list[str](), list[str](), dict[tuple[bool, bool], list[tuple[str, GainStep]]]()
    for fit in fits:
        if (step := fit.step) is not None and step.is_one and step.between:
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
