"""Where the fit of a body on a table begins."""

import numpy as np
import pytest

from onboard.identification.body.start import Guess, PoseWindow, state

MASS, CENTRE, INERTIA = 5.0, np.array([0.01, -0.02]), 0.05
PLACE, YAW = np.array([0.03, -0.04]), 0.3
BEGUN = np.array([0.4, -0.2, 1.1, 0.05, 0.08, -0.2])


def flown():
    """A window that begins with a pulse which turns the body by 4 rad/s^2 for 0.4 s: (forces, poses)."""
    step, fine = 0.02, 1e-4
    force = np.zeros((251, 3))  # N, N, N m about the base's origin
    force[:20] = 1.4, 0.3, 0.2
    force[120:150] = -0.7, 0.0, -0.1
    at, rate, poses = BEGUN[:3].copy(), BEGUN[3:].copy(), []
    for k in range(50_000):
        if k % 100 == 0:
            c, s = np.cos(at[2]), np.sin(at[2])
            x, y = PLACE - CENTRE
            poses.append([at[0] + c * x - s * y, at[1] + s * x + c * y, at[2] + YAW])
        fx, fy, moment = force[int((k + 0.5) * fine / step)]
        c, s = np.cos(at[2]), np.sin(at[2])
        about = moment - CENTRE[0] * fy + CENTRE[1] * fx
        rate += fine * np.array([(c * fx - s * fy) / MASS, (s * fx + c * fy) / MASS, about / INERTIA])
        at += fine * rate
    grid_s = step * np.arange(252)
    return PoseWindow(0.01 * np.arange(500), np.array(poses), grid_s, np.zeros(0)), force


def test_a_body_that_turns_quickly_begins_where_all_poses_of_a_window_say():
    """A line through its first poses is off by a half of what the pulse adds, 0.8 rad/s, and the fit went astray."""
    window, force = flown()
    found = state(window, force, Guess(0, MASS, CENTRE, INERTIA), PLACE, YAW)
    assert found == pytest.approx(BEGUN, abs=2e-3)
    some = slice(0, 50)
    line = np.polyfit(window.time_s[some], window.measured[some, 2], 1)
    assert abs(line[0] - BEGUN[5]) > 0.5


def test_a_guess_that_is_a_tenth_off_is_near_enough():
    window, force = flown()
    found = state(window, force, Guess(0, 1.1 * MASS, CENTRE, 1.1 * INERTIA), PLACE, YAW)
    assert found == pytest.approx(BEGUN, abs=0.15)
