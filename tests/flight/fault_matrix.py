"""Every fault of the vocabulary on every device of RockSat-X, flown: what is said, who else suffers, how it ends.

``python -m tests.flight.fault_matrix docs/faults.md`` flies them all and writes the table. A flight has room for two
faults of different devices, one in each sweep, far enough apart that what is said after one is not about the other.
"""

import sys
import tempfile
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers import records
from drivers.records import Batch, Rows, Severity
from hil_sim.scenario import load
from onboard.estimation.gates import GateReason
from onboard.timebase.clock import ClockState
from tests.flight.missions import fly

SEED = 3
FIRST_S, SECOND_S, EJECTION_S = 3.2, 7.6, 6.0  # where faults begin: in sweep 1, in sweep 2, just before the ejection
END_S = 10.5  # of the last phase to identify in
_SWEEP = {
    "phase": 4,
    "action": "sweep",
    "amplitude_deg": 11.5,
    "stroke_s": 0.6,
    "strokes": 4,
    "pause_s": 0.05,
    "transfer_s": 0.5,
}
MISSION = {
    "sequence": [
        {"phase": 0, "action": "hold", "duration_s": 2.5},
        _SWEEP,
        {"phase": 0, "action": "hold", "duration_s": 0.3},
        {"phase": 5, "action": "eject", "duration_s": 0.5},
        _SWEEP,
        {"phase": 9, "action": "hold", "duration_s": 0.5},
    ]
}
CHANNELS = {  # what a fault of a device may touch; everything else must lose nothing
    "imu_base": ("imu_base",),
    "i2c_1": ("imu_base",),
    "joint_1": ("joint_1",),
    "load_cell": ("load_cell",),
    "arm_phase": ("arm_phase",),
    "sync_box": ("can_sync", "pulse", "joint_1", "load_cell"),
    "sync_line": ("pulse",),
    "can_0": ("can_sync", "joint_1", "load_cell", "arm_phase"),
}


class Cell(NamedTuple):
    """A fault of a device, and what must come of it.

    Attributes:
        reported: codes of events and causes of gaps, all of which must be told.
        recovery_s: rows of the device flow again so long after the fault at the latest.
        start_s: when it begins.
        unnamed: samples of one of its channels that may be lost without a gap record.
        shares: it takes samples away at most; one that puts false ones in their place flies alone.
    """

    device: str
    kind: str
    value: float = 0.0
    last_s: float = 0.6
    reported: tuple[str, ...] = ()
    recovery_s: float = 0.05
    start_s: float = FIRST_S
    shares: bool = True
    unnamed: int = 0

    @property
    def name(self) -> str:
        return f"{self.kind}({self.value:g})" if self.value else self.kind

    @property
    def fault(self) -> dict[str, Any]:
        end_s = self.start_s + self.last_s
        where = {"kind": self.kind, "device": self.device, "value": self.value}
        return {**where, "start_s": self.start_s, "end_s": end_s}


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
    return sum(bool(set(CHANNELS[cell.device]) & set(touched)) for touched in CHANNELS.values())


def _independent(one: Cell, other: Cell) -> bool:
    return not set(CHANNELS[one.device]) & set(CHANNELS[other.device])


@cache
def outcomes(flight: tuple[Cell, ...]) -> tuple[Outcome, ...]:
    """Fly the cells of a flight."""
    with tempfile.TemporaryDirectory() as directory:
        scenario = load("rocksat", {**MISSION, "fault": [cell.fault for cell in flight]})
        result = fly(Path(directory) / "log.mcap", SEED, scenario)
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
    for rows in (*_of(log, "event"), *_of(log, "gap")):
        for row in rows:
            if rows.dtype == records.GAP:
                missing = int(row["last_missing"] - row["first_missing"]) + 1
                text = f"gap {row['cause'].decode()}"
                yield _Said(int(row["host_ns"]), text, False, row["channel"].decode(), missing)
            elif (code := row["code"].decode()) not in ("phase", "zeroed", "stopped"):
                quiet = bool(row["severity"] < Severity.WARNING)
                yield _Said(int(row["host_ns"]), code, quiet, row["source"].decode(), 0)


def _refused(log: Log) -> Iterator[_Said]:
    """Rows that the estimator refused for what their samples are like, at the time of the row."""
    told = GateReason.SATURATED | GateReason.GAP | GateReason.RESIDUAL | GateReason.NOT_SYNCHRONISED
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
    mine_are = [c for c in CHANNELS[cell.device] if c != "arm_phase" or c == cell.device]
    times = [t[np.logical_and(t[:, 1] > 0, t[:, 0] > end_ns), 0] for t in (rows[c] for c in mine_are)]
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


def _cells() -> list[Cell]:
    imu, joint, load_cell, arm = "imu_base", "joint_1", "load_cell", "arm_phase"
    cells = [
        Cell(imu, "off", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell(imu, "reset", 0.0, 0.6, ("brown_out", "gap brown_out"), 0.3),
        Cell(imu, "intermittent", 0.1, 0.6, ("bus_error",)),
        Cell(imu, "stuck", shares=False),
        Cell(imu, "saturated", 0.0, 0.6, ("rows refused: saturated",), shares=False),
        Cell(imu, "wrong", 0.5, shares=False),
        Cell(imu, "delayed", 0.1, shares=False),
        Cell(imu, "garbage", 0.0, 0.6, ("gap fifo_overflow",), 1.1),
        Cell(imu, "slow", 0.2, 0.6, ("clock imu_base rejects pulses",)),
        Cell(imu, "clock_jump", -0.06, 0.6, ("clock imu_base rejects pulses",)),
        Cell(imu, "clock_jump", -0.3, 0.6, ("no_samples", "gap no_samples"), unnamed=1),
        Cell(imu, "timeout", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell(imu, "pulse_drop"),
        Cell(imu, "pulse_spurious", 0.07),
        Cell("i2c_1", "nack", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell("i2c_1", "stuck_bus", 0.0, 0.6, ("bus_error", "gap bus_error"), 0.3),
        Cell("i2c_1", "intermittent", 0.1, 0.6, ("bus_error",)),
    ]
    for node in (joint, load_cell):
        cells += [
            Cell(node, "off", 0.0, 0.6, ("silent", "node_rebooted", "gap node_reset"), 0.2),
            Cell(node, "reset", 0.0, 0.6, ("node_rebooted", "gap node_reset"), 0.2),
            Cell(node, "silent", 0.0, 0.6, ("silent", "emcy_8140", "gap no_pdo")),
            Cell(node, "silent", 0.0, 2.0, ("silent", "heartbeat_lost", "gap node_reset"), 0.6),
            Cell(node, "intermittent", 0.1, 0.6, ("emcy_8140", "gap no_pdo")),
            Cell(node, "stuck", 0.0, 0.6, ("rows refused: residual",), shares=False),
            Cell(node, "wrong", 0.3, shares=False),
            Cell(node, "delayed", 0.1, 0.6, ("rows refused: residual",), shares=False),
            Cell(node, "garbage", 0.0, 0.6, ("bad_heartbeat", "rows refused: saturated")),
            Cell(node, "slow", 0.02, 0.6, ("pdo_extra", "gap no_pdo")),
        ]
    cells.append(Cell(load_cell, "saturated", 1.0, 0.6, ("rows refused: saturated",)))
    late = EJECTION_S
    cells += [
        Cell(arm, "off", 0.0, 1.2, ("heartbeat_lost",), 0.2, late, shares=False),
        Cell(arm, "reset", 0.0, 1.2, ("node_rebooted",), 0.2, late),
        Cell(arm, "silent", 0.0, 1.2, ("emcy_8140",), 0.6, late, shares=False, unnamed=3),
        Cell(arm, "stuck", 0.0, 1.2, ("rows refused: residual",), 4.0, late, shares=False),
        Cell(arm, "wrong", 1.0, 1.2, (), 4.0, late),
        Cell(arm, "delayed", 0.2, 1.2, (), 4.0, late),
        Cell(arm, "garbage", 0.0, 1.2, ("bad_heartbeat",), 4.0, late, shares=False),
        Cell(arm, "slow", 0.2, 1.2, (), 4.0, late),
        Cell(arm, "wrong", 1.0, shares=False),
        Cell("sync_box", "off", 0.0, 0.6, ("sync_restarted",), 0.2),
        Cell("sync_box", "reset", 0.0, 0.6, ("sync_restarted", "pdo_extra"), 0.2, unnamed=1),
        Cell("sync_box", "silent", 0.0, 0.6, ("gap no_sync",), 0.3),
        Cell("sync_box", "intermittent", 0.1, 0.6, ("gap no_sync",), 0.3),
        Cell("sync_box", "wrong", 7.0, 0.6, ("sync_restarted", "gap no_sync"), 0.3),
        Cell("sync_box", "garbage", 0.0, 0.6, ("bad_sync", "sync_restarted"), 0.3),
        Cell("sync_box", "slow", 0.05, recovery_s=0.3, shares=False),
        Cell("sync_box", "clock_jump", 0.1, 0.6, ("sync_restarted", "pdo_extra"), 0.3, unnamed=1),
        Cell("sync_box", "clock_jump", -0.1, 0.6, ("clock can_sync rejects pulses",), 0.3),
        Cell("sync_line", "pulse_drop", recovery_s=0.35),
        Cell("sync_line", "pulse_spurious", 0.07, recovery_s=0.35),
        Cell("sync_line", "intermittent", 0.3, recovery_s=0.35),
        Cell("sync_line", "delayed", 0.02, recovery_s=0.35),
        Cell("sync_line", "garbage", 50.0, recovery_s=0.35),
        Cell("can_0", "frame_drop", 0.0, 0.6, ("gap no_sync",)),
        Cell("can_0", "bus_off", 0.0, 0.6, ("can_error_040", "can_error_100", "gap no_sync")),
        Cell("can_0", "error_frames", 0.01, 0.6, ("can_error_088",)),
        Cell("can_0", "flood", 0x001, 0.6, ("gap no_sync",)),
        Cell("can_0", "flood", 0x101, 0.6, ("silent", "gap no_pdo")),
        Cell("can_0", "flood", 0x7F0),
        Cell("can_0", "delayed", 0.05),
        Cell("can_0", "intermittent", 0.1, 0.6, ("gap no_sync",)),
    ]
    return cells


CELLS = _cells()

_HEADING = """# Faults: what is said, who suffers, how it ends

Written by `python -m tests.flight.fault_matrix docs/faults.md`; `tests/flight/test_fault_matrix.py` flies it again and
compares. Each fault of `hil_sim/faults.py` begins and ends in mid-flight of an 11 s RockSat-X mission in virtual time.

- **reported as**: event codes, causes of `gap` records, what the clocks and the row gates of the estimator say.
- **others lose**: samples missing in channels that do not hang on the device.
- **flows again**: from the end of the fault to the first good row of the device; 5 ms is one step of the flight.
- **samples**: *all* when what the device made is recorded or named as missing, to the sample. *n more named*: gap
  records name samples that were never made: the node was off or heard no SYNC, or the chip's FIFO counts were garbage.
  *n in no gap record*: made, and lost without one; the events beside it are all that tells.
- **estimate**: five masses and inertias at the end of the flight. *right*: the truth is in the 95 % interval; *absent*:
  not reported. A wrong one fails the test, at whatever time of the flight.
- **flight**: two faults that only take samples away may share one, one in each sweep; the estimate is then
  that of both.

| device | fault | lasts | reported as | others lose | flows again after | samples | estimate | flight |
|---|---|---|---|---|---|---|---|---|
"""


def table() -> str:
    """The document."""
    lines: dict[Cell, str] = {}
    for number, flight in enumerate(flights(), start=1):
        for outcome in outcomes(flight):
            lines[_on_its_own(outcome.cell)] = f"{_line(outcome)} {number} |"
    return _HEADING + "\n".join(lines[_on_its_own(cell)] for cell in CELLS) + "\n"


def _on_its_own(cell: Cell) -> Cell:
    return cell._replace(start_s=FIRST_S) if cell.start_s == SECOND_S else cell


def others_lost(outcome: Outcome) -> dict[str, int]:
    """Samples named as missing in channels that the fault must not touch."""
    return {name: n for name, n in outcome.lost.items() if name not in CHANNELS[outcome.cell.device]}


def _line(o: Outcome) -> str:
    cell = o.cell
    others = ", ".join(f"{name} {n}" for name, n in others_lost(o).items()) or "nothing"
    unaccounted = {name: n for name, n in o.unaccounted.items() if n and name in CHANNELS[cell.device]}
    samples = ", ".join(
        f"{name}: {-n} more named" if n < 0 else f"{name}: {n} in no gap record" for name, n in unaccounted.items()
    )
    kinds = [verdict for verdict in ("right", "absent", "wrong") if verdict in o.estimate.values()]
    counts = {kind: sum(verdict == kind for verdict in o.estimate.values()) for kind in kinds}
    estimate = kinds[0] if len(kinds) == 1 else ", ".join(f"{counts[kind]} {kind}" for kind in kinds)
    reported = ", ".join(o.reported) or "—"
    flows = "at once" if o.recovery_s <= 0.005 else f"{10 * round(o.recovery_s * 100 + 0.5)} ms"
    if cell.device == "arm_phase" and o.recovery_s > 1.0:
        flows = "next change"
    lasts = "—" if cell.kind in ("reset", "clock_jump") else f"{cell.last_s:g} s"
    return (
        f"| {cell.device} | {cell.name} | {lasts} | {reported} | {others} | {flows} | {samples or 'all'} | {estimate} |"
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(table(), encoding="utf-8")
