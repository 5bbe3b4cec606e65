"""An encoder by the stops of its joint: zero, direction, counts per turn."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.devices.base import JointDevice
from onboard.estimation.arrays import OF_STEP
from onboard.estimation.calibration.linear import encoder
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import DOUBT, LARGEST_SIZE, sigmas
from onboard.ground.calibrate.readings import LogSpan, Readings, steps
from onboard.ground.calibrate.result import CalibratedNumber, Calibration, KeyChange, two_digits


class Stops(NamedTuple):
    """Angles the joint was held at, in this order, and how well they are known."""

    angles_rad: tuple[float, ...]
    sigma_rad: float


def calibrate_encoder(
    read: Readings, vehicle: config.Vehicle, device: str, stops: Stops, at: Sequence[LogSpan] = ()
) -> Calibration:
    """From readings in which the joint was held at its stops one after the other.

    Counts per turn that agree with the file are not changed: a drawing knows them better than two stops do.

    Args:
        read: without their present gain, zero count taken off.
        vehicle: whose encoder it is.
        device: its name.
        stops: where it was held.
        at: when; found where not given.

    Raises:
        CalibrationError: the run does not tell, or contradicts itself.
    """
    section = vehicle.file.device[device]
    if not isinstance(section, JointDevice):
        raise CalibrationError(f"{device} is a {section.kind} and no encoder of a joint")
    spans = steps(read, at, len(stops.angles_rad), "stops")
    nominal = section.counts_per_revolution
    per_rad = nominal / (2.0 * np.pi)
    means = [float(read.mean(span)[0][0]) for span in spans]
    counts = np.array(means) * per_rad + section.zero_count  # readings are less the zero count that the file has
    angles = np.array(stops.angles_rad)
    found = encoder(angles, counts, stops.sigma_rad)
    gain = found.counts_per_revolution / nominal
    gain_sigma = found.counts_sigma / abs(nominal)
    if abs(abs(gain) - 1.0) > LARGEST_SIZE:
        raise CalibrationError(
            f"{found.counts_per_revolution:.0f} counts a turn where the file has {nominal}; check the angles, deg, and "
            "the gear"
        )
    turned = gain < 0.0
    agrees = abs(abs(gain) - 1.0) < sigmas(DOUBT) * gain_sigma
    kept = -1.0 if turned else 1.0
    slope = (kept if agrees else gain) * per_rad
    weight = np.mean(counts - slope * angles)
    zero_sigma = float(np.hypot(stops.sigma_rad * per_rad, OF_STEP) / np.sqrt(len(angles)))
    if not agrees:
        zero_sigma = max(zero_sigma, found.zero_sigma)
    result = Calibration(
        [
            CalibratedNumber("counts per turn", found.counts_per_revolution, found.counts_sigma, "", float(nominal)),
            CalibratedNumber("zero count", float(weight), zero_sigma, "", float(section.zero_count)),
        ]
    )
    table = ("device", device)
    result.changes.append(KeyChange(table, "zero_count", round(float(weight)), f"{zero_sigma:.2g}"))
    if turned:
        result.notes.append("it counts against the joint: gain is negative")
    if agrees:
        within = f"{sigmas(DOUBT):.2g} sigmas ({100.0 * gain_sigma:.2g} %)"
        result.notes.append(f"its counts per turn agree with the file within {within}: kept")
        if kept != section.gain:
            result.changes.append(KeyChange(table, "gain", kept))
    else:
        result.notes.append(f"its counts per turn are {100.0 * (abs(gain) - 1.0):+.3g} % off those of the file")
        result.changes.append(KeyChange(table, "gain", float(f"{gain:.7g}"), f"{gain_sigma:.2g}"))
        result.changes.append(KeyChange(table, "scale_sigma", two_digits(gain_sigma)))
    return result
