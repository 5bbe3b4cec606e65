"""From a recording to a proposed mapping: what each column is, its unit, the clock; doubts are said where they are."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from onboard.ground.log.bring_in import foreign, text_rows
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.guess import blocks, gains, magnitudes, sniff, text
from onboard.ground.log.bring_in.guess.body import BodyChannels, of_a_body
from onboard.ground.log.bring_in.guess.body import by_place as by_place_of_a_body
from onboard.ground.log.bring_in.guess.clock import TimeColumn, said
from onboard.ground.log.bring_in.guess.groups import ColumnGroup, Group, best, tables
from onboard.ground.log.bring_in.guess.magnitudes import Unit
from onboard.ground.log.bring_in.guess.wheels import WheelChannels, of_wheels
from onboard.ground.log.bring_in.mapping import Csv
from onboard.ground.log.bring_in.messages import read_messages
from onboard.ground.log.bring_in.text_rows import Recording, Values

MOST_ROWS = 200_000  # that are looked at
_RATE_Hz = 100.0  # where nothing says when
_SCALARS = {  # by kind: units that are known, the usual one, names of the channels by label
    "force": (("N",), "N", "force_{}"),
    "moment": (("N m", "N mm"), "N m", "moment_{}"),
    "position": (("m", "mm"), "m", "position_{}"),
    "quaternion": (("1",), "1", "attitude_{}"),
    "load_cell": (("N", "N m", "N mm"), "N", "{}"),
    "torque": (("N m", "N mm", "N"), "N m", "{}_torque"),
    "current": (("A", "mA"), "A", "{}_torque"),
}
_MOST_SEEN = 20  # columns, in a message
_AGREED = "as angles and their rates agree"


class Names(NamedTuple):
    """Channels of a vehicle file, in the order of its devices; empty: none is at hand."""

    imus: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()
    torques: tuple[str, ...] = ()
    gains: tuple[tuple[float, float], ...] = ()  # N m in an A and relative sigma of each, where read as currents
    body: BodyChannels = BodyChannels()
    wheels: WheelChannels = WheelChannels()


class Proposal(NamedTuple):
    """A mapping, and what a person should look at."""

    text: str
    doubts: tuple[str, ...]
    channels: tuple[str, ...]


def propose(path: Path, vehicle: Names) -> Proposal:
    """Look at a recording and write a mapping for it.

    Args:
        path: CSV, MAT, NPZ, JSON, a ROS bag, MCAP or ULog.
        vehicle: channels to name the columns by.

    Raises:
        SourceError: it cannot be read, or holds nothing that is known.
        OSError: likewise.
    """
    kind = sniff.kind_of(path)
    layout = sniff.layout_of(path) if kind == "csv" else None
    columns, truncated, ragged = _read(path, kind, layout)
    units = {}
    if layout is not None and len(layout.units) == len(columns):
        units = dict(zip(columns, layout.units, strict=True))
    made = _Maker(vehicle)
    some = tables(kind, columns, units, vehicle.angles)
    numbered = layout is not None and not layout.csv.header
    by_place = [by_place_of_a_body(one, vehicle.body) for one in some] if numbered else []
    if numbered:
        some = [own or blocks.recognised(one, len(vehicle.angles)) for own, one in zip(by_place, some, strict=True)]
    main = max(some, key=lambda one: sum(len(g.columns) for g in one.groups), default=None)
    if main is None:
        raise SourceError(f"{path} has no columns of two numbers or more")
    if main.no_clock:
        raise SourceError(f"{path}: {main.no_clock}")
    for one in (main, *(other for other in some if other is not main)):
        made.add(one, main)
    if not made.parts:
        raise SourceError(
            f"{path}: {_unknown(main, len(vehicle.angles), numbered=numbered)}; or write a mapping by docs/import.md"
        )
    notes = [truncated] if truncated else []
    notes += layout.notes if layout is not None else ()
    notes += [f"{_of(one)}{said(made.clocks[one.name])}" for one in some if one.name in made.clocks]
    if any(by_place):
        notes.append(
            "doubtful: columns without names are taken by their places: x, y, yaw, and the thrusters in their order"
        )
    if lacking := [name for name in vehicle.imus if name not in made.names]:
        needs = "gyro and accelerometer are needed of each; an attitude stands for neither"
        notes.append(
            f"doubtful: no such columns, and heft identify refuses a log without: {', '.join(lacking)}; {needs}"
        )
    bad = _bad(some, ragged, made.of_vehicle)
    head = text.head(re.sub(r"\W+", "_", path.stem) or "recording", path.name, kind, bad, layout and layout.csv, notes)
    whole = head + _time(main, made) + "".join(made.parts) + text.not_taken(made.others)
    return Proposal(whole, tuple(re.findall(r"^# doubtful: (.*)$", whole, re.MULTILINE)), tuple(made.names))


def _unknown(one: ColumnGroup, vehicle_joints: int, *, numbered: bool) -> str:
    """That no column is known, what is seen of each, and what would help."""
    told = [column for column in one.rest if np.isfinite(column.values).any()]
    seen = [f"{each.name!r:.40} {np.nanmin(each.values):.4g} to {np.nanmax(each.values):.4g}" for each in told]
    clock = f"{one.clock.column!r:.40} rises as times do; " if one.clock is not None else ""
    more = f" and {len(seen) - _MOST_SEEN} more" if len(seen) > _MOST_SEEN else ""
    helps = f"; the vehicle file has {vehicle_joints} joints: their angles, or angles and torques, would be known"
    if not vehicle_joints:
        helps = "; with --vehicle columns are taken by their places: the angles of its joints, then the torques"
    seen_text = f"{clock}{', '.join(seen[:_MOST_SEEN])}{more}"
    return f"no name or number says what its columns are ({seen_text}){helps if numbered else ''}"


def _of(one: ColumnGroup) -> str:
    return f"{one.name}: " if one.name and not one.name.isdigit() else ""


def _read(path: Path, kind: sniff.Kind, layout: sniff.Layout | None) -> Recording:
    if layout is not None:
        return text_rows.read_csv(path, layout.csv, skip=True, most_rows=MOST_ROWS)
    if kind in ("bag", "mcap", "ulog"):
        return read_messages(path, kind, None, MOST_ROWS)
    return foreign.read(path, Csv(), kind)


def _bad(some: Sequence[ColumnGroup], ragged: int, of_vehicle: Sequence[tuple[str, Values]]) -> str:
    """What has to be skipped, in words; "" of nothing."""
    said_of = [f"{ragged} rows have another number of cells"] if ragged else []
    for one in some:
        taken = [group.values for group in one.groups]
        taken += [np.asarray(values, np.float64)[:, None] for name, values in of_vehicle if name == one.name]
        rows = ~np.isfinite(np.hstack(taken)).all(axis=1) if taken else np.zeros(0, np.bool_)
        late = np.isnan(one.clock.seconds) if one.clock is not None else np.zeros(0, np.bool_)
        for count, why in ((rows.sum(), "a cell that is no number"), (late.sum(), "a time that does not rise")):
            if count:
                said_of.append(f"{_of(one)}{count} rows have {why}")
    return "; ".join(said_of)


def _time(main: ColumnGroup, made: "_Maker") -> str:
    if main.clock is None:
        key = text.Key(
            f"rate_Hz = {_RATE_Hz:g}", "there is no column of times: write the rate of the samples, or column and unit"
        )
        return "\n[time]\n" + key.lines
    own = made.clocks[main.name]
    doubt = "; ".join(one for one in (main.taken_for_time, own.doubt) if one and own.why != _AGREED)
    return (
        f"\n[time]\ncolumn = {text.quoted(own.column)}\n"
        + text.Key(f"unit = {text.quoted(own.unit)}", doubt, own.why).lines
        + "".join(text.Key(key, "", why).lines for key, why in _of_count(own))
    )


def _of_count(own: TimeColumn) -> list[tuple[str, str]]:
    """Keys of a column that is no rising count from 0 on, and why."""
    wraps = [(f"wraps = {own.wraps}", "it starts at 0 again")] if own.wraps else []
    return wraps + ([(f"offset = {own.offset:g}", "it begins before 0")] if own.offset else [])


class _Maker:
    """Channels, one after the other."""

    def __init__(self, vehicle: Names) -> None:
        self.parts: list[str] = []
        self.names: list[str] = []
        self.of_vehicle: list[tuple[str, Values]] = []  # table and numbers of columns that go to its channels
        self.others: list[tuple[str, str]] = []  # columns that are not taken, and why
        self.clocks: dict[str, TimeColumn] = {}  # by table, with the unit that rates and angles agree on
        self._vehicle = vehicle
        self._taken: set[str] = set()  # kinds of which there is one
        self._imus = 0

    def add(self, one: ColumnGroup, main: ColumnGroup) -> None:
        """What a table holds."""
        groups = [group for group in one.groups if not group.commanded]
        angles = best(groups, "angle")
        rates = best(groups, "rate")
        units = self._agreed(one, angles, rates)
        time = ""
        if one is not main and one.clock is not None:
            own = self.clocks[one.name]
            keys = [f"column = {text.quoted(own.column)}", f"unit = {text.quoted(own.unit)}"]
            time = f"time = {{ {', '.join([*keys, *(key for key, _ in _of_count(own))])} }}\n"
        if one is not main and one.clock is None:
            self._leave([name for group in one.groups for name in group.called], "no column of times goes with it")
            return
        of_vehicle = (*of_a_body(one, self._vehicle.body, time), *of_wheels(one.columns, self._vehicle.wheels, time))
        for name, column, part in of_vehicle:
            self.names.append(name)
            self.parts.append(part)
            self.of_vehicle.append((one.name, column.values))
            one = one.without(column.name)
        groups = [group for group in one.groups if not group.commanded]
        quaternion = best(groups, "quaternion")
        done = list(self._imu(one, groups, quaternion, time))
        for kind in ("angle", "torque", "current", "wrench", "force", "moment", "load_cell", "quaternion", "position"):
            group = best(groups, kind)
            if (
                group is None
                or (kind in self._taken and kind != "load_cell")
                or (kind == "current" and "torque" in self._taken)
            ):
                continue
            self._taken.add(kind)
            done.append(group)
            by_controller = ""
            if kind == "current" or (kind == "torque" and not group.unit):
                by_controller = gains.doubt(gains.controllers(one, group, rates), self._vehicle.gains)
            self._scalars(kind, group, units.get(kind), time, by_controller)
        self._rest(one, done)

    def _rest(self, one: ColumnGroup, done: Sequence[Group]) -> None:
        for group in one.groups:
            if any(group is other for other in done):
                continue
            why = "commanded or computed, not measured" if group.commanded else ""
            why = why or {
                "rate": "rates are made of the angles",
                "acceleration": "accelerations are made of the angles",
                "accel": "an IMU has rates of turn too",
                "gyro": "an IMU has accelerations too",
            }.get(group.kind, f"another {group.kind} is taken")
            self._leave(group.called, why)
        self._leave([column.name for column in one.rest], "no name that is known, or no number")

    def _leave(self, names: Sequence[str], why: str) -> None:
        self.others += [(name, why) for name in names]

    def _agreed(self, one: ColumnGroup, angles: Group | None, rates: Group | None) -> dict[str, Unit]:
        """Units of the angles, by their rates where there are any; the clock's unit with them."""
        if one.clock is None:
            return {} if angles is None else {"angle": magnitudes.of_angles(angles.values, angles.unit)}
        self.clocks[one.name] = own = one.clock
        if angles is None:
            return {}
        unit = magnitudes.of_angles(angles.values, angles.unit)
        if rates is None or len(rates.columns) != len(angles.columns) or unit.counts != 1.0:
            return {"angle": unit}
        rate = magnitudes.of_rates(rates.values, rates.unit, unit)
        ratio = magnitudes.slope(magnitudes.going_on(angles.values), rates.values, own.seconds)
        if ratio is None:
            return {"angle": unit}
        known = (unit.name, unit.why), (rate.name, rate.why), (own.unit, own.why)
        fixed = [name for name, why in known if "name" in why]
        best = magnitudes.agreed(ratio, unit.name, rate.name, own.unit, fixed)
        if best is None:
            odd = f"the angles change {ratio:.3g} times as fast as {rates.called[0]!r} and those beside it say"
            return {"angle": unit._replace(doubt=unit.doubt or odd)}
        self.clocks[one.name] = own.in_unit(best[2], own.why if "name" in own.why else _AGREED)
        return {"angle": Unit(best[0], "as the rates agree" if "name" not in unit.why else unit.why)}

    def _imu(self, one: ColumnGroup, groups: Sequence[Group], quaternion: Group | None, time: str) -> Iterator[Group]:
        """Gyros with the accelerometers beside them."""
        gyros = [group for group in groups if group.kind == "gyro"]
        accels = [group for group in groups if group.kind == "accel"]
        for gyro, accel in zip(gyros, accels, strict=False):
            named = self._vehicle.imus[self._imus : self._imus + 1]
            self._imus += 1
            name = named[0] if named else "imu_base" if self._imus == 1 else f"imu_{self._imus}"
            self.names.append(name)
            turns = None
            if quaternion is not None and one.clock is not None:
                turns = magnitudes.turned(quaternion.values, gyro.values, one.clock.seconds)
            force = magnitudes.of_accelerations(accel.values, accel.unit).beside(accel.doubt)
            rate = magnitudes.of_rates_of_turn(gyro.values, gyro.unit, turns, force.name).beside(gyro.doubt)
            self.parts.append(
                f'\n[channel.{name}]\nrecord = "imu"\n{time}'
                + text.vector(f"channel.{name}.accel", accel.called, accel.values, force)
                + text.vector(f"channel.{name}.gyro", gyro.called, gyro.values, rate)
            )
            yield from (gyro, accel)

    def _scalars(self, kind: str, group: Group, unit: Unit | None, time: str, further: str) -> None:
        known, usual, pattern = _SCALARS.get(kind, (("rad", "deg"), "rad", "{}"))
        for k, label in enumerate(group.labels):
            column = group.columns[label]
            values = np.asarray(column.values, np.float64)[:, None]
            own_kind, own_label = kind, label
            if kind == "wrench":
                own_kind, own_label = ("force", "moment")[k // 3], "xyz"[k % 3]
                known, usual, pattern = _SCALARS[own_kind]
            own = unit or magnitudes.of_others(own_kind, values, group.unit, known, usual)
            if kind == "torque" and self._vehicle.gains and not group.unit:
                own = Unit("A", "as the vehicle file has gain_N_m_A")
            name = self._name(own_kind, own_label, k, group, pattern)
            first = k == 0
            own = own._replace(doubt=own.doubt if first else "")
            settled = kind == "torque" and self._vehicle.gains
            doubts = ("" if settled else group.doubt, further) if first else ()
            doubt = "; ".join(one for one in doubts if one)
            turn = magnitudes.turn_of(values[:, 0]) if kind == "angle" else 0.0
            self.parts.append(text.scalar(name, column.name, values, own, time, doubt, turn))
            self.names.append(name)

    def _name(self, kind: str, label: str, k: int, group: Group, pattern: str) -> str:
        """Of a channel: a joint's by the vehicle, by its own name, or by its number from 1."""
        torques = self._vehicle.torques
        given = {"angle": self._vehicle.angles, "torque": torques, "current": torques}.get(kind)
        if given and len(given) == len(group.columns):
            same = [[one for one in given if each in one.lower()] for each in group.labels]
            each_once = all(len(one) == 1 for one in same) and len({one[0] for one in same}) == len(given)
            return same[k][0] if each_once and not label.isdigit() else given[k]
        if kind in ("angle", "torque", "current"):
            joint = f"joint_{k + 1}" if label.isdigit() or not label else re.sub(r"\W+", "_", label)
            return pattern.format(joint)
        name = pattern.format(label if kind != "load_cell" else "load_cell" + (f"_{label}" if label else ""))
        while name in self.names:
            name += "_2"
        return name
