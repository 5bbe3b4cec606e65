"""Finds every emulator: in the modules of ``hil_sim.devices`` and its rooms, and by entry points of other packages.

A package that is installed beside heft names its emulators in its ``pyproject.toml``, by their kind::

    [project.entry-points."heft.emulators"]
    wind_vane = "vanes.emulator:WindVaneTable"
"""

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import Literal, get_args, get_origin

from pydantic import ValidationError

from hil_sim import devices
from hil_sim.devices.emulator import Emulator
from hil_sim.scenario.bus_tables import DeviceTable
from hil_sim.scenario.tables import BadTable, Files, ScenarioError

GROUP = "heft.emulators"


def kind_of(table: object) -> str | None:
    """The kind that a class is the table of; None: it is something else, or a base."""
    if not (isinstance(table, type) and issubclass(table, Emulator)):
        return None
    said = table.model_fields["kind"].annotation
    return str(get_args(said)[0]) if get_origin(said) is Literal else None


def _packaged() -> Iterator[tuple[str, type[Emulator]]]:
    for found in pkgutil.walk_packages(devices.__path__, f"{devices.__name__}."):
        if not found.ispkg and found.name != __name__:
            module = importlib.import_module(found.name)
            for table in vars(module).values():
                kind = kind_of(table)
                if kind is not None and table.__module__ == module.__name__:
                    yield kind, table


_PACKAGED = dict(sorted(_packaged()))


def emulator(kind: str) -> type[Emulator]:
    """The table of a kind; one of another package is imported now.

    Raises:
        ScenarioError: unknown kind, or its package cannot be used.
    """
    if kind in _PACKAGED:
        return _PACKAGED[kind]
    elsewhere = {point.name: point for point in metadata.entry_points(group=GROUP)}
    if kind not in elsewhere:
        raise ScenarioError(f"no device is a {kind!r}; there are: {', '.join([*_PACKAGED, *sorted(elsewhere)])}")
    point = elsewhere[kind]
    try:
        table = point.load()
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise ScenarioError(f"kind {kind!r} is {point.value}, which cannot be imported ({why}); correct it") from error
    if kind_of(table) != kind:
        raise ScenarioError(
            f'kind {kind!r} is {point.value}, which is no Emulator with kind: Literal["{kind}"]; correct it'
        )
    found: type[Emulator] = table
    return found


def for_vehicle(kind: str) -> type[Emulator]:
    """The emulator of a kind of device in a vehicle file.

    Raises:
        ScenarioError: none has it, or its package cannot be used.
    """
    for table in _PACKAGED.values():
        if table.vehicle_kind == kind:
            return table
    return emulator(kind)


def read(tables: Mapping[str, DeviceTable], files: Files = ()) -> dict[str, Emulator]:
    """Each device's table, of these files, read by the emulator of its kind.

    Raises:
        ScenarioError: naming each wrong key by its dotted path.
    """
    found: dict[str, Emulator] = {}
    problems, refused, unknown = [], [], False
    for name, table in tables.items():
        try:
            model, given = emulator(table.kind), table.model_dump()
            found[name] = model.model_validate(given)
        except ScenarioError as error:
            problems.append(f"device.{name}: {error}")
            unknown = True
        except ValidationError as error:
            problems += [f"device.{name}.{'.'.join(map(str, e['loc'])) or 'table'}: {e['msg']}" for e in error.errors()]
            refused.append(BadTable(error, model, given, ("device", name)))
    if problems:
        told = () if unknown else tuple(refused)
        raise ScenarioError(f"{'; '.join(problems)}. Correct these keys", told, files=files)
    return found
