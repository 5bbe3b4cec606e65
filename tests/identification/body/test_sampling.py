"""What a recorder does that samples commands, and how the prediction depends on when they came."""

import numpy as np
import pytest

from onboard.dynamics.floating import Floating, predict_floating
from onboard.identification.body.sampling import DrivenWindow, by_steps, lateness, whitener
from onboard.identification.body.stated import Edges, Opening, Valve

STEP, STEPS = 0.02, 100
EACH = np.array([[0.08, 0.03, 0.6], [-0.02, 0.05, -0.9]])  # accelerations by two thrusters, m/s^2, rad/s^2
LEVER = np.array([0.05, -0.03])
GRID = STEP * np.arange(STEPS + 1)


def flown(pulses):
    """(states, force) under pulses of two thrusters, the n-th of which is on from and to some times."""
    force, ahead = np.zeros((2, 3, STEPS))
    for (on, off), own in zip(pulses, EACH, strict=True):
        once, twice = Valve(np.array([-1.0, on, off]), np.array([0.0, 1.0, 0.0])).integrals(
            GRID, Opening(0.0, 0.0, 0.0)
        )
        force += own[:, None] * np.diff(once) / STEP
        ahead += own[:, None] * (np.diff(twice) - 0.5 * STEP * (once[1:] + once[:-1]))
    body = Floating(
        force[:2].T[:, :, None, None],
        force[2][:, None, None],
        ahead.T[:, :, None, None],
        np.zeros((3, 1, 1)),
        np.zeros((2, 1, 1)),
    )
    begun = np.array([0.0, 0.0, 0.4, 0.01, -0.02, 0.1])[:, None, None]
    return predict_floating(body, begun, STEP)[:, :, 0, 0], force


def poses(pulses):
    """Of the tracked frame at the grid, (n + 1, 3)."""
    states, _ = flown(pulses)
    c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
    lever = np.stack([c * LEVER[0] - s * LEVER[1], s * LEVER[0] + c * LEVER[1], 0.0 * c], axis=1)
    return states[:, :3] + lever


def test_forces_that_step_within_a_step_leave_the_body_where_they_do():
    states, _ = flown([(0.107, 0.495), (0.6, 0.6)])
    t, turned = GRID[-1], EACH[0, 2]
    assert states[-1, 5] == pytest.approx(0.1 + turned * 0.388, abs=1e-12)
    assert states[-1, 2] == pytest.approx(0.4 + 0.1 * t + turned * (0.5 * 0.388**2 + 0.388 * (t - 0.495)), abs=1e-12)


def test_the_motion_has_no_kink_where_a_pulse_begins_at_the_end_of_a_step():
    """One of 7 um/s times the step stood there, and fits of commands on the grid's times did not settle."""
    tiny = 1e-4
    before, at, after = (poses([(0.2 + shift, 0.5 + shift), (2.0, 2.0)]) for shift in (-tiny, 0.0, tiny))
    assert np.abs(after - at).max() > 1e-6
    assert np.abs((after - at) - (at - before))[:, 2].max() < 2.0 * 0.6 * tiny**2


def test_by_steps_is_the_difference_of_predictions():
    pulses, late = [(0.113, 0.52), (0.3, 0.9)], 0.01
    states, force = flown(pulses)
    steps = [Edges(np.array(pulse), np.array([1.0, -1.0]), np.full(2, late)) for pulse in pulses]
    found = by_steps(DrivenWindow(GRID, states[:, 2], force[:2].T, LEVER), steps, EACH, GRID)
    assert found.shape == (STEPS + 1, 3, 4)
    small = 1e-5
    for k, (j, end) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1)]):
        moved = [[*pulse] for pulse in pulses]
        moved[j][end] += small
        expected = (poses(moved) - poses(pulses)) * late / np.sqrt(12.0) / small
        assert found[:, :, k] == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


def test_whitened_lines_share_no_noise(rng):
    G = rng.normal(size=(30, 4)) * [3.0, 1.0, 0.3, 1.0]
    white = whitener(G.reshape(10, 3, 4))
    root = white.of(np.eye(30))
    covariance = root @ (np.eye(30) + G @ G.T) @ root.T
    assert covariance == pytest.approx(np.eye(30), abs=1e-9)
    assert white.log_determinant == pytest.approx(np.linalg.slogdet(np.eye(30) + G @ G.T)[1])


def test_noise_of_less_than_a_tenth_of_the_poses_is_left_as_it_is():
    """It would make their sigmas half a per cent larger."""
    white = whitener(np.diag([1.0, 0.15, 0.09])[:, :, None].transpose(0, 2, 1).repeat(3, axis=1) / np.sqrt(3.0))
    assert white.w == pytest.approx(1.0 - 1.0 / np.sqrt([2.0, 1.0 + 0.15**2]))


def test_lateness():
    scattered, with_the_sample = lateness(0.01, True, 0.0), lateness(0.01, False, 0.004)
    assert scattered == pytest.approx((0.005, 0.0025, 0.0025, 0.0025 / np.sqrt(3.0)))
    assert with_the_sample[:3] == pytest.approx((0.0, 0.002, 0.012))
    assert with_the_sample.sigma_s == pytest.approx(np.hypot(0.01, 0.002) / np.sqrt(3.0))
