"""What a worker does with an item: flies it, identifies its log, or calls its function, and brings back the result.

The world is made by a function that the command line hands over: nothing here knows the simulator.
"""

import gc
import importlib
import json
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import tomli_w

from onboard import config
from onboard.flight import hil
from onboard.ground.campaign import instants, results
from onboard.ground.campaign.design import Item
from onboard.ground.campaign.results import FlightResult, Returned
from onboard.ground.campaign.revision import revision
from onboard.ground.campaign.scratch import scratch
from onboard.ground.identify.identify import identify
from onboard.ground.identify.mission import mission_table, own_mission
from onboard.ground.log.tables import truth
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.recording.reader import LogReader

MOST_BYTES = 64 << 20  # of a log that is brought back whole; of a longer one the last quarter of it
MOST_CHECKED = 4  # worlds made before any is flown, beside those with faults that no other has
_ONE_AT_A_TIME = threading.Lock()  # the simulated buses are the process's, not the thread's


class OtherCodeError(ValueError):
    """A worker has another version of heft."""


World = Any  # hil.World, and a context manager
MakeWorld = Callable[[str, Path | None, int, Sequence[str]], tuple[World, Mapping[str, str]]]


def done(item: Item, expected: str, make_world: MakeWorld) -> Returned:
    """Do what ``item`` says. A program that fails is a result too.

    Args:
        item: what to do.
        expected: revision of the code.
        make_world: of a mission's name or path, a scenario file over it, seed and faults: the world and its URLs.

    Raises:
        OtherCodeError: the code here is of another revision.
    """
    own = revision(item.call)
    if own != expected:
        raise OtherCodeError(
            f"its heft is of revision {own}, and this heft of {expected}; NumPy, SciPy, Pinocchio and MuJoCo count too"
        )
    with _ONE_AT_A_TIME, scratch() as directory:
        log = directory / "flight.mcap"
        try:
            result = _result(item, log, make_world)
        except Exception:  # noqa: BLE001 - whatever fails in a flight is kept with the campaign, which goes on
            return Returned(None, traceback.format_exc(), {} if item.keep == "none" else _files(log))
        finally:
            gc.collect()  # a world refers to itself: the arrays of seventy flights, 2.7 GB, waited for a collection
        stays = item.keep == "all" or (item.keep == "wrong" and result.nonsense)
        return Returned(result, kept=_files(log) if stays else {})


def _result(item: Item, log: Path, make_world: MakeWorld) -> FlightResult:
    if item.call:
        module, _, function = item.call.partition(":")
        return cast("FlightResult", getattr(importlib.import_module(module), function)(item.seed, item.settings))
    if item.log:
        return _identified(item, log.parent)
    mission, over = _laid_out(item, log.parent)
    vehicle = _with(config.named(mission), item)
    world, urls = make_world(mission, over, item.seed, item.faults)
    with world:
        flown = hil.fly_simulated(vehicle, world, urls, log)
    truth.write(flown.log, own_mission.with_quantities(vehicle, flown.truth))
    read = LogReader(flown.log, kept=1.0)
    result = results.of_mission(mission_table.result(flown, log=read))
    return result.with_instants(instants.of_flight(read, vehicle, flown.truth))


def check(items: Iterable[Item], make_world: MakeWorld) -> None:
    """Make the world of the first flights, at most ``MOST_CHECKED``, and look for every kind of fault in it.

    Raises:
        ValueError: what a mission cannot be, or a fault that it cannot have.
    """
    possible: dict[str, set[str]] = {}  # kinds of faults, with their devices, by mission
    made = set[str]()
    for item in items:
        key = json.dumps([item.mission, item.scenario], sort_keys=True, default=str)
        new = set(results.kinds(item.faults)) - possible.get(item.mission, set())
        if not item.mission or item.log or not (new or (key not in made and len(made) < MOST_CHECKED)):
            continue
        made.add(key)
        with tempfile.TemporaryDirectory() as directory:
            mission, over = _laid_out(item, Path(directory))
            try:
                world, _ = make_world(mission, over, item.seed, item.faults)
            except ValueError as error:
                raise ValueError(f"{item.text}: {error}".replace(f"{directory}/", "")) from error
            with world:
                can = world.possible_faults().items()
                possible[item.mission] = {f"{kind} {device}" for device, kinds in can for kind in kinds}


def _laid_out(item: Item, directory: Path) -> tuple[str, Path | None]:
    """The files of an item written; its mission by name or path, and the scenario file that lies over it."""
    for name, text in item.files.items():
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    over = directory / "scenario.toml"
    if item.scenario:
        over.write_text(tomli_w.dumps(item.scenario), encoding="utf-8")
    mission = str(directory / item.mission) if item.mission in item.files else item.mission
    return mission, over if item.scenario else None


def _identified(item: Item, directory: Path) -> FlightResult:
    reader = LogReader(Path(item.log))
    vehicle = config.named(_laid_out(item, directory)[0]) if item.mission else vehicle_of(reader, directory)
    (found,) = identify(_with(vehicle, item), [reader.path]).logs
    return results.of_log(found, truth.read(reader.path))


def _with(vehicle: config.Vehicle, item: Item) -> config.Vehicle:
    """The vehicle with the settings of the item."""
    if not item.vehicle:
        return vehicle
    return config.parse_tree(config.laid_over(vehicle.tree, item.vehicle), vehicle.path, config.Origin("the plan"))


def _files(log: Path) -> dict[str, bytes]:
    """A flight's log, as far as there is one, and its truth."""
    kept: dict[str, bytes] = {}
    for path, end in ((log, ".mcap"), (truth.beside(log), ".mcap.truth.json")):
        if path.exists():
            with path.open("rb") as file:
                if path.stat().st_size > MOST_BYTES:
                    file.seek(-MOST_BYTES // 4, 2)
                kept[end] = file.read()
    return kept
