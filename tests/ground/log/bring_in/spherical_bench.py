"""Recordings of a body on a spherical air bearing with three reaction wheels, by Euler's equations about the pivot.

``d(J w + h)/dt = c x g - w x (J w + h) - b w``, integrated by SciPy: J about the pivot with the wheels locked, c the
first moment, h what the wheels store by their speeds, b the drag; the attitude is a quaternion. The IMU is off by
zeros, scales and noise. The drawing forgets what balances the wheels: its centre of mass is centimetres off the pivot.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

MASS_kg, COM_m = 24.0, np.array([9e-5, -1.4e-4, -1.3e-3])
INERTIA = np.array([[0.95, 0.01, -0.006], [0.01, 1.10, 0.012], [-0.006, 0.012, 1.45]])
PROOF_kg, PROOF_AT_m = 0.04, np.array([0.3, 0.05, 0.1])
WHEEL, WHEEL_kg = 3e-3, 1.8
RATE_Hz, DRAG, G = 50.0, 2e-4, 9.80665
_IMU_m = np.array([0.12, 0.08, 0.05])
_GYRO_SCALE, _GYRO_ZERO_rad_s = np.array([2e-3, -1e-3, 3e-3]), np.array([4e-3, -6e-3, 2e-3])
_ACCEL_SCALE, _ACCEL_ZERO_m_s2 = np.array([-2e-3, 1e-3, 2e-3]), np.array([0.04, -0.05, 0.06])
_HEAD = "time_s,gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s],acc_x [g],acc_y [g],acc_z [g]"


def _cross(a, b):
    """Of two vectors; NumPy's takes ten times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def run(rng, proof, seconds=45.0):
    """Columns of a recording: time, gyro deg/s, accelerometer g, wheels rev/min."""
    J, c = INERTIA.copy(), MASS_kg * COM_m
    if proof:
        J += PROOF_kg * (PROOF_AT_m @ PROOF_AT_m * np.eye(3) - np.outer(PROOF_AT_m, PROOF_AT_m))
        c = c + PROOF_kg * PROOF_AT_m
    f, phase, size = rng.uniform(0.05, 0.25, (3, 4)), rng.uniform(0.0, 6.0, (3, 4)), rng.uniform(5.0, 12.0, (3, 4))
    turn = 2.0 * np.pi * f

    def wheels(t):
        angle = turn * t + phase
        return (size * (np.sin(angle) - np.sin(phase))).sum(1), (size * turn * np.cos(angle)).sum(1)

    inverse = np.linalg.inv(J)

    def change(t, x):
        (i, j, k, s), w = x[:4], x[4:]
        down = (
            -G
            / (x[:4] @ x[:4])
            * np.array([2.0 * (i * k - j * s), 2.0 * (j * k + i * s), s * s + k * k - i * i - j * j])
        )
        speed, faster = wheels(t)
        torque = _cross(c, down) - DRAG * w - WHEEL * faster - _cross(w, J @ w + WHEEL * speed)
        return np.concatenate([0.5 * (s * w + _cross(x[:3], w)), [-0.5 * x[:3] @ w], inverse @ torque])

    t = np.arange(0.0, seconds, 1.0 / RATE_Hz)
    start = np.append(Rotation.from_rotvec(rng.normal(0.0, 0.05, 3)).as_quat(), np.zeros(3))
    x = solve_ivp(change, (0.0, seconds), start, "DOP853", t, rtol=1e-9, atol=1e-10).y.T
    w, dw = x[:, 4:], np.array([change(*one)[4:] for one in zip(t, x, strict=True)])
    up = Rotation.from_quat(x[:, :4]).as_matrix()[:, 2] * G
    felt = np.cross(dw, _IMU_m) + np.cross(w, np.cross(w, _IMU_m)) + up
    gyro = w * (1.0 + _GYRO_SCALE) + _GYRO_ZERO_rad_s + rng.normal(0.0, 2e-3, w.shape)
    accel = felt * (1.0 + _ACCEL_SCALE) + _ACCEL_ZERO_m_s2 + rng.normal(0.0, 0.05, w.shape)
    speeds = np.array([wheels(one)[0] for one in t]) + rng.normal(0.0, 0.02, w.shape)
    return np.column_stack([t, np.rad2deg(gyro), accel / G, speeds * 30.0 / np.pi])


def write(path, rows, wheels):
    """One recording; ``wheels`` are the names of the last columns, with commas."""
    np.savetxt(path, rows, delimiter=",", header=f"{_HEAD},{wheels}", comments="", fmt="%.6f")


def urdf():
    """The body as it was drawn."""

    def link(name, mass, moments):
        ixx, iyy, izz = moments
        inertia = f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>'
        return f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'

    def joint(name, kind, child, place, axis="1 0 0"):
        ends = f'<parent link="platform"/><child link="{child}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}</joint>'

    text = link("platform", MASS_kg - 3.0 * WHEEL_kg, (0.8, 1.0, 1.3))
    for k, place in enumerate(("0.2 0 -0.05", "0 0.2 -0.05", "0 0 0.1")):
        name, axis = "xyz"[k], " ".join("01"[n == k] for n in range(3))
        text += link(f"disc_{name}", WHEEL_kg, np.where(np.arange(3) == k, WHEEL, 0.6 * WHEEL))
        text += joint(f"wheel_{name}", "continuous", f"disc_{name}", place, axis)
    text += '<link name="imu"/>' + joint("imu_mount", "fixed", "imu", " ".join(map(str, _IMU_m)))
    text += link("proof", PROOF_kg, (1e-6,) * 3) + joint("pin", "fixed", "proof", " ".join(map(str, PROOF_AT_m)))
    return f'<robot name="bed">{text}</robot>'
