"""What a flight said of itself: its clocks, why rows were left out, and its last answers; read from the log."""

from collections.abc import Iterator

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from onboard import channels
from onboard.estimation.gates import GateReason
from onboard.offline.table import last_answers
from onboard.recording.reader import LogReader
from onboard.timebase.clock import ClockState


def render(log: LogReader) -> RenderableType:
    """Clocks, gates and answers as tables; nothing for a log that has none."""
    parts = [part for part in (_clocks(log), _gates(log), _answers(log)) if part is not None]
    return Group(*parts)


def _table(*headings: str) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False, header_style="bold")
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left")
    return table


def _clocks(log: LogReader) -> RenderableType | None:
    last: dict[str, np.void] = {}
    for _, rows in _of(log, channels.CLOCK):
        for row in rows:
            last[row["channel"].decode()] = row
    if not last:
        return None
    table = _table("clock", "state", "period us", "sigma us", "residual us", "marks", "rejected")
    for name, row in sorted(last.items()):
        numbers = (f"{row[field] * 1e-3:.3f}" for field in ("period_ns", "sigma_ns", "residual_rms_ns"))
        state = ClockState(int(row["state"])).name.lower()
        table.add_row(name, state, *numbers, str(row["marks"]), str(row["rejected"]))
    return table


def _gates(log: LogReader) -> RenderableType | None:
    counts = dict.fromkeys(GateReason, 0)
    total = used = 0
    for channel, rows in log.batches(["row"]) if "row" in log.channels else ():
        del channel
        gate = rows["gate"]
        total, used = total + gate.size, used + int(np.count_nonzero(gate == 0))
        for reason in counts:
            counts[reason] += int(np.count_nonzero(gate & int(reason)))
    if not total:
        return None
    refused = ", ".join(f"{reason.name.lower()} {n}" for reason, n in counts.items() if n and reason.name)
    return Text(f"rows: {used:,} of {total:,} used; refused (a row may have several reasons): {refused}")


def _answers(log: LogReader) -> RenderableType | None:
    supported = {name: a for name, a in last_answers(log).items() if a["supported"]}
    if not supported:
        return None
    table = _table("identified", "value", "95 % interval", "unit")
    for name, answer in supported.items():
        value, low, high = (f"{answer[key]:.6g}" for key in ("value", "low", "high"))
        table.add_row(name, value, f"{low} .. {high}", answer["unit"])
    return table


def _of(log: LogReader, dtype: np.dtype[np.void]) -> Iterator[tuple[str, np.ndarray]]:
    names = [name for name, kind in log.channels.items() if kind == dtype]
    return iter(log.batches(names)) if names else iter(())
