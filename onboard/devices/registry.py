"""Finds every kind of device: in the modules of ``onboard.devices``, and by entry points of other packages.

A package that is installed beside heft names its kinds in its ``pyproject.toml``, by the kind's name::

    [project.entry-points."heft.devices"]
    wind_vane = "vanes.device:WindVaneDevice"

A module is imported when a kind of it is asked for: it is named like the kind, or as the kind begins.
Unusable kinds of other packages are kept in ``BROKEN`` with the reason: a vehicle with such a device is refused with
it; others are not affected.
"""

import importlib
import pkgutil
from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
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


class _Packaged(Mapping[str, type[DeviceSection]]):
    """The kinds in the modules of ``onboard.devices``."""

    @cached_property
    def _modules(self) -> list[str]:
        found = pkgutil.walk_packages(devices.__path__, f"{devices.__name__}.")
        return [one.name for one in found if one.name != __name__]

    @cached_property
    def _every(self) -> dict[str, type[DeviceSection]]:
        return dict(sorted(pair for module in self._modules for pair in _in_module(module)))

    def __getitem__(self, kind: str) -> type[DeviceSection]:
        if "_every" not in vars(self):
            for module in self._modules:
                name = module.rpartition(".")[2]
                if f"{kind}_".startswith(f"{name}_") and kind in (found := dict(_in_module(module))):
                    return found[kind]
        return self._every[kind]

    def __iter__(self) -> Iterator[str]:
        return iter(self._every)

    def __len__(self) -> int:
        return len(self._every)


def _in_module(name: str) -> Iterator[tuple[str, type[DeviceSection]]]:
    for section in vars(importlib.import_module(name)).values():
        kind = kind_of(section)
        if kind is not None and section.__module__ == name:
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


_PACKAGED = _Packaged()
_ELSEWHERE, BROKEN = from_elsewhere(metadata.entry_points(group=GROUP), _PACKAGED)
DEVICES: Mapping[str, type[DeviceSection]] = ChainMap(_ELSEWHERE, _PACKAGED)  # type: ignore[arg-type]  # none is added
