"""What came of one flight: its answers beside their truth, and what each of them was good for."""

import math
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NamedTuple

from onboard.channels import NUMBERS
from onboard.ground.campaign.instants import Instants, off_by
from onboard.ground.log.tables.truth import Truth
from onboard.identification.quantities import outer_of
from onboard.identification.standing import Level

if TYPE_CHECKING:
    from onboard.ground.identify.kinds.identified import Identified

_UNITS = {"masses": "kg", "centres": "m", "inertias": "kg m^2"}
MOST_EVENTS = 64


class Outcome(StrEnum):
    """Of an answer, from best to worst."""

    RIGHT = "right"
    WEAK = "weak"
    DO_NOT_USE = "do not use"
    LEANS = "wrong, unseen"
    NONSENSE = "confident nonsense"
    UNKNOWN = "no truth"


class FlightAnswer(NamedTuple):
    """One quantity of a flight, in SI units; NaN for what is not known or not said."""

    quantity: str
    unit: str = ""
    truth: float = math.nan
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    sigma: float = math.nan
    bound: float = math.nan  # Cramer-Rao: the least sigma
    drawn: float = 0.0  # part of sigma that the drawing's tolerances make
    supported: bool = False
    level: str = ""
    why: str = ""
    leans: str = ""
    instants: Instants = Instants()
    low_999: float = math.nan  # 99.9 % interval; NaN: that of a normal
    high_999: float = math.nan

    @property
    def outer(self) -> tuple[float, float]:
        """Ends of its 99.9 % interval."""
        if math.isnan(self.low_999):
            return outer_of(self.value, self.low, self.high)
        return self.low_999, self.high_999

    def outcome(self, *, unseen: bool = False) -> Outcome:
        """Confident nonsense is an answer that is supported while its truth lies beyond its 99.9 % interval.

        Args:
            unseen: no instrument on board can show what is wrong; the answer leans on a calibration.
        """
        if self.supported and off_by(self.value, *self.outer, self.truth) > 1.0:
            return Outcome.LEANS if unseen else Outcome.NONSENSE
        if self.level == Level.DO_NOT_USE:
            return Outcome.DO_NOT_USE
        if not self.supported or self.level == Level.WEAK:
            return Outcome.WEAK
        return Outcome.RIGHT if math.isfinite(self.truth) else Outcome.UNKNOWN


class FlightResult(NamedTuple):
    """What a flight gives, or a function that a plan calls.

    Attributes:
        answers: each quantity.
        faults: as ``heft hil --fault`` has them, or words; besides those of the plan.
        events: warnings and errors of the log, the first of them.
        accounted: whether every sample was; None where nobody counts.
        unseen: see :meth:`Answer.outcome`.
        capture_s, detected_s: mission time of a capture, and of its first detection; NaN without.
        detections: how many.
        what: flew; the plan's mission or function where it is empty.
    """

    answers: tuple[FlightAnswer, ...]
    faults: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    accounted: bool | None = None
    unseen: bool = False
    capture_s: float = math.nan
    detected_s: float = math.nan
    detections: int = 0
    what: str = ""

    @property
    def nonsense(self) -> bool:
        """Whether an answer is, or was at any time of the flight."""
        at_the_end = any(one.outcome(unseen=self.unseen) is Outcome.NONSENSE for one in self.answers)
        return at_the_end or (not self.unseen and any(one.instants.beyond for one in self.answers))

    def with_instants(self, found: Mapping[str, Instants]) -> "FlightResult":
        """With what was reported in flight, by quantity."""
        told = (one._replace(instants=found.get(one.quantity, Instants())) for one in self.answers)
        return self._replace(answers=tuple(told))


class Returned(NamedTuple):
    """What comes back: a result, or why there is none; and the log and its truth, by the end of their names."""

    result: FlightResult | None
    error: str = ""
    kept: dict[str, bytes] = {}  # noqa: RUF012 - never changed


def of_mission(table: Mapping[str, Any]) -> FlightResult:
    """From the result table of ``heft hil``."""
    answers = [
        _answer(row, _UNITS.get(section, str(row.get("unit") or row.get("shown_in", ""))))
        for section in ("masses", "centres", "inertias", "parameters", "motions")
        for row in table[section]
    ]
    capture = table["capture"] or {"true_s": math.nan, "said_s": []}
    said = capture["said_s"]
    return FlightResult(
        tuple(answers),
        events=tuple(table["events"][:MOST_EVENTS]),
        accounted=bool(table["accounted"]),
        capture_s=float(capture["true_s"]),
        detected_s=float(said[0]) if said else math.nan,
        detections=len(said),
    )


def _answer(row: Mapping[str, Any], unit: str) -> FlightAnswer:
    level, why = _standing(str(row["standing"]))
    made = FlightAnswer(str(row["quantity"]), unit, float(row["truth"]), level=level, why=why, leans=str(row["leans"]))
    if not row["supported"]:
        return made
    numbers: dict[str, Any] = {key: float(row[key]) for key in (*NUMBERS, "drawn")}
    return made._replace(supported=math.isfinite(numbers["value"]), **numbers)


def _standing(text: str) -> tuple[str, str]:
    """Level and reason of ``weak: its interval contains zero`` and of ``good; ± 0.8 % from the rows``."""
    for level in Level:
        if text.startswith(level):
            return str(level), text[len(level) :].lstrip(":; ")
    return "", text


def of_log(found: "Identified", truth: Truth | None) -> FlightResult:
    """From what ``heft identify`` found in a log, beside the truth that lies with it."""
    true = (truth or {}).get("quantities", {})
    known = {name: float(value) for name, value in true.items() if isinstance(value, int | float)}
    answers = []
    for one in found.answers:
        level, why = found.standing(one)
        made = FlightAnswer(one.name, one.unit, known.get(one.name, math.nan), bound=one.bound, leans=one.leans)
        made = made._replace(level=str(level), why=why)
        if one.supported and found.verdict.level is not Level.DO_NOT_USE:
            made = made._replace(supported=True, value=one.value, low=one.low, high=one.high, sigma=one.sigma)
        answers.append(made)
    return FlightResult(tuple(answers), events=(found.verdict.text,))


def kinds(faults: Iterable[str]) -> tuple[str, ...]:
    """What of faults is common to flights: ``stuck load_cell`` of ``stuck:load_cell:5:8``; words stay as they are."""
    return tuple(" ".join(one.split(":")[:2]) if ":" in one else one for one in faults)
