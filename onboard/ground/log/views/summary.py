"""Clock solutions, counts of gate reasons and last estimates of a flight, read from its log."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.progress import Progress
from rich.table import Column, Table
from rich.text import Text

from onboard import channels, config
from onboard.estimation.gates import GateReason
from onboard.flight.clocks import known_delays
from onboard.ground.log.tables.progress import follow
from onboard.ground.log.tables.thin import Thinned
from onboard.ground.log.tables.vehicle_file import attached_vehicle
from onboard.ground.log.views.health import HealthSummary, is_health
from onboard.ground.log.views.standing import is_withdrawn, shown, standing_of
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader
from onboard.timebase.clock import ClockState
from onboard.timebase.delays import Delay

_POINTS = 4000  # points per clock kept for a plot


@dataclass
class LogOverview:
    """CLOCK rows by clock (thinned for a long flight), counts of rows, last estimates, delays removed, health."""

    clocks: dict[str, np.ndarray] = field(default_factory=dict)
    rows: int = 0
    used: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    answers: dict[str, np.void] = field(default_factory=dict)
    delays: tuple[Delay, ...] = ()
    health: HealthSummary = field(default_factory=HealthSummary)

    def as_json(self) -> dict[str, Any]:
        """Plain values; None for quantities that the data do not determine."""
        return {
            "clocks": {name: _clock_json(rows[-1]) for name, rows in sorted(self.clocks.items())},
            "delays": [delay._asdict() for delay in self.delays],
            "rows": {"total": self.rows, "used": self.used, "refused": self.refused},
            "answers": {name: _answer_json(row) for name, row in self.answers.items()},
            "health": self.health.as_json(),
        }


def summary(log: LogReader, progress: Progress | None = None) -> LogOverview:
    """Read the overview of ``log``; parts that the log lacks are empty.

    ``progress`` gets a task that counts the bytes of the log.
    """
    tell = follow(progress, "sum up", log)
    found = LogOverview(delays=_delays(log))
    clocks: dict[str, Thinned] = {}
    fields = {name: set(dtype.names or ()) for name, dtype in log.channels.items()}
    for channel, rows in log.batches():
        tell()
        if {"period_ns", "state", "marks", "channel"} <= fields[channel]:
            for name in np.unique(rows["channel"]):
                clocks.setdefault(printable(name), Thinned(_POINTS)).add(rows[rows["channel"] == name])
        elif channel == "row" and "gate" in fields[channel]:
            count_gates(found, rows["gate"])
        elif is_health(log.channels[channel]):
            found.health.add(rows)
        elif channels.is_quantity(log.channels[channel]):
            found.answers.update((printable(row["name"]), row) for row in rows[-256:])
    found.clocks = {name: kept for name, thinned in clocks.items() if (kept := thinned.rows) is not None}
    return found


def _delays(log: LogReader) -> tuple[Delay, ...]:
    try:
        return tuple(known_delays(attached_vehicle(log)))
    except config.ConfigError:
        return ()  # an imported recording carries no vehicle


def count_gates(found: LogOverview, gate: np.ndarray) -> None:
    """Add the gate reasons of ROW, (n, rows), to the counts of ``found``."""
    found.rows += gate.size
    found.used += int(np.count_nonzero(gate == 0))
    for reason in GateReason:
        if reason.name and (count := int(np.count_nonzero(gate & int(reason)))):
            name = reason.name.lower()
            found.refused[name] = found.refused.get(name, 0) + count


def reason_words(reason: GateReason) -> str:
    """A reason in words; a kernel lacks samples also at both ends of a flight, where no record is missing."""
    return "kernel not full" if reason is GateReason.GAP else (reason.name or "").lower().replace("_", " ")


def _clock_json(row: np.void) -> dict[str, Any]:
    numbers = ("period_ns", "sigma_ns", "residual_rms_ns")
    counts = {name: int(row[name]) for name in ("marks", "rejected")}
    return {"state": _state(row), **{name: float(row[name]) for name in numbers}, **counts}


def _state(row: np.void) -> str:
    return ClockState(int(row["state"])).name.lower()


def _answer_json(row: np.void) -> dict[str, Any]:
    supported = bool(row["supported"])
    numbers = {name: number if supported else None for name, number in channels.numbers_of(row).items()}
    found = standing_of(row)
    level, why = (None, "") if found is None else (str(found.level), found.why)
    return {"supported": supported, "level": level, "why": why, "unit": printable(row["unit"]), **numbers}


def render(found: LogOverview) -> RenderableType:
    """``found`` as tables, without those that are empty."""
    parts = (_clocks(found), _delay_lines(found), _gates(found), _answers(found))
    return Group(*(part for part in parts if part is not None), *(Text(line) for line in found.health.lines()))


def plain_table(*headings: str) -> Table:
    """Without a frame, the first column on the left, the others on the right."""
    columns = (Column(one, justify="right" if k else "left", no_wrap=True) for k, one in enumerate(headings))
    return Table(*columns, box=None, padding=(0, 1), pad_edge=False, header_style="bold")


def _clocks(found: LogOverview) -> RenderableType | None:
    if not found.clocks:
        return None
    table = plain_table("clock", "state", "period us", "sigma us", "residual us", "marks", "rejected")
    for name, rows in sorted(found.clocks.items()):
        row = rows[-1]
        numbers = (f"{row[field] * 1e-3:.3f}" for field in ("period_ns", "sigma_ns", "residual_rms_ns"))
        style = "" if row["state"] == ClockState.LOCKED else "yellow"
        table.add_row(name, Text(_state(row), style), *numbers, str(row["marks"]), str(row["rejected"]))
    return table


def _delay_lines(found: LogOverview) -> RenderableType | None:
    if not found.delays:
        return None
    told = []
    for delay in found.delays:
        name = f"{delay.channel} {delay.part}".strip()
        sigma = f" ± {delay.sigma_s * 1e3:.3g}" if delay.sigma_s else ""
        told.append(f"{name} {delay.delay_s * 1e3:.4g}{sigma} ms ({delay.cause})")
    return Text(f"delays removed: {', '.join(told)}")


def _gates(found: LogOverview) -> RenderableType | None:
    if not found.rows:
        return None
    named = {reason_words(GateReason[name.upper()]): count for name, count in found.refused.items()}
    refused = ", ".join(f"{words} {count:,}" for words, count in named.items())
    return Text(
        f"rows: {found.used:,} of {found.rows:,} used; refused (a row may have several reasons): {refused or 'none'}"
    )


def _answers(found: LogOverview) -> RenderableType | None:
    """Table of the quantities; of base parameters if there are no others; of those left open if none is answered."""
    answered = {name: row for name, row in found.answers.items() if row["supported"] or is_withdrawn(row)}
    rows = answered or found.answers
    rows = {name: row for name, row in rows.items() if row["unit"]} or rows
    if not rows:
        return None
    table = plain_table("identified", "value", "95 % interval", "unit", "level")
    for name, row in rows.items():
        value, low, high = (f"{row[key]:.6g}" for key in ("value", "low", "high"))
        numbers = (value, f"{low} .. {high}") if row["supported"] else ("-", "-")
        table.add_row(name, *numbers, printable(row["unit"]), Text(_level(row), "red" if is_withdrawn(row) else ""))
    reasons: dict[str, list[str]] = {}
    for name, row in rows.items():
        if shown(row) != _level(row):
            reasons.setdefault(shown(row), []).append(name)
    return Group(table, *(Text(f"{', '.join(names)}: {text}") for text, names in reasons.items()))


def _level(row: np.void) -> str:
    found = standing_of(row)
    return "" if found is None else str(found.level)
