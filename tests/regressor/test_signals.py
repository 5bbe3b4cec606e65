"""Noise of smoothed joints: an encoder at rest repeats its count and has none."""

import numpy as np
import pytest

from onboard.estimation.smoothing import SmoothingWindow
from onboard.regressor.signals import noise_of_joints

COUNT = 2.0 * np.pi / 500_000
AT_S = np.arange(0.2, 1.8, 0.01)


def smoothed(angle_rad, rng):
    """Rates and accelerations of a joint from its counts every 5 ms, (n, 1)."""
    t = np.arange(0.0, 2.0, 0.005) + 1e-5 * rng.uniform(-1.0, 1.0, 400)
    counts = COUNT * np.rint(angle_rad(t) / COUNT)
    _, dq, ddq = SmoothingWindow(t, AT_S, 0.1).derivatives(counts[:, None], range(3))
    return dq.values, ddq.values


@pytest.mark.parametrize("angle_rad", [0.0, 0.4, -900.0])
def test_a_joint_at_rest_has_no_noise_of_rate_and_acceleration(rng, angle_rad):
    dq, ddq = smoothed(lambda t: np.full_like(t, angle_rad), rng)
    q, of_dq, of_ddq = noise_of_joints(np.ones((3, AT_S.size, 1)), dq, ddq)
    assert (q == 1.0).all()
    assert not of_dq.any()
    assert not of_ddq.any()


def test_a_joint_that_creeps_or_rests_for_less_than_the_kernel_keeps_it(rng):
    moves = AT_S > 1.05  # half a kernel after the creep begins; before 0.95 s nothing moves
    dq, ddq = smoothed(lambda t: 0.4 + 0.002 * np.maximum(t - 1.0, 0.0), rng)
    _, of_dq, of_ddq = noise_of_joints(np.ones((3, AT_S.size, 1)), dq, ddq)
    for found in (of_dq, of_ddq):
        assert (found[moves] == 1.0).all()
        assert not found[AT_S < 0.94].any()
