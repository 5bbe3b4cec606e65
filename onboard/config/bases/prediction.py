"""By what a vehicle's flights are estimated, of which builders, readers of logs and forecasts have a table each."""

from enum import StrEnum


class Prediction(StrEnum):
    """What method "exiddm" predicts of a vehicle; ROWS: another method, which predicts nothing."""

    ROWS = "rows"
    FREE = "free"  # base IMU and further instruments of a free base
    PARABOLAS = "parabolas"  # the same in runs between hands
    PLANAR = "planar"  # an arm on an air-bearing table
    BODY = "body"  # a body without joints on such a table
    PIVOT = "pivot"  # a body on a spherical air bearing
