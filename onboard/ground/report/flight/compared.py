"""Final estimates beside true and published values."""

from typing import NamedTuple

from onboard.channels import NUMBERS
from onboard.ground.identify.mission.answered import SECTIONS, answered, error, error_told, published_of
from onboard.ground.log.views.standing import answers_of
from onboard.ground.report.flight.flight_data import FlightData


class Compared(NamedTuple):
    """A final estimate of the flight, SI; unknown values are ``None``."""

    name: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    sigma: float
    low_999: float
    high_999: float
    supported: bool
    truth: float | None
    published: float | None
    standing: str = ""  # what it is good for

    def error(self, unit: str = "") -> str:
        """In percent of the truth, with ``unit`` after it; in sigmas where the truth is about zero."""
        if self.truth is None:
            return ""
        return error_told(*error(self.value, self.low, self.high, self.sigma, self.truth), unit)

    @property
    def covered(self) -> bool | None:
        """Whether the interval contains the truth."""
        return None if self.truth is None else self.low <= self.truth <= self.high


def compared(flight: FlightData) -> list[Compared]:
    """The final estimate of every answer, those that were published first."""
    answers = answers_of({name: said[-1] for name, said in flight.quantities.items()})
    is_published = flight.truth is None or flight.truth.get("published", True)
    true = None if flight.truth is None else truths_of(flight)
    rows = answered(flight.vehicle, answers, true, published_of(flight.name) if is_published else {})
    found = []
    for row in (row for section in SECTIONS for row in rows[section] if row["quantity"] in answers):
        one = answers[row["quantity"]]
        published = row["identified_g"] * 1e-3 if "identified_g" in row else None
        standing = "; ".join(part for part in (one["standing"], one["leans"]) if part)
        numbers = {key: one[key] for key in (*NUMBERS, "supported")}
        names = {"name": row["quantity"], "label": row["label"], "unit": one["unit"] or row["shown_in"]}
        found.append(Compared(**names, **numbers, truth=row["value"], published=published, standing=standing))
    return found


def truths_of(flight: FlightData) -> dict[str, float]:
    """True values by quantity, SI."""
    if flight.truth is None:
        return {}
    return dict(flight.truth.get("quantities", {}))
