"""Poses that no body can have."""

import numpy as np
import pytest

from onboard.identification.body.glitches import glitches

NOISE = np.array([5e-4, 5e-4, 1e-3])
T = 0.01 * np.arange(1000)


def poses():
    own = np.stack([0.3 * np.sin(0.2 * T), 0.2 * np.cos(0.3 * T), 3.0 * np.sin(0.2 * T)], axis=1)
    return own + NOISE * np.random.default_rng(1).normal(size=own.shape)


@pytest.mark.parametrize("yaw", [0.0, 2.0 * np.pi])
def test_a_body_that_moves_jumps_nowhere(yaw):
    measured = poses()
    measured[400:, 2] += yaw
    found = glitches(T, measured, NOISE)
    assert found.good.all()
    assert (found.moved, found.lost) == ((), 0)


@pytest.mark.parametrize(("count", "left_out"), [(1, True), (60, True), (150, False)])
def test_most_of_a_jump_is_taken_back_in_a_second(count, left_out):
    measured = poses()
    measured[500 : 500 + count] += [0.1, 0.0, 0.0]
    found = glitches(T, measured, NOISE)
    assert np.flatnonzero(~found.good).tolist() == (list(range(500, 500 + count)) if left_out else [])
    assert len(found.moved) == (0 if left_out else 2)
    assert found.lost == count * left_out
    if not left_out:
        assert found.moved[0] == pytest.approx((4.99, 5.0, 0.1), abs=3e-3)


def test_a_jump_that_comes_back_by_a_third_stays():
    measured = poses()
    measured[500:] += [0.1, 0.0, 0.0]
    measured[520:] -= [0.03, 0.0, 0.0]
    found = glitches(T, measured, NOISE)
    assert found.good.all()
    assert [round(far, 1) for *_, far in found.moved] == [0.1, 0.0]


@pytest.mark.parametrize("between", [2, 4])
def test_where_no_pose_came_the_body_may_have_moved(between):
    measured, kept = poses(), np.ones(1000, np.bool_)
    measured[500:] += [0.1, 0.0, 0.0]
    kept[500 : 499 + between] = False
    assert len(glitches(T[kept], measured[kept], NOISE).moved) == (between == 2)


@pytest.mark.parametrize(("count", "is_lost"), [(5, False), (12, True), (400, True)])
def test_one_pose_for_long_is_none_of_the_body(count, is_lost):
    measured = poses()
    measured[1000 - count :] = 0.1
    found = glitches(T, measured, NOISE)
    assert (~found.good).sum() == count * is_lost
    assert len(found.moved) == (not is_lost)


def test_a_body_that_is_seen_again_goes_on():
    measured = poses()
    measured[500:800] = 0.0
    found = glitches(T, measured, NOISE)
    assert np.flatnonzero(~found.good).tolist() == list(range(500, 800))
    assert (found.moved, found.lost) == ((), 1)


def test_few_poses_are_not_looked_at():
    assert glitches(T[:9], poses()[:9], NOISE).good.all()
