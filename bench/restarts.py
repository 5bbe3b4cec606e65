"""Time from SIGKILL of a worker to its being at work again, in a flight of simulated devices, with and without load.

    python -m bench.restarts [--vehicle rocksat] [--kills 5] [--load 10] [--nice -10]

For recording and estimation it is the time to their first beat; for acquisition the longest hole between two IMU
rows as well. ``--load N`` runs N processes that only compute beside it; ``--nice`` is the flight's nice level (the
systemd unit has -10).
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from onboard import config
from onboard.recording.reader import LogReader

WORKERS = {"heft-record": "recording", "heft-estimate": "estimation", "heft-acquire": "acquisition"}


def busy(count: int, stack: ExitStack) -> None:
    """So many processes that only compute, until ``stack`` is closed."""
    for _ in range(count):
        one = subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True)
        stack.callback(one.kill)


def processes(supervisor: int) -> dict[str, int]:
    """Processes of heft below ``supervisor``, by name."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = entry.read_text().partition("(")[2].rpartition(")")
        except OSError:
            continue
        if int(rest.split()[1]) == supervisor and name.startswith("heft-"):
            found[name] = int(entry.parent.name)
    return found


def pss(pid: int) -> float:
    """Memory of a process [MB], what it shares divided by those that share it."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1e-3


def print_memory(flight: int) -> None:
    """PSS of every process of a flight, and their sum."""
    children = Path(f"/proc/{flight}/task/{flight}/children").read_text().split()
    found = [(Path(f"/proc/{pid}/comm").read_text().strip(), pss(int(pid))) for pid in (str(flight), *children)]
    print("PSS [MB]:", ", ".join(f"{name} {mb:.0f}" for name, mb in found), f"sum {sum(mb for _, mb in found):.0f}")


def start(vehicle: str, log: Path, urls: list[str], nice: int) -> subprocess.Popen[bytes]:
    """A flight in a session of its own, with a nice level; where sessions share the CPU equally, theirs is set too."""
    command = ["nice", f"-n{nice}", sys.executable, "-m", "onboard.cli", "fly", vehicle, "--log", str(log), *urls]
    flight = subprocess.Popen([*command, "--quiet"], start_new_session=True)
    group = Path(f"/proc/{flight.pid}/autogroup")
    if group.exists():
        group.write_text(str(nice))
    return flight


def fly(vehicle: str, place: Path, nice: int, kills: int, load: int) -> tuple[Path, list[tuple[str, int]]]:
    """Fly, kill each worker so many times; the log, and who was killed when."""
    log = place / "restarts.mcap"
    killed: list[tuple[str, int]] = []
    serve = [sys.executable, "-m", "hil_sim.serve", vehicle, "--seed", "3", "--directory", str(place)]
    with ExitStack() as stack:
        devices = stack.enter_context(subprocess.Popen(serve, stdout=subprocess.PIPE, text=True))
        stack.callback(devices.terminate)
        assert devices.stdout is not None
        served = json.loads(devices.stdout.readline())
        named = config.named(vehicle)
        urls = [f"--url={bus}={served[bus]}" for bus in named.buses if bus in served]
        flight = start(vehicle, log, urls, nice)
        stack.callback(flight.wait)
        stack.callback(flight.kill)
        deadline = time.monotonic() + 60
        while not (log.exists() and WORKERS.keys() <= processes(flight.pid).keys()) and time.monotonic() < deadline:
            time.sleep(0.1)
        own = {"supervisor": flight.pid, **processes(flight.pid)}
        pss_mb = {name: pss(pid) for name, pid in own.items()}
        print(
            "PSS [MB]:", ", ".join(f"{name} {mb:.0f}" for name, mb in pss_mb.items()), f"sum {sum(pss_mb.values()):.0f}"
        )
        busy(load, stack)
        time.sleep(4.0)
        for _ in range(kills):
            for name, worker in WORKERS.items():
                killed.append((worker, time.monotonic_ns()))
                os.kill(processes(flight.pid)[name], signal.SIGKILL)
                time.sleep(2.5)
        print(f"load average {os.getloadavg()[0]:.1f}")
        flight.send_signal(signal.SIGTERM)
        flight.wait(120)
    return log, killed


def main() -> None:
    """Print a line for each worker."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--vehicle", default="rocksat")
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
