"""The arm on the bench: what its wrist carries by hand calculation, what its cell makes of that."""

import numpy as np
import pytest

from hil_sim.plants import fixed_arm
from hil_sim.plants.free_flyer import Body, JointMotion

TOOL = Body.box(0.7, (0.3, 0.1, 0.03), (0.01, 0.15, 0.02))
WEIGHT = 9.80665
STILL = JointMotion(*(np.zeros(shape) for shape in ((5,), (5, 1), (5, 1), (5, 1))))


def test_at_rest_the_wrist_carries_the_weight_where_it_is():
    flown = fixed_arm.run(TOOL, STILL, 0.01, 0.02)
    g = fixed_arm.GRIPPER
    assert flown.held.tolist() == [False] * 5 + [True] * 5
    both = g.mass_kg + TOOL.mass_kg
    centre = TOOL.centre_of_mass_m + fixed_arm.TOOL_m
    alone = np.cross(g.centre_of_mass_m, [0, 0, g.mass_kg * WEIGHT])
    held = alone + np.cross(centre, [0, 0, TOOL.mass_kg * WEIGHT])
    np.testing.assert_allclose(flown.wrench[0], [0, 0, g.mass_kg * WEIGHT, *alone], atol=1e-12)
    np.testing.assert_allclose(flown.wrench[-1], [0, 0, both * WEIGHT, *held], atol=1e-12)


def test_a_turning_wrist_carries_what_inertia_asks_for():
    """Only the last joint moves, about the vertical, the arm upright: moment about it = I_zz times its acceleration."""
    motion = JointMotion(np.zeros(5), np.diag([0, 0, 0, 0, 0.3])[:, 4:], np.full((5, 1), 4.0), np.zeros((5, 1)))
    flown = fixed_arm.run(TOOL, motion, 0.0, 0.5)
    bodies = [(fixed_arm.GRIPPER, np.zeros(3)), (TOOL, np.array(fixed_arm.TOOL_m))]
    about_axis = sum(b.inertia_kg_m2[2, 2] + b.mass_kg * ((b.centre_of_mass_m + p)[:2] ** 2).sum() for b, p in bodies)
    np.testing.assert_allclose(flown.wrench[:, 5], about_axis * motion.at(flown.time_s)[2][:, 4], atol=1e-12)


def test_readings_have_the_errors_that_were_asked_for(rng):
    flown = fixed_arm.run(TOOL, STILL, 0.0, 8.0)
    errors = fixed_arm.WristErrors(noise=(0.02, 1e-3), step=(0.01, 5e-4), bias=(0.0, 0.0), scale=0.0)
    readings = fixed_arm.read(flown, errors, rng)
    off = readings.wrench - flown.wrench
    np.testing.assert_allclose(off.std(axis=0), readings.noise, rtol=0.05)
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=1e-3)
    counts = readings.wrench / np.repeat(errors.step, 3)
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
    assert np.abs(readings.angle_rad - flown.q_rad).max() <= 0.5 * fixed_arm.COUNT_rad


def test_bias_and_scale_stay_the_same_for_a_run(rng):
    flown = fixed_arm.run(TOOL, STILL, 0.5, 1.0)
    exact = fixed_arm.WristErrors(noise=(0.0, 0.0), step=(1e-9, 1e-9), bias=(0.5, 0.02), scale=0.01)
    read = fixed_arm.read(flown, exact, rng).wrench
    before, after = read[0] - flown.wrench[0], read[-1] - flown.wrench[-1]
    loaded = [2, 3, 4]  # the weight and its moments
    gained = (after - before)[loaded] / (flown.wrench[-1] - flown.wrench[0])[loaded]
    assert 1e-4 < np.abs(gained).max() < 0.05
    assert before[0] == pytest.approx(after[0])  # nothing pulls sideways: the bias alone
    assert abs(before[0]) > 1e-3
