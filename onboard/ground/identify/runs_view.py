"""Table of the runs of parabolic flights: how the log was cut, and what each run says by itself."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

Row = Mapping[str, Any]


def of_numbers(title: str, *headings: str) -> Table:
    """A table without rows, the first column on the left, the others on the right."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left", no_wrap=True)
    return table


def compared(runs: Sequence[Row], truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Runs beside what was flown: which motion, and how far release and catch are from the true ones.

    Args:
        runs: of the log.
        truth: of the simulated flight.
    """
    flown = list(truth.get("parabolas", ()))
    made = []
    for run in runs:
        shown, offset_s = dict(run), run["log_start_s"] - 1e-9 * truth["start_ns"]  # mission time of the first tick
        release_s = run["release_s"]
        begin_s, end_s = (np.nan if of is None else of + offset_s for of in (release_s, run["catch_s"]))
        same = [one for one in flown if one["release_s"] < end_s and one["catch_s"] > begin_s]
        if same:
            one = same[0]
            shown |= {"flown": one["flown"], "true_bumps": len(one["bumps_s"])}
            shown["release_late_s"] = release_s + offset_s - one["release_s"]
            shown["catch_early_s"] = one["catch_s"] - run["catch_s"] - offset_s
        made.append(shown)
    return made


def render(runs: Sequence[Row]) -> Iterator[RenderableType]:
    """The table, 80 columns, and below it why runs were refused."""
    if not runs:
        return
    known = any("flown" in run for run in runs)
    table = Table(title="runs", title_justify="left", box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    headings = ("", *(("flown",) if known else ()), "free s", "caught s", "bumps", "moves", "mass kg", "")
    for heading in headings:  # where there is little room the names are folded, and no number is cut
        table.add_column(heading, justify="left" if heading in ("flown", "") else "right", no_wrap=heading != "flown")
    for run in runs:
        flown = (str(run.get("flown", "—")),) if known else ()
        times = ["—" if run[key] is None else f"{run[key]:.2f}" for key in ("release_s", "catch_s")]
        counts = [str(len(run[key])) if run["release_s"] is not None else "—" for key in ("bumps_s", "motions_s")]
        table.add_row(str(run["parabola"] + 1), *flown, *times, *counts, _mass(run), run["state"])
    yield table
    reasons: dict[str, list[str]] = {}
    for run in runs:
        if run["reason"]:
            reasons.setdefault(str(run["reason"]), []).append(str(run["parabola"] + 1))
    for reason, numbers in reasons.items():
        yield Text(f"parabola {', '.join(numbers)}: {reason}")


def _mass(run: Row) -> str:
    masses = [one for one in run["quantities"] if one["unit"] == "kg"]
    if not masses:
        return "—"
    half = 0.5 * (masses[0]["high"] - masses[0]["low"])
    return f"{masses[0]['value']:.3f} ± {half:.3f}" if np.isfinite(half) else "—"
