"""Time from SIGKILL of a worker to its being at work again, in a flight of simulated devices, with and without load.

    python -m bench.restarts [--vehicle dymaflex] [--kills 5] [--load 10] [--nice -10]

For recording and estimation it is the time to their first beat; for acquisition the longest hole between two IMU
rows as well. ``--load N`` runs N processes that only compute beside it; ``--nice`` is the flight's nice level (the
systemd unit has -10).
"""

import argparse
import os
import signal
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.real_flight import WORKERS, busy, flying, longer, memory_line, processes
from onboard.recording.reader import LogReader

START_S, PAUSE_S = 4.0, 2.5  # before the first kill, after each


def fly(vehicle: str, place: Path, nice: int, kills: int, load: int) -> tuple[Path, list[tuple[str, int]]]:
    """Fly, kill each worker so many times; the log, and who was killed when."""
    killed: list[tuple[str, int]] = []
    over = longer(vehicle, START_S + 3 * PAUSE_S * kills + 30.0, place)
    with flying(vehicle, place, name="restarts", over=over, nice=nice) as flight, busy(load):
        print(memory_line(flight.process.pid))
        time.sleep(START_S)
        for _ in range(kills):
            for name, worker in WORKERS.items():
                killed.append((worker, time.monotonic_ns()))
                os.kill(processes(flight.process.pid)[name], signal.SIGKILL)
                time.sleep(PAUSE_S)
        print(f"load average {os.getloadavg()[0]:.1f}")
        print(f"exit code {flight.end()}")
    return flight.log, killed


def main() -> None:
    """Print a line for each worker."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--vehicle", default="dymaflex")
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--load", type=int, default=0)
    parser.add_argument("--nice", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        log, killed = fly(options.vehicle, Path(place), options.nice, options.kills, options.load)
        read = LogReader(log)
        said = read.read("event_supervisor")
        for worker in WORKERS.values():
            stages = []
            for code in ("died", "restarted", "back"):
                took_ms = []
                told = said[(said["source"] == worker.encode()) & (said["code"] == f"worker_{code}".encode())]
                for at_ns in (at for name, at in killed if name == worker):
                    after = told["host_ns"][told["host_ns"] > at_ns]
                    took_ms.append((int(after[0]) - at_ns) * 1e-6 if len(after) else float("inf"))
                stages.append(f"{code} {statistics.median(took_ms):.0f} (worst {max(took_ms):.0f}) ms")
            print(f"{worker}, after the kill: {', '.join(stages)}, {len(took_ms)} kills")
        imu = read.read("imu_base")["host_ns"]
        holes_ms = np.sort(np.diff(imu))[-options.kills :] * 1e-6
        print("longest holes in imu_base [ms]:", " ".join(f"{hole:.0f}" for hole in holes_ms))
        missing = {row["cause"].decode(): 0 for row in read.read("gap")}
        for row in read.read("gap"):
            missing[row["cause"].decode()] += int(row["last_missing"] - row["first_missing"] + 1)
        print(f"rows named missing, by cause: {missing}; rows the recorder lost: {len(read.read('recorder_gap'))} gaps")
        print(f"estimators begun anew: {int(read.read('tick')['fresh'].sum())}; damage: {len(read.damage)}")


if __name__ == "__main__":
    main()
