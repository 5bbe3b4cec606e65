"""vehicle.toml to frozen objects. A key nobody knows is refused with its line and a remedy."""

import difflib
import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from onboard.config.checks import check
from onboard.config.devices import CHANNELS, DEVICES
from onboard.config.errors import ConfigError, line_of
from onboard.config.estimation import Carried, Estimation, Gates, Masses, Memory, Phases, Prior, Zero
from onboard.config.free_body import Carrier, FreeBody, Load
from onboard.config.planar import Planar, Puck
from onboard.config.vehicle import Bus, Recording, Vehicle, VehicleFile, VehicleSection


def packaged(name: str) -> Path:
    """Path of a vehicle that comes with heft."""
    return Path(__file__).parents[1] / "vehicles" / name / "vehicle.toml"


def load(path: Path) -> Vehicle:
    """Read and check a vehicle file.

    Raises:
        ConfigError: no such file, no TOML, an unknown key, a wrong value, or a name that points nowhere.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give the path of a vehicle.toml") from error
    return parse(text, path)


def parse(text: str, path: Path) -> Vehicle:
    """As :func:`load`, for a text that is at hand already (from a log, say)."""
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error
    try:
        file = VehicleFile.model_validate(tree)
    except ValidationError as error:
        raise ConfigError("\n".join(_explain(path, text, tree, dict(one)) for one in error.errors())) from error
    vehicle = Vehicle(path=path, text=text, file=file)
    check(vehicle)
    return vehicle


def _explain(path: Path, text: str, tree: dict[str, Any], error: dict[str, Any]) -> str:
    where = [str(part) for part in error["loc"]]
    # a discriminated union puts the kind into the location: of a device, of a node's channel
    if where[:1] == ["device"] and len(where) > 2:
        del where[2]
        if where[2:3] == ["channel"] and len(where) > 4:
            del where[4]
    line = line_of(text, where)
    name = ".".join(where)
    if error["type"] == "extra_forbidden":
        known = _known_keys(where[:-1], tree)
        near = difflib.get_close_matches(where[-1], known, 1, 0.5)
        remedy = f"did you mean {near[0]!r}? Units stand in the key" if near else f"known here: {', '.join(known)}"
        return f"{path}:{line}: unknown key {name!r}; {remedy}"
    if error["type"] == "missing":
        return f"{path}:{line}: {name!r} is missing; add it"
    return f"{path}:{line}: {name!r}: {error['msg']} (found {error['input']!r})"


def _known_keys(where: list[str], tree: dict[str, Any]) -> list[str]:
    if not where:
        return list(VehicleFile.model_fields)
    if where[0] == "device":
        table = tree["device"][where[1]]
        if len(where) == 2:
            return list(DEVICES[table["kind"]].model_fields)
        return list(CHANNELS[table["channel"][int(where[3])]["role"]].model_fields)
    models: dict[str, type[BaseModel]] = {
        "vehicle": VehicleSection,
        "bus": Bus,
        "estimation": Estimation,
        "phases": Phases,
        "gates": Gates,
        "zero": Zero,
        "prior": Prior,
        "masses": Masses,
        "memory": Memory,
        "carried": Carried,
        "free_body": FreeBody,
        "carrier": Carrier,
        "load": Load,
        "planar": Planar,
        "puck": Puck,
        "recording": Recording,
    }
    tables = [part for part in where if not part.isdigit()]  # an array of tables counts them
    section = models.get(tables[-1]) or models.get(tables[0])
    return list(section.model_fields) if section else []
