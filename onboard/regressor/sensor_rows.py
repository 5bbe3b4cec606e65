"""Rows of motor currents, and base motion from IMUs on any link."""

import numpy as np
from numpy.typing import ArrayLike

from onboard.dynamics.errors import SignalError
from onboard.dynamics.kinematics import cross, frame_motions, turned
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.regressor.rows import BaseMotion


def base_motion_from_link(
    vehicle: VehicleModel, imu_frame: str, joints: tuple[FloatArray, FloatArray, FloatArray], imu: BaseMotion
) -> BaseMotion:
    """Motion of the base frame from an IMU on any link, by relative kinematics (:func:`frame_motions`).

    Args:
        vehicle: gives the IMU's place.
        imu_frame: name of the IMU's frame.
        joints: positions, rates, accelerations, (n, joints) each.
        imu: rate, angular acceleration and specific force at the IMU, (n, 3) each, in its axes.

    Raises:
        UnknownFrameError: no such frame.
        SignalError: shapes that do not fit.
    """
    (at,) = frame_motions(vehicle, [imu_frame], *joints)
    rate, acceleration, force = (turned(at.R, _three(v, len(at.p))) for v in imu)
    w = rate - at.w
    dw = acceleration - at.dw - cross(w, at.w)
    return BaseMotion(w, dw, force - at.a - cross(dw, at.p) - cross(w, cross(w, at.p) + 2.0 * at.v))


def imu_on_link(
    vehicle: VehicleModel, imu_frame: str, joints: tuple[FloatArray, FloatArray, FloatArray], motion: BaseMotion
) -> BaseMotion:
    """True input of an IMU on any link, (n, 3) each, in its axes: the inverse of :func:`base_motion_from_link`.

    Raises:
        UnknownFrameError: no such frame.
        SignalError: shapes that do not fit.
    """
    (at,) = frame_motions(vehicle, [imu_frame], *joints)
    w, dw, f = (_three(v, len(at.p)) for v in motion)
    felt = (
        w + at.w,
        dw + at.dw + cross(w, at.w),
        f + at.a + cross(dw, at.p) + cross(w, cross(w, at.p) + 2.0 * at.v),
    )
    Rt = at.R.swapaxes(-1, -2)
    return BaseMotion(*(turned(Rt, v) for v in felt))


def _three(values: ArrayLike, ticks: int) -> FloatArray:
    out = np.asarray(values, np.float64)
    if out.shape != (ticks, 3):
        raise SignalError(f"motion of shape {out.shape} for {ticks} ticks of the joints; give ({ticks}, 3) each")
    return out
