"""A log of parabolic flights cut into releases, motions and catches (Limparis, appendix A.2), by a state machine.

| state | begins with |
|---|---|
| SECURED | the aircraft pulls up: a specific force of g or so, or no reading |
| HELD | free fall of the aircraft; the vehicle shows the unrest of hands or straps |
| FREE | the release: nothing but the instrument's noise and what the arm does |
| MOTION | the arm moves while nothing holds the vehicle |

From FREE and MOTION a contact leads back to HELD. A contact shorter than ``settle_s`` was a bump, and the run goes on
with another momentum; a longer one was the catch, and ends the run.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Any

import numpy as np

from onboard.config.bases.parabola import Parabola
from onboard.estimation.arrays import BoolArray, FloatArray, finite, gaps
from onboard.estimation.free_fall import CUBIC_s, WINDOW_s, is_free
from onboard.identification.free_flyer.prediction.ticks import RESTS_rad_s, Ticks
from onboard.identification.windows import SHORTEST


class Stage(StrEnum):
    """State of a vehicle that is flown by hand."""

    SECURED = "secured"
    HELD = "held"
    FREE = "free"
    MOTION = "motion"


@dataclass(frozen=True)
class ParabolaRun:
    """A release by hand with what follows, or a parabola without one."""

    parabola: int  # its number, from 0
    parts: tuple[slice, ...]  # ticks of free flight, divided at bumps; what is fitted
    release_s: float = float("nan")
    catch_s: float = float("nan")
    bumps_s: tuple[float, ...] = ()  # middle of each
    motions_s: tuple[tuple[float, float], ...] = ()  # begin and end of each
    reason: str = ""  # why nothing can be fitted; empty if it can

    def as_json(self) -> dict[str, Any]:
        """Plain values; times since the log's first tick."""
        return {
            "parabola": self.parabola,
            "release_s": None if np.isnan(self.release_s) else self.release_s,
            "catch_s": None if np.isnan(self.catch_s) else self.catch_s,
            "bumps_s": list(self.bumps_s),
            "motions_s": [list(motion) for motion in self.motions_s],
        }


def stages(ticks: Ticks, period_s: float, settings: Parabola) -> list[Stage]:
    """State at each tick; bumps and catches are distinguished by :func:`cut`."""
    low, free = _low(ticks.measured[:, 3:6], period_s, settings.low_m_s2), _free(ticks, period_s, settings)
    moving = np.any(np.nan_to_num(np.abs(ticks.dq)) > RESTS_rad_s, axis=1)
    found, stage = [], Stage.SECURED
    for is_low, is_free_, moves in zip(low.tolist(), free.tolist(), moving.tolist(), strict=True):
        if not is_low:
            stage = Stage.SECURED
        elif not is_free_:
            stage = Stage.HELD
        elif moves:
            stage = Stage.MOTION
        elif stage in (Stage.SECURED, Stage.HELD, Stage.MOTION):
            stage = Stage.FREE
        found.append(stage)
    return found


def cut(ticks: Ticks, period_s: float, settings: Parabola) -> list[ParabolaRun]:
    """Runs of a log, and parabolas without one, in the order of their times.

    Args:
        ticks: of the whole log.
        period_s: between ticks.
        settings: of the vehicle file.
    """
    at = np.array(stages(ticks, period_s, settings))
    joints = finite([ticks.q, ticks.dq, ticks.ddq])
    found: list[ParabolaRun] = []
    bump_s = settings.settle_s + CUBIC_s + WINDOW_s  # of a contact, with what is not free beside it
    fall = [one for one in _spans(at != Stage.SECURED) if (one.stop - one.start) * period_s >= settings.shortest_s]
    for number, low in enumerate(fall):
        flying = (at == Stage.FREE) | (at == Stage.MOTION)
        flying[: low.start], flying[low.stop :] = False, False
        groups: list[list[slice]] = []
        for part in (one for one in _spans(flying) if (one.stop - one.start) * period_s > 2.0 * settings.settle_s):
            if groups and (part.start - groups[-1][-1].stop) * period_s <= bump_s:
                groups[-1].append(part)
            else:
                groups.append([part])
        runs = [_run(number, group, ticks, at, joints, period_s, settings) for group in groups]
        fitted = [run for run in runs if not run.reason]
        if not runs:
            runs = [ParabolaRun(number, (), reason="it was never let go: strapped down, or held all the time")]
        elif not fitted:
            runs = [max(runs, key=lambda run: run.catch_s - run.release_s)]
        found += fitted or runs
    return found


def _run(
    number: int, parts: Sequence[slice], ticks: Ticks, at: Any, joints: BoolArray, period_s: float, settings: Parabola
) -> ParabolaRun:
    time_s, margin = ticks.time_s, round(settings.settle_s / period_s)
    release_s, catch_s = float(time_s[parts[0].start]), float(time_s[parts[-1].stop - 1])
    bumps = tuple(float(0.5 * (time_s[a.stop - 1] + time_s[b.start])) for a, b in pairwise(parts))
    moving, inside = np.zeros((2, len(at)), np.bool_)
    for one in parts:
        moving[one] = at[one] == Stage.MOTION
        inside[one.start + margin : one.stop - margin] = True
    motions = _motions(moving, time_s)
    whole = [piece for piece in _spans(joints & inside) if piece.stop - piece.start > 2 * margin]
    reason = ""
    if sum(one.stop - one.start for one in whole) * period_s < settings.shortest_s:
        reason = f"free for {catch_s - release_s:.1f} s only"
    elif not motions:
        reason = "the arm did not move while the vehicle was free"
    return ParabolaRun(number, tuple(whole), release_s, catch_s, bumps, motions, reason)


def _low(force: FloatArray, period_s: float, limit: float) -> BoolArray:
    """Whether the aircraft falls freely at each tick, by the mean specific force; missing readings do not count."""
    width = max(1, round(WINDOW_s / period_s))
    kernel, known = np.ones(width), np.isfinite(force).all(axis=1)
    counts = np.convolve(known, kernel, "same")
    sums = np.column_stack([np.convolve(np.where(known, axis, 0.0), kernel, "same") for axis in force.T])
    size = np.linalg.norm(sums, axis=1) / np.maximum(counts, 1.0)
    return np.asarray((counts > 0.0) & (size < limit), np.bool_)


def _free(ticks: Ticks, period_s: float, settings: Parabola) -> BoolArray:
    """Free fall of the vehicle, tick by tick, in each stretch of time without a gap."""
    found = np.zeros(len(ticks.time_s), np.bool_)
    apart = np.flatnonzero(gaps(ticks.time_s, period_s)) + 1
    for one in np.split(np.arange(len(found)), apart):
        found[one] = is_free(ticks.measured[one, 3:6], ticks.sigma[one, 3:6], period_s, settings.free_m_s2)
    return found


def _motions(moving: BoolArray, time_s: FloatArray) -> tuple[tuple[float, float], ...]:
    """Begin and end of motions; a pause between strokes belongs to one."""
    found: list[slice] = []
    for one in _spans(moving):
        if found and one.start - found[-1].stop < SHORTEST:
            found[-1] = slice(found[-1].start, one.stop)
        else:
            found.append(one)
    long = [one for one in found if one.stop - one.start >= SHORTEST]
    return tuple((float(time_s[one.start]), float(time_s[one.stop - 1])) for one in long)


def _spans(true: Any) -> list[slice]:
    """Where it is true without a break."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
