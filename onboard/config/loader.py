"""Reads vehicle.toml into frozen objects; an unknown key is refused with its line and a remedy."""

import difflib
import json
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import AliasChoices, BaseModel, ValidationError
from pydantic.fields import FieldInfo

from onboard.config.checks import check
from onboard.config.errors import ConfigError, Origin
from onboard.config.text import read, tree_of
from onboard.config.vehicle import Vehicle, VehicleFile
from onboard.devices.registry import BROKEN

UNIONS = (Union, UnionType)
File = TypeVar("File", bound=BaseModel)


def packaged(name: str) -> Path:
    """Path of a vehicle that comes with heft."""
    return Path(__file__).parents[1] / "vehicles" / name / "vehicle.toml"


def named(name: str | Path, urdf: Path | None = None) -> Vehicle:
    """A vehicle by the path of its file, or by the name of a packaged one.

    Raises:
        ConfigError: there is none of that name, or see :func:`load`.
    """
    if str(name).endswith(".toml"):
        return load(Path(name), urdf)
    path = packaged(str(name))
    if not path.exists():
        known = sorted(file.parent.name for file in path.parents[1].glob("*/vehicle.toml"))
        near = difflib.get_close_matches(str(name), known, 1)
        meant = f"did you mean {near[0]!r}? Others: " if near else "there are "
        others = ", ".join(one for one in known if one not in near)
        raise ConfigError(
            f"no packaged vehicle {str(name)!r}; {meant}{others}; one of your own is a path to a vehicle.toml"
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
    vehicle = Vehicle(path=path, origin=origin, tree=tree, file=file, urdf=urdf)
    check(vehicle)
    return vehicle


def validated(model: type[File], tree: dict[str, Any], origin: Origin) -> File:
    """Tables as an object of ``model``.

    Raises:
        ConfigError: an unknown key or a wrong value, with its line and a remedy.
    """
    try:
        file = model.model_validate(tree)
    except ValidationError as error:
        raise ConfigError("\n".join(_explain(origin, tree, dict(one), model) for one in error.errors())) from error
    for where, why in _coerced(tree, file, []):
        raise ConfigError(f"{origin.place(where)}: {'.'.join(where)!r}: {why}")
    return file


def _refuse_broken(origin: Origin, tree: dict[str, Any]) -> None:
    """A device of a kind that another package claims, and that cannot be used, is refused with the reason."""
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
        yield where, f"a number is wanted here (found {json.dumps(given)}); write it without quotes"


def _explain(origin: Origin, tree: dict[str, Any], error: dict[str, Any], model: type[BaseModel]) -> str:
    where = _place([str(part) for part in error["loc"]], tree)
    place, name = origin.place(where), ".".join(where)
    if error["type"] == "extra_forbidden":
        known = list(_model_at(where[:-1], tree, model).model_fields)
        near = difflib.get_close_matches(where[-1], known, 1, 0.5)
        remedy = f"did you mean {near[0]!r}? Units are in the key" if near else f"known here: {', '.join(known)}"
        return f"{place}: unknown key {name!r}; {remedy}"
    if error["type"] == "missing":
        return f"{place}: {name!r} is missing; add it"
    return f"{place}: {name!r}: {error['msg']} (found {error['input']!r})"


def _place(loc: list[str], tree: dict[str, Any]) -> list[str]:
    """The path of a key in the file; pydantic adds the kind of a table to ``loc``."""
    where: list[str] = []
    node: Any = tree
    for part in loc[:-1]:
        if isinstance(node, dict) and part in node:
            node = node[part]
        elif isinstance(node, list) and part.isdigit():
            node = node[int(part)]
        else:
            continue
        where.append(part)
    return [*where, *loc[-1:]]


def _model_at(where: list[str], tree: dict[str, Any], model: type[BaseModel]) -> type[BaseModel]:
    """The class that reads the table at ``where``, where ``model`` reads the whole."""
    said: Any = model  # of the value that is looked at
    node: Any = tree
    for part in where:
        said = _field(model, part).annotation if said is model else _of_items(said)
        node = node[int(part)] if isinstance(node, list) else node[part]
        found = _model_of(said, node)
        if found is not None:
            said = model = found
    return model


def _field(model: type[BaseModel], key: str) -> FieldInfo:
    """The field that reads ``key``, by its name or by one that older files have for it."""
    for field in model.model_fields.values():
        if isinstance(field.validation_alias, AliasChoices) and key in field.validation_alias.choices:
            return field
    return model.model_fields[key]


def _of_items(annotation: Any) -> Any:
    """What an annotation says of the values of a dict, the items of a tuple."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    for one in get_args(annotation) if get_origin(annotation) in UNIONS else [annotation]:
        if get_origin(one) is dict:
            return get_args(one)[1]
        if get_origin(one) in (tuple, list):
            return get_args(one)[0]
    return Any


def _model_of(annotation: Any, value: Any) -> type[BaseModel] | None:
    """The class in an annotation that reads a table: of several, the one whose literals (a kind) the table has."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        literals = {
            k: get_args(f.annotation) for k, f in annotation.model_fields.items() if get_origin(f.annotation) is Literal
        }
        fits = isinstance(value, dict) and all(value[k] in said for k, said in literals.items() if k in value)
        return annotation if fits else None
    if get_origin(annotation) is Annotated or get_origin(annotation) in UNIONS:
        found = (_model_of(one, value) for one in get_args(annotation))
        return next((model for model in found if model is not None), None)
    return None
