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
from onboard.flight.flight_log import VEHICLE_ATTACHMENT
from onboard.recording.reader import LogReader


class Replay(NamedTuple):
    """What a replay found."""

    identical: bool
    summary: str
    compared: dict[str, int]  # rows by channel
    damage: tuple[object, ...]


def vehicle_of(log: LogReader, directory: Path) -> config.Vehicle:
    """The vehicle a log was flown with, its attached files laid out in ``directory``.

    Raises:
        ConfigError: the attachments are missing or cannot be used.
    """
    for name, attachment in log.attachments.items():
        (directory / Path(name).name).write_bytes(attachment.data)
    return config.load(directory / VEHICLE_ATTACHMENT)


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
        estimator = Estimator(vehicle_of(log, Path(directory)))
    absent = [name for name in estimator.inputs if name not in log.channels]
    inputs = _Inputs(log, tuple(name for name in estimator.inputs if name not in absent))
    again: dict[str, list[Rows]] = {name: [] for name in estimator.outputs}
    short = ""
    for tick in log.read("tick") if "tick" in log.channels else ():
        batches: dict[str, Rows] = {}
        for column, name in enumerate(estimator.inputs):
            count = int(tick["consumed"][column])
            if name in absent or not count:
                continue
            first, last = int(tick["first_sequence"][column]), int(tick["last_sequence"][column])
            batches[name] = inputs.take(name, first, last)
            if len(batches[name]) != count:
                short = short or f"{name}: {count - len(batches[name])} rows of {first}..{last} are not in the log"
        for channel, rows in estimator.process(int(tick["host_ns"]), batches, 0 if tick["final"] else None):
            if channel in again:
                again[channel].append(rows)
    compared: dict[str, int] = {}
    for name, parts in again.items():
        made = np.concatenate(parts) if parts else np.empty(0, estimator.outputs[name])
        said = log.read(name) if name in log.channels else made[:0]
        compared[name] = len(said)
        count = min(len(made), len(said))
        same = (_bytes(made[:count]) == _bytes(said[:count])).all(axis=1)
        if len(made) != len(said) or not same.all():
            first = count if same.all() else int(np.argmin(same))
            why = f"; {short}" if short else ""
            text = f"{name} differs from row {first}: {len(said)} recorded, {len(made)} replayed{why}"
            return Replay(False, text, compared, log.damage)
    total = ", ".join(f"{count} {name}" for name, count in compared.items())
    return Replay(True, f"identical to the last bit: {total}", compared, log.damage)
