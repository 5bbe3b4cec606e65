"""Flies a seed's flight for the plan ``bench/plans/honesty.toml``."""

import tempfile
from pathlib import Path
from typing import Any

from bench.honest_flights import recorded
from bench.honest_flights.drawn import MISSIONS, Drawn, draw
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import config
from onboard.flight import hil
from onboard.offline.campaign.results import FlightResult, of_mission
from onboard.offline.views import mission_table


def flight(seed: int, settings: dict[str, Any]) -> FlightResult:
    """What came of a seed's flight; ``settings``: ``vehicle``, of a share of all otherwise, and ``healthy``."""
    drawn = draw(seed, settings.get("vehicle"), settings.get("healthy", False))
    found = recorded.run(drawn) if drawn.vehicle == "planar" else _simulated(drawn)
    return found._replace(faults=drawn.texts, unseen=drawn.invisible, what=drawn.vehicle)


def _simulated(drawn: Drawn) -> FlightResult:
    """Through drivers, clocks and estimator, in virtual time."""
    scenario = scenario_of(drawn.vehicle, {**MISSIONS[drawn.vehicle], "fault": drawn.faults, **drawn.overrides})
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process(scenario, drawn.seed)
        with world:
            path = Path(directory) / "flight.mcap"
            flown = hil.fly_simulated(config.load(config.packaged(drawn.vehicle)), world, urls, path)
        return of_mission(mission_table.result(flown))
