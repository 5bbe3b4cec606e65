"""Reads vehicle.toml into frozen objects; an unknown key is refused with its line and a remedy."""

import difflib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from onboard.config.checks import check, check_devices
from onboard.config.errors import ConfigError, Origin
from onboard.config.explain import explained
from onboard.config.text import read, tree_of
from onboard.config.vehicle import BROKEN_BASES, Vehicle, VehicleFile
from onboard.devices.registry import BROKEN

File = TypeVar("File", bound=BaseModel)


_PACKAGED = Path(__file__).parents[1] / "vehicles"


def packaged(name: str) -> Path:
    """Path of a vehicle that comes with heft."""
    return _PACKAGED / name / "vehicle.toml"


def named(name: str | Path, urdf: Path | None = None) -> Vehicle:
    """A vehicle by the path of its file, or by the name of a packaged one.

    Raises:
        ConfigError: there is none of that name, or see :func:`load`.
    """
    if str(name).endswith(".toml"):
        return load(Path(name), urdf)
    if str(name).endswith(".urdf"):
        raise ConfigError(f"{name} is a URDF, not a vehicle file; heft init --urdf {name} DIRECTORY makes one of it")
    path = packaged(str(name))
    if not path.exists():
        known = sorted(file.parent.name for file in _PACKAGED.glob("*/vehicle.toml"))
        near = difflib.get_close_matches(str(name), known, 1)
        meant = f"did you mean {near[0]!r}? Others: " if near else "there are "
        others = ", ".join(one for one in known if one not in near)
        raise ConfigError(
            f"no packaged vehicle {str(name)!r}; {meant}{others}; for your vehicle give a path to its vehicle.toml"
        )
    return load(path, urdf)


def load(path: Path, urdf: Path | None = None) -> Vehicle:
    """Read and check a vehicle file.

    Args:
        path: of the file.
        urdf: another than it names.

    Raises:
        ConfigError: no such file, not TOML, an unknown key, a wrong value, or an undefined name.
    """
    return parse(read(path), path, urdf)


def parse(text: str, path: Path, urdf: Path | None = None) -> Vehicle:
    """As :func:`load`, for a text already read (from a log, say)."""
    return parse_tree(tree_of(text, str(path)), path, Origin(str(path), text), urdf)


def with_mission(vehicle: Vehicle, until: str | None, segments: Path | None) -> Vehicle:
    """A vehicle with another goal, or another file of segments, in its text too, which its log carries.

    Raises:
        ConfigError: it is no goal, or there are no segments.
    """
    if until is None and segments is None:
        return vehicle
    path = segments or vehicle.segments_path
    if path is None:
        raise ConfigError(f"{vehicle.label}: --until needs --segments FILE, which heft plan --segments writes")
    import tomlkit  # noqa: PLC0415  (not with what every flight starts with)

    document = tomlkit.parse(vehicle.text)
    document.setdefault("mission", tomlkit.table())
    document["mission"]["segments"] = path.name
    if until is not None:
        document["mission"]["until"] = until
    made = parse(tomlkit.dumps(document), vehicle.path, vehicle.urdf)
    return made.model_copy(
        update={"own_segments": path.absolute(), "arm": vehicle.arm, "own_motion": vehicle.own_motion}
    )


def parse_tree(tree: dict[str, Any], path: Path, origin: Origin, urdf: Path | None = None) -> Vehicle:
    """As :func:`load`, for tables that are read already, and stand for the file at ``path``.

    Messages begin with the label of ``origin``, and name lines where it has a text.
    """
    _refuse_broken(origin, tree)
    file = validated(VehicleFile, tree, origin)
    vehicle = Vehicle.model_construct(path=path, origin=origin, tree=tree, file=file, urdf=urdf)
    check(vehicle)
    return vehicle


def devices_alone(text: str, label: str) -> Vehicle:
    """Buses and devices without a vehicle around them, as they are tried on a desk.

    Args:
        text: their tables.
        label: what messages call it.

    Raises:
        ConfigError: as :func:`load`.
    """
    tree = tree_of(text, label) | {"vehicle": {"name": "desk", "urdf": "none", "base": "fixed", "base_link": "desk"}}
    origin = Origin(label, text)
    file = validated(VehicleFile, tree, origin)
    vehicle = Vehicle.model_construct(path=Path(), origin=origin, tree=tree, file=file, urdf=None)
    check_devices(vehicle)
    return vehicle


def validated(model: type[File], tree: dict[str, Any], origin: Origin) -> File:
    """Tables as an object of ``model``.

    Raises:
        ConfigError: an unknown key or a wrong value, with its line and a remedy.
    """
    try:
        file = model.model_validate(tree)
    except ValidationError as error:
        raise ConfigError("\n".join(explained(error, tree, model, [origin]))) from error
    for where, why in _coerced(tree, file, []):
        raise ConfigError(f"{origin.place(where)}: {'.'.join(where)!r}: {why}")
    return file


def _refuse_broken(origin: Origin, tree: dict[str, Any]) -> None:
    """A device or base of a kind that another package claims, and that cannot be used, is refused with the reason."""
    base = tree["vehicle"].get("base") if isinstance(tree.get("vehicle"), dict) else None
    if isinstance(base, str) and base in BROKEN_BASES:
        raise ConfigError(f"{origin.place(['vehicle', 'base'])}: base {base!r}: {BROKEN_BASES[base]}")
    devices = tree.get("device")
    for name, table in devices.items() if isinstance(devices, dict) else ():
        kind = table.get("kind") if isinstance(table, dict) else None
        if isinstance(kind, str) and kind in BROKEN:
            place = origin.place(["device", name, "kind"])
            raise ConfigError(f"{place}: 'device.{name}': kind {kind!r}: {BROKEN[kind]}")


def _coerced(given: Any, read: Any, where: list[str]) -> Iterator[tuple[list[str], str]]:
    """Values that were taken for a number and are written as none: ``true`` would be 1, ``"5"`` would be 5."""
    if isinstance(given, dict):
        for key, value in given.items():
            part = read.get(key) if isinstance(read, dict) else getattr(read, key, None)
            yield from _coerced(value, part, [*where, key])
    elif isinstance(given, list) and isinstance(read, list | tuple):
        for number, (value, part) in enumerate(zip(given, read, strict=False)):
            yield from _coerced(value, part, [*where, str(number)])
    elif isinstance(given, bool | str) and isinstance(read, int | float) and type(given) is not type(read):
        yield where, f"a number is wanted here (given: {json.dumps(given)}); write it without quotes"
