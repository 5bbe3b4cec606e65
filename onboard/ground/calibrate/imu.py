"""An IMU by six positions and whole turns: bias, scale, misalignment of both triads; noise by Allan deviation."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.devices.base import ImuDevice
from onboard.estimation.arrays import PAUSE, FloatArray
from onboard.estimation.calibration.imu import RestBias, TriadCalibration, rest_bias, six_positions, turns
from onboard.estimation.errors import CalibrationError
from onboard.estimation.policy import LARGEST_SIZE
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.calibrate.allan import Allan, allan_deviation
from onboard.ground.calibrate.place import Gravity
from onboard.ground.calibrate.readings import LogSpan, Readings, still
from onboard.ground.calibrate.result import CalibratedNumber, Calibration, KeyChange, rounded, stated, two_digits

GYRO, ACCEL = slice(0, 3), slice(3, 6)
_TURNING_rad_s = np.deg2rad(5.0)  # a steady turn about the vertical looks still but for this
_CARRIED = np.cos(np.pi * LARGEST_SIZE)  # what a wrong scale leaves of half a turn


class ImuOptions(NamedTuple):
    """How the bench is.

    Attributes:
        place: gravity.
        fixture_rad: how well a position is held, 1 sigma by axis.
        turn_rad: a turn is this, or a multiple.
        turn_sigma_rad: how well.
        allan: whether the noise keys are wanted.
    """

    place: Gravity
    fixture_rad: float = 1e-3
    turn_rad: float = 2.0 * np.pi
    turn_sigma_rad: float = 1e-3
    allan: bool = False


class _Position(NamedTuple):
    span: LogSpan
    up: FloatArray  # (3,)
    mean: FloatArray  # (6,)
    spread: FloatArray  # (6,)


def calibrate_imu(
    read: Readings, vehicle: config.Vehicle, device: str, options: ImuOptions, at: Sequence[LogSpan] = ()
) -> tuple[Calibration, Allan | None]:
    """From readings in which each face of the sensor was up, still, and on each it was turned both ways.

    Args:
        read: without their present calibration.
        vehicle: whose IMU it is.
        device: its name.
        options: how the bench is.
        at: when it was still; found where not given.

    Raises:
        CalibrationError: the run does not tell, or contradicts itself.
    """
    section = vehicle.file.device[device]
    if not isinstance(section, ImuDevice):
        raise CalibrationError(f"{device} is a {section.kind} and no IMU of three axes each; calibrate it in itself")
    positions = _positions(read, at)
    accel, gyro, rest = _solved(read, positions, options)
    result = Calibration()
    before = [np.array(v) for v in (section.accel_matrix, section.accel_bias_m_s2, section.gyro_matrix)]
    result.add("accelerometer matrix", accel.matrix, accel.matrix_sigma, "", before[0])
    result.add("accelerometer bias", accel.bias, accel.bias_sigma, "m/s^2", before[1])
    result.add("gyro matrix", gyro.matrix, gyro.matrix_sigma, "", before[2])
    result.add("gyro bias", rest.bias_rad_s, rest.sigma_rad_s, "rad/s", np.array(section.gyro_bias_rad_s))
    result.changes += _changes(device, accel, gyro, rest)
    result.changes += _prior(vehicle, device, accel, gyro)
    result.notes.append(
        f"{len(positions)} rests and turns in {read.time_s[-1]:.0f} s; gravity "
        f"{options.place.gravity_m_s2:.5f} +- {options.place.sigma_m_s2:.2g} m/s^2; residuals "
        f"{accel.residual:.2f} and {gyro.residual:.2f} of the stated sigmas"
    )
    result.notes.append(
        "biases come back differently after power-up and with temperature: [estimation.imu_prior] keeps their sigmas"
    )
    if not options.allan:
        return result, None
    allan = allan_deviation(read, max((one.span for one in positions), key=lambda span: span.end_s - span.start_s))
    for key, part in (("gyro_noise_rad_s", GYRO), ("accel_noise_m_s2", ACCEL)):
        value = float(np.sqrt(np.mean(allan.sample_noise[part] ** 2)))
        spread = value * allan.relative_sigma
        unit = "rad/s" if part is GYRO else "m/s^2"
        result.found.append(CalibratedNumber(key, value, spread, unit, getattr(section, key)))
        result.changes.append(KeyChange(("device", device), key, two_digits(value), f"{spread:.2g} by Allan deviation"))
    return result, allan


def _positions(read: Readings, at: Sequence[LogSpan]) -> list[_Position]:
    means = [(span, *read.mean(span)) for span in still(read, at)]
    usual = np.median([mean[GYRO] for _, mean, _ in means], axis=0)
    found = []
    for span, mean, spread in means:
        if np.abs(mean[GYRO] - usual).max() > _TURNING_rad_s:
            continue
        force = mean[ACCEL]
        size = float(np.linalg.norm(force))
        axis = int(np.abs(force).argmax())
        if not size > 0.0 or abs(force[axis]) < np.cos(LARGEST_SIZE) * size:
            direction = ", ".join(f"{part:.2f}" for part in force / max(size, 1e-9))
            raise CalibrationError(
                f"at {span} it lies on no face: up is ({direction}) in its axes; hold it on its faces, or leave that "
                "time out by --at"
            )
        up = np.zeros(3)
        up[axis] = np.sign(force[axis])
        found.append(_Position(span, up, mean, spread))
    missing = [
        f"{'+-'[int(sign < 0)]}{'xyz'[axis]}"
        for axis in range(3)
        for sign in (1, -1)
        if not any(one.up[axis] == sign for one in found)
    ]
    if missing:
        raise CalibrationError(f"no position with {', '.join(missing)} up; hold it still on each of its six faces")
    return found


def _solved(
    read: Readings, positions: list[_Position], options: ImuOptions
) -> tuple[TriadCalibration, TriadCalibration, RestBias]:
    up = np.array([one.up for one in positions])
    mean, spread = np.array([one.mean for one in positions]), np.array([one.spread for one in positions])
    same = [mean[(up == one).all(axis=1)] for one in np.unique(up, axis=0)]
    drift = np.sqrt(np.median([each.var(axis=0) for each in same], axis=0))  # while it warms up, say
    noise, noise_gyro = (
        float(np.sqrt(np.mean(spread[:, part] ** 2) + np.mean(drift[part] ** 2))) for part in (ACCEL, GYRO)
    )
    g, g_sigma = options.place
    accel = six_positions(mean[:, ACCEL], up, g, options.fixture_rad, noise)
    along = np.eye(3) * g_sigma / g
    accel = accel._replace(matrix_sigma=np.hypot(accel.matrix_sigma, along))
    rest = rest_bias(mean[:, GYRO], up, noise_gyro)
    _require_one_frame(read, positions, rest.bias_rad_s)
    angle, axis, integral = _turns(read, positions, options.turn_rad)
    gyro = turns(angle, axis, integral, options.fixture_rad, options.turn_sigma_rad)
    return accel, gyro, rest


def _require_one_frame(read: Readings, positions: list[_Position], bias: FloatArray) -> None:
    """Refuse a gyro whose axes are not those of the accelerometer: from face to face, ``du/dt = -w x u``.

    A turn about the vertical does not tell in which sense it went; how it was laid from one face on another does.
    """
    off = []
    for before, after in pairwise(positions):
        part = read.within(LogSpan(before.span.end_s, after.span.start_s))
        if (before.up == after.up).all() or not read.usable[part].all():
            continue
        u = _carried(before.up, (read.values[part, GYRO] - bias)[:-1] * np.diff(read.time_s[part])[:, None])
        off.append(float(u @ after.up / np.linalg.norm(u)) < _CARRIED)
    if any(off):
        raise CalibrationError(
            "from face to face the gyro turns another way than the accelerometer: their axes are no right-handed "
            "frame; check signs and order of the axes"
        )


def _carried(u: FloatArray, angles: FloatArray) -> FloatArray:
    """A direction (3,) in axes that turn by small angles (n, 3), one after the other; in Python, as three numbers."""
    x, y, z = u.tolist()
    for a, b, c in angles.tolist():
        p, q, r = b * z - c * y, c * x - a * z, a * y - b * x  # angle x u
        x = x - p + 0.5 * (b * r - c * q)
        y = y - q + 0.5 * (c * p - a * r)
        z = z - r + 0.5 * (a * q - b * p)
    return np.array([x, y, z], np.float64)


def _turns(read: Readings, positions: list[_Position], turn_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angle, axis and integral of every turn between two rests on the same face."""
    found = []
    period = float(np.median(np.diff(read.time_s)))
    for before, after in pairwise(positions):
        if (before.up != after.up).any():
            continue
        span = LogSpan(before.span.end_s, after.span.start_s)
        part = read.within(span)
        t, rate = read.time_s[part], read.values[part, GYRO]
        share = ((t - t[0]) / max(t[-1] - t[0], 1e-9))[:, None]
        integral = np.trapezoid(rate - (before.mean[GYRO] * (1 - share) + after.mean[GYRO] * share), t, axis=0)
        about = float(integral @ before.up)
        times = round(about / turn_rad)
        if not times:
            continue
        if np.diff(t).max() > PAUSE * period:
            raise CalibrationError(f"samples are missing in the turn at {span}; repeat the run")
        if not read.usable[part].all():
            raise CalibrationError(f"the gyro is saturated in the turn at {span}; turn slower")
        if abs(about - times * turn_rad) > LARGEST_SIZE * turn_rad:
            raise CalibrationError(
                f"the turn at {span} goes {np.rad2deg(about):.0f} deg, which is no multiple of "
                f"{np.rad2deg(turn_rad):.0f} deg; turn it whole, or give --turn-deg"
            )
        found.append((times * turn_rad, before.up, integral))
    lacking = [axis for n, axis in enumerate("xyz") if not any(abs(one[1][n]) for one in found)]
    if lacking:
        raise CalibrationError(
            f"no turn about {', '.join(lacking)}: on a face of each axis turn it about the vertical by "
            f"{np.rad2deg(turn_rad):.0f} deg, still before and after"
        )
    angle, axis, integral = (np.array(column) for column in zip(*found, strict=True))
    return angle, axis, integral


def _changes(device: str, accel: TriadCalibration, gyro: TriadCalibration, rest: RestBias) -> list[KeyChange]:
    table = ("device", device)
    scale = [float(np.sqrt(np.mean(np.diag(one.matrix_sigma) ** 2))) for one in (accel, gyro)]
    angle = [float(one.matrix_sigma[~np.eye(3, dtype=bool)].mean()) for one in (accel, gyro)]
    told = [f"{a:.2g} of scales, {b:.2g} of angles" for a, b in zip(scale, angle, strict=True)]
    bias, bias_gyro = float(accel.bias_sigma.mean()), float(rest.sigma_rad_s.mean())
    return [
        KeyChange(table, "accel_matrix", rounded(accel.matrix, min(scale[0], angle[0])), told[0]),
        stated(table, "accel_bias_m_s2", accel.bias, bias),
        KeyChange(table, "accel_scale_sigma", two_digits(scale[0])),
        KeyChange(table, "gyro_matrix", rounded(gyro.matrix, min(scale[1], angle[1])), told[1]),
        stated(table, "gyro_bias_rad_s", rest.bias_rad_s, bias_gyro),
        KeyChange(table, "gyro_scale_sigma", two_digits(scale[1])),
    ]


def _prior(vehicle: config.Vehicle, device: str, accel: TriadCalibration, gyro: TriadCalibration) -> list[KeyChange]:
    """The sigmas of [estimation.imu_prior], where the base is predicted with this IMU."""
    if vehicle.prediction is config.Prediction.ROWS or roles_of(vehicle).imu.channels[0] != device:
        return []
    table, changes = ("estimation", "imu_prior"), []
    for name, one in (("gyro", gyro), ("accelerometer", accel)):
        scale = float(np.sqrt(np.mean(np.diag(one.matrix_sigma) ** 2)))
        angle = float(np.sqrt(np.mean(one.matrix_sigma[~np.eye(3, dtype=bool)] ** 2)))
        changes.append(KeyChange(table, f"{name}_scale", two_digits(scale)))
        changes.append(KeyChange(table, f"{name}_misalignment_rad", two_digits(angle)))
        changes.append(KeyChange(table, f"{name}_cross_axis", two_digits(angle)))
    return changes
