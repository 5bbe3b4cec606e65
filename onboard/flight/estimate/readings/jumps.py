"""Which encoders have jumped, and the events that report it; ``onboard.estimation.jumps`` decides.

Where the estimator follows a jump, what comes after it is read without it, so that the angle goes on smoothly: then
nothing is wrong if the zero has slipped, and what is left of another scale or delay is zero at the jump.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, Severity
from onboard.devices.roles import SmoothedChannel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.jumps import AngleJumps, Jump
from onboard.estimation.stuck import NONE
from onboard.flight.estimate.readings.stuck import StuckEvent, breaks
from onboard.regressor.signals import EncoderJump

_EVERY = 1 << 31  # samples: more than are kept
_ROUNDING = 1.0 / math.sqrt(12.0)  # counts, rms
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
            self._jumps = AngleJumps(max(self._signal.noise[0], _ROUNDING * count))
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
