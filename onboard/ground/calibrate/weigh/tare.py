"""Writes the zeros of a six-axis cell into the device tables of a vehicle file, where the driver takes them off."""

import numpy as np

from onboard import config
from onboard.devices.roles import LoadCellKeys
from onboard.ground.calibrate.result import KeyChange, rounded, stated
from onboard.ground.calibrate.weigh.errors import PosesError
from onboard.ground.calibrate.weigh.weigh import Answer


def changes(vehicle: config.Vehicle, answer: Answer) -> list[KeyChange]:
    """``offset_N`` of every load cell, by its axis and whether it measures a force or a moment.

    Args:
        vehicle: whose cells' axes are the sensor's.
        answer: zeros at the last pose.

    Raises:
        PosesError: the file has no load cell.
    """
    zero = np.array([one.zero for one in answer.axes]).reshape(2, 3)
    sigma = np.array([one.zero_sigma for one in answer.axes]).reshape(2, 3)
    reaction = -1.0 if answer.poses.convention.sign == "reaction" else 1.0  # what the device itself reads
    found = []
    for name, section in vehicle.file.device.items():
        if not isinstance(section, LoadCellKeys):
            continue
        axis = np.array(section.axis) / np.linalg.norm(section.axis)
        which, unit = (1, section.lever_m) if section.measures == "moment" else (0, 1.0)
        value, own = reaction * float(axis @ zero[which]), float(np.sqrt(axis**2 @ sigma[which] ** 2))
        value, own = value * section.gain / unit, own * section.gain / unit
        found.append(stated(("device", name), "offset_N", value, own))
    if not found:
        raise PosesError(f"{vehicle.label} has no load cell whose zero could be written; leave --vehicle out")
    return found


def lines(answer: Answer) -> str:
    """The same as TOML, of a sensor whose vehicle file is not at hand: N and N m, ``offset_N`` of a lever of 1 m."""
    reaction = -1.0 if answer.poses.convention.sign == "reaction" else 1.0
    return "\n".join(
        f"[device.{one.name.replace(' ', '_')}]\n"
        f"offset_N = {rounded(np.array(reaction * one.zero), one.zero_sigma)}    # +- {one.zero_sigma:.2g} (1 sigma)"
        for one in answer.axes
    )
