"""Methods of estimation (``[estimation] method``): what each needs of a vehicle, and what they predict of it.

Builders, readers of logs and forecasts have a table each, by :class:`Prediction`.
"""

from dataclasses import dataclass
from enum import StrEnum


@dataclass(frozen=True)
class EstimationMethod:
    """What a method needs.

    Attributes:
        name: in vehicle.toml.
        predicts: it predicts what the base's instruments show, and has no rows.
        falling: its rows are force and moment on a free base, both zero.
    """

    name: str
    predicts: bool = False
    falling: bool = False


PREDICTING = EstimationMethod("exiddm", predicts=True)
OF_A_FREE_BASE = f'the method "{PREDICTING.name}" of a free base'
METHODS = {method.name: method for method in (EstimationMethod("instrumental", falling=True), PREDICTING)}


def method_of(name: str) -> EstimationMethod:
    """A method by its name; a name without an entry has rows, those that the vehicle file states."""
    return METHODS.get(name, EstimationMethod(name))


class Prediction(StrEnum):
    """What the method predicts of a vehicle; ROWS: it predicts nothing."""

    ROWS = "rows"
    FREE = "free"  # base IMU and further instruments of a free base
    PARABOLAS = "parabolas"  # the same in runs between hands
    PLANAR = "planar"  # an arm on an air-bearing table
    BODY = "body"  # a body without joints on such a table
    PIVOT = "pivot"  # a body on a spherical air bearing
