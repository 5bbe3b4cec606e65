"""Tests whether the rows agree: unexplained readings and steps of an instrument's gain, which no interval contains.

Per instrument, at the estimate of all rows:

- *Gain*: a step of it, and an error of it against the other instruments (:class:`GainTests`), all considered errors but
  gains estimated beside it, and gains, too, where the answer is by these and of one recording: a drift of a zero is no
  step. Rows that read nothing, those of a wrench known to be zero, have no gain.
- *Between recordings*: an arm that was recorded without its load and later with it has cooled down or warmed up, and
  what its gears lose with it. Where a step between the recordings is nearly as likely as the likeliest, it is that one;
  it is reported, its effect is in the intervals, and nothing is refused for it.
- *Misfit*: residual relative to the noise, and to the signal, of the worst kind of rows that noise does not explain.
  The noise of the motion is computed at the estimate, at most that at the plain least squares' or at the drawing: of
  parameters that no row tells, the correction for this noise may go so far that the noise explains any residual.
- *Response*: readings relative to those predicted from the URDF. A ratio near zero is an unloaded or dead instrument.

The tests of a gain show whether rows show another one than the estimate of all rows takes, and since when. Every gain
is estimated together with all parameters, which take up part of it, by one step of Newton's from the estimate; the
blocks' scores there are those of :mod:`onboard.identification.rows.row_blocks`. It is tested by Student's t with the
variance that these scores show and at least that of the stated noise, and of what is left over besides in the very
blocks that tell of it: a few blocks at an end, alike by chance in what vibration leaves, are no step, and vibration of
a fast sweep hides no step that a slow one shows. What other instruments leave over counts too, as far as they tell of
what takes up part of the gain. A block that carries much of it is given its leverage: one block of noise at an end is
none. Degrees of freedom are twice the blocks that tell of it, in effect ``(sum I_b)^2 / sum I_b^2`` by the information
I_b of each (Kish, Survey Sampling, 1965): a block is two kernels long. After a release few blocks tell of the gain of
the rows without the payload.

- *Step*: a jump of the scale, or an error that begins in the measured motion. Estimated together with a constant error
  of the gain for each time at which it could be; the likeliest is tested, corrected for the number of places tried.
- *Error against the others*: a gain that is wrong from the beginning shows where other instruments read the same
  motion. Parameters that only this instrument tells of take it up whole: then there is none.
- *Effect on the intervals*: an error that too few blocks tell of to be sure may be real all the same. Intervals contain
  what it does to the estimate, beyond what chance does, with the variance by the scatter of all blocks.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.special import stdtr, stdtrit

from onboard.dynamics.spatial import times
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import (
    DOUBT,
    FARTHEST_SIZE,
    HALF,
    INTERVAL,
    LIKELY_SIZE,
    MISFIT_PART,
    MOST_SHARE,
    MOSTLY,
    ODDS,
    REFUSE,
    of_each,
)
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import OF_GAIN, Considered

_ABSORBED = 0.01  # of a gain's information: what the parameters leave of a step at the release of a payload
LEAST_STEP = 0.03  # of a gain: instruments creep, and gears ripple; intervals contain smaller ones


class Blocks(NamedTuple):
    """Blocks of an instrument's rows."""

    times_s: FloatArray  # when each begins, (b,)
    H: FloatArray  # information of each, (b, p, p)
    scores: FloatArray  # derivative of each one's log likelihood at the estimate, (b, p)
    left: FloatArray  # residual sum of each, (b,)
    of_noise: FloatArray  # one over what the stated noise makes of ``left``, (b,)


class GainError(NamedTuple):
    """An error of an instrument's gain: of all its rows, or the likeliest step."""

    size: float  # relative
    chance: float  # probability of as much by the scatter of the blocks that tell of it
    sigmas: float  # of the scatter of all blocks, each relative to what is left over in it
    expected: float  # sigmas that chance exceeds in 5 % of cases
    moved: FloatArray  # (p,) change of the estimate by it
    time_s: float = np.nan  # of a step
    since_s: float = 0.0  # the first of the rows, until the step
    between: bool = False  # it lies between the recording without the payload and that with it
    stated: float = 0.0  # sigma of such an error that the vehicle file states, and that intervals hold

    @property
    def is_significant(self) -> bool:
        """Whether it is larger than what is left to the intervals, and not by chance."""
        return self.chance < of_each(DOUBT) and abs(self.size) > LEAST_STEP

    @property
    def is_as_stated(self) -> bool:
        """Whether it lies between the recordings, and within two of the sigmas stated for that."""
        return self.between and abs(self.size) <= HALF * self.stated

    @property
    def suspected(self) -> FloatArray:
        """What it does to the estimate beyond what chance and the stated sigma explain, (p,); in the intervals."""
        explained = (self.expected / self.sigmas) ** 2 + (HALF * self.stated / self.size) ** 2 if self.size else 1.0
        return np.asarray(self.moved * np.sqrt(max(0.0, 1.0 - explained)), np.float64)


class GainTests:
    """Tests of one instrument's gain.

    Args:
        parts: blocks of its rows, with the payload and without.
        others: those of the other instruments, which tell of the parameters that take up part of a gain.
        body: the estimate's parameters of bodies, (p,).
        every: information of all rows and the prior, (p, p).
    """

    def __init__(self, parts: Sequence[Blocks], others: Sequence[Blocks], body: FloatArray, every: FloatArray) -> None:
        self._body, self._others = body, others
        times_s = np.concatenate([part.times_s for part in parts])
        order = np.argsort(times_s, kind="stable")
        self._times_s = times_s[order]
        self._H, self._scores, self._left, self._of_noise = (
            np.concatenate(column)[order] for column in zip(*(part[1:] for part in parts), strict=True)
        )
        of_body = times(self._H, np.broadcast_to(body, self._scores.shape))
        self._later = np.cumsum(of_body[::-1], axis=0)[::-1]  # (k, p) sums over the blocks from a cut on
        unit = 1.0 / np.sqrt(np.diag(every))
        self._a = np.linalg.solve(every * np.outer(unit, unit), (self._later * unit).T).T * unit
        self._of_cut = self._later @ body - np.einsum("kp,kp->k", self._later, self._a)
        self._scored = np.cumsum((self._scores @ body)[::-1])[::-1]

    def error(self) -> GainError | None:
        """Of the gain of all its rows; None where the parameters take it up, or too few blocks tell of it.

        Its information is ``E_00`` of :meth:`step`: what the parameters leave of ``sum_b body' H_b body``.
        """
        information = float(self._of_cut[0])
        if len(self._times_s) < 3 or not information > _ABSORBED * float(self._later[0] @ self._body):
            return None
        size, n = float(self._scored[0]) / information, len(self._times_s)
        return self._tested(np.ones(n), -self._a[0], size, information, 1)

    def step(self, recorded_s: float) -> GainError | None:
        """The likeliest step; None where the blocks are too few to be cut.

        Readings after a cut k are predicted as ``(1 + g + G) Y body``, those before as ``(1 + G) Y body``. All
        parameters are estimated again with g and G, where the scores of all rows add up to zero at the estimate:

            a_k = every^-1 sum_(b >= k) H_b body
            E_jk = sum_(b >= j, b >= k) body' H_b body - a_j' sum_(b >= k) H_b body
            r = E_0k / E_00,  c_b = ([b >= k] - r) body - (a_k - r a_0),  g = sum_b ([b >= k] - r) body' scores_b / I

        with ``I = E_kk - r E_0k``.

        Between two recordings a gain has changed in as many cases as an instrument is wrong (:data:`ODDS`) in others.

        Args:
            recorded_s: when another recording begins.
        """
        times_s, n, later, a = self._times_s, len(self._times_s), self._later, self._a
        if n < 3 or not self._body.any():
            return None
        of_all = later @ self._body - a @ later[0]
        share = of_all / (self._of_cut[0] + LIKELY_SIZE**-2)
        information = self._of_cut - share * of_all
        information = np.where(information > _ABSORBED * (later @ self._body), information, 0.0)
        moved = self._scored - share * self._scored[0]
        information[0] = 0.0
        likely = np.divide(moved * moved, information, out=np.zeros(n), where=information > 0.0)
        k = int(np.argmax(likely))
        apart = [cut for cut in range(1, n) if times_s[cut - 1] < recorded_s <= times_s[cut]]
        between = bool(apart and 0.5 * (likely[k] - likely[apart[0]]) < -np.log(ODDS))
        k = apart[0] if between else k
        if not information[k] > 0.0:
            return None
        of_block, taken_up = (np.arange(n) >= k) - share[k], share[k] * a[0] - a[k]
        tried, size = int(np.count_nonzero(information)), float(moved[k] / information[k])
        tested = self._tested(of_block, taken_up, size, float(information[k]), tried)
        moved_by, at_s = a[k] * size, float(times_s[k])
        return tested._replace(moved=moved_by, time_s=at_s, since_s=at_s - float(times_s[0]), between=between)

    def _tested(
        self, of_block: FloatArray, taken_up: FloatArray, size: float, information: float, tried: int
    ) -> GainError:
        """An error ``of_block`` (b,) times its size in each block, with what the parameters take up of it, (p,)."""
        c = np.outer(of_block, self._body) + taken_up
        shares, told = _squares(self._H, c), (c * self._scores).sum(axis=1)
        others = [(_squares(b.H, np.broadcast_to(taken_up, b.scores.shape)), b.scores @ taken_up) for b in self._others]
        shares = np.concatenate([shares, *(one for one, _ in others)])
        told = np.concatenate([told, *(one for _, one in others)])
        left = np.concatenate([self._left, *(b.left for b in self._others)])
        of_noise = np.concatenate([self._of_noise, *(b.of_noise for b in self._others)])
        unexplained = np.maximum(1.0, (left - 2.0 * size * told + size**2 * shares) * of_noise)  # besides the error
        around = (told - shares * size) ** 2  # of each block, scattered by ``shares`` times what is unexplained
        leverage, tells = np.minimum(shares / information, MOST_SHARE), shares > 0.0
        noise, n = float(shares @ unexplained), len(self._times_s)
        scatter = float((around[tells] / (shares * unexplained * (1.0 - leverage))[tells]).mean())
        told_by_all = abs(size) * information
        surely = told_by_all / np.sqrt(max(float((around / (1.0 - leverage) ** 2).sum()), noise))
        freedom = 2.0 * float(shares.sum() ** 2 / (shares @ shares))
        chance = min(1.0, 2.0 * float(stdtr(freedom, -surely)) * tried)
        sigmas = float(told_by_all / np.sqrt(max(1.0, scatter) * noise))
        expected = -float(stdtrit(n - 2, 0.5 * (1.0 - INTERVAL) / tried))
        return GainError(size, chance, sigmas, expected, -taken_up * size)


def _squares(H: FloatArray, c: FloatArray) -> FloatArray:
    """``c' H c`` of each, (b,): matrices (b, p, p), vectors (b, p)."""
    return np.asarray((times(H, c) * c).sum(axis=1), np.float64)


_NONE, _EXACT = np.zeros(0), 1e-12  # no considered errors; sigma of one of which the file states none
_NOTHING: Mapping[int, int | None] = MappingProxyType({})
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
    friction: Mapping[int, int | None] = _NOTHING,
    since_s: tuple[float, float] = (-np.inf, -np.inf),
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
        friction: which of them are shares of a parameter of rows with the payload, and of which: columns in the blocks
            are of the estimates of their times, which turn to what friction is with the payload.
        since_s: blocks of rows without the payload, and with it, that begin earlier are left out.
    """
    of_shares = np.eye(len(mean) + len(considered) + 2)
    for share, parameter in friction.items():
        of_shares[:, len(mean) + share] = mean[parameter] * of_shares[:, parameter]
    none = np.zeros(len(considered))
    v, *others = (np.concatenate([one, none, [-1.0, 0.0]]) for one in (mean, plain, drawn))
    late = {part: blocks.times_s(*part) >= since_s[part[0]] for part in blocks.parts}
    late = {part: which for part, which in late.items() if which.any()}
    times_s = {part: blocks.times_s(*part)[which] for part, which in late.items()}
    rows_of = {}
    for part, which in late.items():
        of_rows, noise = blocks.with_errors(*part)
        rows_of[part] = of_rows[which], noise[which]
    rows_of |= {
        part: (of_shares.T @ N @ of_shares, of_shares.T @ noise @ of_shares)
        for part, (N, noise) in rows_of.items()
        if part[0]
    }
    judged = {part: _part(times_s[part], *rows_of[part], v, correlation) for part in rows_of}
    every = block_diag(prior, np.diag(correlation / np.maximum(considered, _EXACT) ** 2))
    every += sum(part.H.sum(axis=0) for part in judged.values())
    if len(none) and judged:
        scores = sum(part.scores.sum(axis=0) for part in judged.values())
        # what gains leave to the parameters is a step between the recordings, where there are two
        own = 0.0 * mean if recorded_apart else scores[: len(mean)] + prior @ (drawn - mean)
        v[:-2] += np.linalg.solve(every, np.append(own, scores[len(mean) :]))
        judged = {part: _part(times_s[part], *rows_of[part], v, correlation) for part in rows_of}
    body, plan = np.append(np.where(physical, v[: len(mean)], 0.0), none), np.where(physical, drawn, 0.0)
    found = []
    begins = [
        min((part.times_s.min() for (held, _), part in judged.items() if held is own), default=np.inf)
        for own in (True, False)
    ]
    another_s = max(begins) if recorded_apart else np.inf  # when the second of the recordings begins
    for number, name in enumerate(blocks.instruments):
        parts, squares, worst = list[Blocks](), np.zeros(4), (False, 0.0, 0.0)
        for held, own in rows_of:
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
            expected = blocks.own(held, number) * float(late[held, number].mean()) + correlation * min(
                of_motion[0], max(of_motion[1:])
            )
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
