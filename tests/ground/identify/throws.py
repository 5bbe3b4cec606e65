"""Made-up throws of a body with a spinning wheel, as logs: Euler's equations integrated, sensors as counts."""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from drivers.records import IMU, SCALAR
from onboard.recording.writer import LogWriter

WHEEL = 1.68698e-6  # about its axis, which is body -z: the URDF's
AXIS = np.array([0.0, 0.0, -1.0])
PERIOD_NS = 248_000
SPUN_UP_RAD_S = 900.0


def fly(inertia, centre, w0, duration_s=0.78):
    """Times (k,), rate (k, 3), specific force (k, 3) at the IMU, wheel rate (k,); ``centre``: of mass, from the IMU."""
    t = np.arange(0, duration_s, PERIOD_NS * 1e-9)

    def wheel(time):
        x = np.clip((time - 0.15) / 0.3, 0.0, None)
        return SPUN_UP_RAD_S * (1 - np.exp(-3 * x)), SPUN_UP_RAD_S * 10 * np.exp(-3 * x) * (x > 0)

    inverse = np.linalg.inv(inertia)

    def acceleration(time, w):  # (3,) or (3, k)
        s, ds = wheel(time)
        h = inertia @ w + np.multiply.outer(AXIS, WHEEL * s)
        moment = np.array([w[2] * h[1] - w[1] * h[2], w[0] * h[2] - w[2] * h[0], w[1] * h[0] - w[0] * h[1]])
        return inverse @ (moment - np.multiply.outer(AXIS, WHEEL * ds))

    w = solve_ivp(acceleration, (0, t[-1]), w0, t_eval=t, rtol=1e-10, atol=1e-10).y
    w, dw = w.T, acceleration(t, w).T
    return t, w, -np.cross(dw, centre) - np.cross(w, np.cross(w, centre)), wheel(t)[0]


def write(path: Path, inertia, centre, w0, rng=None, noise=(0.02, 1.0, 5.0), start_ns=7_000_000_123, rate="wheel_rate"):
    """A log of one throw. ``noise``: of gyro, accelerometer, wheel rate; none without ``rng``."""
    t, w, f, s = fly(np.asarray(inertia), np.asarray(centre), w0)
    if rng is not None:
        w, f, s = (v + sigma * rng.normal(size=v.shape) for v, sigma in zip((w, f, s), noise, strict=True))
    host_ns = start_ns + PERIOD_NS * np.arange(t.size)
    imu, wheel = np.zeros(t.size, IMU), np.zeros(t.size, SCALAR)
    for rows in imu, wheel:
        rows["sequence"] = rows["tick"] = np.arange(t.size)
        rows["host_ns"] = host_ns
    gyro, accel = np.float32(np.abs(w).max() / 32000), np.float32(np.abs(f).max() / 32000)
    imu["gyro_scale_rad_s"], imu["accel_scale_m_s2"] = gyro, accel
    imu["gyro_raw"], imu["accel_raw"] = np.rint(w / gyro), np.rint(f / accel)
    wheel["scale"], wheel["unit"] = 1.496 if rng is not None else 1e-4, b"rad/s"
    wheel["value_raw"] = np.rint(s / wheel["scale"])
    with LogWriter.create(path, durable=False, overwrite=True) as writer:
        writer.register(rate, SCALAR)
        writer.register("imu_base", IMU)
        for first in range(0, t.size, 300):  # wheel rows well ahead of the IMU's, as no flight would write them
            writer.write(rate, wheel[2 * first : 2 * first + 600])
            writer.write("imu_base", imu[first : first + 300])
    return path
