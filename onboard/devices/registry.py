"""Finds every kind of device: in the modules of ``onboard.devices``, and by entry points of other packages.

A package that is installed beside heft names its kinds in its ``pyproject.toml``, by the kind's name::

    [project.entry-points."heft.devices"]
    wind_vane = "vanes.device:WindVaneDevice"

Unusable kinds of other packages are kept in ``BROKEN`` with the reason: a vehicle with such a device is refused with
it; others are not affected.
"""

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Iterator
from importlib import metadata
from typing import Any, Literal, get_args, get_origin

from onboard import devices
from onboard.devices.base import DeviceSection

GROUP = "heft.devices"


def kind_of(section: object) -> str | None:
    """The kind that a class is the table of; None: it is something else, or a base."""
    if not (isinstance(section, type) and issubclass(section, DeviceSection)):
        return None
    said = section.model_fields["kind"].annotation
    return str(get_args(said)[0]) if get_origin(said) is Literal else None


def _packaged() -> Iterator[tuple[str, type[DeviceSection]]]:
    for found in pkgutil.walk_packages(devices.__path__, f"{devices.__name__}."):
        if found.name != __name__:
            module = importlib.import_module(found.name)
            for section in vars(module).values():
                kind = kind_of(section)
                if kind is not None and section.__module__ == module.__name__:
                    yield kind, section


def from_elsewhere(
    points: Iterable[metadata.EntryPoint],
    taken: Iterable[str],
    named: Callable[[object], str | None] = kind_of,
    needed: str = "DeviceSection with kind: Literal",
) -> tuple[dict[str, Any], dict[str, str]]:
    """Kinds by entry points, and by kind why one cannot be used.

    Args:
        points: of one group.
        taken: names of the kinds that there are already.
        named: name of the kind that a point's object is; None: it is something else.
        needed: what the object has to be, in words.
    """
    found: dict[str, Any] = {}
    broken: dict[str, str] = {}
    for point in points:
        source = f"{point.value} of {point.dist.name if point.dist else 'an unknown package'}"
        if point.name in {*taken, *found}:
            broken[point.name] = f"{source} has the name of a kind that there is already: rename it or uninstall it"
            continue
        try:
            section = point.load()
        except Exception as error:  # noqa: BLE001 - whatever another package's import does
            broken[point.name] = f"{source} cannot be imported ({type(error).__name__}: {error}): mend or uninstall it"
            continue
        if named(section) != point.name:
            broken[point.name] = f'{source} is no {needed}["{point.name}"]: mend it'
            continue
        found[point.name] = section
    return found, broken


_PACKAGED = dict(sorted(_packaged()))
_ELSEWHERE, BROKEN = from_elsewhere(metadata.entry_points(group=GROUP), _PACKAGED)
DEVICES: dict[str, type[DeviceSection]] = {**_PACKAGED, **_ELSEWHERE}
