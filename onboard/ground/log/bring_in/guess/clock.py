"""The clock of a recording: which column, in what unit, how even, with what gaps."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.ground.log.bring_in.channel_rows import rising, unwrapped
from onboard.ground.log.bring_in.mapping import NS_PER
from onboard.ground.log.bring_in.text_rows import Values

_SINCE_1970_s = 5e8, 4e9  # 1985 to 2096
_SLOWEST_Hz, _FASTEST_Hz = 0.01, 50e3
_USUAL_Hz, _DECADES = 200.0, 0.8  # of recordings: middle and spread of their rates
_SURE = 2.5  # nats between the likeliest unit and the next one
_LONGEST_STEP = 20.0  # median steps: where a counter starts again, it has gone on by no more
_FEWEST_KNOWN = 0.5  # of the cells, that have to be times
_MOST_STARTS = 9  # of recordings in one file; where times fall more often they are mixed
_MOST_LEFT_OUT = 0.1  # of the rows, so that times rise
_MOST_REPEATED = 0.5  # of the rows: written twice, or by a clock of the logger that is slower than the samples


class TimeColumn(NamedTuple):
    """A column of times.

    Attributes:
        column: its name.
        unit: of it.
        why: what the unit is by.
        doubt: why that may be wrong; or "".
        seconds: (n,) of the rows, NaN where there is none.
        rate_Hz: of the samples, by the median interval.
        gaps: intervals of more than 1.5 medians, and the longest, s.
        left_out: rows that have to be left out so that times rise.
        wraps: the column starts at 0 again after so many units; 0: it does not.
        offset: to be added to the column, so that no time is before 0.
    """

    column: str
    unit: str
    why: str
    doubt: str
    seconds: NDArray[np.float64]
    rate_Hz: float  # noqa: N815  (a unit's letters)
    gaps: tuple[int, float]
    left_out: int
    wraps: int = 0
    offset: float = 0.0

    def in_unit(self, unit: str, why: str) -> "TimeColumn":
        """The same in another unit, which is known."""
        factor = NS_PER[unit] / NS_PER[self.unit]
        count, longest_s = self.gaps
        found = self._replace(unit=unit, why=why, doubt="", gaps=(count, longest_s * factor))
        return found._replace(seconds=self.seconds * factor, rate_Hz=self.rate_Hz / factor)


def clock(column: str, values: Values, named: str) -> TimeColumn | None:
    """What a column says of time; None if it does not rise.

    Args:
        column: its name in the recording.
        values: (n,).
        named: unit by its name or the kind of file; or "".
    """
    wraps = _wraps(values)
    if wraps:
        values = unwrapped(values, wraps)
    number = values.astype(np.float64)
    known = np.flatnonzero(np.isfinite(number))
    if len(known) < max(3, _FEWEST_KNOWN * len(number)):
        return None
    kept = known[rising(values[known])] if values.dtype.kind in "iu" else known[rising(number[known])]
    repeated = int((np.diff(number[known]) == 0.0).sum())
    if len(known) - len(kept) - repeated > _MOST_LEFT_OUT * len(known) or len(kept) < 3:
        return None
    if repeated > _MOST_REPEATED * len(known):
        return None
    left_out = len(number) - len(kept)
    offset = float(np.ceil(max(0.0, -number[kept[0]])))
    steps = np.diff(number[kept])
    step, middle = float(np.median(steps)), float(np.median(number[kept]))
    whole = bool((number[kept] == np.rint(number[kept])).all())
    found, why, doubt = _unit(step, middle, named, whole=whole)
    scale = 1e-9 * NS_PER[found]
    seconds = np.full(len(number), np.nan)
    seconds[kept] = (number[kept] - number[kept[0]]) * scale
    wide = steps > 1.5 * step
    gaps = int(wide.sum()), float(steps.max() * scale) if wide.any() else 0.0
    return TimeColumn(column, found, why, doubt, seconds, 1.0 / (step * scale), gaps, left_out, wraps, offset)


def refused(column: str, values: Values) -> str:
    """Why a column that is a time by its name is none, with the remedy."""
    number = values.astype(np.float64)
    bad = int((~np.isfinite(number)).sum())
    if len(number) - bad < _FEWEST_KNOWN * len(number):
        return f"{column!r} is a time by its name, and {bad} of its {len(number)} cells are no number: give them times"
    back = np.flatnonzero(np.diff(number) < 0.0)
    if len(back) and len(back) <= _MOST_STARTS:
        rows = ", ".join(str(one + 2) for one in back.tolist())
        return f"{column!r} starts again in row {rows}: cut the recordings apart, and import them in turn"
    if not len(back):
        count = int((np.diff(number) == 0.0).sum())
        return (
            f"{column!r} is a time by its name and stands still in {count} of {len(number)} rows: it is coarser "
            "than the samples; delete the column, and the rate is asked for in its place"
        )
    return f"{column!r} is a time by its name and does not rise: sort the recording"


def _wraps(values: Values) -> int:
    """Modulus of a counter of 16, 24 or 32 bits that went on where it started at 0 again; 0 of another column."""
    number = values[np.isfinite(values)].astype(np.float64)
    if len(number) < 3 or number.min() < 0.0:
        return 0
    steps = np.diff(number)
    back = steps[steps < -0.5 * number.max()]
    usual = float(np.median(steps))
    for modulus in (1 << 16, 1 << 24, 1 << 32):
        if len(back) and number.max() < modulus and ((on := back + modulus) > 0.0).all() and usual > 0.0:
            return modulus if (on < _LONGEST_STEP * usual).all() else 0
    return 0


def _unit(step: float, middle: float, named: str, *, whole: bool) -> tuple[str, str, str]:
    """Unit, what it is by, and the doubt."""
    if named in NS_PER:
        rate = 1e9 / (step * NS_PER[named])
        odd = "" if _SLOWEST_Hz <= rate <= _FASTEST_Hz else f"it would be {rate:.3g} Hz"
        return named, "by its name", odd
    for unit, ns in NS_PER.items():
        if _SINCE_1970_s[0] < middle * 1e-9 * ns < _SINCE_1970_s[1] and 1e9 / (step * ns) > _SLOWEST_Hz:
            return unit, "since 1970", ""
    likely = {}
    for unit, ns in NS_PER.items():
        rate = 1e9 / (step * ns)
        if _SLOWEST_Hz <= rate <= _FASTEST_Hz:
            likely[unit] = -0.5 * (math.log10(rate / _USUAL_Hz) / _DECADES) ** 2
            if unit == "s" and not whole:
                likely[unit] += _SURE  # fractions are written of seconds
    if not likely:
        return "s", "by default", f"steps of {step:.3g} are no usual rate in any unit"
    order = sorted(likely, key=lambda unit: -likely[unit])
    rates = [f"{unit} would be {1e9 / (step * NS_PER[unit]):.4g} Hz" for unit in order]
    close = len(order) > 1 and likely[order[0]] - likely[order[1]] < _SURE
    count = whole and step == 1.0
    doubt = f"by its steps of {step:g} alone: {', '.join(rates[:2])}" if close else ""
    if count:
        doubt = "it counts rows, which need not be a time: then write rate_Hz instead of column and unit"
    return order[0], f"by its steps of {step:g}", doubt


def said(one: TimeColumn) -> str:
    """Rate and gaps in words."""
    count, longest_s = one.gaps
    gaps = f"{count} intervals longer than 1.5 of that, up to {longest_s:.3g} s" if count else "no gaps"
    out = f"; {one.left_out} rows whose times do not rise" if one.left_out else ""
    return f"{one.rate_Hz:.4g} Hz, {gaps}{out}"
