"""The trials of a controller as a log: what went to and came from the drives, and a row a trial with its errors."""

from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from drivers.records import Batch, Rows
from onboard import config
from onboard.channels import TRIAL
from onboard.flight.acquire.publisher import SHARED_CHANNELS
from onboard.flight.store.flight_log import open_simulated_log
from onboard.ground.before.control.run import Trial


class TrialsLog:
    """A log that is being written; a context manager.

    Args:
        vehicle: whose arm it is; its files go in.
        path: of the log; must not exist.
        now_ns: of the bench.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, vehicle: config.Vehicle, path: Path, now_ns: Callable[[], int]) -> None:
        self._writer, self._now_ns = open_simulated_log(vehicle, path), now_ns
        self._numbers: dict[str, int] = {}  # of the next row of a channel that several devices share

    def record(self, batches: Sequence[Batch]) -> None:
        """Write what a bus gave."""
        for batch in batches:
            rows = self._numbered(batch.channel, batch.rows) if batch.channel in SHARED_CHANNELS else batch.rows
            self._write(batch.channel, rows)

    def trial(self, flown: Trial) -> None:
        """Write what came of a trial."""
        row, of = np.zeros(1, TRIAL), flown.flown
        row["host_ns"], row["number"], row["missed"] = self._now_ns(), flown.number, of.missed
        row["joints_rms_rad"], row["tip_rms_m"], row["saturated"] = of.rms_rad, flown.tip_rms_m, of.saturated
        row["stage"] = flown.stage.name.lower().encode()
        row["stopped"] = of.stopped.encode()[: TRIAL["stopped"].itemsize]
        self._write("trial", self._numbered("trial", row))

    def _numbered(self, channel: str, rows: Rows) -> Rows:
        first = self._numbers.get(channel, 0)
        rows = rows.copy()
        rows["sequence"] = np.arange(first, first + len(rows))
        self._numbers[channel] = first + len(rows)
        return rows

    def _write(self, channel: str, rows: Rows) -> None:
        self._writer.register(channel, rows.dtype)
        self._writer.write(channel, rows)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._writer.close()
