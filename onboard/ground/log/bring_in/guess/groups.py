"""Columns of a recording, grouped by what they are: the angles of all joints, the three axes of a gyro."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.ground.log.bring_in.guess import joint_names, names
from onboard.ground.log.bring_in.guess.clock import TimeColumn, clock, refused
from onboard.ground.log.bring_in.guess.names import Name
from onboard.ground.log.bring_in.mapping import NS_PER
from onboard.ground.log.bring_in.messages import TIMES
from onboard.ground.log.bring_in.text_rows import Values

_WIDEST = 64  # columns of an array
_OF_ONE = 0.02  # of a quaternion's length
_BESIDE = {"frame", "seq", "sequence", "index", "count", "counter", "iteration", "n", "k", "unnamed", "id", "row"}


class NumberColumn(NamedTuple):
    """A column of numbers."""

    name: str  # as a mapping calls it
    values: Values  # (n,)
    of: Name


class Group(NamedTuple):
    """Columns of a kind."""

    kind: str
    stem: tuple[str, ...]
    unit: str  # that is named
    columns: Mapping[str, NumberColumn]  # by label: x, y, z, w, a number, a joint's name, or ""
    commanded: bool
    doubt: str = ""  # of what it is

    @property
    def values(self) -> NDArray[np.float64]:
        """(n, columns), in the order of the labels."""
        return np.column_stack([self.columns[label].values for label in self.labels]).astype(np.float64)

    @property
    def labels(self) -> list[str]:
        """In their order."""
        order = {label: k for k, label in enumerate("wxyz")}
        return sorted(self.columns, key=lambda one: (order.get(one, 9), int(one) if one.isdigit() else 0))

    @property
    def called(self) -> list[str]:
        """The columns' names, in the order of the labels."""
        return [self.columns[label].name for label in self.labels]


class ColumnGroup(NamedTuple):
    """Columns with one clock: a file of text, a topic, arrays of a length."""

    name: str
    groups: tuple[Group, ...]
    clock: TimeColumn | None
    rest: tuple[NumberColumn, ...]  # of no kind that is known
    taken_for_time: str = ""  # why, where no name says it
    no_clock: str = ""  # why a column that is a time by its name is none, where there is no other

    @property
    def columns(self) -> list[NumberColumn]:
        """All but the clock."""
        return [*self.rest, *(column for group in self.groups for column in group.columns.values())]

    def without(self, name: str) -> "ColumnGroup":
        """Without a column, and the group that it is of."""
        groups = tuple(group for group in self.groups if name not in group.called)
        return self._replace(groups=groups, rest=tuple(column for column in self.rest if column.name != name))


def tables(
    kind: str, columns: Mapping[str, Values], units: Mapping[str, str], joints: Sequence[str]
) -> list[ColumnGroup]:
    """Tables of a recording; ``units``: by column, of a line of units; ``joints``: of the vehicle, by their angles."""
    apart: dict[str, list[NumberColumn]] = {}
    for name, values in columns.items():
        if not values.ndim:
            continue
        table = (
            name.rpartition(":")[0] if kind in ("bag", "mcap", "ulog") else "" if kind == "csv" else str(len(values))
        )
        for own, one in _flat(name, values):
            plain = _undoubled(own, columns)
            apart.setdefault(table, []).append(NumberColumn(own, one, names.parsed(plain or own, units.get(own, ""))))
    return [_table(name, kind, some, joints) for name, some in apart.items() if len(some[0].values) > 1]


def best(groups: Sequence[Group], kind: str) -> Group | None:
    """The group of a kind that was measured, by its words, its columns and its place."""
    some = [group for group in groups if group.kind == kind]
    return max(some, key=lambda one: (bool(set(one.stem) & set(names.MEASURED)), len(one.columns)), default=None)


def _flat(name: str, values: Values) -> list[tuple[str, Values]]:
    if values.dtype.kind not in "iufb" or values.ndim > 2:
        return []
    if values.ndim < 2:
        return [(name, values)] if values.ndim else []
    return [(f"{name}[{k}]", values[:, k]) for k in range(values.shape[1])] if values.shape[1] <= _WIDEST else []


def _table(name: str, kind: str, columns: list[NumberColumn], joints: Sequence[str]) -> ColumnGroup:
    usable = [one for one in columns if np.isfinite(one.values).any()]
    clocks = [one for one in usable if names.is_time(one.of)]
    if kind in ("bag", "mcap", "ulog"):
        clocks = [one for wanted in TIMES for one in usable if one.name.rpartition(":")[2] == wanted]
    found = None
    taken = ""
    for one in clocks:
        named = {"bag": "ns", "mcap": "ns", "ulog": "us"}.get(kind, one.of.unit or names.known_unit(one.name))
        if (found := clock(one.name, one.values, named)) is not None and _goes_on(one.values):
            break
        found = None
    lost = next((refused(one.name, one.values) for one in clocks if found is None and _goes_on(one.values)), "")
    if found is None and not lost and kind in ("csv", "npz", "mat", "json"):
        for one in usable:
            if not set(one.of.stem) & _BESIDE and _rises(one.values):
                found = clock(one.name, one.values, one.of.unit)
                unnamed = found is not None and one.of.unit not in NS_PER
                taken = "it rises from row to row; no name says that it is a time" if unnamed else ""
                break
    used = {one.name for one in clocks} | ({found.column} if found else set())
    groups, rest = _groups([one for one in usable if one.name not in used], joints)
    rest += [one for one in columns if not np.isfinite(one.values).any()]
    return ColumnGroup(name, tuple(groups), found, tuple(rest), taken, lost)


def _goes_on(values: Values) -> bool:
    return bool(np.ptp(values[np.isfinite(values)].astype(np.float64)) > 0.0)


def _rises(values: Values) -> bool:
    return len(values) > 10 and bool((np.diff(values) > 0).all()) and bool(values[0] >= 0)


def _groups(columns: list[NumberColumn], joints: Sequence[str]) -> tuple[list[Group], list[NumberColumn]]:
    together: dict[tuple[tuple[str, ...], str], dict[str, NumberColumn]] = {}
    doubts: dict[tuple[tuple[str, ...], str], str] = {}
    rest: list[NumberColumn] = []
    labelled = joint_names.labelled([one.of for one in columns], joints)
    for one in [one._replace(of=of) for one, of in zip(columns, labelled, strict=True)]:
        place = one.of.stem, one.of.unit
        own = together.setdefault(place, {})
        if one.of.label not in own:
            own[one.of.label] = one
            continue
        rest.append(one)
        if not np.array_equal(own[one.of.label].values, one.values, equal_nan=one.values.dtype.kind == "f"):
            doubts[place] = f"{own[one.of.label].name!r} could be {one.name!r} as well, which differs"
    groups, stems = list[Group](), {stem for stem, _ in together}
    for (stem, unit), found in together.items():
        kind = names.kind_of(Name(stem, "", unit), frozenset(found))
        if kind == "angle" and set(found) == set("0123") and _is_attitude(found):
            kind = "quaternion"
        if kind == "angle" and stem[-1:] == ("a",) and len(found) < 3:
            kind = ""
        if stem == ("t",) and kind == "moment" and ("r",) in stems:  # of motion capture: RX, RY, RZ, TX, TY, TZ
            kind = "position"
        doubt = doubts.get((stem, unit), "")
        if not kind and (kind := names.by_unit(Name(stem, "", unit), frozenset(found))):
            doubt = doubt or f"its unit, {unit}, is all that says what it is"
        if kind:
            groups.append(Group(kind, stem, unit, found, names.commanded(stem), doubt))
        else:
            rest += found.values()
    return groups, rest


def _undoubled(name: str, known: Mapping[str, Values]) -> str:
    """The name as it stands in the file, where it stands there more than once; "" where it does not."""
    numbered = re.fullmatch(r"(.*?) ?\((\d+)\)", name)
    twice = numbered is not None and {f"{numbered[1]} (1)".strip(), f"{numbered[1]} (2)".strip()} <= set(known)
    return numbered[1] if twice and numbered is not None else ""


def _is_attitude(found: Mapping[str, NumberColumn]) -> bool:
    values = np.column_stack([found[label].values for label in "0123"]).astype(np.float64)
    return bool(np.nanmax(np.abs(np.linalg.norm(values, axis=1) - 1.0), initial=0.0) < _OF_ONE)
