"""Kills the recorder, over and over, while a DYMAFLEX's worth of rows comes in; then everything at once.

::

    python bench/kill_recorder.py [--kills 200] [--seed 1] [--directory DIR]

Two IMUs at 1 kHz, five joints and a load cell at 500 Hz are pushed into rings by a process of their own, on the clock,
10 ms of rows at a time. The recording process of a flight drains them; it is killed with SIGKILL at random instants
(while it starts, takes over, writes, syncs or changes segments) and started again at once. In the end both are killed
in the same moment, and what the rings hold is harvested. Every row that had reached a ring must then be in the log
once, as it was pushed.
"""

import argparse
import multiprocessing
import os
import shutil
import signal
import tempfile
import time
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers import records
from drivers.records import Rows
from onboard.flight.store import directories, harvest, manifest
from onboard.flight.store.rings import SECONDS_KEPT
from onboard.flight.supervise import workers
from onboard.flight.supervise.realtime import UNCHANGED
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble
from onboard.ring import RingReader, RingWriter

PUSH_S = 0.010
RATES_HZ = {"imu_0": 1000, "imu_1": 1000, **{f"joint_{n}": 500 for n in range(1, 6)}, "load_cell": 500}
STORAGE = manifest.Storage(200_000_000, 5_000_000_000, 64 << 20, 1 << 20)  # segments of 5 s, to change them often


class KillCounts(NamedTuple):
    """What came of a campaign; all but ``kills``, ``rows`` and ``segments`` should be 0."""

    kills: int
    rows: int
    segments: int
    lost: int
    doubled: int
    altered: int
    told_missing: int
    damaged: int

    @property
    def is_clean(self) -> bool:
        """Nothing lost, doubled, altered or damaged."""
        return not any(self[3:])


def rows_of(channel: str, first: int, count: int) -> Rows:
    """Rows whose every field follows from their number."""
    dtype = records.IMU if channel.startswith("imu") else records.SCALAR
    rows = np.zeros(count, dtype)
    number = np.arange(first, first + count, dtype=np.uint64)
    rows["sequence"] = rows["tick"] = number
    rows["host_ns"] = number.astype(np.int64) * (1_000_000_000 // RATES_HZ[channel])
    mixed = number * np.uint64(0x9E3779B97F4A7C15)
    if dtype == records.IMU:
        words = (mixed[:, None] >> np.array([0, 11, 23, 31, 43, 48], np.uint64)).astype(np.uint16).view(np.int16)
        rows["accel_raw"], rows["gyro_raw"] = words[:, :3], words[:, 3:]
    else:
        rows["value_raw"], rows["scale"], rows["unit"] = mixed.view(np.int64), 1e-4, b"N"
    return rows


def acquire(directory: Path) -> None:
    """Push rows on the clock until killed."""
    with directories.belong(directory):
        rings = {
            name: RingWriter(directory / f"{name}.ring", rows_of(name, 0, 0).dtype, _capacity(name))
            for name in RATES_HZ
        }
        start = time.monotonic()
        while True:
            for name, ring in rings.items():
                due = int((time.monotonic() - start) * RATES_HZ[name]) - ring.published
                ring.push(rows_of(name, ring.published, due))
            time.sleep(PUSH_S)


def _capacity(channel: str) -> int:
    return int(SECONDS_KEPT * RATES_HZ[channel])


class _Killable:
    """A process that can be killed and started again quickly: forked from a server that has imported all it needs."""

    def __init__(self, context: ForkServerContext, directory: Path) -> None:
        self._context, self._directory = context, directory
        self.start()

    def start(self) -> None:
        self._pipe, end = self._context.Pipe()
        self._process = self._context.Process(target=workers.record, args=(self._directory, 0, UNCHANGED, end))
        self._process.start()
        end.close()

    def kill(self) -> None:
        assert self._process.pid is not None
        assert self._process.is_alive(), "the recorder ended by itself; its message stands above"
        os.kill(self._process.pid, signal.SIGKILL)
        self._process.join()
        self._pipe.close()


def campaign(folder: Path, kills: int, seed: int, longest_s: float = 0.8) -> KillCounts:
    """Fly, kill ``kills`` times, kill all, harvest, compare.

    Args:
        folder: for the log.
        kills: of the recorder alone.
        seed: of the instants.
        longest_s: between a start and the kill.
    """
    rng = np.random.default_rng(seed)
    log = folder / "flight.mcap"
    with manifest.new_flight(log, f"{seed:08d}{time.monotonic_ns():x}") as directory:
        pass
    manifest.Manifest(directory, log, "dymaflex", STORAGE, Preamble(f"kill-{seed}")).save()
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["onboard.flight.supervise.workers", "onboard.flight.store.flight_log"])
    acquisition = context.Process(target=acquire, args=(directory,))
    acquisition.start()
    try:
        while len(list(directory.glob("*.ring"))) < len(RATES_HZ) or not _published(directory)["load_cell"]:
            time.sleep(0.05)
        recorder = _Killable(context, directory)
        for _ in range(kills):
            time.sleep(rng.uniform(0.0, longest_s))
            recorder.kill()
            recorder.start()
        time.sleep(rng.uniform(0.0, longest_s))
    finally:
        acquisition.kill()
    recorder.kill()
    acquisition.join()
    pushed = _published(directory)
    [result] = [one for one in harvest.harvest(time.monotonic_ns()) if one.log == log]
    assert not result.problem, result.problem
    return _compare(LogReader(log), pushed, kills)


def _published(directory: Path) -> dict[str, int]:
    return {name: RingReader(directory / f"{name}.ring").published for name in RATES_HZ}


def _compare(log: LogReader, pushed: dict[str, int], kills: int) -> KillCounts:
    lost = doubled = altered = 0
    for name, count in pushed.items():
        rows = log.read(name)
        numbers, times = np.unique(rows["sequence"], return_counts=True)
        lost += count - len(numbers)
        doubled += int((times > 1).sum())
        made = rows_of(name, 0, count)[rows["sequence"].astype(int)]
        altered += sum(int((rows[field] != made[field]).any()) for field in rows.dtype.names or ())
    gaps = log.read("recorder_gap")
    told = int((gaps["last_missing"] - gaps["first_missing"] + 1).sum())
    return KillCounts(kills, sum(pushed.values()), len(log.segments), lost, doubled, altered, told, len(log.damage))


def main() -> int:
    """Run a campaign and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--directory", type=Path, help="where the log goes (default: a new one in /tmp)")
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(dir=arguments.directory))
    try:
        done = campaign(folder, arguments.kills, arguments.seed)
    finally:
        shutil.rmtree(folder)
    for name, value in done._asdict().items():
        print(f"{name:14} {value:>10,}")
    return 0 if done.is_clean else 1


if __name__ == "__main__":
    raise SystemExit(main())
