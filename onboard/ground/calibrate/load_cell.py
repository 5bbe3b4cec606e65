"""A load cell by known masses: scale and offset, or the lever of one that measures a moment."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.devices.roles import LoadCellKeys
from onboard.estimation.arrays import FloatArray
from onboard.estimation.calibration.linear import line
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import LARGEST_SIZE
from onboard.ground.calibrate.place import Gravity
from onboard.ground.calibrate.readings import LogSpan, Readings, require_within, steps
from onboard.ground.calibrate.result import CalibratedNumber, Calibration, KeyChange, stated, two_digits


class HungMasses(NamedTuple):
    """What was hung on the cell, in this order.

    Attributes:
        masses_kg: as marked; 0 for none.
        sigma_kg: of each but none.
        place: gravity.
        arm_m: of a moment: from the axis, horizontally, to where they hang; None where they hang on the cell itself.
        arm_sigma_m: how well.
        combined_error: of the cell's data sheet, relative: creep and non-linearity, which no fit takes out.
    """

    masses_kg: tuple[float, ...]
    sigma_kg: float
    place: Gravity
    arm_m: float | None = None
    arm_sigma_m: float = 2e-4
    combined_error: float = 3e-4


def calibrate_load_cell(
    read: Readings, vehicle: config.Vehicle, device: str, hung: HungMasses, at: Sequence[LogSpan] = ()
) -> Calibration:
    """From readings in which the masses hung on the cell one after the other, still for some seconds each.

    Args:
        read: without their present calibration.
        vehicle: whose cell it is.
        device: its name.
        hung: the masses.
        at: when they hung still; found where not given.

    Raises:
        CalibrationError: the run does not tell, or contradicts itself.
    """
    section = vehicle.file.device[device]
    if not isinstance(section, LoadCellKeys):
        raise CalibrationError(f"{device} is a {section.kind} and no load cell")
    if hung.arm_m is not None and section.measures != "moment":
        raise CalibrationError(f"{device} measures a force and has no lever: leave --arm-m out")
    if min(hung.masses_kg) < 0.0:
        raise CalibrationError("a mass is negative; give what hangs, 0 for nothing")
    require_within(read, section.capacity_N, "hang less on it")
    spans = steps(read, at, len(hung.masses_kg), "masses")
    means = [read.mean(span) for span in spans]
    reading = np.array([float(mean[0]) for mean, _ in means])
    sigma = np.array([float(spread[0]) for _, spread in means])
    sigma = np.hypot(sigma, hung.combined_error * np.abs(reading - reading[np.abs(reading).argmin()]))
    masses, g = np.array(hung.masses_kg), hung.place
    known = masses * g.gravity_m_s2
    known_sigma = np.where(masses > 0.0, hung.sigma_kg * g.gravity_m_s2, 0.0)
    found = line(known, reading, known_sigma, sigma)
    common = float(
        np.linalg.norm([found.slope_sigma / found.slope, g.sigma_m_s2 / g.gravity_m_s2, hung.combined_error])
    )
    result = Calibration(notes=[_fitted(found.residual, spans, reading, masses)])
    if len(masses) < 3:
        result.notes.append("two masses fit any line: a third would show an error")
    table = ("device", device)
    if hung.arm_m is not None:
        _lever(result, table, section, hung, found.slope, common)
    else:
        if abs(found.slope - 1.0) > LARGEST_SIZE:
            raise CalibrationError(
                f"it reads {found.slope:.3g} N for a newton; check the masses, kg, the unit, and how the cell is held"
            )
        gain_sigma = found.slope * common
        result.found.append(CalibratedNumber("gain", found.slope, gain_sigma, "N/N", section.gain))
        result.changes.append(stated(table, "gain", found.slope, gain_sigma))
        result.changes.append(KeyChange(table, "scale_sigma", two_digits(common)))
    result.found.append(CalibratedNumber("offset", found.offset, found.offset_sigma, "N", section.offset_N))
    result.changes.append(stated(table, "offset_N", found.offset, found.offset_sigma))
    return result


def _lever(
    result: Calibration, table: tuple[str, ...], section: LoadCellKeys, hung: HungMasses, slope: float, common: float
) -> None:
    """``reading = m g arm / lever``: the lever, its scale in it."""
    assert hung.arm_m is not None
    if not slope > 0.0:
        raise CalibrationError("it reads less for more mass; turn the joint so that they pull the other way")
    lever = hung.arm_m / slope
    sigma = lever * float(np.hypot(common, hung.arm_sigma_m / hung.arm_m))
    if abs(lever / section.lever_m - 1.0) > LARGEST_SIZE:
        raise CalibrationError(
            f"a lever of {1e3 * lever:.4g} mm where the file has {1e3 * section.lever_m:.4g} mm; check --arm-m, the "
            "masses, and lever_m in the file"
        )
    result.found.append(CalibratedNumber("lever", lever, sigma, "m", section.lever_m))
    result.changes += [
        stated(table, "lever_m", lever, sigma),
        KeyChange(table, "lever_sigma_m", two_digits(sigma)),
        KeyChange(table, "scale_sigma", 0.0, "in lever_sigma_m"),
        KeyChange(table, "gain", 1.0, "in lever_m"),
    ]


def _fitted(residual: float, spans: list[LogSpan], reading: FloatArray, masses: FloatArray) -> str:
    shown = "; ".join(f"{m:g} kg {r:.4f} N at {span}" for m, r, span in zip(masses, reading, spans, strict=True))
    return f"{shown}; {1e3 * residual:.2g} mN off the line"
