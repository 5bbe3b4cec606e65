"""A long flight in real time: whether memory, files, threads or shared memory grow.

    python -m bench.soak [--vehicle dymaflex] [--minutes 60] [--json FILE]

Looks at every process of the flight every 10 s. The first fifth, and two minutes at least, is warm-up: the rings are
touched for the first time, the estimator's histories fill. After it a line is fitted to each quantity; growth is what
the line gains over the rest. Exit code 1 where PSS of all grows by more than 5 MB an hour (and more than the scatter
about the line), or where files, threads, processes, or bytes in shared memory grow at all, or where the flight ends
itself, loses rows in the recorder or restarts a worker. A worker that was restarted begins anew.

The simulator's memory grows with the mission's length, by some 0.8 GB an hour; it is not part of the flight.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench import given
from bench.real_flight import WORKERS, RealFlight, all_processes, flying, longer, pss_by_kind_mb, pss_mb
from onboard.recording.reader import LogReader

EVERY_S = 10.0
WARM_UP_S = 120.0
GROWTH_MB_H = 5.0


class ProcessLoad(NamedTuple):
    """Of all processes of a flight at one instant."""

    at_s: float
    pss_mb: dict[str, float]
    files: int
    threads: int
    processes: int
    shared_bytes: int
    kinds_mb: dict[str, float]  # PSS by process and kind: a ring counts for who has touched it, at most once round


def look(flight: RealFlight, at_s: float) -> ProcessLoad:
    """Now."""
    pss: dict[str, float] = {}
    kinds: dict[str, float] = {}
    files = threads = processes = 0
    for pid, name in all_processes(flight.process.pid).items():
        place = Path(f"/proc/{pid}")
        try:
            own = WORKERS.get(name, name)
            pss[own] = pss.get(own, 0.0) + pss_mb(pid)
            for kind, mb in pss_by_kind_mb(pid).items():
                kinds[f"{own}, {kind}"] = kinds.get(f"{own}, {kind}", 0.0) + mb
            files += len(list((place / "fd").iterdir()))
            threads += len(list((place / "task").iterdir()))
        except (OSError, StopIteration):
            continue  # it has just ended
        processes += 1
    shared = sum(path.stat().st_blocks * 512 for path in flight.rings.rglob("*") if path.is_file())
    return ProcessLoad(at_s, pss, files, threads, processes, shared, kinds)


class Growth(NamedTuple):
    """Of a quantity over the time after the warm-up: from the line fitted to it, and the scatter about that."""

    gained: float
    scatter: float
    first: float
    last: float


def growth(at_s: np.ndarray, values: np.ndarray) -> Growth:
    """Fit a line to ``values`` (n,) at ``at_s`` (n,)."""
    slope, offset = np.polyfit(at_s - at_s[0], values, 1)
    scatter = float(np.std(values - offset - slope * (at_s - at_s[0])))
    return Growth(float(slope * (at_s[-1] - at_s[0])), scatter, float(values[0]), float(values[-1]))


def judge(looks: list[ProcessLoad]) -> tuple[list[str], dict[str, Growth]]:
    """What grows, and by how much each quantity does."""
    at_s = np.array([one.at_s for one in looks])
    hours = (at_s[-1] - at_s[0]) / 3600.0
    names = sorted({name for one in looks for name in one.pss_mb})
    found = {f"PSS of {name}": growth(at_s, np.array([one.pss_mb.get(name, 0.0) for one in looks])) for name in names}
    for name in sorted({name for one in looks for name in one.kinds_mb}):
        found[f"PSS of {name}"] = growth(at_s, np.array([one.kinds_mb.get(name, 0.0) for one in looks]))
    total = growth(at_s, np.array([sum(one.pss_mb.values()) for one in looks]))
    found["PSS of all"] = total
    too_much = total.gained > max(GROWTH_MB_H * hours, total.scatter)
    grown = [f"PSS by {total.gained / hours:.1f} MB an hour"] if too_much else []
    for field in ("files", "threads", "processes", "shared_bytes"):
        one = growth(at_s, np.array([getattr(look_, field) for look_ in looks], np.float64))
        found[field] = one
        if min(getattr(look_, field) for look_ in looks[-3:]) > max(getattr(look_, field) for look_ in looks[:3]):
            grown.append(f"{field} from {one.first:.0f} to {one.last:.0f}")
    return grown, found


def main() -> int:
    """Fly, look, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--vehicle", choices=given.rehearsed(), default="dymaflex", help="a packaged one with a scenario"
    )
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    seconds = 60.0 * options.minutes
    with tempfile.TemporaryDirectory() as directory:
        place = Path(directory)
        over = longer(options.vehicle, seconds + 60.0, place)
        looks: list[ProcessLoad] = []
        with flying(options.vehicle, place, name="soak", over=over) as flight:
            began_s = time.monotonic()
            while (now_s := time.monotonic() - began_s) < seconds and flight.process.poll() is None:
                looks.append(look(flight, now_s))
                print(
                    f"{now_s:6.0f} s  {sum(looks[-1].pss_mb.values()):6.1f} MB  {looks[-1].files} files  "
                    f"{looks[-1].threads} threads  {looks[-1].shared_bytes / 1e6:.2f} MB in shared memory",
                    flush=True,
                )
                time.sleep(EVERY_S)
            ended = flight.process.poll() is not None
            code = flight.end()
        log = LogReader(flight.log)
        restarts, lost = int(log.read("health")["restarts"][-1]), len(log.read("recorder_gap"))
    kept = [one for one in looks if one.at_s >= min(max(WARM_UP_S, 0.2 * seconds), 0.5 * seconds)]
    grown, found = judge(kept)
    for name, one in found.items():
        print(f"{name}: {one.first:.1f} to {one.last:.1f}, line {one.gained:+.2f}, scatter {one.scatter:.2f}")
    grown += ["it ended itself"] * ended + [f"exit code {code}"] * bool(code)
    grown += [f"{restarts} restarts"] * bool(restarts) + [f"{lost} gaps of the recorder"] * bool(lost)
    for text in grown:
        print(f"MISSED {text}")
    if options.json:
        spans = {name: one._asdict() for name, one in found.items()}
        told: dict[str, Any] = {"minutes": options.minutes, "missed": grown, "found": spans}
        options.json.write_text(json.dumps(told), encoding="utf-8")
    return int(bool(grown))


if __name__ == "__main__":
    sys.exit(main())
