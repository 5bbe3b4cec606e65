"""Speeds of wheels, and the column that says what is being done, by the channels of a vehicle file."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from onboard.ground.log.bring_in.guess import magnitudes, text
from onboard.ground.log.bring_in.guess.groups import NumberColumn
from onboard.ground.log.bring_in.text_rows import Values

_WHEELS = {"wheel", "wheels", "rw", "flywheel", "rotor", "rotors"}
_SPEEDS = {"speed", "rate", "omega", "vel", "velocity", "rpm", "measured", "actual", "act", "meas"}
_HELD = {
    *("payload", "load", "loaded", "object", "holding", "held", "grasp", "grasped", "grip", "gripped", "gripper"),
    *("attached", "carrying", "picked"),
}
_RATES = ("rad/s", "deg/s", "rev/min")


class WheelChannels(NamedTuple):
    """Of a vehicle file: its recorded speeds of joints, what it reads its phase from, and whether the payload is held.

    ``held``: the channel of which heft identify takes the second value for "held", where the file says nothing of it.
    """

    wheels: tuple[str, ...] = ()
    phase: str = ""
    held: str = ""


def of_wheels(
    columns: Sequence[NumberColumn], wanted: WheelChannels, time: str
) -> Iterator[tuple[str, NumberColumn, str]]:
    """Channel, column and table of the mapping of each that is found.

    Wheels are columns that are called like them, but for words such as speed; or as many columns as there are, x, y, z
    or numbered, of which the name says that they are of wheels. The phase is called so, or like its channel. A payload
    is held from the one change on of a column of two values whose name says so.
    """
    for name, one in _wheels(columns, wanted.wheels).items():
        values = np.asarray(one.values, np.float64)[:, None]
        unit = magnitudes.of_others("speed of a wheel", values, one.of.unit, _RATES, "rad/s")
        yield name, one, text.scalar(name, one.name, values, unit, time)
    called, name = (_plain(wanted.phase), "phase"), wanted.phase or wanted.held
    for one in columns:
        if wanted.phase and _called(one) in called:
            why = "a phase"
        elif wanted.held and _HELD & set(one.of.stem) and (low := _taken(one.values)) is not None:
            why = f"{low:g}, then {low + 1:g}: the payload is held"
        else:
            continue
        keys = f'column = {text.quoted(one.name)}\nvalues = "physical"\nscale = 1.0    # {why}\nunit = "1"\n'
        yield name, one, f'\n[channel.{name}]\nrecord = "scalar"\n{time}\n[channel.{name}.value]\n' + keys
        return


def _taken(values: Values) -> float | None:
    """The first of two values of which the second, greater by one, follows once and stays; None of other columns."""
    good = values[np.isfinite(values)].astype(np.float64)
    steps = np.diff(good)
    return float(good[0]) if np.count_nonzero(steps) == 1 and steps.max() == 1.0 else None


def _wheels(columns: Sequence[NumberColumn], wheels: Sequence[str]) -> dict[str, NumberColumn]:
    by_name = {_called(one): one for one in reversed(columns)}
    own = {name: by_name[_plain(name)] for name in wheels if _plain(name) in by_name}
    if len(own) == len(wheels):
        return own
    for stem in dict.fromkeys(one.of.stem for one in columns if _WHEELS & set(one.of.stem) and one.of.label):
        some = sorted((one for one in columns if one.of.stem == stem), key=lambda one: one.of.label.zfill(4))
        if len(some) == len(wheels):
            return dict(zip(wheels, some, strict=True))
    return {}


def _called(one: NumberColumn) -> str:
    return "".join((*(word for word in one.of.stem if word not in _SPEEDS), one.of.label))


def _plain(name: str) -> str:
    return "".join(part for part in name.lower() if part.isalnum())
