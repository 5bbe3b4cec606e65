"""Fields of packets from rows of the flight."""

import math
from typing import Any

import numpy as np

from onboard.channels import numbers_of
from onboard.recording.format.texts import printable
from onboard.telemetry.packets import KINDS

OF_HEALTH = {  # fields of the status, of the row HEALTH
    "latched": "status_latched",
    "word": "status_word",
    "rows": "rows",
    "rows_hz": "rows_hz",
    "slowest": "slowest_percent",
    "gaps": "gaps",
    "missing": "missing",
    "not_recorded": "not_recorded",
    "recorder_backlog": "recorder_backlog_percent",
    "estimator_lag": "estimator_lag_s",
    "estimator_skipped": "estimator_skipped_s",
    "restarts": "restarts",
    "computer_idle": "computer_idle_percent",
    "memory_free": "memory_free_mb",
    "disk_free": "disk_free_mb",
    "temperature": "temperature_deg_c",
}
_HEALTH_FIELDS = {
    field.name: field
    for field in KINDS["status"].fields
    if field.name in (*OF_HEALTH, "health_age", "clocks_locked", "clocks_not_locked")
}


def health_values(row: np.void | None, now_ns: int) -> dict[str, Any]:
    """Those of a status that are of a HEALTH row; zeros and NaN without one."""
    if row is None:
        return {name: 0 if field.code in "BHIQ" else math.nan for name, field in _HEALTH_FIELDS.items()}
    health = {name: row[of].item() for name, of in OF_HEALTH.items()}
    health["health_age"] = max(0, now_ns - int(row["host_ns"])) * 1e-9
    clocks = {state: int(row[f"clocks_{state}"]) for state in ("acquiring", "locked", "flywheel", "invalid")}
    health["clocks_locked"] = clocks.pop("locked")
    health["clocks_not_locked"] = sum(clocks.values())
    return health


def level_of(row: np.void) -> int:
    """Level of a QUANTITY row; weak where an older log has none."""
    return min(int(row["level"]), 2) if "level" in (row.dtype.names or ()) else 1


def why_of(row: np.void) -> str:
    """Why it is no better."""
    return printable(row["why"]) if "why" in (row.dtype.names or ()) else ""


def of_answer(row: np.void) -> tuple[int, dict[str, Any]]:
    """Time, host clock, and fields of an answer."""
    supported = int(bool(row["supported"]))
    return int(row["host_ns"]), {
        "quantity": printable(row["name"]),
        "unit": printable(row["unit"]),
        "supported": supported,
        "level": level_of(row),
        **{name: number if supported else math.nan for name, number in numbers_of(row).items()},
    }


def of_event(row: np.void) -> tuple[int, dict[str, Any]]:
    """Time, host clock, and fields of an event."""
    texts = {key: printable(row[key]) for key in ("code", "source", "text")}
    return int(row["host_ns"]), {"severity": min(int(row["severity"]), 2), **texts}
