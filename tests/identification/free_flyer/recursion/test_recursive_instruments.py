"""Ticks that are missing, wrong or noisier than stated, IMU or joints: left out or shown, and no alarm."""

import pickle

import numpy as np
import pytest

from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, LONGEST_s
from tests.identification.free_flyer.recorded_flights import online, ticks_of


def test_ticks_without_an_imu_carry_the_momentum_on(held):
    ticks = ticks_of(held)
    ticks.measured[450:520] = np.nan
    recursive = online(held)
    recursive.update(ticks)
    assert recursive.changes == []
    assert recursive.ticks_used == 398 + (len(ticks.time_s) - 400) // BATCH_TICKS * BATCH_TICKS - 70
    found = recursive.estimate()
    assert abs(found.body.mass_kg - 5.0) < 4.0 * np.sqrt(found.covariance[0, 0])


def test_when_joints_and_imu_are_missing_nothing_is_said_until_the_momentum_is_found_again(held):
    ticks, recursive = ticks_of(held), online(held)
    end = 504 + round(LONGEST_s / held.period_s)
    ticks.q[504:end] = np.nan
    ticks.measured[490:end] = np.nan
    recursive.update(ticks.part(slice(0, 502)))
    assert recursive.estimate() is not None
    recursive.update(ticks.part(slice(502, end + 1)))
    assert recursive.estimate() is None
    recursive.update(ticks.part(slice(end + 1, None)))
    assert recursive.changes == []
    assert abs(recursive.estimate().body.mass_kg - 5.0) < 4.0 * np.sqrt(recursive.estimate().covariance[0, 0])


@pytest.mark.parametrize("lost", [3, 60, 150])
def test_missing_joints_cost_the_readings_beside_them_and_after_a_long_time_the_momentum(held, lost):
    ticks, recursive = ticks_of(held), online(held)
    recursive.update(ticks.part(slice(0, 502)))
    before = np.diag(recursive.covariance).copy()
    ticks.dq[502 : 502 + lost, 2] = np.nan
    recursive.update(ticks.part(slice(502, 502 + lost + 1)))
    if lost * held.period_s < LONGEST_s:
        assert recursive.estimate() is not None
        np.testing.assert_allclose(np.diag(recursive.covariance)[PAYLOAD], before[PAYLOAD], rtol=0.05)
    else:
        assert recursive.estimate() is None
    recursive.update(ticks.part(slice(502 + lost + 1, None)))
    assert recursive.changes == []
    found = recursive.estimate()
    assert abs(found.body.mass_kg - 5.0) < 4.0 * np.sqrt(found.covariance[0, 0])
    assert found.covariance[0, 0] < before[3]


def test_a_rate_of_which_nothing_is_known_begins_a_window_and_the_payload_is_found_again(held):
    ticks, recursive = ticks_of(held), online(held)
    recursive.update(ticks.part(slice(0, 502)))
    recursive.covariance[RATE, RATE] = 1e12 * np.eye(3)  # as by steps along a motion that no such vehicle makes
    recursive.update(ticks.part(slice(502, 514)))
    assert recursive.estimate() is None
    assert recursive.glitches == BATCH_TICKS
    recursive.update(ticks.part(slice(514, None)))
    assert recursive.changes == []
    found = recursive.estimate()
    assert abs(found.body.mass_kg - 5.0) < 4.0 * np.sqrt(found.covariance[0, 0])


def test_a_glitch_is_left_out_and_no_alarm(held):
    ticks, clean = ticks_of(held), online(held)
    clean.update(ticks)
    ticks.measured[50, 1] += 0.05  # in the first window
    ticks.measured[555, 4] -= 30.0
    recursive = online(held)
    recursive.update(ticks)
    assert recursive.glitches == 2
    assert recursive.changes == []
    sigma = np.sqrt(np.diag(clean.covariance))
    assert (np.abs(recursive.state - clean.state) < 0.5 * sigma).all()


def test_an_innovation_that_is_too_large_shows_by_instrument(held):
    ticks, clean = ticks_of(held), online(held)
    clean.update(ticks)
    assert set(clean.misfit.by_instrument()) == {"imu", "gyro", "accelerometer"}
    assert all(0.9 < ratio < 1.1 for ratio in clean.misfit.by_instrument().values())
    noisier = ticks.measured.copy()
    noisier[450:, :3] += 0.35 * ticks.sigma[450:, :3] * np.random.default_rng(1).normal(size=(len(noisier) - 450, 3))
    spoilt = online(held)
    spoilt.update(ticks._replace(measured=noisier))
    assert spoilt.changes == []
    assert spoilt.misfit.by_instrument()["gyro"] > 1.08
    assert spoilt.misfit.by_instrument()["accelerometer"] < 1.05


def test_a_batch_that_is_suspect_is_not_taken_in(held):
    ticks, recursive = ticks_of(held), online(held)
    recursive.update(ticks.part(slice(0, 500)))
    batch = ticks.part(slice(500, 510))
    outcomes = []
    for scale in np.linspace(0.0, 3.0, 31):
        again = pickle.loads(pickle.dumps(recursive))
        again.update(batch._replace(measured=batch.measured + scale * batch.sigma * [1, -1, 1, -1, 1, -1]))
        outcomes.append("alarm" if again.changes else again.ticks_used - recursive.ticks_used)
    assert outcomes[0] == 10
    assert outcomes[-1] == "alarm"
    assert 0 in outcomes  # large, and not large enough for an alarm: it may be the beginning of something


def test_noise_of_the_joints_that_is_told_is_no_change(held):
    rng = np.random.default_rng(4)
    ticks, sigma = ticks_of(held), np.full((len(held.q), 2, 5), [[[2e-3], [0.05]]])
    dq, ddq = np.moveaxis(sigma * rng.normal(size=sigma.shape), 1, 0)
    noisy = ticks._replace(dq=ticks.dq + dq, ddq=ticks.ddq + ddq)
    trusting, knowing = online(held), online(held)
    trusting.update(noisy.part(slice(0, 100)))
    knowing.update(noisy._replace(joint_sigma=sigma))
    assert trusting.estimate() is None  # nothing explains its window
    assert knowing.changes == []
    found = knowing.estimate()
    assert abs(found.body.mass_kg - 5.0) < 3.0 * np.sqrt(found.covariance[0, 0]) < 0.5
