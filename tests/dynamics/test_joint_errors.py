"""Readings of encoders with errors taken out, against the motion that they were made from."""

import numpy as np

from onboard.dynamics.joint_errors import EncoderReadings

PERIOD_s = 1e-3
TURNS = 100.0  # of the motor in one of the joint


def test_a_late_encoder_behind_a_gear_shows_the_motion_and_not_its_ripple() -> None:
    """2 ms times the acceleration of a ripple of 50 urad would be 160 urad/s, 70 times what is left."""
    at_s, late_s, ripple_rad = PERIOD_s * np.arange(400), 2e-3, 5e-5

    def motion(time_s: np.ndarray) -> np.ndarray:
        return np.array([0.4 * np.sin(time_s), 0.4 * np.cos(time_s), -0.4 * np.sin(time_s)])[..., None]

    def waves(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        sine, cosine = np.sin(TURNS * q), TURNS * np.cos(TURNS * q)
        return np.stack([sine, cosine * dq, cosine * ddq - TURNS**2 * sine * dq**2], axis=1)

    told = motion(at_s - late_s)
    functions = waves(*told)
    q, dq, ddq = told + ripple_rad * functions.swapaxes(0, 1)
    errors = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, late_s]])
    read = EncoderReadings(q, dq, ddq, PERIOD_s, functions)
    found = read.corrected(errors, np.array([-ripple_rad]), np.zeros(1, np.intp))
    for one, true in zip(found[:3], motion(at_s), strict=True):
        assert np.abs(one - true)[2:-2].max() < 0.6 * late_s**2  # of second order
