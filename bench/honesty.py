"""Random flights with faults and model errors, alone and in pairs: does a wrong answer ever look like a right one?

Run ``python bench/honesty.py [--flights 20] [--first 1] [--vehicle rocksat] [--healthy]``. Each seed is a short
mission of its own: vehicle, faults of the vocabulary (``hil_sim.faults``), and how far the truth is from the drawing
are drawn from it. Counted are

- *confident nonsense*: a quantity that the flight supports while its truth lies outside its 99.9 % interval,
- the same under a fault that no instrument on board can see (a scale that is wrong from the first sweep on, or for all
  of what was released, where nothing stands beside): there the answer leans on a calibration,
- flights with a harmless fault (samples are missing, none is false) that still answer,
- healthy flights of which some answer is not to be used,
- faults on an instrument that another one stands beside, and whether an event names it.

Exit code 1: confident nonsense.
"""

import argparse
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from hil_sim.mission import open_in_process
from hil_sim.scenario.load import load
from onboard import config
from onboard.flight import hil
from onboard.offline.views import mission_table as table

WIDER = 3.2905 / 1.9600  # a 99.9 % interval, of a 95 % one
SHORTEST_S, LONGEST_S = 0.2, 3.0  # of a fault that ends
_SWEEP = {"action": "sweep", "amplitude_deg": 11.5, "pause_s": 0.05, "transfer_s": 0.5}
_SLOW, _FAST = (
    _SWEEP | {"phase": 3, "stroke_s": 1.0, "strokes": 3},
    _SWEEP | {"phase": 4, "stroke_s": 0.6, "strokes": 4},
)


def _hold(duration_s: float, phase: int = 0) -> dict[str, Any]:
    return {"phase": phase, "action": "hold", "duration_s": duration_s}


MISSION = [
    *(_hold(2.5), _SLOW, _hold(0.4), _FAST, _hold(0.3), {"phase": 5, "action": "eject", "duration_s": 0.8}),
    *(_SLOW, _hold(0.4), _FAST, _hold(0.5, 9)),
]
FIRST_SWEEP_S, LAST_HELD_S, RELEASED_S, END_S = 2.6, 9.1, 10.9, 17.0
_MISSING = [("off", 0.0), ("reset", 0.0), ("silent", 0.0), ("intermittent", 0.1)]
_FALSE = [("stuck", 0.0), ("wrong", np.nan), ("delayed", 0.1)]  # NaN: a scale is drawn
FAULTS: dict[str, dict[str, list[tuple[str, float]]]] = {
    "rocksat": {
        "imu_base": [*_MISSING[:2], *_FALSE, ("saturated", 1.0), ("garbage", 0.0)],
        "joint_1": [*_MISSING, *_FALSE, ("garbage", 0.0)],
        "load_cell": [*_MISSING, *_FALSE, ("saturated", 1.0), ("garbage", 0.0)],
        "arm_phase": [("wrong", 1.0), ("wrong", 2.0), ("delayed", 0.2)],
        "can_0": [("frame_drop", 0.0), ("intermittent", 0.1), ("error_frames", 0.01)],
        "sync_line": [("pulse_drop", 0.0), ("delayed", 0.02)],
    },
    "rocksat_serial": {
        "imu_base": [*_MISSING, *_FALSE, ("saturated", 1.0)],
        "joint_1": [*_MISSING, *_FALSE, ("slow", 0.2)],
        "load_cell": [*_MISSING, *_FALSE, ("saturated", 1.0)],
        "cell_port": [("byte_loss", 0.02), ("byte_garble", 0.02), ("unplug", 0.0)],
        "joint_port": [("byte_loss", 0.02), ("unplug", 0.0)],
    },
    "rocksat_mixed": {
        "joint_1": [*_MISSING[:1], *_FALSE],
        "load_cell": [*_MISSING, *_FALSE],
        "load_cell_2": [*_MISSING, *_FALSE],
        "imu_base": [*_FALSE],
    },
}
HARMLESS = {"off", "reset", "silent", "intermittent", "frame_drop", "error_frames", "pulse_drop", "byte_loss", "unplug"}
REDUNDANT = {"rocksat_mixed": {"load_cell", "load_cell_2"}}


class Drawn(NamedTuple):
    """A flight to be flown."""

    seed: int
    vehicle: str
    faults: list[dict[str, Any]]
    overrides: dict[str, Any]  # of the scenario: what is not as drawn

    @property
    def text(self) -> str:
        """For people."""
        said = [
            f"{f['kind']}({f['value']:.3g}) of {f['device']} from {f['start_s']:.1f} s"
            + (f" to {f['end_s']:.1f} s" if "end_s" in f else "")
            for f in self.faults
        ]
        return f"seed {self.seed} {self.vehicle}: {', '.join([*said, *self.overrides]) or 'healthy'}"

    @property
    def invisible(self) -> bool:
        """A scale is wrong for all of the rows with the payload, or all of those without, and nothing stands beside."""
        alone = [f for f in self.faults if f["kind"] == "wrong" and f["device"] in ("load_cell", "joint_1")]
        for fault in alone:
            starts, ends = fault["start_s"], fault.get("end_s", np.inf)
            whole = starts < FIRST_SWEEP_S + 1.0 and ends > LAST_HELD_S - 1.0
            whole |= starts < RELEASED_S + 1.0 and ends > END_S - 1.0 and starts > LAST_HELD_S - 1.5
            if whole and fault["device"] not in REDUNDANT.get(self.vehicle, set()):
                return True
        return False


class Outcome(NamedTuple):
    """What came of it."""

    drawn: Drawn
    nonsense: tuple[str, ...]
    answered: bool  # all masses
    refused: bool  # some quantity is not to be used
    named: bool  # by an event, every device with a fault


def draw(seed: int, vehicle: str | None, healthy: bool) -> Drawn:
    """What flies under a seed."""
    rng = np.random.default_rng([seed, 0x12])
    name = vehicle or str(rng.choice(list(FAULTS), p=[0.5, 0.2, 0.3]))
    faults, overrides = list[dict[str, Any]](), dict[str, Any]()
    count = 0 if healthy else int(rng.choice([1, 2], p=[0.6, 0.4]))
    devices = rng.permutation(list(FAULTS[name]))[:count]
    for device in devices:
        kinds = FAULTS[name][str(device)]
        kind, value = kinds[int(rng.integers(len(kinds)))]
        if np.isnan(value):
            value = float(rng.choice([-2.0, -1.0, -0.5, -0.1, 0.05, 0.1, 0.3]))
        start_s = float(rng.choice([0.5, rng.uniform(2.0, 15.0)], p=[0.2, 0.8]))
        fault = {"kind": kind, "device": str(device), "value": value, "start_s": start_s}
        lasts = kind in ("stuck", "wrong", "delayed") and device != "arm_phase" and rng.random() < 0.5
        if not lasts:
            fault["end_s"] = start_s + float(rng.uniform(SHORTEST_S, LONGEST_S if kind in ("stuck", "wrong") else 0.8))
        faults.append(fault)
    if not healthy and rng.random() < 0.4:
        overrides["body"] = {
            body: {"as_built_factor": float(1.0 + 0.03 * rng.normal()), "com_mm": (com + rng.normal(size=3)).tolist()}
            for body, com in (("arm", np.array([39.75, 1.41, 5.0])), ("tip_mass", np.array([0.0, -13.91, 0.0])))
        }
    return Drawn(seed, name, faults, overrides)


def fly(seed: int, vehicle: str | None = None, healthy: bool = False) -> Outcome:
    """Fly a seed's flight."""
    drawn = draw(seed, vehicle, healthy)
    scenario = load(drawn.vehicle, {"sequence": MISSION, "fault": drawn.faults, **drawn.overrides})
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process(scenario, seed)
        with world:
            path = Path(directory) / "flight.mcap"
            flown = hil.fly_simulated(config.load(config.packaged(drawn.vehicle)), world, urls, path)
        result = table.result(flown)
    told = [*result["masses"], *result["centres"], *result["inertias"]]
    wrong = [
        f"{row['quantity']} {100.0 * (row['value'] / row['truth'] - 1.0):+.1f} %"
        for row in told
        if row["supported"] and abs(row["value"] - row["truth"]) > WIDER * (row["high"] - row["value"])
    ]
    events = " ".join(result["events"])
    return Outcome(
        drawn,
        tuple(wrong),
        all(row["supported"] for row in result["masses"]),
        any(row["standing"].startswith("do not use") for row in told),
        all(fault["device"] in events for fault in drawn.faults),
    )


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole}" + (f" ({100.0 * part / whole:.1f} %)" if whole else "")


def main() -> int:
    """Print what went wrong as it comes, then the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--vehicle", choices=list(FAULTS))
    parser.add_argument("--healthy", action="store_true", help="no fault, all as drawn")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.flights)
    done: list[Outcome] = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for one in pool.map(partial(fly, vehicle=arguments.vehicle, healthy=arguments.healthy), seeds):
            done.append(one)
            if one.nonsense:
                kind = "leans on calibration" if one.drawn.invisible else "NONSENSE"
                print(f"{kind}: {one.drawn.text}: {', '.join(one.nonsense)}", flush=True)
            elif arguments.healthy and (one.refused or not one.answered):
                print(f"no answer: {one.drawn.text}", flush=True)
    nonsense = [one for one in done if one.nonsense and not one.drawn.invisible]
    invisible = [one for one in done if one.drawn.invisible]
    harmless = [one for one in done if one.drawn.faults and {f["kind"] for f in one.drawn.faults} <= HARMLESS]
    beside = [
        one
        for one in done
        if len(one.drawn.faults) == 1
        and one.drawn.faults[0]["device"] in REDUNDANT.get(one.drawn.vehicle, set())
        and one.drawn.faults[0]["kind"] in ("stuck", "wrong")
    ]
    healthy = [one for one in done if not one.drawn.faults and not one.drawn.overrides]
    print(f"confident nonsense: {_share(len(nonsense), len(done) - len(invisible))}")
    print(f"invisible to every instrument: {len(invisible)}, wrong in {sum(bool(one.nonsense) for one in invisible)}")
    print(f"harmless faults answered: {_share(sum(one.answered for one in harmless), len(harmless))}")
    print(f"healthy flights with an answer not to be used: {_share(sum(o.refused for o in healthy), len(healthy))}")
    print(f"faulty redundant instrument named: {_share(sum(one.named for one in beside), len(beside))}")
    return int(bool(nonsense))


if __name__ == "__main__":
    sys.exit(main())
