"""Flights side by side: what each said last of every quantity, whether they agree, how it changes from one to the next.

Flights with the same instruments share the errors of their calibration, so a mean is not taken to be any better than
the flights are.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Group, RenderableType
from rich.progress import Progress
from rich.table import Column, Table
from rich.text import Text
from scipy.special import chdtrc

from onboard.estimation.policy import HALF
from onboard.ground.log.views.info import LogInfo, info
from onboard.ground.log.views.summary import LogOverview, summary
from onboard.recording.format.scan import Damage
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

DISAGREE = 0.01  # chance that flights of one value scatter so widely, below which it is said


class ComparedFlight(NamedTuple):
    """One log."""

    path: Path
    about: LogInfo
    said: LogOverview


@dataclass(frozen=True)
class ComparedQuantity:
    """One quantity over the flights, in their order.

    Attributes:
        name: of the quantity.
        unit: of it; empty for a base parameter.
        value: by flight; NaN where the data did not support it.
        sigma: standard deviation, likewise.
        mean: weighted by the variances.
        sigma_mean: of the mean, for errors that all flights share: no less than if they were one flight.
        chance: that flights of one value scatter so widely (chi-square); None for fewer than two.
        trend: change from a flight to the next, and its sigma; None for fewer than three.
    """

    name: str
    unit: str
    value: tuple[float, ...]
    sigma: tuple[float, ...]
    mean: float
    sigma_mean: float
    chance: float | None
    trend: tuple[float, float] | None

    def as_json(self) -> dict[str, Any]:
        """Plain values; None for what is no number."""
        numbers = {key: [None if np.isnan(one) else one for one in getattr(self, key)] for key in ("value", "sigma")}
        return {**self.__dict__, **numbers, "trend": None if self.trend is None else list(self.trend)}


@dataclass(frozen=True)
class FlightComparison:
    """All flights, and every quantity that one of them answered."""

    flights: tuple[ComparedFlight, ...]
    quantities: tuple[ComparedQuantity, ...]

    @property
    def damage(self) -> tuple[Damage, ...]:
        """Of all logs."""
        return tuple(one for flight in self.flights for one in flight.about.damage)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        logs = [
            {
                "log": str(flight.path),
                "duration_s": flight.about.duration_s,
                "unexplained": flight.about.unexplained,
                "rows_used": flight.said.used,
                "rows": flight.said.rows,
            }
            for flight in self.flights
        ]
        return {"logs": logs, "quantities": [one.as_json() for one in self.quantities]}


def compare(logs: Sequence[LogReader], progress: Progress | None = None) -> FlightComparison:
    """Compare what flights said last; at least two.

    Raises:
        ValueError: fewer than two logs, or none that says anything.
        OSError: a log cannot be read.
    """
    if len(logs) < 2:
        raise ValueError("give two logs or more to compare")
    flights = tuple(ComparedFlight(log.path, info(log, progress), summary(log, progress)) for log in logs)
    answers = [flight.said.answers for flight in flights]
    names = dict.fromkeys(name for one in answers for name, row in one.items() if row["supported"])
    if not names:
        raise ValueError("none of the logs answers anything; identify from them with heft identify")
    quantities = [compared_quantity(name, answers) for name in names]
    with_unit = tuple(one for one in quantities if one.unit)
    return FlightComparison(flights, with_unit or tuple(quantities))


def compared_quantity(name: str, answers: Sequence[dict[str, np.void]]) -> ComparedQuantity:
    """One quantity by the last answers of each log, and whether they agree."""
    rows = [one.get(name) for one in answers]
    known = [row is not None and bool(row["supported"]) and row["sigma"] > 0 for row in rows]
    value, sigma = (
        np.array([row[key] if row is not None and good else np.nan for row, good in zip(rows, known, strict=True)])
        for key in ("value", "sigma")
    )
    unit = next((printable(row["unit"]) for row in rows if row is not None and row["supported"]), "")
    at, x, s = np.flatnonzero(known).astype(float), value[known], sigma[known]
    if not len(x):
        return ComparedQuantity(name, unit, tuple(value), tuple(sigma), np.nan, np.nan, None, None)
    weight = 1.0 / s**2
    mean, sigma_mean = (float(np.sum(weight * one) / np.sum(weight)) for one in (x, s))
    chance = float(chdtrc(len(x) - 1, np.sum(weight * (x - mean) ** 2))) if len(x) > 1 else None
    trend = None
    if len(x) > 2:  # weighted straight line over the flights' numbers
        centred = at - np.sum(weight * at) / np.sum(weight)
        square = float(np.sum(weight * centred**2))
        trend = float(np.sum(weight * centred * (x - mean))) / square, square**-0.5
    return ComparedQuantity(name, unit, tuple(value.tolist()), tuple(sigma.tolist()), mean, sigma_mean, chance, trend)


def render(found: FlightComparison) -> RenderableType:
    """``found`` for a terminal."""
    flights = Table(box=None, padding=(0, 1), pad_edge=False, header_style="bold")
    for heading in ("", "log", "length s", "unexplained", "rows used"):
        flights.add_column(heading, justify="left" if heading == "log" else "right")
    for number, flight in enumerate(found.flights, 1):
        used = f"{flight.said.used:,} of {flight.said.rows:,}"
        missing = f"{flight.about.unexplained:,}" if flight.about.unexplained else "-"
        flights.add_row(str(number), str(flight.path), f"{flight.about.duration_s:.2f}", missing, used)
    headings = (*map(str, range(1, len(found.flights) + 1)), "together", "a flight")
    numbers = (Column(heading, justify="right") for heading in headings)
    columns = Column("quantity", no_wrap=True), *numbers, Column("unit", no_wrap=True), Column(no_wrap=True)
    table = Table(*columns, box=None, padding=(0, 1), pad_edge=False, header_style="bold")
    for one in found.quantities:
        each = [interval(value, sigma) for value, sigma in zip(one.value, one.sigma, strict=True)]
        trend = "" if one.trend is None else interval(*one.trend, sign="+")
        differ = one.chance is not None and one.chance < DISAGREE
        word = Text("they disagree", style="yellow") if differ else Text("")
        table.add_row(Text(one.name), *each, interval(one.mean, one.sigma_mean), trend, one.unit, word)
    told = (
        "Values with 95 % intervals; together: weighted mean, no surer than a flight is, for errors of calibration are "
        "common to all; a flight: change from flight to flight."
    )
    return Group(flights, Text(), table, Text(told))


def interval(value: float, sigma: float, sign: str = "") -> str:
    """``value`` with the half width of its 95 % interval, to two digits of that."""
    if not np.isfinite(value + sigma):
        return "-"
    half = HALF * sigma
    decimals = max(0, 1 - int(np.floor(np.log10(half)))) if half > 0 else 6
    return f"{value:{sign}.{decimals}f} ± {half:.{decimals}f}"
