"""What each device is to the estimator: the IMU, the angle of a joint, a load cell. Kinds of devices end here.

Of several IMUs the first in the file measures the base; the others are recorded.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from onboard import config
from onboard.timebase.delays import MPU6050_FILTER_DELAY_S

STANDARD_GRAVITY_M_S2 = 9.80665
ANGLE = {b"rad": 1.0, b"deg": math.pi / 180.0}
RATE = {b"rad/s": 1.0, b"deg/s": math.pi / 180.0}
SPECIFIC_FORCE = {b"m/s^2": 1.0, b"g": STANDARD_GRAVITY_M_S2}


class Signal(NamedTuple):
    """A channel that is smoothed, and what that needs to know of it.

    Attributes:
        delays_s: of the filter of each of its columns.
        noise: standard deviation of a sample of each column, SI.
        period_s: nominal.
        si: SI units in each unit that its rows may carry; empty for IMU rows, whose units are fixed.
        zero_count: raw value at zero.
        limit: values as large as this are saturated, SI.
        absolute: it still measures from the same zero after its device was reset.
        ripple: its cyclic errors: periods of each in a radian of what it measures, times 2 pi, and its rms, SI.
    """

    delays_s: tuple[float, ...]
    noise: tuple[float, ...]
    period_s: float
    si: Mapping[bytes, float]
    zero_count: int = 0
    limit: float = math.inf
    absolute: bool = True
    ripple: tuple[tuple[float, float], ...] = ()


class Imu(NamedTuple):
    """Channels of gyro x, y, z, accel x, y, z in this order, in one or one by one; the URDF's frame they measure in."""

    channels: tuple[str, ...]
    frame: str


class Joint(NamedTuple):
    """The channel of a joint's angle, or of its rate where ``is_rate``."""

    joint: str
    channel: str
    is_rate: bool = False


class Cell(NamedTuple):
    """A load cell: the name of its row, its channel, what it measures."""

    name: str
    channel: str
    keys: config.LoadCellKeys


class Roles(NamedTuple):
    """The roles in a vehicle, and the signals by channel that fill them."""

    imus: list[Imu]
    joints: list[Joint]
    cells: list[Cell]
    signals: dict[str, Signal]

    @property
    def imu(self) -> Imu:
        """The one that measures the base."""
        return self.imus[0]


def roles_of(vehicle: config.Vehicle) -> Roles:
    """Who measures what in a vehicle."""
    roles = Roles([], [], [], {})
    for name, device in vehicle.file.device.items():
        period_s = 1.0 / vehicle.rate_hz(name)
        match device:
            case config.ImuDevice():
                roles.imus.append(Imu((name,), device.frame))
                gyro_delay_s, accel_delay_s = _imu_delays_s(device)
                delays_s = (gyro_delay_s,) * 3 + (accel_delay_s,) * 3
                noise = (device.gyro_noise_rad_s,) * 3 + (device.accel_noise_m_s2,) * 3
                roles.signals[name] = Signal(delays_s, noise, period_s, {})
            case config.JointDevice():
                roles.joints.append(Joint(device.joint, name))
                absolute = not isinstance(device, config.QsbDevice)
                angle = _scalar(0.0, device.noise_rad, period_s, ANGLE)
                turns = device.gear_ratio
                ripple = (turns, device.eccentricity_rad), (2.0 * turns, device.transmission_error_rad)
                roles.signals[name] = angle._replace(
                    zero_count=device.zero_count, absolute=absolute, ripple=tuple(tone for tone in ripple if tone[1])
                )
            case config.RecordedAngle():
                roles.joints.append(Joint(device.joint, name))
                angle = _scalar(0.0, device.noise_rad, period_s, ANGLE)
                roles.signals[name] = angle._replace(zero_count=device.zero_count)
            case config.RecordedRate():
                roles.joints.append(Joint(device.joint, name, is_rate=True))
                roles.signals[name] = _scalar(0.0, device.noise_rad_s, period_s, RATE)
            case config.RecordedLoadCell():
                roles.cells.append(Cell(name, name, device))
                roles.signals[name] = _force(device, period_s)
            case config.LoadCellDevice():
                channel = next(iter(device.channels(name)))
                roles.cells.append(Cell(name, channel, device))
                roles.signals[channel] = _force(device, period_s)
            case config.NodeFrameDevice():
                _add_node(roles, name, device, period_s)
    return roles


def _add_node(roles: Roles, name: str, device: config.NodeFrameDevice, period_s: float) -> None:
    imu: dict[str, str] = {}
    for part in device.channel:
        channel = f"{name}_{part.name}"
        match part:
            case config.JointChannel():
                roles.joints.append(Joint(part.joint, channel))
                angle = _scalar(part.delay_ms, part.noise_rad, period_s, ANGLE)
                roles.signals[channel] = angle._replace(zero_count=part.zero_count, absolute=part.absolute)
            case config.ForceChannel():
                roles.cells.append(Cell(channel, channel, part))
                roles.signals[channel] = _force(part, period_s)
            case config.GyroChannel():
                imu[f"gyro_{part.axis}"] = channel
                roles.signals[channel] = _scalar(part.delay_ms, part.noise_rad_s, period_s, RATE)
            case config.AccelChannel():
                imu[f"accel_{part.axis}"] = channel
                roles.signals[channel] = _scalar(part.delay_ms, part.noise_m_s2, period_s, SPECIFIC_FORCE)
    if device.frame is not None:
        order = tuple(imu[f"{kind}_{axis}"] for kind in ("gyro", "accel") for axis in "xyz")
        roles.imus.append(Imu(order, device.frame))


def _scalar(delay_ms: float, noise: float, period_s: float, si: Mapping[bytes, float]) -> Signal:
    return Signal((delay_ms * 1e-3,), (noise,), period_s, si)


def _force(keys: config.LoadCellKeys, period_s: float) -> Signal:
    direct = keys.measures == "moment" and keys.lever_m == 1.0
    si = {b"N m": 1.0} if direct else {b"N": 1.0, b"kg": keys.gravity_m_s2}
    return _scalar(keys.delay_ms, keys.noise_N, period_s, si)._replace(limit=keys.capacity_N)


def _imu_delays_s(device: config.ImuDevice) -> tuple[float, float]:
    """Delays of the gyro's and the accelerometer's own filters."""
    match device:
        case config.Mpu6050Device():
            accel_delay_s, gyro_delay_s = MPU6050_FILTER_DELAY_S[device.filter_code]
            return gyro_delay_s, accel_delay_s
        case config.NimuDevice():
            return device.gyro_delay_ms * 1e-3, device.accel_delay_ms * 1e-3
        case _:
            return 0.0, 0.0
