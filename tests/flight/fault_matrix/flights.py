"""Which faults fly together, and what came of each."""

import tempfile
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers import records
from drivers.records import Batch, Rows, Severity
from hil_sim.scenario.load import load
from onboard.estimation.gates import GateReason
from onboard.timebase.clock import ClockState
from tests.flight.fault_matrix.cells import CELLS, CHANNELS, EJECTION_S, SECOND_S, Cell
from tests.flight.missions import fly, sweep

SEED = 3
MISSION = {
    "sequence": [
        {"phase": 0, "action": "hold", "duration_s": 2.5},
        sweep(4, 0.5),
        {"phase": 0, "action": "hold", "duration_s": 0.3},
        {"phase": 5, "action": "hold", "duration_s": 0.5},
        sweep(4, 0.5),
        {"phase": 9, "action": "hold", "duration_s": 0.5},
    ]
}


class Outcome(NamedTuple):
    """What came of a cell."""

    cell: Cell
    reported: tuple[str, ...]  # "code" and "gap cause", in alphabetical order
    recovered: tuple[str, ...]  # what was said about its end
    lost: dict[str, int]  # samples named as missing, by channel
    unaccounted: dict[str, int]  # produced less recorded and missing, by channel of the flight
    recovery_s: float  # from its end to the first good row of the device; infinite when there was none
    estimate: dict[str, str]  # "right", "absent" or "wrong", by quantity
    worst: float  # largest error of a supported quantity at any time in the flight, in half-widths of its interval


@cache
def flights() -> tuple[tuple[Cell, ...], ...]:
    """Which cells fly together: two of different devices, neither of which makes samples false."""
    paired: list[tuple[Cell, ...]] = [(cell,) for cell in CELLS if not cell.shares]
    waiting = [cell for cell in CELLS if cell.shares]
    waiting.sort(key=lambda cell: -_reach(cell))  # those that go with few others first
    while waiting:
        one = waiting.pop(0)
        partners = [cell for cell in waiting if _independent(one, cell) and {one.start_s, cell.start_s} != {EJECTION_S}]
        if not partners:
            paired.append((one,))
            continue
        other = max(partners, key=lambda cell: (_reach(cell), cell.device.startswith("i")))
        waiting.remove(other)
        early, late = (other, one) if one.start_s == EJECTION_S else (one, other)
        paired.append((early, late if late.start_s == EJECTION_S else late._replace(start_s=SECOND_S)))
    return tuple(paired)


def _reach(cell: Cell) -> int:
    """How many devices it shares a channel with, those that begin late last."""
    return sum(bool(set(cell.channels) & set(touched)) for touched in CHANNELS[cell.vehicle].values())


def _independent(one: Cell, other: Cell) -> bool:
    return one.vehicle == other.vehicle and not set(one.channels) & set(other.channels)


@cache
def outcomes(flight: tuple[Cell, ...]) -> tuple[Outcome, ...]:
    """Fly the cells of a flight."""
    with tempfile.TemporaryDirectory() as directory:
        vehicle = flight[0].vehicle
        scenario = load(vehicle, {**MISSION, "fault": [cell.fault for cell in flight]})
        result = fly(Path(directory) / "log.mcap", SEED, scenario, vehicle=vehicle)
        log = list(result.log.batches())
        said = [*_said(log), *_refused(log)]
        rows = _rows(log, result.table["channels"])
        worst = _worst(log, result.table)
    start_ns = int(result.flown.truth["start_ns"])
    until = [*(cell.start_s for cell in flight[1:]), float(result.flown.truth["duration_s"])]
    return tuple(
        _outcome(cell, until_s, start_ns, result.table, said, rows, worst)
        for cell, until_s in zip(flight, until, strict=True)
    )


Log = list[Batch]


class _Said(NamedTuple):
    host_ns: int
    text: str
    is_end: bool
    channel: str
    missing: int


def _said(log: Log) -> Iterator[_Said]:
    rejected: dict[str, int] = {}
    for rows in _of(log, "clock"):
        for row in rows:
            name = row["channel"].decode()
            if row["rejected"] > rejected.get(name, 0):
                yield _Said(int(row["host_ns"]), f"clock {name} rejects pulses", False, name, 0)
            rejected[name] = int(row["rejected"])
            if row["marks"] and row["state"] != ClockState.LOCKED:
                state = ClockState(int(row["state"])).name.lower()
                yield _Said(int(row["host_ns"]), f"clock {name} {state}", False, name, 0)
    for who, rows in (
        *(("", rows) for rows in (*_of(log, "event"), *_of(log, "gap"))),
        *(("estimation ", rows) for rows in _of(log, "event_estimation")),
    ):
        for row in rows:
            if rows.dtype == records.GAP:
                missing = int(row["last_missing"] - row["first_missing"]) + 1
                text = f"gap {row['cause'].decode()}"
                yield _Said(int(row["host_ns"]), text, False, row["channel"].decode(), missing)
            elif (code := row["code"].decode()) not in ("phase", "zeroed", "stopped"):
                quiet = bool(row["severity"] < Severity.WARNING)
                yield _Said(int(row["host_ns"]), who + code, quiet, row["source"].decode(), 0)


def _refused(log: Log) -> Iterator[_Said]:
    """Rows that the estimator refused for what their samples are like, at the time of the row."""
    told = GateReason.SATURATED | GateReason.GAP | GateReason.RESIDUAL | GateReason.NOT_SYNCHRONISED
    told |= GateReason.STUCK | GateReason.LEFT_OUT
    for rows in _of(log, "row"):
        for row in rows[(rows["gate"] != 0).reshape(len(rows), -1).any(axis=1)]:
            reasons = int(np.bitwise_or.reduce(np.atleast_1d(row["gate"])))
            if not reasons & int(GateReason.PHASE):
                for reason in GateReason(reasons & int(told)):
                    yield _Said(int(row["vehicle_ns"]), f"rows refused: {str(reason.name).lower()}", False, "", 0)


def _rows(log: Log, channels: Iterable[str]) -> dict[str, np.ndarray[Any, Any]]:
    """(host_ns, usable) of every row, by channel."""
    found: dict[str, list[np.ndarray[Any, Any]]] = {channel: [np.zeros((0, 2), np.int64)] for channel in channels}
    for channel, rows in log:
        if channel not in found:
            continue
        status = rows["status"] if "status" in (rows.dtype.names or ()) else np.zeros(len(rows), np.uint8)
        bad = records.SampleStatus.SATURATED | records.SampleStatus.NOT_VALID
        found[channel].append(np.column_stack([rows["host_ns"], (status & bad) == 0]))
    return {channel: np.concatenate(pieces) for channel, pieces in found.items()}


def _worst(log: Log, compared: dict[str, Any]) -> float:
    truth = {row["quantity"].encode(): row["truth"] for row in (*compared["masses"], *compared["inertias"])}
    worst = 0.0
    for rows in _of(log, "quantity"):
        for name, true in truth.items():
            mine = rows[(rows["name"] == name) & (rows["supported"] != 0)]
            mine = mine[np.isfinite(mine["value"])]
            error = np.abs(mine["value"] - true) / np.maximum(mine["high"] - mine["value"], 1e-12)
            worst = max(worst, float(error.max(initial=0.0)))
    return worst


def _of(log: Log, channel: str) -> Iterator[Rows]:
    return (rows for name, rows in log if name == channel)


def _outcome(
    cell: Cell,
    until_s: float,
    start_ns: int,
    table: dict[str, Any],
    said: list[_Said],
    rows: dict[str, Any],
    worst: float,
) -> Outcome:
    begins_ns = start_ns + round(cell.start_s * 1e9)
    until_ns = start_ns + round(until_s * 1e9)
    end_ns = begins_ns if cell.kind == "reset" else begins_ns + round(cell.last_s * 1e9)
    mine = [s for s in said if begins_ns <= s.host_ns < until_ns]
    lost: dict[str, int] = {}
    for each in mine:
        if each.missing:
            lost[each.channel] = lost.get(each.channel, 0) + each.missing
    times = [t[np.logical_and(t[:, 1] > 0, t[:, 0] > end_ns), 0] for t in (rows[c] for c in cell.flowing)]
    recovery_s = max(((t[0] - end_ns) * 1e-9 if len(t) else np.inf for t in times), default=np.inf)
    estimate = {}
    for row in (*table["masses"], *table["inertias"]):
        supported = row["supported"] and np.isfinite(row["value"])
        estimate[row["quantity"]] = "absent" if not supported else "right" if row["covered"] else "wrong"
    return Outcome(
        cell,
        tuple(sorted({s.text for s in mine if not s.is_end})),
        tuple(sorted({s.text for s in mine if s.is_end})),
        lost,
        {n: c["produced"] - c["recorded"] - c["missing"] for n, c in table["channels"].items()},
        recovery_s,
        estimate,
        worst,
    )


def others_lost(outcome: Outcome) -> dict[str, int]:
    """Samples named as missing in channels that the fault must not touch."""
    return {name: n for name, n in outcome.lost.items() if name not in outcome.cell.channels}


def broken_promises(flight: tuple[Cell, ...]) -> list[str]:
    """What the cells of a flight promise and its outcomes do not keep; it is flown."""
    touched = {channel for cell in flight for channel in cell.channels}
    found = []
    for outcome in outcomes(flight):
        cell = outcome.cell
        unnamed = {name: n for name, n in outcome.unaccounted.items() if name in cell.channels and n > cell.unnamed}
        strangers = {name: n for name, n in outcome.unaccounted.items() if n and name not in touched}
        wrong = [name for name, verdict in outcome.estimate.items() if verdict == "wrong"]
        complaints = {
            "not reported": sorted(set(cell.reported) - set(outcome.reported)),
            "others lost": others_lost(outcome),
            f"flows again after {outcome.recovery_s:.3f} s": outcome.recovery_s > cell.recovery_s,
            "lost without a gap": unnamed,
            "unaccounted elsewhere": strangers,
            "wrong estimate": wrong,
            f"wrong on the way, by {outcome.worst:.2f} half-widths": outcome.worst >= 1.0,
        }
        where = f"{cell.vehicle} {cell.device} {cell.name}"
        found += [f"{where}: {what}: {detail}" for what, detail in complaints.items() if detail]
    return found
