"""Drives of a new vehicle: ``[drive]``, and a motion to begin with that every joint can make."""

import math
from collections.abc import Sequence

import numpy as np

from onboard.config.drive import Drive
from onboard.config.driving import Range, joint_ranges
from onboard.config.errors import ConfigError

MOTION = "motion.csv"
_SECONDS, _ROWS_HZ = 20.0, 50
_LARGEST_rad = 0.6
_OF_RANGE, _OF_RATE, _OF_ACCELERATION = 0.7, 0.6, 0.5  # shares that the motion takes
_APART = 1.24  # frequencies of two joints, so that they do not go in step


def table(own: str) -> str:
    """Of the vehicle file; ``own``: keys of the kind of drive."""
    return f"""
[drive]                        # what the drives are sent: docs/driving.md
armed = true                   # and then only by heft fly --arm
motion = "{MOTION}"          # yours: heft plan writes it
{own}"""


def motion(urdf: str, joints: Sequence[str]) -> str:
    """The CSV: swings of all joints about the middles of their ranges, from rest to rest.

    Raises:
        ConfigError: a joint without a range.
    """
    ranges, time_s = joint_ranges(urdf), np.linspace(0.0, _SECONDS, round(_ROWS_HZ * _SECONDS) + 1)
    rise = np.sin(math.pi * time_s / _SECONDS) ** 2  # its own largest rate is pi / _SECONDS
    columns = [time_s]
    for number, joint in enumerate(joints):
        low, high, rate = ranges.get(joint, Range(math.nan, math.nan, math.nan))
        if not (low < high and rate > 0.0):
            raise ConfigError(f"--drives: the URDF gives {joint!r} no range or rate; put them into its <limit>")
        defaults = Drive()
        size_rad = min(_LARGEST_rad, _OF_RANGE * (0.5 * (high - low) - defaults.margin_rad))
        most_rad_s = min(_OF_RATE * rate - size_rad * math.pi / _SECONDS, size_rad * 2.0 * math.pi)
        turns_rad_s = min(most_rad_s / size_rad, math.sqrt(_OF_ACCELERATION * defaults.acceleration_rad_s2 / size_rad))
        swing = np.sin(turns_rad_s / _APART ** (number % 4) * time_s)
        columns.append(0.5 * (low + high) + size_rad * rise * swing)
    rows = [",".join(["time_s", *joints])]
    rows += [",".join(f"{value:.6f}" for value in row) for row in np.column_stack(columns)]
    return "\n".join([*rows, ""])
