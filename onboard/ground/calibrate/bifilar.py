"""The bare vehicle's inertia from its swings on two strings, by the gyro in a log (Limparis, section 4.2)."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.devices.roles import ImuRole
from onboard.dynamics.model.inertia import elements
from onboard.estimation.arrays import FloatArray, eigen
from onboard.estimation.calibration.bifilar import (
    FEWEST_SWINGS,
    AxisErrors,
    BifilarSwing,
    Suspension,
    axis_errors,
    inertia_tensor,
    swing,
)
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import MOST_CONTRADICTED
from onboard.flight.estimate.problem.model import build_model, drawn_body
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.calibrate.readings import LogSpan, Readings, still
from onboard.ground.calibrate.result import CalibratedNumber, Calibration, KeyChange, stated, two_digits

SHORTEST_s = 12.0
RATE_hz = 50.0
AXIS_rad = 3e-3  # of the gyro's axes in the base, where the vehicle file says nothing
ELEMENTS = ("XX", "XY", "YY", "XZ", "YZ", "ZZ")


class PendulumSwing(NamedTuple):
    """One swing: when, about which axis of the base, and what it says."""

    span: LogSpan
    axis: FloatArray  # (3,) base axes
    swing: BifilarSwing
    sway: float  # rate across the axis over that about it, rms


def calibrate_bifilar(
    read: Readings,
    vehicle: config.Vehicle,
    device: str,
    suspension: Suspension,
    at: Sequence[LogSpan] = (),
    gravity_sigma: float = 0.0,
) -> tuple[Calibration, list[PendulumSwing]]:
    """From readings in which the base hung by six axes or more, and swung about each.

    Args:
        read: of the IMU, calibrated; its gyro tells the axis of each hang.
        vehicle: whose base link it is, alone.
        device: the IMU on it.
        suspension: how it hung.
        at: when it swung freely; found where not given.
        gravity_sigma: relative, of the place.

    Raises:
        CalibrationError: a run that is no free swing, or axes that do not determine the tensor.
    """
    roles = roles_of(vehicle)
    role = next((one for one in roles.imus if one.channels == (device,)), None)
    if role is None:
        raise CalibrationError(f"{device} is no IMU: a gyro has to swing with the body")
    R_BS, _ = build_model(vehicle).pose_in_base(role.frame)
    errors, stated = _of_gyro(vehicle, role)
    hangs = [_hang(read, span, R_BS, suspension, errors.scale) for span in _swings(read, at)]
    if not hangs:
        raise CalibrationError("there is no swing in the log; let it go without a push and leave it alone for 30 s")
    axes = np.array([one.axis for one in hangs])
    values = np.array([one.swing.inertia_kg_m2 for one in hangs])
    own = np.array([one.swing.parts["swings"] for one in hangs]) * values
    by_scale, sway = np.array([[one.swing.by_scale_kg_m2, one.sway] for one in hangs]).T
    tensor, covariance = inertia_tensor(axes, values, axis_errors(axes, values, own, by_scale, errors, sway, R_BS))
    causes = suspension.relative_sigmas() | {"gravity": gravity_sigma}
    common = float(np.linalg.norm(list(causes.values())))
    order = [0, 3, 1, 4, 5, 2]  # of xx yy zz xy xz yz
    six = elements(tensor)
    sigma = np.sqrt(np.diag(covariance)[order] + (common * six) ** 2)
    result = Calibration(notes=[_described(one) for one in hangs])
    shared = ", ".join(f"{name} {100 * part:.2g} %" for name, part in causes.items())
    result.notes.append(f"common to all: {shared}")
    result.notes.append(
        f"axes of {device} in the base within {errors.misalignment_rad:.2g} rad ({stated}): products lean on it"
    )
    _into(result, vehicle, six, sigma, suspension)
    return result, hangs


def _of_gyro(vehicle: config.Vehicle, role: ImuRole) -> tuple[AxisErrors, str]:
    """What the vehicle file states of its gyro's axes and scale, and where."""
    if vehicle.prediction is not config.Prediction.ROWS:
        prior = vehicle.file.estimation.imu_prior
        own, housing = prior.gyro_misalignment_rad, prior.mounting_rad
        key = "mounting_rad" if housing > own else "gyro_misalignment_rad"
        axes = AxisErrors(math.hypot(own, housing), prior.gyro_scale, prior.cross_axis[0])
        return axes, f"estimation.imu_prior.{key}"
    if role.misalignment_sigma_rad:
        return AxisErrors(role.misalignment_sigma_rad, role.gyro_scale_sigma), "misalignment_sigma_rad"
    return AxisErrors(AXIS_rad, role.gyro_scale_sigma), "assumed: state misalignment_sigma_rad"


def _into(
    result: Calibration, vehicle: config.Vehicle, six: FloatArray, sigma: FloatArray, suspension: Suspension
) -> None:
    link = vehicle.file.vehicle.base_link
    drawn = drawn_body(build_model(vehicle), link)
    before = elements(drawn.inertia_kg_m2)
    for name, value, one, was in zip(ELEMENTS, six, sigma, before, strict=True):
        result.found.append(CalibratedNumber(f"I {name} of {link}", float(value), float(one), "kg m^2", float(was)))
    result.found.append(
        CalibratedNumber(f"mass of {link}", suspension.mass_kg, suspension.mass_sigma_kg, "kg", float(drawn.mass_kg))
    )
    table = ("link", link)
    result.changes.append(KeyChange(table, "mass_kg", suspension.mass_kg, f"{suspension.mass_sigma_kg:.2g}"))
    result.changes.append(stated(table, "inertia_kg_m2", six, sigma))
    half_trace = 0.5 * float(six[0] + six[2] + six[5])
    relative = float(np.sqrt(np.mean(sigma**2))) / half_trace
    if link in vehicle.file.estimation.prior.link:
        prior = ("estimation", "prior", "link", link)
        mass = max(suspension.mass_sigma_kg / suspension.mass_kg, 1e-6)
        result.changes.append(KeyChange(prior, "mass_relative", two_digits(mass)))
        result.changes.append(KeyChange(prior, "inertia_relative", two_digits(relative)))


def _swings(read: Readings, at: Sequence[LogSpan]) -> list[LogSpan]:
    """What lies between rests and is long enough."""
    if at or read.spans:
        return list(at or read.spans)
    rests = still(read, shortest_s=0.7)
    edges = [(a.end_s, b.start_s) for a, b in pairwise(rests)]
    edges.append((rests[-1].end_s, float(read.time_s[-1])))
    return [LogSpan(a, b) for a, b in edges if b - a >= SHORTEST_s]


def _hang(read: Readings, span: LogSpan, R_BS: FloatArray, suspension: Suspension, scale_sigma: float) -> PendulumSwing:
    part = read.within(span)
    if not read.usable[part].all():
        raise CalibrationError(f"the gyro is saturated in the swing at {span}; begin with a smaller angle")
    t, rate = _thinned(read.time_s[part], read.values[part, :3])
    middle = rate - rate.mean(axis=0)
    strength, directions = eigen(middle.T @ middle)
    axis = directions[:, -1]
    if strength[-2] > MOST_CONTRADICTED * strength[-1]:
        raise CalibrationError(
            f"the body swings about several axes at {span}; let it go without a push, and keep it from swinging "
            "sideways"
        )
    about = rate @ axis
    t, about = _free(t, about)
    try:
        found = swing(t, about, suspension, scale_sigma)
    except CalibrationError as error:
        raise CalibrationError(f"swing at {span}: {error}") from error
    return PendulumSwing(span, R_BS @ axis, found, float(np.sqrt(max(strength[-2], 0.0) / strength[-1])))


def _thinned(t: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of so many samples that :data:`RATE_hz` are left."""
    size = max(1, round(1.0 / (RATE_hz * float(np.median(np.diff(t))))))
    n = len(t) // size
    return t[: n * size].reshape(n, size).mean(axis=1), rate[: n * size].reshape(n, size, 3).mean(axis=1)


def _free(t: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """From a period after the release to the last zero but one: the hand that let go, or stopped it, is left out."""
    level = rate - np.median(rate)
    crossings = np.flatnonzero(np.signbit(level[1:]) != np.signbit(level[:-1]))
    large = 0.1 * float(np.abs(level).max())
    each = zip([0, *crossings], crossings, [*crossings[1:], len(t) - 1], strict=False)
    kept = [c for a, c, b in each if min(np.abs(level[a : c + 1]).max(), np.abs(level[c : b + 1]).max()) > large]
    if len(kept) < 2.0 * FEWEST_SWINGS:
        return t, rate
    part = slice(int(kept[3]), int(kept[-2]))
    return t[part], rate[part]


def _described(one: PendulumSwing) -> str:
    axis, found = ", ".join(f"{part:.3f}" for part in one.axis), one.swing
    return (
        f"{one.span} about ({axis}): {found.inertia_kg_m2:.5f} +- {found.sigma_kg_m2:.2g} kg m^2 "
        f"({found.linear_kg_m2:.5f} taking the angle for small); period {found.period_s:.3f} s, from "
        f"{np.rad2deg(found.amplitude_rad):.0f} deg"
    )
