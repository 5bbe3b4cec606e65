"""Flies a drawn flight; what came of it, as plain values for a line of JSON."""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench.honest_flights import recorded
from bench.honest_flights.drawn import CAPTURE_MISSION, MISSION, ROCKETS, Drawn, Outcome
from hil_sim.mission import open_in_process
from hil_sim.scenario.load import load
from onboard import config
from onboard.flight import hil
from onboard.offline.views import mission_table as table

WIDER = 3.2905 / 1.9600  # a 99.9 % interval, of a 95 % one


def fly(drawn: Drawn) -> dict[str, Any]:
    """One flight's line: what was drawn and what came of it."""
    begun_s = time.process_time()
    outcome = recorded.run(drawn) if drawn.vehicle in ("workshop", "planar") else _simulated(drawn)
    return {
        "seed": drawn.seed,
        "vehicle": drawn.vehicle,
        "faults": drawn.faults,
        "model_errors": drawn.model_errors,
        "invisible": drawn.invisible,
        "nonsense": [_told(answer) for answer in outcome.answers if is_nonsense(answer)],
        "answered": all(a["supported"] for a in outcome.answers if a["quantity"] in outcome.needed),
        "refused": any(a["standing"].startswith("do not use") for a in outcome.answers),
        "named": all(fault["device"] in " ".join(outcome.events) for fault in drawn.faults),
        "leans": sorted({a["leans"] for a in outcome.answers if a.get("leans")}),
        "covered": [sum(a["low"] <= a["truth"] <= a["high"] for a in _shown(outcome)), len(_shown(outcome))],
        "standings": {a["quantity"]: a["standing"] for a in outcome.answers},
        "events": outcome.events[:12],
        "cpu_s": round(time.process_time() - begun_s, 1),
    }


def is_nonsense(answer: dict[str, Any]) -> bool:
    """Whether it is supported while the truth lies beyond its 99.9 % interval."""
    if not answer["supported"]:
        return False
    return bool(abs(answer["value"] - answer["truth"]) > WIDER * (answer["high"] - answer["value"]))


def _shown(outcome: Outcome) -> list[dict[str, Any]]:
    return [answer for answer in outcome.answers if answer["supported"]]


def _told(answer: dict[str, Any]) -> str:
    half = answer["high"] - answer["value"]
    off = answer["value"] - answer["truth"]
    part = f"{100.0 * off / answer['truth']:+.1f} %" if answer["truth"] else f"{off:+.3g}"
    return f"{answer['quantity']} {part}, {abs(off) / half:.1f} half-widths"


def _simulated(drawn: Drawn) -> Outcome:
    """Through drivers, clocks and estimator, in virtual time."""
    mission: dict[str, Any] = {"sequence": MISSION} if drawn.vehicle in ROCKETS else CAPTURE_MISSION
    scenario = load(drawn.vehicle, {**mission, "fault": drawn.faults, **drawn.overrides})
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process(scenario, drawn.seed)
        with world:
            path = Path(directory) / "flight.mcap"
            flown = hil.fly_simulated(config.load(config.packaged(drawn.vehicle)), world, urls, path)
        result = table.result(flown)
    answers = [{"value": np.nan, **row} for row in (*result["masses"], *result["centres"], *result["inertias"])]
    needed = tuple(row["quantity"] for row in result["masses"])
    return Outcome(answers, result["events"], needed)
