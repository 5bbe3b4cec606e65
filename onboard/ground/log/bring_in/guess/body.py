"""A body on a table: the columns of its thrusters and of its tracked pose, by the channels of a vehicle file."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from onboard.ground.log.bring_in.guess import heading, magnitudes, names, text
from onboard.ground.log.bring_in.guess.groups import ColumnGroup, Group, NumberColumn, best
from onboard.ground.log.bring_in.guess.magnitudes import Unit

_LARGEST_LEVEL, _PER_CENT = 1.5, 100.0  # of a level that is 1 when it is on; of one in per cent
_YAWS = ("yaw", "theta", "psi", "heading", "th", "phi")
_POSITIONS = ("", "pos", "position", "pose", "p")


class BodyChannels(NamedTuple):
    """Of a vehicle file: its thrusters, whether these were commanded by times, and its tracker's pose."""

    thrusters: tuple[str, ...] = ()
    on_time: bool = False
    pose: str = ""


def of_a_body(table: ColumnGroup, wanted: BodyChannels, time: str) -> Iterator[tuple[str, NumberColumn, str]]:
    """Channel, column and table of the mapping of each that is found.

    Thrusters are columns that are called like them, or as many columns as there are, numbered, of which none is
    commanded below 0 or above 1, or 100 (by times: below 0). The pose is x, y and yaw, without more in the name than
    that they are a position, or a position and a quaternion.
    """
    columns = table.columns
    thrusters = _thrusters(columns, wanted)
    full = max((float(np.nanmax(one.values, initial=0.0)) for one in thrusters.values()), default=1.0)
    for name, one in thrusters.items():
        largest = float(np.nanmax(one.values, initial=0.0))
        unit = Unit("%", f"up to {full:.4g}") if full > _LARGEST_LEVEL else Unit("1", "on is 1")
        if wanted.on_time:
            unit = Unit(one.of.unit, "by its name") if one.of.unit in ("s", "ms") else Unit("s", "as is usual")
            unit = unit if largest < 100.0 or one.of.unit else Unit("ms", f"up to {largest:.4g}")
        yield name, one, text.scalar(name, one.name, _values(one), unit, time)
    if not wanted.pose:
        return
    named = {_called(one): one for one in reversed(columns)}
    yaw = next((named[word] for word in _YAWS if word in named), None)
    attitude = best(table.groups, "quaternion") if yaw is None else None
    up = "z"
    if attitude is not None:
        order = _w_first(attitude)
        up, name = magnitudes.vertical_of(attitude.values[:, order]), f"{wanted.pose}_yaw"
        called = [attitude.called[k] for k in order]
        yield name, attitude.columns[attitude.labels[0]], text.yaw(name, called, up, time)
    place = best(table.groups, "position")
    way: list[magnitudes.FloatArray] = []
    for axis, recorded in (("x", "x"), ("y", "z" if up == "y" else "y")):
        found = next((named[f"{word}{recorded}"] for word in _POSITIONS if f"{word}{recorded}" in named), None)
        found = found or (place.columns.get(recorded) if place is not None else None)
        if found is not None:
            unit = magnitudes.of_others("position", _values(found), found.of.unit, ("m", "mm"), "m")
            name, sign = f"{wanted.pose}_{axis}", "-" if recorded == "z" else "+"
            way.append(_values(found))
            yield name, found, text.scalar(name, found.name, _values(found), unit, time, sign=sign)
    if yaw is not None:
        unit, name = magnitudes.of_angles(_values(yaw), yaw.of.unit), f"{wanted.pose}_yaw"
        turn = magnitudes.turn_of(_values(yaw)[:, 0])
        if 0.0 < turn <= 360.0 and not yaw.of.unit:
            unit = Unit("deg" if turn == 360.0 else "rad", f"it starts again after {turn:.4g}")
        elif not yaw.of.unit and thrusters and len(way) == 2 and table.clock is not None and not wanted.on_time:
            levels = np.hstack([_values(one) for one in thrusters.values()])
            by_way = heading.unit_of(table.clock.seconds, np.hstack(way), _values(yaw)[:, 0], levels)
            unit = Unit(by_way, "so it goes where its thrusters push it") if by_way else unit
        yield name, yaw, text.scalar(name, yaw.name, _values(yaw), unit, time, "", turn)


def by_place(table: ColumnGroup, wanted: BodyChannels) -> ColumnGroup | None:
    """A table whose columns are numbered, named as a body's: x, y, yaw and its thrusters, or these first; else None."""
    columns = sorted(table.columns, key=lambda one: int(one.name))
    count = len(wanted.thrusters)
    if not wanted.pose or not count or len(columns) != count + 3:
        return None
    limit = np.inf if wanted.on_time else _PER_CENT
    commanded = [bool(np.nanmin(_values(one)) >= 0.0 and np.nanmax(_values(one)) <= limit) for one in columns]
    pose = ("x", "y", "yaw")
    if all(commanded[3:]):
        called = (*pose, *wanted.thrusters)
    elif all(commanded[:count]):
        called = (*wanted.thrusters, *pose)
    else:
        return None
    named = (one._replace(of=names.Name((_plain(name),), "", "")) for one, name in zip(columns, called, strict=True))
    return table._replace(groups=(), rest=tuple(named))


def _w_first(attitude: Group) -> list[int]:
    """Its columns, w first. Where they are numbered: of what turns about an axis w is one of the two that are large."""
    large = np.argsort(np.nanmean(attitude.values**2, axis=0))[-2:]
    return [0, 1, 2, 3] if "w" in attitude.columns or 0 in large else [3, 0, 1, 2]


def _thrusters(columns: Sequence[NumberColumn], wanted: BodyChannels) -> dict[str, NumberColumn]:
    by_name = {_called(one): one for one in reversed(columns)}
    own = {name: by_name[_plain(name)] for name in wanted.thrusters if _plain(name) in by_name}
    if wanted.thrusters and len(own) == len(wanted.thrusters):
        return own
    limit = np.inf if wanted.on_time else _PER_CENT
    stems = dict.fromkeys(one.of.stem for one in columns if one.of.label.isdigit())
    for stem in stems:
        some = [one for one in columns if one.of.stem == stem and one.of.label.isdigit()]
        levels = all(np.nanmin(_values(one)) >= 0.0 and np.nanmax(_values(one)) <= limit for one in some)
        if levels and len(some) == len(wanted.thrusters):
            return dict(zip(wanted.thrusters, sorted(some, key=lambda one: int(one.of.label)), strict=True))
    return {}


def _values(one: NumberColumn) -> magnitudes.FloatArray:
    return np.asarray(one.values, np.float64)[:, None]


def _called(one: NumberColumn) -> str:
    return "".join((*one.of.stem, one.of.label))


def _plain(name: str) -> str:
    return "".join(part for part in name.lower() if part.isalnum())
