"""The motion of a trial: continuous, closed, and within every limit."""

import numpy as np
import pytest

from onboard.control.motion import JointLimits, Motion, fitted
from onboard.control.watch import astray, diverges

WIDE = JointLimits(*(np.full(3, value) for value in (-3.0, 3.0, 2.0, 50.0)))


def test_rates_are_derivatives_and_trials_follow_each_other():
    motion = Motion(np.array([0.1, -0.4, 0.0]), np.array([0.3, 0.2, 0.25]), 4.0, 1.0)
    time_s = np.linspace(0.0, motion.seconds, 50_001)
    q, dq, ddq = motion.at(time_s)
    step = time_s[1]
    np.testing.assert_allclose(np.gradient(q, step, axis=0), dq, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(np.gradient(dq, step, axis=0)[2:-2], ddq[2:-2], rtol=0.0, atol=1e-3)
    for rows in (dq, ddq):
        assert rows[[0, -1]] == pytest.approx(np.zeros((2, 3)), abs=1e-12)
    assert q[[0, -1]] == pytest.approx(np.tile(motion.start_rad, (2, 1)), abs=1e-12)
    assert np.ptp(q, axis=0).min() > 0.2


@pytest.mark.parametrize(
    "tight", [WIDE._replace(low=np.array([-0.1, -3.0, -3.0])), WIDE._replace(speed=np.full(3, 0.2)), WIDE]
)
def test_it_stays_within_the_limits(tight):
    inertia = np.diag([30.0, 2.0, 0.1])
    made = fitted(np.zeros(3), tight, inertia, 4.0, 1.0)
    q, dq, ddq = made.at(np.linspace(0.0, 5.0, 1001))
    assert ((q > tight.low) & (q < tight.high)).all()
    assert (np.abs(dq) <= 0.5001 * tight.speed).all()
    assert (np.abs(ddq @ inertia) <= 0.2001 * tight.effort).all()
    assert (np.abs(made.amplitude_rad) > 1e-3).all()


def test_an_arm_outside_its_limits_is_refused():
    with pytest.raises(ValueError, match="joint 2 stands outside"):
        fitted(np.array([0.0, 3.5, 0.0]), WIDE, np.eye(3), 4.0, 1.0)


@pytest.mark.parametrize(
    ("errors", "stops"),
    [
        ([1.0, 0.5, 0.3, 0.2], False),
        ([1.0, 0.2, 0.25, 0.22, 0.24, 0.21], False),  # at the floor of noise
        ([0.1, 0.11, 0.12, 0.13], False),  # not yet twice the best
        ([1.0, 0.1, 0.15, 0.2, 0.3], True),
        ([0.1, 0.2, 0.4], False),  # two rises
        ([0.1, 0.2, 0.4, 0.8], True),
    ],
)
def test_growing_errors_end_the_trials(errors, stops):
    assert bool(diverges(errors)) is stops


def test_a_joint_astray_is_named():
    assert astray(np.array([0.1, -0.8]), ["a", "b"]) == "b is 46 deg from where it should be"
    assert astray(np.array([0.4, -0.4]), ["a", "b"]) == ""
    assert "no number" in astray(np.array([np.nan, 0.0]), ["a", "b"])
