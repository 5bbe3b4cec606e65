"""A flight on a real disk that fills up, and is emptied again; run inside of a mount namespace of its own.

    unshare -rm python small_disk.py DIRECTORY

Mounts a tmpfs of 48 MB there, records a DYMAFLEX's channels on it in virtual time while somebody else fills the disk,
twice: so that the recorder sees it coming, and to the last byte between two of its writes. Prints JSON.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from bench.kill_recorder import RATES_HZ, rows_of
from drivers.records import EVENT, Severity, event
from onboard.flight.store import manifest
from onboard.flight.store.flight_log import open_recorder
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble
from onboard.ring import RingWriter

STEP_S = 0.05
STORAGE = manifest.Storage(200_000_000, 10_000_000_000, 64 << 20, 4 << 20)


class Flight:
    """Pushes rows and steps the recorder, in virtual time."""

    def __init__(self, disk, directory):
        self.log = disk / "flight.mcap"
        directory.mkdir()
        self.rings = {
            name: RingWriter(directory / f"{name}.ring", rows_of(name, 0, 0).dtype, 6 * rate)
            for name, rate in RATES_HZ.items()
        }
        self.events = RingWriter(directory / "event.ring", EVENT, 2400)
        about = manifest.Manifest(directory, self.log, "dymaflex", STORAGE, Preamble("small-disk"))
        self.recorder = open_recorder(about)
        self.now_ns = 0

    def seconds(self, duration_s):
        reports = []
        for _ in range(round(duration_s / STEP_S)):
            self.now_ns += int(STEP_S * 1e9)
            for name, ring in self.rings.items():
                due = self.now_ns * RATES_HZ[name] // 10**9 - ring.published
                ring.push(rows_of(name, ring.published, due))
            row = event(self.now_ns, Severity.INFO, "step", "test", "").rows
            row["sequence"] = self.events.published
            self.events.push(row)
            reports.append(self.recorder.step(self.now_ns))
        return reports


def fill(path, leave):
    """Take all but ``leave`` bytes of the disk."""
    disk = os.statvfs(path.parent)
    with path.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, disk.f_bavail * disk.f_frsize - leave)


def main(place):
    """Fly, and say what came of it."""
    disk = Path(place)
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=48m", "tmpfs", place], check=True)
    flight = Flight(disk, disk.parent / "rings")
    other = disk / "other"
    flight.seconds(4)
    fill(other, 2_000_000)  # it is seen coming: less than the margin is left
    flight.seconds(10)
    other.unlink()
    flight.seconds(6)
    ballast = flight.log.with_name("flight.mcap.heft-reserve")
    held = ballast.exists()
    ballast.unlink()
    fill(other, 0)  # not one byte is left, and no ballast
    refused = any(report.failing for report in flight.seconds(10))
    other.unlink()
    flight.seconds(6)
    closed = not flight.recorder.close(flight.now_ns).failing
    log = LogReader(flight.log)
    gaps = log.read("recorder_gap")
    wrong = []
    for name, ring in flight.rings.items():
        rows = log.read(name)["sequence"]
        of = gaps[gaps["channel"] == name.encode()]
        told = [np.arange(first, last + 1) for first, last in zip(of["first_missing"], of["last_missing"], strict=True)]
        numbers = np.sort(np.concatenate([rows, *told]))
        if not np.array_equal(numbers, np.arange(ring.published)):
            wrong.append(name)
        if not np.array_equal(log.read(name), rows_of(name, 0, ring.published)[rows.astype(int)]):
            wrong.append(f"{name} altered")
    result = {
        "ballast_held": held,
        "refused": refused,
        "closed": closed,
        "complete": log.complete,
        "wrong": wrong,
        "told_missing": int((gaps["last_missing"] - gaps["first_missing"] + 1).sum()),
        "causes": sorted({cause.decode() for cause in gaps["cause"].tolist()}),
        "events_lost": flight.events.published - len(log.read("event")),
        "said": [code.decode() for code in log.read("recorder_event")["code"].tolist()],
    }
    sys.stdout.write(json.dumps(result))


if __name__ == "__main__":
    main(sys.argv[1])
