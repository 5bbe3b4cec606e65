"""Random faults on all missions, alone and in pairs: does the flight app end, and is every lost sample named?

Run ``python bench/faults.py --flights 100 --first 7001 [--jobs 2] [--results faults.jsonl]``. Every seed is a flight in
virtual time: mission, faults of the vocabulary (``heft hil MISSION --faults``), their times and values are
drawn from it. Each flight is a line of JSON in ``--results``; seeds that are in it are not flown again. Counted are

- *crashed*: an exception anywhere, from the first step to the result table,
- *unnamed*: samples of a channel that are neither in the log nor in a gap record, or a jump of its numbers in none,
- *inexact*: gap records that say their samples were counted, and do not add up,
- *recovery*: from the end of a fault to the first row of all channels that paused under it.

Exit code 1: a crash, or an unnamed or inexact gap. Faults of the computer (killed and stopped processes, a stepped
clock, a full disk) are flown in real time by ``bench/process_faults.py``.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from functools import cache, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.faults import FaultError, FaultKind
from hil_sim.mission import open_in_process
from onboard import config
from onboard.flight import hil
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.acquire.devices import open_devices
from onboard.flight.acquire.expected import expected
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.simulated import RECORDING_NS, VirtualClock, step_of
from onboard.flight.store import rings
from onboard.flight.store.directories import scratch
from onboard.flight.store.flight_log import open_simulated_recorder
from onboard.ground.identify.mission import mission_table
from onboard.ground.identify.mission.accounts import Account, Seen, render
from onboard.ground.log.views.info import info
from onboard.recording.reader import LogReader

Fault = dict[str, Any]
SHORTEST_S, LONGEST_S = 0.02, 4.0  # of a fault that ends
_SWEEP = {
    "action": "strokes",
    "amplitude": {"joint_1": 0.2007},
    "stroke_s": 0.6,
    "strokes": 3,
    "pause_s": 0.05,
    "transfer_s": 0.5,
}
_ROCKET = [
    {"phase": 0, "action": "hold", "duration_s": 2.5},
    {"phase": 4, **_SWEEP},
    {"phase": 5, "action": "hold", "duration_s": 0.8},
    {"phase": 4, **_SWEEP},
    {"phase": 9, "action": "hold", "duration_s": 0.5},
]
_SWING = {"action": "swing", "ramp_s": 1.0, "swing": 0.137, "tones": 3, "band_Hz": [0.1, 0.6]}
_FREE_FLYER = [
    {"phase": 0, "action": "hold", "duration_s": 3.0},
    {"phase": 1, "duration_s": 4.0, **_SWING},
    {"phase": 2, "duration_s": 4.0, **_SWING},
    {"phase": 9, "action": "hold", "duration_s": 0.5},
]
_CAPTURE = {"earliest_s": 4.0, "latest_s": 5.0}
MISSIONS: dict[str, dict[str, Any]] = {
    "rocksat": {"sequence": _ROCKET},
    "rocksat_serial": {"sequence": _ROCKET},
    "rocksat_mixed": {"sequence": _ROCKET},
    "dymaflex": {"sequence": _FREE_FLYER, "capture": _CAPTURE},
}
_SHARES = (0.35, 0.25, 0.2, 0.2)
_VALUES: dict[FaultKind, tuple[float, float] | list[float]] = {  # two: between them, by ratio; a list: one of them
    FaultKind.INTERMITTENT: (0.01, 0.5),
    FaultKind.SATURATED: [-1.0, 1.0],
    FaultKind.WRONG: [-2.0, -1.0, -0.1, 0.3, 1.0, 7.0],
    FaultKind.SLIPPED: [-30.0, -2.0, 0.1, 5.0],
    FaultKind.DELAYED: (0.003, 1.0),
    FaultKind.GARBAGE: (1.0, 1000.0),
    FaultKind.SLOW: (0.003, 0.3),
    FaultKind.CLOCK_JUMP: [-1.0, -0.3, -0.06, -0.005, 0.005, 0.1, 1.0],
    FaultKind.NACK: [0.0, 5.0, 110.0, 121.0],
    FaultKind.WHO_AM_I: [0.0, 0x42, 0x70, 0xFF],
    FaultKind.PULSE_SPURIOUS: (0.003, 0.3),
    FaultKind.ERROR_FRAMES: (0.001, 0.1),
    FaultKind.FLOOD: [0.0, 0x001, 0x080, 0x101, 0x181, 0x281, 0x701, 0x7F0],
    FaultKind.FRAME_DROP: [0.0, 0.0, 0x080, 0x181, 0x182, 0x183, 0x281, 0x701],
    FaultKind.BYTE_LOSS: (0.0005, 0.3),
    FaultKind.BYTE_GARBLE: (0.0005, 0.3),
}


@cache
def vocabulary(mission: str) -> dict[str, tuple[FaultKind, ...]]:
    """Kinds of faults by device and bus of a mission."""
    with open_in_process(scenario_of(mission, MISSIONS[mission]), 1)[0] as world:
        return world.possible_faults()


def draw(seed: int) -> tuple[str, list[Fault]]:
    """What flies under a seed: a mission, one or two faults."""
    rng = np.random.default_rng([seed, 0xFA])
    name = str(rng.choice(list(MISSIONS), p=_SHARES))
    possible = vocabulary(name)
    end_s = sum(_lasts(step) for step in MISSIONS[name]["sequence"])
    faults: list[Fault] = []
    for device in rng.choice(sorted(possible), 1 + int(rng.random() < 0.4), replace=False):
        kind = possible[str(device)][int(rng.integers(len(possible[str(device)])))]
        start_s = 0.0 if rng.random() < 0.08 else float(rng.uniform(0.2, end_s - 0.3))
        fault: Fault = {
            "kind": str(kind),
            "device": str(device),
            "start_s": round(start_s, 4),
            "value": _value(kind, rng),
        }
        if rng.random() < 0.85 or kind in (FaultKind.INTERMITTENT, FaultKind.GARBAGE):
            lasts_s = SHORTEST_S * (LONGEST_S / SHORTEST_S) ** rng.random()
            fault["end_s"] = round(start_s + lasts_s, 4)
        if kind is FaultKind.DELAYED and device.startswith("can"):  # nobody knows of frames under way at the end
            latest_s = max(end_s - fault["value"] - 0.05, 0.1)
            fault |= {
                "start_s": min(fault["start_s"], latest_s - 0.05),
                "end_s": min(fault.get("end_s", end_s), latest_s),
            }
        faults.append(fault)
    return name, faults


def _lasts(step: dict[str, Any]) -> float:
    return float(step["duration_s"] if "duration_s" in step else step["strokes"] * step["stroke_s"])


def _value(kind: FaultKind, rng: np.random.Generator) -> float:
    among = _VALUES.get(kind)
    if among is None:
        return 0.0
    if isinstance(among, list):
        return float(rng.choice(among))
    return float(f"{among[0] * (among[1] / among[0]) ** rng.random():.4g}")


def fly(seed: int, without_estimator: bool = False) -> dict[str, Any]:
    """Fly a seed's flight; plain values of what came of it."""
    name, faults = draw(seed)
    began_s = time.monotonic()
    told: dict[str, Any] = {"seed": seed, "mission": name, "faults": faults}
    try:
        told |= flown(seed, name, faults, without_estimator)
    except FaultError as error:
        told["refused"] = str(error)  # a value that its device cannot have: no flight
    except Exception:  # noqa: BLE001 - any at all is what is looked for
        told["crash"] = traceback.format_exc()
    return told | {"took_s": round(time.monotonic() - began_s, 1)}


def flown(seed: int, name: str, faults: list[Fault], without_estimator: bool) -> dict[str, Any]:
    """Fly these faults; plain values of what came of it."""
    vehicle = config.load(config.packaged(name))
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "flight.mcap"
        world, urls = open_in_process(scenario_of(name, {**MISSIONS[name], "fault": faults}), seed)
        with world:
            if without_estimator:
                done = _fly_drivers(vehicle, world, urls, path)
            else:
                done = hil.fly_simulated(vehicle, world, urls, path)
                mission_table.render(mission_table.result(done))
        about, log, start_ns = info(path), LogReader(path), int(done.truth["start_ns"])
        seen = Seen(done.produced, start_ns)
        for batch in log.batches():
            seen.see(batch)
        made = seen.accounts()
        return {
            "accounts": {n: [c.produced, c.recorded, c.missing, c.about] for n, c in made.items()},
            "unnamed": {n: c.left for n, c in made.items() if not c.is_whole},
            "jumps": {c.name: [c.repeated, c.unexplained] for c in about.channels if c.repeated or c.unexplained},
            "recovery_s": _recovery(log, made, faults, start_ns),
            "said": [text for text in render(made) if text.startswith("SAMPLES")],
        }


def _fly_drivers(vehicle: config.Vehicle, world: hil.World, urls: Mapping[str, str], path: Path) -> hil.Flown:
    """Acquisition and recording as in ``hil.fly_simulated``, without the estimator."""
    flying, clock = vehicle.with_urls(dict(urls)), VirtualClock(world.start_ns)
    with ExitStack() as stack:
        directory = stack.enter_context(scratch())
        publisher = Publisher(rings.create(directory, flying, rings.device_channels(flying)))
        opened = open_devices(flying, clock)
        stack.callback(opened.close)
        acquisition = Acquisition(opened.devices, publisher)
        recorder = open_simulated_recorder(vehicle, directory, path)
        for bus in flying.buses:
            acquisition.expect(expected(flying, bus), world.start_ns)
        acquisition.start(clock.now_ns)
        pause_ns, step = step_of(acquisition.devices), 0
        while clock.now_ns < world.end_ns:
            step, clock.now_ns = step + 1, min(clock.now_ns + pause_ns, world.end_ns)
            world.advance(clock.now_ns)
            acquisition.step(clock.now_ns)
            if step % max(1, RECORDING_NS // pause_ns) == 0:
                recorder.step(clock.now_ns)
        acquisition.stop(clock.now_ns)
        recorder.close(clock.now_ns)
    return hil.Flown(path, world.produced(), world.truth())


def _recovery(log: LogReader, made: dict[str, Account], faults: list[Fault], start_ns: int) -> float | None:
    """Seconds from the end of the last fault to the first row of the slowest of the channels with gaps under it."""
    ends = [f["start_s"] if f["kind"] in ("reset", "clock_jump") else f.get("end_s", np.inf) for f in faults]
    end_s = max(ends, default=0.0)
    slowest = None
    for name, account in made.items():
        if any(gap["to_s"] > end_s > gap["from_s"] - 0.1 for gap in account.gaps) and name in log.channels:
            times_s = 1e-9 * (log.read(name)["host_ns"].astype(np.int64) - start_ns)
            after = times_s[times_s > end_s]
            slowest = max(slowest or 0.0, float(after[0] - end_s) if len(after) else np.inf)
    return None if slowest is None or not np.isfinite(slowest) else round(slowest, 4)


def is_bad(told: dict[str, Any]) -> bool:
    """A crash, or something unnamed or inexact."""
    return bool(told.get("crash") or told.get("unnamed") or told.get("jumps"))


def line(told: dict[str, Any]) -> str:
    """A flight for people."""
    faults = ", ".join(
        f"--fault {f['kind']}:{f['device']}:{f['start_s']}:{f.get('end_s', '')}:{f['value']:g}" for f in told["faults"]
    )
    what = told.get("crash", "").strip().splitlines()[-1:] or [*told.get("said", []), *map(str, told["jumps"].items())]
    return f"seed {told['seed']} {told['mission']} {faults}\n    " + "\n    ".join(what)


def table(flights: Iterable[dict[str, Any]]) -> str:
    """Results by kind of fault; flights with two count in both rows."""
    flown = [told for told in flights if "refused" not in told]
    kinds = sorted({fault["kind"] for told in flown for fault in told["faults"]})
    rows = ["| fault | flights | crashed | unnamed | lost | named | counted exactly | recovery, median and worst |"]
    rows.append("|---|" + "---:|" * 7)
    for kind in [*kinds, "all"]:
        mine = [t for t in flown if kind == "all" or any(f["kind"] == kind for f in t["faults"])]
        accounts = [account for t in mine for account in t.get("accounts", {}).values()]
        lost = sum(max(0, made - recorded) for made, recorded, *_ in accounts)
        named = sum(missing for _, _, missing, *_ in accounts)
        counted = [a for a in accounts if a[2] and not a[3]]
        exact = sum(made == recorded + missing for made, recorded, missing, *_ in counted)
        recovery = [t["recovery_s"] for t in mine if t.get("recovery_s") is not None]
        back = f"{np.median(recovery):.2f} s, {max(recovery):.2f} s" if recovery else "—"
        crashed, unnamed = (sum(bool(t.get(key)) for t in mine) for key in ("crash", "unnamed"))
        unnamed += sum(bool(t.get("jumps")) and not t.get("unnamed") for t in mine)
        cells = (len(mine), crashed, unnamed, lost, named, f"{exact} of {len(counted)}" if counted else "—", back)
        rows.append(f"| {kind} | " + " | ".join(map(str, cells)) + " |")
    return "\n".join(rows)


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--first", type=int, default=7001, help="seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, default=Path("faults.jsonl"))
    parser.add_argument("--without-estimator", action="store_true", help="drivers and recorder only, ten times as fast")
    arguments = parser.parse_args()
    lines = arguments.results.read_text(encoding="utf-8").splitlines() if arguments.results.exists() else []
    flown = {told["seed"]: told for told in map(json.loads, lines)}
    seeds = [s for s in range(arguments.first, arguments.first + arguments.flights) if s not in flown]
    with (
        ProcessPoolExecutor(arguments.jobs, multiprocessing.get_context("spawn")) as pool,
        arguments.results.open("a", encoding="utf-8") as results,
    ):
        for told in pool.map(partial(fly, without_estimator=arguments.without_estimator), seeds):
            flown[told["seed"]] = told
            results.write(json.dumps(told) + "\n")
            results.flush()
            if is_bad(told):
                print(line(told), flush=True)
    print(table(flown.values()))
    return int(any(map(is_bad, flown.values())))


if __name__ == "__main__":
    sys.exit(main())
