"""What all flights of a campaign say together: errors, coverage, which factor drives them, what came of each fault.

Errors of masses and moments of inertia are in percent of the truth, those of lengths in mm and of products of inertia
in g m², all others in SI units. Bands of shares are exact binomial ones (Clopper and Pearson 1934). Sensitivity is by
least squares on the design: the share of the errors' variance that goes when a factor leaves the model, and the F test
of it (Draper and Smith, Applied Regression Analysis, section 6.2).
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from onboard.estimation.arrays import FloatArray
from onboard.ground.campaign.instants import off_by
from onboard.ground.campaign.results import Outcome, kinds
from onboard.ground.campaign.store import FACTOR
from onboard.identification.quantities import is_positive

Row = Mapping[str, Any]
MOST_WORST = 15
MOST_LEVELS = 30  # of a factor; one with more is a number for each flight, not a factor
_SCALES = {"m": ("mm", 1e3), "kg m^2": ("g m²", 1e3)}
NO_FAULT = "none"


class Share(NamedTuple):
    """``part`` of ``whole``, and the 95 % band of the share."""

    part: int
    whole: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """NaN of nothing."""
        return self.part / self.whole if self.whole else math.nan

    @property
    def text(self) -> str:
        """``93.8 % (88.1 to 97.3)``."""
        if not self.whole:
            return "none"
        return f"{100 * self.share:.1f} % ({100 * self.low:.1f} to {100 * self.high:.1f})"


def share_of(part: int, whole: int) -> Share:
    """With its band; from 0 to 1 of nothing."""
    if not whole:
        return Share(0, 0, 0.0, 1.0)
    band = stats.binomtest(part, whole).proportion_ci(0.95, "exact")
    return Share(part, whole, float(band.low), float(band.high))


class ErrorStatistics(NamedTuple):
    """Of a quantity, over the flights that answer it and whose truth is known; ``shown_in`` is the unit of all numbers.

    ``in_sigma`` and ``in_bound``: rms of the error over its sigma, and over the Cramer-Rao bound.
    """

    quantity: str
    shown_in: str
    flights: int
    answered: int
    p95: float
    rms: float
    mean: float
    worst: float
    sigma: float
    drawn: float
    in_sigma: float
    in_bound: float
    covered: Share
    whitened: FloatArray  # (answered,) errors in their sigmas


class Effect(NamedTuple):
    """Of a factor on a quantity's error: shares of variance explained, and chances that nothing does it."""

    quantity: str
    factor: str
    shifts: float
    shifts_chance: float
    spreads: float  # of the size of what the whole design leaves of the error: Levene's test
    spreads_chance: float


class Worst(NamedTuple):
    """An answer far outside."""

    flight: str
    what: str
    quantity: str
    error: float
    shown_in: str
    half_widths: float  # error over its side of the 99.9 % interval
    outcome: str
    faults: tuple[str, ...]
    leans: str

    @property
    def text(self) -> str:
        """``m_arm +4.3 %``."""
        return f"{self.quantity} {self.error:+.3g} {self.shown_in}".rstrip()


class Summary(NamedTuple):
    """Everything that a report shows."""

    flights: int
    errors: tuple[ErrorStatistics, ...]
    effects: tuple[Effect, ...]
    answers: Counter[str]  # by outcome
    outcomes: dict[str, Counter[str]]  # the same by fault; an answer under two faults counts under both
    flights_of: dict[str, int]  # by fault
    nonsense_of: dict[str, int]  # flights with confident nonsense, by fault
    worst: tuple[Worst, ...]
    nonsense: tuple[Worst, ...]
    accounted: Share
    detected_once: Share
    late_s: tuple[float, ...]

    @property
    def wrong_flights(self) -> list[tuple[str, str]]:
        """Flights with confident nonsense, farthest first: name, and what is wrong under which faults."""
        by_flight: dict[str, list[Worst]] = {}
        for one in self.nonsense:
            by_flight.setdefault(one.flight, []).append(one)
        return [
            (flight, f"{of[0].what}: {', '.join(one.text for one in of)} ({', '.join(of[0].faults) or 'no fault'})")
            for flight, of in by_flight.items()
        ]

    def as_json(self) -> dict[str, Any]:
        """Plain values, None for NaN."""
        told: dict[str, Any] = {
            **{
                "flights": self.flights,
                "answers": self.answers,
                "outcomes": self.outcomes,
                "flights_of": self.flights_of,
            },
            **{"nonsense_of": self.nonsense_of, "late_s": list(self.late_s)},
            **{name: getattr(self, name)._asdict() for name in ("accounted", "detected_once")},
            **{name: [one._asdict() for one in getattr(self, name)] for name in ("effects", "worst", "nonsense")},
            "errors": [
                {key: value for key, value in one._asdict().items() if key != "whitened"}
                | {"covered": one.covered._asdict()}
                for one in self.errors
            ],
        }
        plain: dict[str, Any] = _plain(told)
        return plain


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def summary(rows: Sequence[Row]) -> Summary:
    """Of the rows of a campaign's data set."""
    by_quantity: dict[str, list[Row]] = {}
    by_flight: dict[str, Row] = {}
    for row in rows:
        by_flight.setdefault(row["flight"], row)
        if row["quantity"]:
            by_quantity.setdefault(row["quantity"], []).append(row)
    found = [one for of in by_quantity.values() if (one := _errors(of)) is not None]
    effects = [effect for of in by_quantity.values() for effect in _effects(of)]
    worst = sorted((_worst(row) for row in rows if _is_known(row)), key=lambda one: -one.half_widths)
    outcomes, wrong = _by_fault(rows)
    heads = by_flight.values()
    counted = [head["accounted"] for head in heads if head["accounted"] is not None]
    captured = [head for head in heads if head["capture_s"] is not None]
    once = [head for head in captured if head["detections"] == 1]
    return Summary(
        len(by_flight),
        tuple(found),
        tuple(effects),
        Counter(row["outcome"] for row in rows if row["quantity"]),
        outcomes,
        dict(Counter(fault for head in heads for fault in _faults(head))),
        wrong,
        tuple(worst[:MOST_WORST]),
        tuple(one for one in worst if one.outcome == Outcome.NONSENSE),
        share_of(sum(counted), len(counted)),
        share_of(len(once), len(captured)),
        tuple(head["detected_s"] - head["capture_s"] for head in once),
    )


def by_level(rows: Sequence[Row], factor: str) -> dict[str, Summary]:
    """The same of the flights of each level, or number, of a factor.

    Raises:
        ValueError: there is no such factor, or it has too many levels to be told one by one.
    """
    column = FACTOR + factor
    levels = dict.fromkeys(row[column] for row in rows if row.get(column) is not None)
    if not levels and rows:
        known = sorted({key.removeprefix(FACTOR) for row in rows for key in row if key.startswith(FACTOR)})
        raise ValueError(f"no flight has a factor {factor!r}; there are: {', '.join(known) or 'none'}")
    if len(levels) > MOST_LEVELS:
        raise ValueError(
            f"the factor {factor!r} has {len(levels)} levels, and at most {MOST_LEVELS} are shown separately"
        )
    return {str(level): summary([row for row in rows if row.get(column) == level]) for level in levels}


def _is_known(row: Row) -> bool:
    return bool(row["supported"]) and row["truth"] is not None


def _scale(row: Row) -> tuple[str, float]:
    """Unit that an error is shown in, and the factor to it."""
    if is_positive(row["quantity"], row["unit"]) and row["truth"]:
        return "%", 100.0 / abs(row["truth"])
    return _SCALES.get(row["unit"], (row["unit"], 1.0))


def _errors(rows: Sequence[Row]) -> ErrorStatistics | None:
    """None where no truth is known."""
    if not any(row["truth"] is not None for row in rows):
        return None
    known = [row for row in rows if _is_known(row)]
    quantity, flights = rows[0]["quantity"], len({row["flight"] for row in rows})
    if not known:
        no = math.nan
        return ErrorStatistics(quantity, "", flights, 0, no, no, no, no, no, no, no, no, share_of(0, 0), np.zeros(0))
    factor = np.array([_scale(row)[1] for row in known])
    plain, sigma = _column(known, "value") - _column(known, "truth"), _column(known, "sigma")
    error, bound = factor * plain, _column(known, "bound")
    inside = (_column(known, "low") <= _column(known, "truth")) & (_column(known, "truth") <= _column(known, "high"))
    return ErrorStatistics(
        quantity,
        _scale(known[0])[0],
        flights,
        len(known),
        float(np.percentile(np.abs(error), 95)),
        _rms(error),
        float(error.mean()),
        float(np.abs(error).max()),
        float((factor * sigma).mean()),
        float((factor * np.nan_to_num(_column(known, "drawn"))).mean()),
        _rms(plain / sigma),
        _rms(plain / bound) if np.isfinite(bound).all() else math.nan,
        share_of(int(inside.sum()), len(known)),
        plain / sigma,
    )


def _column(rows: Sequence[Row], key: str) -> FloatArray:
    return np.array([math.nan if row[key] is None else row[key] for row in rows], np.float64)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _worst(row: Row) -> Worst:
    unit, factor = _scale(row)
    return Worst(
        *(
            row["flight"],
            f"{row['what']} seed {row['seed']}",
            row["quantity"],
            factor * (row["value"] - row["truth"]),
            unit,
        ),
        float(off_by(row["value"], row["low_999"], row["high_999"], row["truth"])),
        *(row["outcome"], tuple(row["faults"]), row["leans"]),
    )


def _faults(row: Row) -> tuple[str, ...]:
    return tuple(dict.fromkeys(kinds(row["faults"]))) or (NO_FAULT,)


def _by_fault(rows: Iterable[Row]) -> tuple[dict[str, Counter[str]], dict[str, int]]:
    """Outcomes of answers, and flights with confident nonsense, by each fault that a flight has."""
    found: dict[str, Counter[str]] = {}
    wrong: dict[str, set[str]] = {}
    for row in rows:
        for fault in _faults(row):
            counter = found.setdefault(fault, Counter())
            if row["quantity"]:
                counter[row["outcome"]] += 1
            if row["outcome"] == Outcome.NONSENSE:
                wrong.setdefault(fault, set()).add(row["flight"])
    order = sorted(found, key=lambda fault: (fault != NO_FAULT, -len(wrong.get(fault, ())), fault))
    return {fault: found[fault] for fault in order}, {fault: len(flights) for fault, flights in wrong.items()}


def _effects(rows: Sequence[Row]) -> list[Effect]:
    """Of every factor of the design on one quantity, most of all first."""
    known = [row for row in rows if _is_known(row)]
    factors: dict[str, FloatArray] = {}
    for name in [key for key in rows[0] if key.startswith(FACTOR)]:
        if (columns := _design([row[name] for row in known])) is not None:
            factors[name.removeprefix(FACTOR)] = columns
    if (columns := _design([" and ".join(_faults(row)) for row in known])) is not None:
        factors["faults"] = columns
    if not factors:
        return []
    error = np.array([_scale(row)[1] * (row["value"] - row["truth"]) for row in known])
    scatter = np.abs(error - _fitted(np.hstack([np.ones((len(error), 1)), *factors.values()]), error))
    found = []
    for name in factors:
        shifts, spreads = (_partial(factors, name, response) for response in (error, scatter))
        if shifts is not None and spreads is not None:
            found.append(Effect(rows[0]["quantity"], name, *shifts, *spreads))
    return sorted(found, key=lambda one: -max(one.shifts, one.spreads))


def _design(values: Sequence[Any]) -> FloatArray | None:
    """Columns of a factor: a number as it is, levels as indicators of all but the first; None of a constant one."""
    levels = list(dict.fromkeys(values))
    if len(levels) < 2:
        return None
    if all(isinstance(value, float) for value in values):
        column = np.array(values, np.float64)
        return np.asarray(((column - column.mean()) / column.std())[:, None], np.float64)
    if len(levels) > MOST_LEVELS:
        return None
    return np.array([[float(value == level) for level in levels[1:]] for value in values])


def _partial(factors: Mapping[str, FloatArray], name: str, response: FloatArray) -> tuple[float, float] | None:
    """Share of variance that a factor alone explains, and the chance of as much by nothing; None of too few flights."""
    ones = np.ones((len(response), 1))
    whole = np.hstack([ones, *factors.values()])
    without = np.hstack([ones, *(columns for other, columns in factors.items() if other != name)])
    rank, less = int(np.linalg.matrix_rank(whole)), int(np.linalg.matrix_rank(without))
    free, total = len(response) - rank, float(np.sum((response - response.mean()) ** 2))
    if free < 2 or rank == less or total == 0.0:
        return None
    left, before = _residual(whole, response), _residual(without, response)
    ratio = (before - left) / (rank - less) / max(left / free, np.finfo(float).tiny)
    return max(before - left, 0.0) / total, float(stats.f.sf(ratio, rank - less, free))


def _residual(design: FloatArray, response: FloatArray) -> float:
    return float(np.sum((response - _fitted(design, response)) ** 2))


def _fitted(design: FloatArray, response: FloatArray) -> FloatArray:
    return np.asarray(design @ np.linalg.lstsq(design, response, rcond=None)[0], np.float64)
