"""What is done at a bench, by the options of ``heft calibrate``: by the operator, and by the simulated one."""

import argparse
import math
from typing import Any

from onboard import config
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.calibrate import guide
from onboard.ground.calibrate.balance import rig

_SPACING_M, _LENGTH_M = 0.40, 1.80  # of the simulated pendulum


def angles_deg(a: argparse.Namespace, vehicle: config.Vehicle, device: str) -> tuple[float, ...]:
    """The joint's stops: as given, or the URDF's limits, each twice.

    Raises:
        ValueError: the joint has none.
    """
    if a.angles_deg:
        return tuple(a.angles_deg)
    name = next((joint.joint for joint in roles_of(vehicle).joints if joint.channel == device), None)
    if name is None:
        raise ValueError(f"{device} measures no joint; give --device")
    joint = build_model(vehicle).joint(name)
    if not (math.isfinite(joint.low) and math.isfinite(joint.high)):
        raise ValueError(f"joint {name} has no limits in the URDF; give --angles-deg")
    return (math.degrees(joint.low), math.degrees(joint.high)) * 2


def steps(a: argparse.Namespace, vehicle: config.Vehicle, device: str) -> list[guide.GuideStep]:
    """What the operator does: ``a.what`` is the kind of calibration, its options are those of the command."""
    match a.what:
        case "imu":
            return guide.imu(a.turn_deg, a.allan or 0.0)
        case "load-cell":
            return guide.masses(a.masses_kg)
        case "encoder":
            return guide.stops(angles_deg(a, vehicle, device))
        case "bifilar":
            return guide.swings()
    return guide.orientations(len(rig(a.rig).orientation))


def settings(a: argparse.Namespace, vehicle: config.Vehicle, device: str) -> dict[str, Any]:
    """What the simulated bench does: arguments of :func:`hil_sim.bench.open_bench`."""
    match a.what:
        case "imu":
            return {"long_rest_s": a.allan or 0.0}
        case "load-cell":
            return {"masses_kg": a.masses_kg, "sigma_kg": 1e-3 * a.mass_sigma_g, "arm_m": a.arm_m}
        case "encoder":
            return {"angles_rad": [math.radians(angle) for angle in angles_deg(a, vehicle, device)]}
        case "bifilar":
            a.spacing_m = _SPACING_M if a.spacing_m is None else a.spacing_m
            a.length_m = _LENGTH_M if a.length_m is None else a.length_m
            return {"spacing_m": a.spacing_m, "length_m": a.length_m, "scale_sigma_kg": a.mass_sigma_kg}
    return {"rig": [one.model_dump() for one in rig(a.rig).orientation]}
