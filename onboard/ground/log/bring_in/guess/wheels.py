"""Speeds of wheels, and the switch that says what is being done, by the channels of a vehicle file."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from onboard.ground.log.bring_in.guess import magnitudes, text
from onboard.ground.log.bring_in.guess.groups import Column

_WHEELS = {"wheel", "wheels", "rw", "flywheel", "rotor", "rotors"}
_SPEEDS = {"speed", "rate", "omega", "vel", "velocity", "rpm", "measured", "actual", "act", "meas"}
_RATES = ("rad/s", "deg/s", "rev/min")


class WheelChannels(NamedTuple):
    """Of a vehicle file: its recorded speeds of joints, and what it reads its phase from."""

    wheels: tuple[str, ...] = ()
    phase: str = ""


def of_wheels(columns: Sequence[Column], wanted: WheelChannels, time: str) -> Iterator[tuple[str, Column, str]]:
    """Channel, column and table of the mapping of each that is found.

    Wheels are columns that are called like them, but for words such as speed; or as many columns as there are, x, y, z
    or numbered, of which the name says that they are of wheels. The phase is called so, or like its channel.
    """
    for name, one in _wheels(columns, wanted.wheels).items():
        values = np.asarray(one.values, np.float64)[:, None]
        unit = magnitudes.of_others("speed of a wheel", values, one.of.unit, _RATES, "rad/s")
        yield name, one, text.scalar(name, one.name, values, unit, time)
    if not wanted.phase:
        return
    called = _plain(wanted.phase), "phase"
    for one in columns:
        if _called(one) in called:
            keys = f'column = {text.quoted(one.name)}\nvalues = "physical"\nscale = 1.0    # a phase\nunit = "1"\n'
            table = f'\n[channel.{wanted.phase}]\nrecord = "scalar"\n{time}\n[channel.{wanted.phase}.value]\n'
            yield wanted.phase, one, table + keys
            return


def _wheels(columns: Sequence[Column], wheels: Sequence[str]) -> dict[str, Column]:
    by_name = {_called(one): one for one in reversed(columns)}
    own = {name: by_name[_plain(name)] for name in wheels if _plain(name) in by_name}
    if len(own) == len(wheels):
        return own
    for stem in dict.fromkeys(one.of.stem for one in columns if _WHEELS & set(one.of.stem) and one.of.label):
        some = sorted((one for one in columns if one.of.stem == stem), key=lambda one: one.of.label.zfill(4))
        if len(some) == len(wheels):
            return dict(zip(wheels, some, strict=True))
    return {}


def _called(one: Column) -> str:
    return "".join((*(word for word in one.of.stem if word not in _SPEEDS), one.of.label))


def _plain(name: str) -> str:
    return "".join(part for part in name.lower() if part.isalnum())
