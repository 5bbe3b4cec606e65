"""Time from SIGKILL of a worker to its being at work again, in a flight of simulated devices, with and without load.

    python -m bench.restarts [--vehicle dymaflex] [--kills 5] [--load 10] [--nice -10]

For recording and estimation it is the time to their first beat; for acquisition the longest hole between two IMU
rows as well. ``--load N`` runs N processes that only compute beside it; ``--nice`` is the flight's nice level (the
systemd unit has -10).

Bars (exit code 1 where one is missed): the worst restart of each worker 300 ms, the longest hole of acquisition 500 ms,
no row lost by the recorder, none missing without a gap record, no estimator begun anew.
"""

import argparse
import os
import signal
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench import given
from bench.real_flight import WORKERS, busy, flying, longer, memory_line, processes
from onboard.ground.log.views.info import info
from onboard.recording.reader import LogReader

BACK_MS, HOLE_MS = 300.0, 500.0
START_S, PAUSE_S = 4.0, 2.5  # before the first kill, after each
FOUND_S = 1.5  # that finding a worker's process may take on a busy computer


def fly(vehicle: str, place: Path, nice: int, kills: int, load: int) -> tuple[Path, list[tuple[str, int]]]:
    """Fly, kill each worker so many times; the log, and who was killed when."""
    killed: list[tuple[str, int]] = []
    over = longer(vehicle, START_S + 3 * (PAUSE_S + FOUND_S) * kills + 30.0, place)
    with flying(vehicle, place, name="restarts", over=over, nice=nice) as flight, busy(load):
        print(memory_line(flight.process.pid))
        time.sleep(START_S)
        for _ in range(kills):
            for name, worker in WORKERS.items():
                pid = processes(flight.process.pid)[name]
                killed.append((worker, time.monotonic_ns()))
                os.kill(pid, signal.SIGKILL)
                time.sleep(PAUSE_S)
        print(f"load average {os.getloadavg()[0]:.1f}")
        print(f"exit code {flight.end()}")
    return flight.log, killed


def main() -> int:
    """Print a line for each worker, and the bars missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--vehicle", choices=given.rehearsed(), default="dymaflex")
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--load", type=int, default=0)
    parser.add_argument("--nice", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        log, killed = fly(options.vehicle, Path(place), options.nice, options.kills, options.load)
        read = LogReader(log)
        said, missed = read.read("event_supervisor"), list[str]()
        for worker in WORKERS.values():
            stages = []
            for code in ("died", "restarted", "back"):
                took_ms = []
                told = said[(said["source"] == worker.encode()) & (said["code"] == f"worker_{code}".encode())]
                for at_ns in (at for name, at in killed if name == worker):
                    after = told["host_ns"][told["host_ns"] > at_ns]
                    took_ms.append((int(after[0]) - at_ns) * 1e-6 if len(after) else float("inf"))
                if code == "back" and max(took_ms) > BACK_MS:
                    missed.append(f"{worker} back after {max(took_ms):.0f} ms, bar {BACK_MS:g}")
                stages.append(f"{code} {statistics.median(took_ms):.0f} (worst {max(took_ms):.0f}) ms")
            print(f"{worker}, after the kill: {', '.join(stages)}, {len(took_ms)} kills")
        imu = read.read("imu_base")["host_ns"]
        holes_ms = np.sort(np.diff(imu))[-options.kills :] * 1e-6
        print("longest holes in imu_base [ms]:", " ".join(f"{hole:.0f}" for hole in holes_ms))
        causes = {row["cause"].decode(): 0 for row in read.read("gap")}
        for row in read.read("gap"):
            causes[row["cause"].decode()] += int(row["last_missing"] - row["first_missing"] + 1)
        lost, unexplained = len(read.read("recorder_gap")), info(log).unexplained
        anew = int(read.read("tick")["fresh"].sum())
        print(f"rows named missing, by cause: {causes}; rows the recorder lost: {lost} gaps; in no gap: {unexplained}")
        print(f"estimators begun anew: {anew}; damage: {len(read.damage)}")
    missed += [f"hole of {holes_ms[-1]:.0f} ms in imu_base, bar {HOLE_MS:g}"] if holes_ms[-1] > HOLE_MS else []
    counts = {"gaps of the recorder": lost, "rows in no gap": unexplained, "estimators begun anew": anew}
    missed += [f"{count} {what}" for what, count in counts.items() if count]
    for text in missed:
        print(f"MISSED {text}")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
