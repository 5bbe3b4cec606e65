"""Estimate again from a log and compare with what was said in flight, bit for bit.

The TICK records say what each step of the onboard estimator consumed; the same code is fed the same rows in the same
steps. Whatever the scheduling was on board, the answers are the same to the last bit, or something is wrong.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard import config
from onboard.flight.estimator import Estimator
from onboard.offline.vehicle_file import vehicle_of
from onboard.recording.reader import LogReader

_UNANSWERED = 2  # last steps of a flight that was cut off, whose TICK came into the log and whose answers did not


class Replay(NamedTuple):
    """What a replay found."""

    identical: bool
    summary: str
    compared: dict[str, int]  # rows by channel
    damage: tuple[object, ...]


class _Inputs:
    """Rows of the input channels by sequence, each read once and forgotten once consumed."""

    def __init__(self, log: LogReader, channels: tuple[str, ...]) -> None:
        self._waiting: dict[str, Rows] = {name: np.empty(0, log.channels[name]) for name in channels}
        self._batches: Iterator[Any] = log.batches(list(channels))

    def take(self, name: str, first: int, last: int) -> Rows:
        """Rows ``first..last`` (sequence numbers, both included) of one channel."""
        while not len(self._waiting[name]) or self._waiting[name]["sequence"][-1] < last:
            batch = next(self._batches, None)
            if batch is None:
                break
            channel, rows = batch
            self._waiting[channel] = np.concatenate([self._waiting[channel], rows])
        rows = self._waiting[name]
        low = int(np.searchsorted(rows["sequence"], first))
        high = int(np.searchsorted(rows["sequence"], last, side="right"))
        self._waiting[name] = rows[high:]
        return rows[low:high]


def _bytes(rows: Rows) -> NDArray[np.uint8]:
    """The rows' fields as they lie in memory, (n, itemsize), what fills the gaps between them zeroed."""
    clean = np.zeros(len(rows), rows.dtype)
    for field in rows.dtype.names or ():
        clean[field] = rows[field]
    return clean.view(np.uint8).reshape(len(rows), rows.dtype.itemsize)


def replay(path: Path) -> Replay:
    """Replay a log.

    Raises:
        LogFormatError: it is no log.
        ConfigError: it carries no vehicle that can be used.
    """
    log = LogReader(path)
    with tempfile.TemporaryDirectory() as directory:
        return _replay(log, vehicle_of(log, Path(directory)))


def _anew(vehicle: config.Vehicle, log: LogReader, again: dict[str, list[Rows]], now_ns: int) -> Estimator:
    """The estimator that began at ``now_ns`` in place of one that died, whose last answers may not have come out."""
    said = {name: int((log.read(name)["host_ns"] < now_ns).sum()) for name in again}
    for name, count in said.items():
        made = np.concatenate([log.read(name)[:0], *again[name]])
        again[name] = [made[:count]]
    estimator = Estimator(vehicle)
    estimator.go_on_from(said)
    return estimator


class Step(NamedTuple):
    """What a step of the onboard estimator consumed, by channel."""

    now_ns: int
    batches: dict[str, Rows]
    lag_ns: int | None
    fresh: bool  # another estimator began with it
    short: str  # what of it the log does not hold; empty where it holds all


def steps(log: LogReader, channels: tuple[str, ...]) -> Iterator[Step]:
    """The steps that the estimator of ``log`` made, as its TICK records tell them.

    Args:
        log: of a flight.
        channels: what the estimator consumed, in its order.
    """
    ticks: Rows = log.read("tick") if "tick" in log.channels else np.empty(0, np.void(0).dtype)
    inputs = _Inputs(log, tuple(name for name in channels if name in log.channels))
    for tick in ticks:
        batches: dict[str, Rows] = {}
        short = ""
        for column, name in enumerate(channels):
            count = int(tick["consumed"][column])
            if name not in log.channels or not count:
                continue
            first, last = int(tick["first_sequence"][column]), int(tick["last_sequence"][column])
            batches[name] = inputs.take(name, first, last)
            if len(batches[name]) != count:
                short = short or f"{name}: {count - len(batches[name])} rows of {first}..{last} are not in the log"
        fresh = "fresh" in (ticks.dtype.names or ()) and bool(tick["fresh"])
        yield Step(int(tick["host_ns"]), batches, 0 if tick["final"] else None, fresh, short)


def _replay(log: LogReader, vehicle: config.Vehicle) -> Replay:
    estimator = Estimator(vehicle)
    again: dict[str, list[Rows]] = {name: [] for name in estimator.outputs}
    short, times_ns = "", []
    for step in steps(log, estimator.inputs):
        times_ns.append(step.now_ns)
        if step.fresh:
            estimator = _anew(vehicle, log, again, step.now_ns)
        short = short or step.short
        for channel, rows in estimator.process(step.now_ns, step.batches, step.lag_ns):
            if channel in again:
                again[channel].append(rows)
    answered_ns = times_ns[-1 - _UNANSWERED] if len(times_ns) > _UNANSWERED else -1
    compared: dict[str, int] = {}
    for name, parts in again.items():
        made = np.concatenate(parts) if parts else np.empty(0, estimator.outputs[name])
        said = log.read(name) if name in log.channels else made[:0]
        compared[name] = len(said)
        if len(said) < len(made) and (made["host_ns"][len(said) :] > answered_ns).all():
            made = made[: len(said)]  # the flight ended, or was cut off, before these came out
        count = min(len(made), len(said))
        same = (_bytes(made[:count]) == _bytes(said[:count])).all(axis=1)
        if len(made) != len(said) or not same.all():
            first = count if same.all() else int(np.argmin(same))
            why = f"; {short}" if short else ""
            text = f"{name} differs from row {first}: {len(said)} recorded, {len(made)} replayed{why}"
            return Replay(False, text, compared, log.damage)
    total = ", ".join(f"{count} {name}" for name, count in compared.items())
    return Replay(True, f"identical to the last bit: {total}", compared, log.damage)
