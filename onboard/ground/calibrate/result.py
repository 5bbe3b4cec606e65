"""What a calibration found, for the terminal, for JSON and for the vehicle file."""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from onboard.estimation.arrays import FloatArray


class CalibratedNumber(NamedTuple):
    """One number."""

    name: str
    value: float
    sigma: float
    unit: str = ""
    before: float | None = None  # in the vehicle file


class KeyChange(NamedTuple):
    """One key of the vehicle file; a value of None takes it out."""

    table: tuple[str, ...]
    key: str
    value: Any
    sigma: str = ""  # written in the comment behind it


@dataclass
class Calibration:
    """What a calibration found.

    Attributes:
        found: what to show.
        changes: what to write.
        notes: what the operator should know.
    """

    found: list[CalibratedNumber] = field(default_factory=list)
    changes: list[KeyChange] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, values: FloatArray, sigmas: FloatArray, unit: str, before: FloatArray) -> None:
        """Show a vector or a matrix of values, its elements by x, y, z."""
        for index in np.ndindex(values.shape):
            label = "".join("xyz"[n] for n in index)
            one = float(values[index]), float(sigmas[index])
            self.found.append(CalibratedNumber(f"{name} {label}", *one, unit, float(before[index])))

    def as_json(self) -> dict[str, Any]:
        """The same for programs."""
        return {
            "found": [number._asdict() for number in self.found],
            "changes": [one._asdict() | {"table": ".".join(one.table)} for one in self.changes],
            "notes": self.notes,
        }


def digits(sigma: float) -> int:
    """Decimals that show two digits of ``sigma``."""
    return 9 if not sigma > 0.0 else max(0, 1 - math.floor(math.log10(sigma)))


def rounded(values: FloatArray, sigma: float) -> Any:
    """Values as lists, to a tenth of their sigma."""
    return np.round(values, digits(sigma) + 1).tolist()


def stated(table: tuple[str, ...], key: str, value: Any, sigma: Any) -> KeyChange:
    """A key with the 1 sigma of its value behind it, or with those of its parts."""
    sigmas = np.atleast_1d(sigma)
    shown = ", ".join(f"{one:.2g}" for one in sigmas)
    return KeyChange(table, key, rounded(np.asarray(value), float(sigmas.min())), shown)


def two_digits(sigma: float) -> float:
    """A sigma to two significant digits."""
    return float(f"{sigma:.2g}")


def render(calibration: Calibration, title: str) -> Table:
    """What was found, as a table."""
    numbers = (Column(heading, justify="right") for heading in ("value", "1 sigma", "in the file"))
    table = Table("", *numbers, "unit", box=SIMPLE_HEAD, title=title, title_justify="left")
    for name, value, sigma, unit, before in calibration.found:
        places = digits(sigma)
        was = "" if before is None else f"{before:.{places}f}"
        table.add_row(name, f"{value:.{places}f}", f"{sigma:.2g}", was, unit)
    return table
