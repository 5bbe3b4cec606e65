"""Missions flown in virtual time for tests: a scenario, perhaps changed, and what came of it."""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from hil_sim.scenario.load import Scenario
from onboard import config
from onboard.flight import hil
from onboard.ground.identify.mission import mission_table as table
from onboard.recording.reader import LogReader


def sweep(strokes: int, transfer_s: float) -> dict[str, Any]:
    """An entry of RockSat's sequence: strokes of the arm in phase 4, and the way back."""
    of_each = {"amplitude": {"joint_1": 0.2007}, "stroke_s": 0.6, "pause_s": 0.05}
    return {"phase": 4, "action": "strokes", "strokes": strokes, "transfer_s": transfer_s, **of_each}


SHORT = [  # of RockSat: 16 s in which all three masses are found
    {"phase": 0, "action": "hold", "duration_s": 4.0},
    sweep(6, 0.6),
    {"phase": 0, "action": "hold", "duration_s": 0.5},
    {"phase": 5, "action": "hold", "duration_s": 1.5},
    sweep(6, 0.6),
    {"phase": 9, "action": "hold", "duration_s": 0.5},
]
BRIEF = [*SHORT[:1], sweep(3, 0.6), SHORT[-1]]  # 8 s with the tip mass, which determine next to nothing
# 9 s in which all three are found too, less exactly
SHORTER = [SHORT[0] | {"duration_s": 2.0}, sweep(3, 0.5), SHORT[3] | {"duration_s": 0.5}, sweep(3, 0.5), SHORT[5]]
CATCH_SEED = 14
CATCH: dict[str, Any] = {  # of DYMAFLEX: 13.5 s
    "sequence": [
        {"phase": 0, "action": "hold", "duration_s": 1.0},
        {
            "phase": 1,
            "action": "swing",
            "duration_s": 12.0,
            "ramp_s": 1.5,
            "swing": 0.274,
            "tones": 3,
            "band_Hz": [0.1, 0.6],
        },
        {"phase": 9, "action": "hold", "duration_s": 0.5},
    ],
    "capture": {"earliest_s": 4.0, "latest_s": 5.0},
}
SHORT_REAL = [*SHORT[:-1], SHORT[-1] | {"duration_s": 2.0}]  # on a busy computer too a flight ends before its devices


class Result(NamedTuple):
    """A flown mission."""

    path: Path
    flown: hil.Flown
    table: dict[str, Any]

    @property
    def log(self) -> LogReader:
        return _read(self.path, self.path.stat().st_mtime_ns)

    def mass(self, quantity: str) -> dict[str, Any]:
        return next(row for row in self.table["masses"] if row["quantity"] == quantity)

    def events(self, code: str) -> list[str]:
        rows = [row for _, rows in self.log.batches() if "severity" in (rows.dtype.names or ()) for row in rows]
        return [f"{r['source'].decode()}: {r['text'].decode()}" for r in rows if r["code"].decode() == code]


@lru_cache(maxsize=4)
def _read(path: Path, changed_ns: int) -> LogReader:
    """One reader of a log as it stands, for all tests: it is decoded once."""
    return LogReader(path, kept=True)


def fly(
    path: Path, seed: int = 3, scenario: Scenario | None = None, vehicle: str = "rocksat", **overrides: Any
) -> Result:
    """Fly a packaged vehicle's mission; ``overrides`` change tables of its scenario."""
    world, urls = open_in_process(scenario or scenario_of(vehicle, overrides or None), seed)
    with world:
        flown = hil.fly_simulated(config.load(config.packaged(vehicle)), world, urls, path)
    return Result(path, flown, table.result(flown))


def inline(step: dict[str, object]) -> str:
    """A TOML inline table."""
    told = {key: inline(value) if isinstance(value, dict) else json.dumps(value) for key, value in step.items()}
    return "{" + ", ".join(f"{key} = {value}" for key, value in told.items()) + "}"
