"""Innovations of a batch: whitened by all that lines have in common, with and without noise of the joints."""

import numpy as np

from onboard.identification.free_flyer.innovation import TickBatch
from onboard.identification.free_flyer.prediction.further import CellPrior, FurtherCell
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.prediction.joint_noise import LineNoise, NoiseCorrection
from tests.identification.free_flyer.recorded_flights import PRIOR, online, ticks_of


def test_an_innovation_is_whitened_by_the_covariance_of_state_and_lines(held, rng):
    """One joint's error is in all lines of a tick, of the IMU and of a cell, which is silent once."""
    cell = FurtherCell("cell", "link_5", (0.6, 0.5, 0.2, 0.3, -0.7, 0.9), 5, CellPrior(0.03, 1e-4, 0.0025, 2e-4))
    ekf = online(held, imu_prior=PRIOR, further=[cell])
    predictor, ticks, p, n = ekf.predictor, ticks_of(held).part(slice(300, 312)), len(ekf.covariance), 10
    state, m = np.zeros(p), predictor.lines[-1].stop
    state[PAYLOAD] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    predicted = predictor.predict(ticks.q, ticks.dq, ticks.ddq, state)
    root = rng.standard_normal((p, p)) * 0.01 * np.nan_to_num(predictor.sigma, nan=1.0)[:, None]
    noise = LineNoise.of(rng.uniform(0.1, 0.3, (n, m)), rng.standard_normal((n, 2 * 5, m)))
    shift, most = rng.standard_normal(p), rng.standard_normal((p, 2))
    correction = NoiseCorrection(shift, np.zeros(p), most, most)
    off, there = rng.standard_normal((n, m)), np.ones((n, m), np.bool_)
    there[3, 6] = False
    batch = TickBatch(predicted, predicted.values + off, noise, ticks.time_s[1:-1], correction)
    found = ekf.innovations.of(batch, there, ekf.fusion.order, root @ root.T)
    rows = ekf.fusion.rows(ekf.fusion.order, n)
    assert sorted(rows) == list(range(n * m))
    assert (np.diff(rows) != 1).any()  # of each instrument together
    H, used, sigma = predicted.jacobian.reshape(n * m, p)[rows], there.ravel()[rows], noise.sigma.ravel()[rows]
    of_lines = np.zeros((n, m, n, m))
    own = noise.sigma**2 - (noise.by_joint**2).sum(axis=1)
    for k in range(n):
        of_lines[k, :, k] = noise.by_joint[k].T @ noise.by_joint[k] + np.diag(own[k])
    S = H @ root @ root.T @ H.T + of_lines.reshape(n * m, n * m)[np.ix_(rows, rows)]
    some = np.ix_(used, used)
    np.testing.assert_allclose((np.outer(sigma, sigma) * (found.L @ found.L.T))[some], S[some], atol=1e-9)
    for shown, expected in (
        (found.e, off.ravel()[rows]),
        (found.e - found.corrected_e, H @ shift),
        (found.doubt, H @ most),
        (found.W, H @ root @ root.T),
    ):
        np.testing.assert_allclose(((found.L @ shown).T * sigma).T[used], expected[used], atol=1e-9)
    assert not found.e[~used].any()
