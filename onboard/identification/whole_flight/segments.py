"""Segments of a flight, in windows where they are too long to be predicted; errors that are others in some."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.free_flyer.steps import OtherError
from onboard.identification.windows import SHORTEST, WINDOW_s

Changed = tuple[float, Sequence[OtherError]]  # from when on, s, errors may be others


class Segment(NamedTuple):
    """Ticks in succession, joints known, with one payload held or nothing."""

    ticks: Ticks
    held: bool


def in_windows(segments: Sequence[Segment], period_s: float) -> list[Segment]:
    """The same ticks in segments of ``WINDOW_s`` or less, each with a rate of its own at its start.

    A base that tumbles while its arm moves is chaotic: what a guess of the payload or the first rate is off by grows
    until the prediction has no more to do with the readings, and no step of a fit leads nearer.

    Args:
        segments: in the order of their times.
        period_s: between ticks.
    """
    size = max(SHORTEST, round(WINDOW_s / period_s))
    found = list[Segment]()
    for one in segments:
        n = len(one.ticks.time_s)
        edges = np.linspace(0, n, max(1, -(-n // size)) + 1).round().astype(int).tolist()
        found += [Segment(one.ticks.part(slice(*ends)), one.held) for ends in pairwise(edges)]
    return found


def pushed(predictor: ImuPredictor, segments: Sequence[Segment]) -> tuple[list[Segment], list[Changed]]:
    """The same ticks in windows, and what pushes the base unknown as another one in each; nothing where it is known.

    Drag turns in the base's axes as the base turns: a constant push leaves of it what a payload then takes. From window
    to window it changes as the filter's first-order Gauss-Markov process of sigma s and correlation time T does in the
    time t between them, by ``s sqrt(2 (1 - exp(-t / T)))``.

    Args:
        predictor: of the vehicle's instruments.
        segments: in the order of their times.
    """
    memory_s = dict(predictor.fading)
    unknown = [at for at, _ in predictor.pushes if predictor.sigma[at] > 0.0]
    if not unknown:
        return [*segments], []
    windows = in_windows(segments, predictor.period_s)
    changed = list[Changed]()
    for before, one in pairwise(windows):
        begins_s, since_s = float(one.ticks.time_s[0]), float(before.ticks.time_s[0])
        others = []
        for at in unknown:
            size = predictor.sigma[at] * np.sqrt(2.0 * (1.0 - np.exp((since_s - begins_s) / memory_s[at])))
            others.append(OtherError(predictor.names[at], np.array([at]), np.array([size])))
        changed.append((begins_s, others))
    return windows, changed


def divided(segments: Sequence[Segment], without: Sequence[slice], when_s: tuple[float, float, float]) -> list[Segment]:
    """The same ticks, none of a segment before a time and others after it.

    Args:
        segments: to be divided.
        without: lines that are not used about it, as it may be another one.
        when_s: between which times; in the middle the time itself.
    """
    found, (first_s, at_s, last_s) = list[Segment](), when_s
    for one in segments:
        time_s, measured = one.ticks.time_s, one.ticks.measured.copy()
        for lines in without:
            measured[(time_s > first_s) & (time_s < last_s), lines] = np.nan
        ticks, k = one.ticks._replace(measured=measured), int(np.searchsorted(time_s, at_s))
        found += [Segment(ticks.part(part), one.held) for part in (slice(0, k), slice(k, None)) if len(time_s[part])]
    return found


def others_in(segments: Sequence[Segment], changed: Sequence[Changed], size: int) -> tuple[list[str], FloatArray]:
    """What may be other errors from some times on, of unit normal prior, in segments of a flight.

    Args:
        segments: none has ticks of before and after such a time.
        changed: time, s, and errors of each.
        size: p, of the state.

    Returns:
        m names, and what each does to the state in each segment, (segments, p, m).
    """
    of_each = [(time_s, k, other) for k, (time_s, others) in enumerate(changed) for other in others]
    along, ends_s = np.zeros((len(segments), size, len(of_each))), [one.ticks.time_s[-1] for one in segments]
    for column, (time_s, _, other) in enumerate(of_each):
        along[np.flatnonzero(np.array(ends_s) > time_s)[:, None], other.at, column] = other.along
    return [f"{other.name}_from_{k}" for _, k, other in of_each], along
