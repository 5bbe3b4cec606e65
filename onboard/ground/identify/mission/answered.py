"""Which answers of a flight are shown, in which order and unit: the same by ``heft hil`` and ``heft report``.

The packaged vehicle's ``published.toml`` lists what was published of it: masses (``row``), centres of mass (``centre``)
and ``inertia``, each with its label and, if there is one, the published value. These come first, and whatever else the
vehicle answers after them. Of any other vehicle all that it answers is shown, base parameters of rows (``parameter``)
among it where the world knows their true values.
"""

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from onboard import config

Row = dict[str, Any]
SECTIONS = ("row", "centre", "inertia", "parameter", "motion")
_SECTION = {"kg": "row", "m": "centre", "kg m^2": "inertia", "m/s": "motion", "rad/s": "motion"}
_UNITS = {"kg": ("g", 1e3), "m": ("mm", 1e3), "kg m^2": ("g m²", 1e3), "m/s": ("mm/s", 1e3)}
_KINDS = {  # units of base parameters, by the first part of their names
    **{"M": "kg", "Ia": "kg m²", "Fv": "N m s", "Fc": "N m"},
    **dict.fromkeys(("MX", "MY", "MZ"), "kg m"),
    **dict.fromkeys(("XX", "XY", "YY", "XZ", "YZ", "ZZ"), "kg m²"),
}
_PUBLISHED: dict[str, Row] = {  # how what was published is shown
    "row": {"shown_in": "g", "factor": 1e3, "digits": 1},
    "centre": {"shown_in": "mm", "factor": 1e3, "digits": 2},
    "inertia": {"shown_in": "g m²", "factor": 1e3, "digits": 3},
}
_DIGITS = 5  # significant, of a truth
_FEWER = 2  # digits, of what is about zero and has those of its interval


def published_of(name: str) -> Row:
    """What was published of a packaged vehicle; empty if nothing."""
    try:
        path = config.packaged(name).with_name("published.toml")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}


def answered(
    vehicle: config.Vehicle | None, answers: Mapping[str, Row], true: Mapping[str, float] | None, published: Row
) -> dict[str, list[Row]]:
    """Rows by section: ``quantity``, ``label``, true ``value`` (None if unknown), ``shown_in``, ``factor``, ``digits``.

    Args:
        vehicle: that flew; None where it is not known.
        answers: the last QUANTITY of each name.
        true: what these should have been, SI; None of a flight without a truth, of which all with a unit are shown.
        published: of it (:func:`published_of`).
    """
    found: dict[str, list[Row]] = {section: [] for section in SECTIONS}
    for section, shown in _PUBLISHED.items():
        rows = published.get(section, [])
        found[section] = [shown | row | {"value": (true or {}).get(row["quantity"])} for row in rows]
    seen = {row["quantity"] for rows in found.values() for row in rows}
    for name, answer in answers.items():
        value = float("nan") if true is None else true.get(name, np.nan)
        if name in seen or not (np.isfinite(value) if true is not None else answer["unit"]):
            continue
        section = _SECTION.get(answer["unit"], "parameter")
        own = _PUBLISHED.get(section, {}) if published else {}
        found[section].append(_row(name, answer, value, section) | own)
    ours = vehicle is not None and vehicle.prediction not in (config.Prediction.ROWS, config.Prediction.PLANAR)
    if published or ours:  # of predictions, the standard parameters say the same as their body
        found["parameter"] = []
    return found


def _row(name: str, answer: Row, value: float, section: str) -> Row:
    shown_in, factor = _UNITS.get(answer["unit"], (answer["unit"] or _KINDS.get(name.split("_", 1)[0], "SI"), 1.0))
    known = float(value) if np.isfinite(value) else None
    row: Row = {"quantity": name, "label": name, "value": known, "shown_in": shown_in, "factor": factor}
    if section != "motion":
        return row | {"digits": _digits(factor * abs(value))}
    size = max(abs(float(value)), *(abs(answer.get(end) or 0.0) for end in ("low", "high")))  # it is about zero
    return row | {
        "label": name.replace("_before_capture_", " before, "),
        "unit": answer["unit"],
        "digits": max(_digits(factor * size) - _FEWER, 0),
    }


def error(value: float, low: float, high: float, sigma: float, truth: float) -> tuple[float | None, float | None]:
    """Of an answer, in percent of the truth and in its sigmas; each None where it says nothing.

    The data cannot tell a truth of less than half the interval from zero: a share of it would be 100 % and more.
    """
    near_zero = abs(truth) <= 0.5 * (high - low)
    return None if near_zero else 100.0 * (value / truth - 1.0), (value - truth) / sigma if sigma > 0.0 else None


def error_told(percent: float | None, sigmas: float | None, unit: str = "") -> str:
    """``+1.23``, with ``unit`` after it; ``-0.8 σ`` where a share says nothing."""
    if percent is not None:
        return f"{percent:+.2f}{unit}"
    return "" if sigmas is None else f"{sigmas:+.1f} σ"


def _digits(size: float) -> int:
    if size == 0.0 or not np.isfinite(size):
        return 3
    return int(np.clip(_DIGITS - 1 - np.floor(np.log10(size)), 0, 6))
