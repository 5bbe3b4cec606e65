"""A QUANTITY row as plain values, its level and reason as text."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from onboard.channels import numbers_of
from onboard.identification.standing import LEVELS, Level, Standing
from onboard.recording.format.texts import printable


def standing_of(row: np.void) -> Standing | None:
    """Level and reason; None in a log of an older version."""
    if "level" not in (row.dtype.names or ()):
        return None
    level = LEVELS[min(int(row["level"]), len(LEVELS) - 1)]
    return Standing(level, printable(row["why"]))


def leans_on(row: np.void) -> str:
    """``leans on load_cell scale_sigma 0.25 %``: of a good quantity; empty where nothing is said."""
    found = standing_of(row)
    return found.why if found is not None and found.level is Level.GOOD else ""


def is_withdrawn(row: np.void) -> bool:
    """Whether its level is *do not use*."""
    found = standing_of(row)
    return found is not None and found.level is Level.DO_NOT_USE


def shown(row: np.void) -> str:
    """``good; ± 0.8 % from the rows, ± 1.2 % from the drawing``; empty in a log without levels."""
    found = standing_of(row)
    if found is None:
        return ""
    if found.level is Level.GOOD:
        found = Standing(Level.GOOD)
    drawn = float(row["drawn"])
    if not (found.level is not Level.DO_NOT_USE and row["supported"] and drawn > 0.0 and row["value"]):
        return found.text
    rows = float(np.sqrt(max(float(row["sigma"]) ** 2 - drawn**2, 0.0)))
    parts = (f"{200.0 * part / abs(float(row['value'])):.1f} %" for part in (rows, drawn))
    return "{}; ± {} from the rows, ± {} from the drawing".format(found.text, *parts)


def answers_of(last: Mapping[str, np.void]) -> dict[str, dict[str, Any]]:
    """Last QUANTITY rows by name as plain values, SI, with what each is good for."""
    return {
        name: {
            **numbers_of(row),
            "unit": printable(row["unit"]),
            "supported": bool(row["supported"]),
            "standing": shown(row),
            "leans": leans_on(row),
            "drawn": float(row["drawn"]) if "drawn" in (row.dtype.names or ()) else 0.0,
        }
        for name, row in last.items()
    }
