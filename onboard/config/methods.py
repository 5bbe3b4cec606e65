"""Methods of estimation (``[estimation] method``): what each needs of a vehicle, and what they predict of it.

:data:`METHODS` is the only table of them. Builders, readers of logs and forecasts have a table each, by
:class:`Prediction`.
"""

from dataclasses import dataclass
from enum import StrEnum


@dataclass(frozen=True)
class EstimationMethod:
    """What a method needs.

    Attributes:
        name: in vehicle.toml.
        predicts: it predicts what the base's instruments show, and has no rows.
        tick_means: it takes the base IMU's means over each tick, and not smoothed signals at its middle.
        builder: "package.module:function" that makes its estimator from a vehicle file; "": by what is predicted.
    """

    name: str
    predicts: bool = False
    tick_means: bool = False
    builder: str = ""


PREDICTING = EstimationMethod("exiddm", predicts=True, tick_means=True)
OF_A_FREE_BASE = f'the method "{PREDICTING.name}" of a free base'
METHODS = {method.name: method for method in (EstimationMethod("rows"), PREDICTING)}


class Prediction(StrEnum):
    """What the method predicts of a vehicle; ROWS: it predicts nothing."""

    ROWS = "rows"
    FREE = "free"  # base IMU and further instruments of a free base
    PARABOLAS = "parabolas"  # the same in runs between hands
    PLANAR = "planar"  # an arm on an air-bearing table
    BODY = "body"  # a body without joints on such a table
    PIVOT = "pivot"  # a body on a spherical air bearing
