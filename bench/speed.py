"""How many seconds of flight a second of CPU simulates, and what takes it.

::

    python -m bench.speed [rocksat dymaflex ...] [--seed 3] [--rounds 3] [--json FILE]

One process, virtual time, CPU time (``time.process_time``), the round with the least of each mission, imports left
out. It is divided among the parts as ``time.perf_counter`` was between their calls: asking for CPU time costs more.
``start`` is building and closing what flies; ``simulator`` the world's steps and what the drivers' I2C transfers
make it do; ``acquisition`` the drivers and the rings; ``estimator`` and ``recorder`` their steps; ``x`` flight seconds
over all of it, ``x dev`` over all but the estimator. The SHA-256 is of the log: the same seed must give the same,
whatever was made faster (the log names the revision of the code, which is left out here).
"""

import argparse
import hashlib
import json
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hil_sim.buses.media import I2cBus
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import Mission, open_in_process
from onboard import config
from onboard.flight import hil
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.estimate.estimation import EstimationWorker
from onboard.flight.store import flight_log
from onboard.recording.recorder import Recorder

MISSIONS = ("rocksat", "dymaflex")
PARTS = ("start", "simulator", "acquisition", "estimator", "recorder")


def flown(mission: str, seed: int, log: Path) -> dict[str, float | str]:
    """CPU seconds by part, flight seconds, and the log's SHA-256."""
    began_s, began = time.process_time(), time.perf_counter()
    spent: Counter[str] = Counter()
    depth: list[float] = []  # CPU time taken by parts inside the one that is timed
    kept = {}

    def timed(owner: Any, name: str, part: str) -> None:
        inner: Callable[..., Any] = getattr(owner, name)
        kept[owner, name] = inner

        def outer(*arguments: Any, **named: Any) -> Any:
            depth.append(0.0)
            since = time.perf_counter()
            try:
                return inner(*arguments, **named)
            finally:
                took = time.perf_counter() - since
                spent[part] += took - depth.pop()
                if depth:
                    depth[-1] += took

        setattr(owner, name, outer)

    revision = flight_log._revision
    flight_log._revision = lambda: "bench"
    try:
        timed(Mission, "advance", "simulator")
        timed(I2cBus, "transfer", "simulator")
        for name in ("step", "stop"):
            timed(Acquisition, name, "acquisition")
        for name in ("step", "finish"):
            timed(EstimationWorker, name, "estimator")
        for name in ("step", "close"):
            timed(Recorder, name, "recorder")
        world, urls = open_in_process(scenario_of(mission), seed)
        with world:
            hil.fly_simulated(config.named(mission), world, urls, log)
            flight_s = 1e-9 * (world.end_ns - world.start_ns)
    finally:
        flight_log._revision = revision
        for (owner, name), inner in kept.items():
            setattr(owner, name, inner)
    cpu_s, whole = time.process_time() - began_s, time.perf_counter() - began
    spent["start"] = whole - sum(spent.values())
    parts: dict[str, float | str] = {part: cpu_s * spent[part] / whole for part in PARTS}
    return parts | {"cpu": cpu_s, "flight": flight_s, "sha256": hashlib.sha256(log.read_bytes()).hexdigest()}


def main() -> int:
    """Fly and print; 1 where two rounds wrote different logs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("missions", nargs="*", default=MISSIONS)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    parts = "  ".join(f"{part:>11}" for part in PARTS)
    print(f"{'mission':<16}{'flight s':>9}{'CPU s':>7}{'x':>6}{'x dev':>7}  {parts}  log")
    found, same = {}, True
    for mission in arguments.missions:
        with tempfile.TemporaryDirectory() as directory:
            rounds = [
                flown(mission, arguments.seed, Path(directory) / f"{number}.mcap") for number in range(arguments.rounds)
            ]
        best = found[mission] = min(rounds, key=lambda one: float(one["cpu"]))
        same &= len({one["sha256"] for one in rounds}) == 1
        speed = float(best["flight"]) / float(best["cpu"])
        of_devices = float(best["flight"]) / (float(best["cpu"]) - float(best["estimator"]))
        shares = "  ".join(f"{best[part]:11.2f}" for part in PARTS)
        spent = f"{best['flight']:9.1f}{best['cpu']:7.2f}{speed:6.1f}{of_devices:7.1f}"
        print(f"{mission:<16}{spent}  {shares}  {str(best['sha256'])[:12]}")
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if not same:
        print("one seed wrote different logs")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
