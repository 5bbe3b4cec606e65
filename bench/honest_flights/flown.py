"""Flies a seed's flight for the plans ``bench/plans/honesty.toml`` and ``bench/plans/scoreboard.toml``."""

import tempfile
from pathlib import Path
from typing import Any

from bench.honest_flights import recorded
from bench.honest_flights.classes import of_class
from bench.honest_flights.drawn import MISSIONS, Drawn, draw
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import config
from onboard.flight import hil
from onboard.ground.campaign import instants
from onboard.ground.campaign.results import FlightResult, of_mission
from onboard.ground.identify.mission import mission_table
from onboard.recording.reader import LogReader


def flight(seed: int, settings: dict[str, Any]) -> FlightResult:
    """What came of a seed's flight; ``settings``: ``class``, else ``vehicle`` (drawn otherwise) and ``healthy``."""
    without = ""
    if "class" in settings:
        drawn, without = of_class(settings["class"], seed)
    else:
        drawn = draw(seed, settings.get("vehicle"), settings.get("healthy", False))
    found = recorded.run(drawn) if drawn.vehicle == "planar" else _simulated(drawn, without)
    return found._replace(faults=drawn.texts, unseen=drawn.invisible, what=drawn.vehicle)


def _simulated(drawn: Drawn, without: str) -> FlightResult:
    """Through drivers, clocks and estimator, in virtual time."""
    scenario = scenario_of(drawn.vehicle, {**MISSIONS[drawn.vehicle], "fault": drawn.faults, **drawn.overrides})
    vehicle = _without(config.load(config.packaged(drawn.vehicle)), without)
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process(scenario, drawn.seed)
        with world:
            flown = hil.fly_simulated(vehicle, world, urls, Path(directory) / "flight.mcap")
        log = LogReader(flown.log, kept=True)
        found = of_mission(mission_table.result(flown, log=log))
        return found.with_instants(instants.of_flight(log, vehicle, flown.truth))


def _without(vehicle: config.Vehicle, device: str) -> config.Vehicle:
    """The vehicle as its file would be without a device."""
    if not device:
        return vehicle
    devices = {name: table for name, table in vehicle.tree["device"].items() if name != device}
    return config.parse_tree(vehicle.tree | {"device": devices}, vehicle.path, config.Origin(f"without {device}"))
