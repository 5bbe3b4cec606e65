"""Flies a scenario file with a vehicle file through the unmodified app, as ``heft hil`` does: result as JSON."""

import json
import sys
from pathlib import Path

from hil_sim.mission import open_in_process
from onboard import config
from onboard.flight import hil
from onboard.ground.identify.mission import mission_table

scenario, vehicle, log = sys.argv[1:]
world, urls = open_in_process(scenario, 3)
with world:
    flown = hil.fly_simulated(config.load(Path(vehicle)), world, urls, Path(log))
result = mission_table.result(flown)
sys.stdout.write(
    json.dumps({**{key: result[key] for key in ("accounted", "channels")}, "start_ns": flown.truth["start_ns"]})
)
