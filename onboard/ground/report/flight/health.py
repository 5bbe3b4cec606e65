"""Section of a report: how the flight computer, the workers and the streams stood."""

from onboard.flight.health.status import words
from onboard.ground.drawing import html
from onboard.ground.drawing.html import Cell
from onboard.ground.log.views.health import PROCESSES, HealthSummary

_HEALTH = {
    "rows_hz": "rows a second",
    "slowest_percent": "slowest stream, % of its rate",
    "recorder_backlog_percent": "fullest ring before the recorder, %",
    "estimator_lag_s": "estimator behind the devices, s",
    "row_age_s": "age of the newest row, s",
    **{f"{name}_cpu_percent": f"CPU of {name}, % of a core" for name in PROCESSES},
    **{f"{name}_pss_mb": f"memory (PSS) of {name}, MB" for name in PROCESSES},
    "computer_idle_percent": "idle time of all cores, %",
    "memory_free_mb": "memory available, MB",
    "disk_free_mb": "disk free, MB",
    "temperature_deg_c": "temperature, deg C",
}


def health(said: HealthSummary) -> str:
    """Least, mean and largest values, and the status words."""
    if not said.rows:
        return html.paragraph("The flight has no health records: it was simulated in virtual time, or imported.")
    rows: list[list[object]] = []
    for name, what in _HEALTH.items():
        numbers = (said.least(name), said.mean(name), said.most(name))
        rows.append([what, *(Cell("unknown" if number is None else f"{number:.4g}") for number in numbers)])
    text = f"Last second: {words(said.status)}. At any time: {words(said.latched)}."
    return html.paragraph(text) + html.table(["", "least", "mean", "most"], rows)
