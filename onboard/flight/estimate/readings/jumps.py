"""Which encoders have jumped and which readings are stuck, and the events that report it.

``onboard.estimation.jumps`` and ``onboard.estimation.stuck`` decide.

Where the estimator follows a jump, what comes after it is read without it, so that the angle goes on smoothly: then
nothing is wrong if the zero has slipped, and what is left of another scale or delay is zero at the jump.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, Severity
from onboard.devices import si
from onboard.devices.roles import SmoothedChannel
from onboard.estimation.arrays import OF_STEP, FloatArray
from onboard.estimation.jumps import AngleJumps, Jump
from onboard.estimation.stuck import NONE, StuckReadings, longest_run
from onboard.regressor.signals import EncoderJump

_OVER_S = 1.0  # without a stuck reading before it is said to be over: a freeze that comes and goes is reported once


class StuckEvent(NamedTuple):
    """An event about a channel."""

    severity: Severity
    code: str
    text: str


class StuckWatch:
    """Watches one channel.

    Args:
        signal: what is known of it.
    """

    def __init__(self, signal: SmoothedChannel) -> None:
        self._signal = signal
        self._readings: StuckReadings | None = None  # its counts are not known before the first rows
        self._sequence: int | None = None  # of the last row
        self._fine = 0  # readings since the last stuck one
        self._told = False

    def watch(self, rows: Rows, usable: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], slice, StuckEvent | None]:
        """Judge the next rows, at least one.

        Args:
            rows: of the channel, in order.
            usable: (n,) those that are good otherwise.

        Returns:
            Which are stuck, (n,); which of those before them are, counted from the first of these; what the
            event reports.
        """
        if self._readings is None:
            longest, travels = _longest(self._signal, rows[0]), self._signal.travels and not self._signal.repeats
            self._readings = StuckReadings(len(self._signal.noise), longest, travels=travels)
        raw = np.hstack([rows["gyro_raw"], rows["accel_raw"]]) if not self._signal.si else rows["value_raw"][:, None]
        stuck, before = np.zeros(len(rows), np.bool_), NONE
        starts = breaks(rows, self._sequence)
        self._sequence = int(rows["sequence"][-1])
        for first, last in itertools.pairwise(sorted({0, *starts, len(rows)})):
            if first in starts:
                self._readings.forget()
            steps = raw[first:last] / self._signal.quantum_counts
            stuck[first:last], reaching = self._readings.watch(steps, usable[first:last])
            begin, end = first + reaching.start, first + reaching.stop
            stuck[max(0, begin) : max(0, end)] = True
            if begin < min(end, 0):
                before = slice(begin, min(end, 0))
        return stuck, before, self._say(raw, stuck, before != NONE)

    def _say(self, raw: NDArray[np.generic], stuck: NDArray[np.bool_], before: bool) -> StuckEvent | None:
        if stuck.any() or before:
            at = np.flatnonzero(stuck)
            self._fine = len(stuck) - 1 - int(at[-1]) if len(at) else len(stuck)
            if self._told:
                return None
            self._told = True
            value = raw[int(at[0]) if len(at) else 0]
            held = ", ".join(str(count) for count in np.atleast_1d(value))
            text = f"it reads {held} again and again where it must change: rows that need it are refused meanwhile"
            return StuckEvent(Severity.ERROR, "stuck", text)
        self._fine += len(stuck)
        if self._told and self._fine * self._signal.period_s > _OVER_S:
            self._told = False
            return StuckEvent(Severity.INFO, "stuck_over", "its readings change again")
        return None


def breaks(rows: Rows, last: int | None) -> list[int]:
    """Which rows do not follow on the one before.

    Args:
        rows: in order, at least one.
        last: sequence number of the one before these; None: there was none.
    """
    numbers, resets = rows["sequence"], rows["status"] & si.AFTER_RESET
    begins = int(numbers[0]) - 1 if last is None else last
    if int(numbers[-1]) - begins == len(rows) and not resets.any():  # they ascend
        return []
    return np.flatnonzero((np.diff(numbers.astype(np.int64), prepend=begins) != 1) | (resets != 0)).tolist()


def _longest(signal: SmoothedChannel, row: np.void) -> float:
    """Run that may be chance."""
    if signal.repeats:
        return math.inf
    if signal.si:
        scales = [float(row["scale"]) * signal.si.get(row["unit"], math.nan)]
    else:
        scales = [float(row["gyro_scale_rad_s"])] * 3 + [float(row["accel_scale_m_s2"])] * 3
    steps = [signal.quantum_counts * abs(scale) for scale in scales]
    counts = [noise / step if step else math.inf for noise, step in zip(signal.noise, steps, strict=True)]
    delay_s = max(signal.delays_s)
    return longest_run(counts, math.exp(-signal.period_s / delay_s) if delay_s > 0.0 else 0.0)


_EVERY = 1 << 31  # samples: more than are kept
_FOLLOWED = "the angle goes on without it"


def jumped_text(names: str, *, follows: bool = True) -> str:
    """Why answers are weak after the angles of some joints have jumped; whether the estimator ``follows``."""
    then = "its scale or delay may have changed" if follows else "nothing is used from there until it jumps back"
    return f"{names}: its angle jumps between two samples; {then}"


class JumpsSeen(NamedTuple):
    """What is to be done with the rows of a channel."""

    wrong: NDArray[np.bool_]  # (n,) those of another encoder, which is not followed
    before: slice  # of those before them, counted from the first of these: wrong, or too large
    off: FloatArray  # (n,) rad: they are so much too large
    before_off: float  # rad, and so are those of ``before``; zero: they are wrong
    said: list[StuckEvent]


class JumpWatch:
    """Watches the channel of a joint's angle.

    Args:
        signal: what is known of it.
        follows: the estimator goes on after a jump.

    Attributes:
        jumped: whether its angle jumped after rows were used: unless it is followed none is made of what came until
            it jumped back.
        new: jumps to be followed, the oldest first; whoever takes them removes them.
    """

    def __init__(self, signal: SmoothedChannel, *, follows: bool = False) -> None:
        self._signal, self._follows = signal, follows
        self._off, self.new = 0.0, list[EncoderJump]()
        self._jumps: AngleJumps | None = None  # its counts are not known before the first rows
        self._sequence: int | None = None  # of the last row
        self._since: Jump | None = None  # its encoder is another one
        self.jumped = False

    def watch(self, rows: Rows, angle: FloatArray, times_ns: NDArray[np.int64] | None, in_use: bool) -> JumpsSeen:
        """Judge the next rows, at least one.

        Args:
            rows: of the channel, in order.
            angle: (n,) rad; NaN where it may not be used.
            times_ns: (n,) vehicle time of each; None: not known, and none is judged.
            in_use: rows of the estimator were made of those before.
        """
        if self._jumps is None:
            count = self._signal.quantum_counts * abs(
                float(rows["scale"][0]) * self._signal.si.get(rows["unit"][0], 0.0)
            )
            self._jumps = AngleJumps(max(self._signal.noise[0], OF_STEP * count))
        starts, found = breaks(rows, self._sequence), list[Jump]()
        self._sequence = int(rows["sequence"][-1])
        times = np.full(len(rows), np.nan) if times_ns is None else times_ns.astype(np.float64)
        arrived = rows["host_ns"].astype(np.float64)
        for first, last in itertools.pairwise(sorted({0, *starts, len(rows)})):
            if first in starts:
                self._jumps.forget()
            part = slice(first, last)
            found += [
                one._replace(at=first + one.at) for one in self._jumps.watch(angle[part], times[part], arrived[part])
            ]
        wrong = np.full(len(rows), self._since is not None and not self._follows)
        seen = JumpsSeen(wrong, NONE, np.full(len(rows), self._off), 0.0, [])
        for one in found:
            seen = self._of(one, seen, float(times[0]), in_use)
        return seen

    def _of(self, one: Jump, seen: JumpsSeen, first_ns: float, in_use: bool) -> JumpsSeen:
        """What is to be done after one more jump; ``first_ns``: time of the first row."""
        after, since = slice(max(one.at, 0), None), self._since
        undone = since if since is not None and one.undoes(since) else None
        text = (
            f"its angle jumps {'back ' * (undone is not None)}by {math.degrees(one.size):+.3g} deg between two samples"
        )
        if undone is None:
            text = f"{text}, as no motion does: its zero, scale or delay has changed"
        if self._follows and in_use:
            seen.said.append(_warning(f"{text}; {_FOLLOWED}"))
            return self._followed(one, undone, seen, first_ns)
        if undone is not None:
            self._since, seen.wrong[after] = None, False
            text = f"{text}: it reads as before; rows are used again"
            seen.said.append(StuckEvent(Severity.INFO, "angle_jumped_back", text))
            return seen
        if since is not None:
            return seen
        if not in_use:
            seen.wrong[: after.start] = True
            seen.said.append(_warning(f"{text}; no row before that is used"))
            return seen._replace(before=slice(-_EVERY, min(one.at, 0)))
        self.jumped, self._since, seen.wrong[after] = True, one, True
        seen.said.append(StuckEvent(Severity.ERROR, "angle_jumped", f"{text}; no row from there on is used"))
        return seen._replace(before=slice(min(one.at, 0), 0))

    def _followed(self, one: Jump, undone: Jump | None, seen: JumpsSeen, first_ns: float) -> JumpsSeen:
        """Go on without a jump; where it undoes the one before, as before that."""
        at, period_s = one.at, self._signal.period_s
        whence = undone or one._replace(expected=one.expected - self._off)
        by = one.size if undone is None else -undone.size
        at_ns = round(first_ns + 1e9 * period_s * at)
        self.new.append(EncoderJump(at_ns, by, whence.expected, whence.travel / period_s))
        self.jumped, self._since, self._off = True, None if undone else whence, self._off + by
        seen.off[max(at, 0) :] += by
        return seen if at >= 0 else seen._replace(before=slice(at, 0), before_off=by)


def _warning(text: str) -> StuckEvent:
    return StuckEvent(Severity.WARNING, "angle_jumped", text)
