"""The scoreboard: by class of flights how often a wrong number was supported, how often any was, and how sharp."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from bench.honest_flights.classes import CLASSES
from onboard.ground.campaign.results import Outcome
from onboard.identification.standing import Level

_MISS = 2.0 / 0.05  # Gneiting and Raftery 2007, eq. 43: what a truth outside of a 95 % interval costs
_UNTOLD = 2.0  # interval score of a number that is not reported: as one of +-100 % that holds the truth
_USEFUL = 0.2  # half width over value of a mass that can be used
_SIZED = ("m_", "M_", "I_xx", "I_yy", "I_zz", "ZZ_")  # relative to their truth

Rows = list[dict[str, Any]]
HEADINGS = (
    *("flights", "answered", "lies, any time", "lies, end", "good, beyond", "inside 95 %", "rms"),
    *("half width", "score", "named", "another blamed"),
)


class Score(NamedTuple):
    """Of one class.

    Attributes:
        flights: how many.
        answered: flights of which every mass is supported, and half as wide as :data:`_USEFUL` or less.
        lied: flights that supported a number beyond its 99.9 % interval, at any time of the flight.
        lied_at_end: the same of the last estimates.
        good_beyond: flights that called such a number good, at any time.
        inside: share of the numbers at the end that lie in their 95 % interval.
        rms: of their errors in sigmas.
        half_width: median of masses, of their truth.
        score: mean interval score of masses and principal moments, of their truth; one not reported: :data:`_UNTOLD`.
        named: flights whose events, reasons or leanings hold the culprit's name; NaN where nothing is wrong.
        blamed: flights whose events or reasons say of an instrument that is right that it contradicts.
    """

    flights: int
    answered: int
    lied: int
    lied_at_end: int
    good_beyond: int
    inside: float
    rms: float
    half_width: float
    score: float
    named: float
    blamed: int

    @property
    def cells(self) -> tuple[str, ...]:
        """As :data:`HEADINGS`."""
        named = "" if math.isnan(self.named) else f"{self.named:.0f}"
        return (
            *(str(self.flights), str(self.answered), str(self.lied), str(self.lied_at_end), str(self.good_beyond)),
            *(_text(100.0 * self.inside, "{:.0f} %"), _text(self.rms, "{:.2f}")),
            *(_text(100.0 * self.half_width, "{:.2g} %"), _text(100.0 * self.score, "{:.3g} %")),
            *(named, str(self.blamed)),
        )


def of_class(rows: Rows, culprits: Sequence[str]) -> Score:
    """The score of a class: its rows, and the names of which one is what is wrong."""
    flights: dict[str, Rows] = {}
    for row in rows:
        flights.setdefault(row["flight"], []).append(row)
    told = [row for row in rows if row["supported"] and row["value"] is not None and row["truth"] is not None]
    off = np.array([(row["value"] - row["truth"]) / row["sigma"] for row in told])
    inside = [row["low"] <= row["truth"] <= row["high"] for row in told]
    sized = [row for row in rows if row["quantity"].startswith(_SIZED) and row["truth"]]
    masses = [_half(row) for row in told if row["unit"] == "kg"]
    each = list(flights.values())
    return Score(
        len(each),
        sum(_answered(one) for one in each),
        sum(any(row["instants_beyond"] for row in one) for one in each),
        sum(any(row["outcome"] in (Outcome.NONSENSE, Outcome.LEANS) for row in one) for one in each),
        sum(any(row["instants_good_beyond"] for row in one) for one in each),
        float(np.mean(inside)) if inside else math.nan,
        float(np.sqrt(np.mean(off * off))) if off.size else math.nan,
        float(np.median(masses)) if masses else math.nan,
        float(np.mean([_interval_score(row) for row in sized])) if sized else math.nan,
        sum(_holds(one, culprits, leans=True) for one in each) if culprits else math.nan,
        sum(_blames(one, culprits) for one in each),
    )


def board(rows: Rows) -> dict[str, Score]:
    """The score of each class that flew, in the order of :data:`CLASSES`; ``factor class`` names a row's."""
    flown: dict[str, Rows] = {}
    for row in rows:
        flown.setdefault(row.get("factor class") or "", []).append(row)
    return {name: of_class(flown[name], own.culprits) for name, own in CLASSES.items() if name in flown}


def page(after: dict[str, Score], before: dict[str, Score]) -> str:
    """A Markdown table, group by group; each number of ``before`` in brackets beside that of ``after``."""
    lines = list[str]()
    for group in dict.fromkeys(CLASSES[name].group for name in after):
        lines += ["", f"## {group[0].upper()}{group[1:]}", ""]
        lines += [f"| class | {' | '.join(HEADINGS)} |", f"|---|{'---:|' * len(HEADINGS)}"]
        for name, score in after.items():
            if CLASSES[name].group == group:
                was = before[name].cells if name in before else ("",) * len(HEADINGS)
                lines.append(f"| {name} | {' | '.join(_beside(score.cells, was))} |")
    return "\n".join(lines)


def _beside(cells: Iterable[str], was: Iterable[str]) -> list[str]:
    return [f"{one} ({other})" if other and other != one else one for one, other in zip(cells, was, strict=True)]


def _answered(flight: Rows) -> bool:
    masses = [row for row in flight if row["unit"] == "kg"]
    return bool(masses) and all(row["supported"] and _half(row) <= _USEFUL for row in masses)


def _half(row: dict[str, Any]) -> float:
    return float(0.5 * (row["high"] - row["low"]) / abs(row["truth"])) if row["truth"] else math.inf


def _interval_score(row: dict[str, Any]) -> float:
    if not row["supported"] or row["level"] == Level.DO_NOT_USE:
        return _UNTOLD
    low, high, truth = row["low"], row["high"], row["truth"]
    return float((high - low + _MISS * (max(low - truth, 0.0) + max(truth - high, 0.0))) / abs(truth))


def _holds(flight: Rows, names: Sequence[str], *, leans: bool) -> bool:
    said = " ".join([*flight[0]["events"], *(row["why"] + (row["leans"] if leans else "") for row in flight)])
    return any(name in said for name in names)


def _blames(flight: Rows, culprits: Sequence[str]) -> bool:
    """Whether an instrument that is not at fault is said to contradict the others."""
    said = [text for text in (*flight[0]["events"], *(row["why"] for row in flight)) if "contradict" in text]
    return any(not any(name in text for name in culprits) for text in said)


def _text(value: float, form: str) -> str:
    return "" if math.isnan(value) else form.format(value)
