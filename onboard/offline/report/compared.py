"""Final estimates beside true and published values."""

import tomllib
from typing import Any, NamedTuple

import numpy as np

from onboard import config
from onboard.offline.report.flight_data import FlightData
from onboard.offline.views.standing import leans_on, shown
from onboard.recording.texts import printable


class Compared(NamedTuple):
    """A final estimate of the flight, SI; unknown values are ``None``."""

    name: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    supported: bool
    truth: float | None
    published: float | None
    standing: str = ""  # what it is good for

    @property
    def error_percent(self) -> float | None:
        """Relative error, percent of the truth."""
        return None if self.truth is None or not self.truth else 100.0 * (self.value / self.truth - 1.0)

    @property
    def covered(self) -> bool | None:
        """Whether the interval contains the truth."""
        return None if self.truth is None else self.low <= self.truth <= self.high


def compared(flight: FlightData) -> list[Compared]:
    """The final estimate of every quantity with a unit, those with a published value first."""
    rows = _published(flight.name)
    order = {row["quantity"]: number for number, row in enumerate(rows)}
    labels = {row["quantity"]: row["label"] for row in rows}
    published = {row["quantity"]: row["identified_g"] * 1e-3 for row in rows if "identified_g" in row}
    truths = truths_of(flight)
    found = []
    for name, said in flight.quantities.items():
        last = said[-1]
        if last["unit"]:
            value, low, high = (float(last[field]) for field in ("value", "low", "high"))
            label, unit, supported = labels.get(name, name), printable(last["unit"]), bool(last["supported"])
            known = truths.get(name), published.get(name)
            found.append(Compared(name, label, unit, value, low, high, supported, *known, _standing(last)))
    return sorted(found, key=lambda one: order.get(one.name, len(order)))


def truths_of(flight: FlightData) -> dict[str, float]:
    """True values by quantity, SI."""
    if flight.truth is None:
        return {}
    truths: dict[str, float] = dict(flight.truth.get("quantities", {}))
    for name in flight.quantities:  # the same mass, from the rows with the payload held alone
        if name.removesuffix("_held") in truths:
            truths.setdefault(name, truths[name.removesuffix("_held")])
    return truths


def _published(vehicle: str) -> list[dict[str, Any]]:
    """Rows of the packaged vehicle's published table, possibly none."""
    try:
        path = config.packaged(vehicle).with_name("published.toml")
    except config.ConfigError:
        return []
    if not path.exists():
        return []
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    return [row for section in ("row", "centre", "inertia") for row in tables.get(section, [])]


def _standing(row: np.void) -> str:
    """Level, reason, and the calibrations that a good answer leans on."""
    return "; ".join(part for part in (shown(row), leans_on(row)) if part)
