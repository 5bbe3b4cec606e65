"""Reads scenario TOML into frozen objects; units are in the keys, unknown keys are refused.

The schema: ``tables`` has the common tables, ``vehicle_tables`` and ``part_tables`` those of what moves,
``sensor_tables`` and ``bus_tables`` the rest; the keys of a device are read by its emulator where a mission is made.
The drawing that a file names is a packaged vehicle's, or lies beside it. The TOML file gives the source of each number
beside it. A scenario may be ``based_on`` another: its tables override those of the other, but the wiring (``bus``,
``device``, ``clock``) is taken from one of the two as a whole.
"""

import tomllib
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hil_sim.scenario import bed
from hil_sim.scenario.tables import BadTable, Files, ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario

__all__ = ["Scenario", "ScenarioError", "load", "merged", "names", "parse"]

_WIRING = {"bus", "device", "clock"}


def names() -> tuple[str, ...]:
    """Names of the packaged scenarios, sorted."""
    folder = resources.files("hil_sim.scenario") / "packaged"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def load(name_or_path: str | Path, overrides: Mapping[str, Any] | None = None, over: Files = ()) -> Scenario:
    """Read a packaged scenario by name, or any TOML file by path (it ends in ``.toml``).

    Args:
        name_or_path: ``"rocksat"``, or a path.
        overrides: nested tables laid over the file's, e.g. ``{"as_built": {"tip_mass": {"mass_factor": 0.9}}}``.
        over: the file that these were read from, to be named where they are wrong.

    Raises:
        ScenarioError: no such scenario, not TOML, or a key that is unknown, missing, or out of range.
    """
    label, table, files = _read(name_or_path)
    label = " with ".join([label, *(path for path, _ in over)])
    return parse(merged(table, overrides or {}), label, (*files, *over))


def _read(name_or_path: str | Path, above: tuple[str, ...] = ()) -> tuple[str, dict[str, Any], Files]:
    """Label of a file, its tables merged over those of its base, and the texts of both."""
    if str(name_or_path).endswith(".toml"):
        label = str(name_or_path)
        source: Traversable = Path(name_or_path)
    else:
        label = f"packaged scenario {name_or_path}"
        source = resources.files("hil_sim.scenario") / "packaged" / f"{name_or_path}.toml"
    try:
        text = source.read_text(encoding="utf-8")
        table = tomllib.loads(text)
    except FileNotFoundError as error:
        raise ScenarioError(f"{label} does not exist; packaged scenarios are {', '.join(names())}") from error
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{label} is not TOML: {error}; correct the file") from error
    _take_drawing(table, source, label)
    base = table.get("scenario", {}).get("based_on")
    if base is None:
        return label, table, ((label, text),)
    if label in above:
        raise ScenarioError(f"{label} is based on itself; take a based_on out")
    _, below, files = _read(str(base), (*above, label))
    kept = {key: value for key, value in below.items() if key not in _WIRING & table.keys()}
    return label, merged(kept, table), (*files, (label, text))


def _take_drawing(table: dict[str, Any], file: Traversable, label: str) -> None:
    """The text of the drawing that a file names: beside it, or of a packaged vehicle."""
    said = table.get("vehicle")
    if not isinstance(said, dict) or "urdf" not in said:
        return
    name = str(said["urdf"])
    beside = Path(str(file)).parent / name
    path = beside if beside.is_file() else bed.VEHICLES / name
    try:
        table["vehicle"] = {"label": path.name, **said, "urdf": path.read_text(encoding="utf-8")}
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{label}: vehicle.urdf cannot be read ({error}); put it beside the file") from error


def parse(table: Mapping[str, Any], label: str = "scenario", files: Files = ()) -> Scenario:
    """Check a table, made of these files, against the schema.

    Raises:
        ScenarioError: naming each wrong key by its dotted path.
    """
    try:
        return Scenario.model_validate(table).of(files)
    except ValidationError as error:
        problems = "; ".join(f"{'.'.join(map(str, e['loc'])) or 'file'}: {e['msg']}" for e in error.errors())
        raise ScenarioError(
            f"{label} cannot be used: {problems}. Correct these keys",
            (BadTable(error, Scenario, dict(table)),),
            label,
            files,
        ) from error


def merged(table: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Tables with others laid over them, key by key."""
    out = dict(table)
    for key, value in overrides.items():
        below = out.get(key)
        out[key] = merged(below, value) if isinstance(below, dict) and isinstance(value, Mapping) else value
    return out
