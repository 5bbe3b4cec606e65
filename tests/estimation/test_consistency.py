"""Intervals that cover: Monte Carlo on correlated rows, noisy regressors and common causes; laws of the block store."""

import numpy as np
import pytest
from scipy.special import stdtrit

from onboard.estimation.errors import RowError, SingularError
from onboard.estimation.recursive.consistency import BlockScores, JackknifeEstimate, NoiseScale, noise_scale
from onboard.estimation.recursive.least_squares import RecursiveLeastSquares
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.estimation.smoothing import smooth
from onboard.identification.evidence.mixture import Mixture

WIDTH_S, PERIOD_S = 0.1, 0.01


def estimate(times, Y, y, sigma, prior, considered=None, noise=None, block_s=5 * WIDTH_S, capacity=64):
    C, considered_sigma = considered if considered else (None, ())
    rls = SquareRootRls(Y.shape[1], 0 if C is None else C.shape[1])
    rls.prior(*prior)
    rls.update(Y, y, sigma, C)
    blocks = BlockScores(Y.shape[1], block_s, capacity)
    blocks.add(times, Y, y, sigma, noise)
    return JackknifeEstimate(rls, blocks, considered_sigma)


def motion(times):
    return np.column_stack([np.sin(2 * np.pi * 0.4 * times), np.cos(2 * np.pi * 0.7 * times), np.ones(times.size)])


PRIOR = (np.zeros(3), np.full(3, 100.0))
TRUTH = np.array([2.0, -1.0, 0.5])


def coverage(draw, runs=300):
    """Share of runs whose 95 % interval holds the truth, by parameter; and of the formal covariance's interval."""
    covered, formal = np.zeros(3), np.zeros(3)
    for _ in range(runs):
        found, truth = draw()
        interval = found.combination(np.eye(3))
        covered += (interval.low <= truth) & (truth <= interval.high)
        formal += np.abs(found.mean - truth) <= 1.96 * np.sqrt(found.formal_variance(np.eye(3)))
    return covered / runs, formal / runs


def test_filtered_noise_is_covered_where_the_formal_interval_is_not(rng):
    """Rows through the smoothing kernel, weighted as if they were independent: formal 95 % holds half the time."""
    t = np.arange(0, 12, 0.005)
    at = np.arange(0.2, 11.8, PERIOD_S)
    Y = motion(at)

    def draw():
        noise = smooth(t, 0.3 * rng.normal(size=t.size), at, WIDTH_S)
        sigma = 0.3 * noise.noise_gain
        return estimate(at, Y, Y @ TRUTH + noise.values[:, 0], sigma, PRIOR), TRUTH

    covered, formal = coverage(draw)
    assert (formal < 0.9).all()
    assert ((covered >= 0.92) & (covered <= 0.99)).all(), covered


def test_slow_errors_that_no_sigma_told_of_are_covered(rng):
    at = np.arange(0, 30, PERIOD_S)
    Y = motion(at)

    def draw():
        slow = np.convolve(rng.normal(size=at.size + 40), np.ones(40) / 40, mode="valid")[: at.size]
        y = Y @ TRUTH + slow + 0.01 * rng.normal(size=at.size)
        return estimate(at, Y, y, np.full(at.size, 0.01), PRIOR), TRUTH

    covered, formal = coverage(draw, 200)
    assert (formal < 0.6).all()
    assert ((covered >= 0.90) & (covered <= 0.99)).all(), covered


def test_a_common_scale_error_is_covered_and_not_averaged_out(rng):
    at = np.arange(0, 20, PERIOD_S)
    Y = motion(at)

    def draw():
        y = (1 + 0.02 * rng.normal()) * (Y @ TRUTH) + 0.05 * rng.normal(size=at.size)
        return estimate(at, Y, y, np.full(at.size, 0.05), PRIOR, considered=(y[:, None], [0.02])), TRUTH

    covered, _ = coverage(draw, 200)
    assert ((covered >= 0.91) & (covered <= 0.995)).all(), covered
    found, _ = draw()
    assert found.combination(np.eye(3)).sigma[0] == pytest.approx(0.02 * 2.0, rel=0.2)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.02 * 2.0, rel=0.2)


def test_regressor_noise_bias_is_taken_out_and_covered(rng):
    """A noisy first column: plain least squares loses a fifth of it, the corrected estimate none."""
    at = np.arange(0, 40, PERIOD_S)
    exact = motion(at)
    spread = np.array([0.35, 0.0, 0.0])
    noise = np.zeros((at.size, 1, 3))
    noise[:, 0] = spread
    plain, corrected = [], []

    def draw():
        Y = exact + spread * rng.normal(size=(at.size, 1))
        y = exact @ TRUTH + 0.05 * rng.normal(size=at.size)
        found = estimate(at, Y, y, np.full(at.size, 0.7), PRIOR, noise=noise)
        plain.append(np.linalg.lstsq(Y, y, rcond=None)[0][0])
        corrected.append(found.mean[0])
        return found, TRUTH

    covered, _ = coverage(draw, 200)
    assert np.mean(plain) == pytest.approx(2.0 / (1 + 0.35**2 / 0.5), rel=0.01)
    assert np.mean(corrected) == pytest.approx(2.0, abs=0.01)
    assert ((covered >= 0.91) & (covered <= 1.0)).all(), covered


def test_noise_that_the_left_hand_side_shares_is_taken_out_of_it_too(rng):
    """A known parameter's part, moved to the other side, carries the noise of the same motion as the row."""
    at = np.arange(0, 40, PERIOD_S)
    exact = motion(at)
    noise = np.zeros((at.size, 1, 4))
    noise[:, 0] = [0.35, 0.0, 0.0, -0.7]
    means = []

    def draw():
        error = rng.normal(size=at.size)
        Y = exact + 0.35 * error[:, None] * [1.0, 0.0, 0.0]
        y = exact @ TRUTH - 0.7 * error + 0.05 * rng.normal(size=at.size)
        found = estimate(at, Y, y, np.full(at.size, 1.4), PRIOR, noise=noise)
        means.append(found.mean[0])
        return found, TRUTH

    covered, _ = coverage(draw, 200)
    assert np.mean(means) == pytest.approx(2.0, abs=0.02)  # 0.98 where the shared noise is passed over
    assert ((covered >= 0.91) & (covered <= 1.0)).all(), covered


@pytest.mark.parametrize("shared", [0.0, -0.7])
def test_rows_without_noise_tell_what_those_with_it_will(shared, rng):
    """What the regressor's noise adds on average is put in, and taken out again of the estimate, not of its spread."""
    at = np.arange(0, 40, PERIOD_S)
    Y, sigma = motion(at), np.full(at.size, 1.4)
    noise = np.zeros((at.size, 1, 4))
    noise[:, 0] = [0.35, 0.1, 0.0, shared]
    C = rng.normal(size=(at.size, 1))
    made = RecursiveLeastSquares(3, 1, 5 * WIDTH_S)
    made.rls.prior(TRUTH, PRIOR[1])
    made.add(at, Y, Y @ TRUTH, sigma, C, noise)
    assert abs(JackknifeEstimate(made.rls, made.blocks, [0.0]).mean[0] - TRUTH[0]) > 0.1
    made.expect_noise()
    found = JackknifeEstimate(made.rls, made.blocks, [1.0])
    np.testing.assert_allclose(found.mean, TRUTH, rtol=1e-9)
    information = Y.T @ Y / 1.4**2 + np.diag(PRIOR[1] ** -2.0)
    inverse, added = np.linalg.inv(information), at.size / 1.4**2 * np.outer(noise[0, 0, :3], noise[0, 0, :3])
    spread = inverse @ (information + added) @ inverse
    np.testing.assert_allclose(found.formal_variance(np.eye(3)), np.diag(spread), rtol=1e-9)
    np.testing.assert_allclose(found.causes(np.eye(3)), inverse @ Y.T @ C / 1.4**2, rtol=1e-9)


def test_not_knowing_the_noise_well_widens_what_it_biases(rng):
    """Power of the regressor's noise stated 20 % too low: the correction falls short, the interval knows."""
    at = np.arange(0, 40, PERIOD_S)
    exact = motion(at)
    spread = np.array([0.35, 0.0, 0.0])
    noise = np.zeros((at.size, 1, 3))
    noise[:, 0] = np.sqrt(0.8) * spread

    def draw():
        Y = exact + spread * rng.normal(size=(at.size, 1))
        y = exact @ TRUTH + 0.05 * rng.normal(size=at.size)
        return estimate(at, Y, y, np.full(at.size, 0.7), PRIOR, noise=noise), TRUTH

    covered, _ = coverage(draw, 100)
    assert (covered > 0.95).all(), covered


def test_a_column_that_is_only_noise_is_not_relied_on(rng):
    at = np.arange(0, 20, PERIOD_S)
    Y = motion(at)
    Y[:, 0] = 0.3 * rng.normal(size=at.size)
    noise = np.zeros((at.size, 1, 3))
    noise[:, 0, 0] = 0.3
    prior = (np.array([0.7, 0.0, 0.0]), np.full(3, 5.0))
    found = estimate(at, Y, Y[:, 1:] @ TRUTH[1:], np.full(at.size, 0.1), prior, noise=noise)
    interval = found.combination(np.eye(3))
    assert interval.mean[0] == pytest.approx(0.7, rel=0.01)  # the prior's
    assert interval.sigma[0] == pytest.approx(5.0, rel=0.01)
    np.testing.assert_allclose(interval.mean[1:], TRUTH[1:], atol=0.02)
    assert (interval.sigma[1:] < 0.05).all()


def test_white_noise_needs_no_correction_and_gets_almost_none(rng):
    at = np.arange(0, 60, PERIOD_S)
    Y = motion(at)
    sigmas = []
    for _ in range(50):
        y = Y @ TRUTH + 0.1 * rng.normal(size=at.size)
        found = estimate(at, Y, y, np.full(at.size, 0.1), PRIOR)
        sigmas.append(found.combination(np.eye(3)).sigma / np.sqrt(found.formal_variance(np.eye(3))))
    assert np.mean(sigmas) == pytest.approx(1.08, abs=0.08)  # never below the floor, hence a little above one


def test_prior_only_gives_the_prior_back():
    rls = SquareRootRls(3)
    rls.prior(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3]))
    found = JackknifeEstimate(rls, BlockScores(3, 1.0))
    interval = found.combination(np.eye(3))
    np.testing.assert_allclose(interval.mean, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(interval.sigma, [0.1, 0.2, 0.3], rtol=1e-9)
    np.testing.assert_allclose(found.covariance, np.diag([0.01, 0.04, 0.09]), rtol=1e-9, atol=1e-15)
    assert (interval.degrees_of_freedom == 1.0).all()


def test_covariance_agrees_with_combination_and_is_positive_definite(rng):
    at = np.arange(0, 20, PERIOD_S)
    Y = motion(at)
    y = Y @ TRUTH + np.convolve(rng.normal(size=at.size + 20), np.ones(20), mode="valid")[: at.size]
    found = estimate(at, Y, y, np.ones(at.size), PRIOR)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.combination(np.eye(3)).sigma, rtol=1e-6)
    wide = JackknifeEstimate.combination(found, [1.0, 1.0, 0.0])
    assert wide.mean[0] == pytest.approx(found.mean[0] + found.mean[1])


def test_information_in_one_block_gives_few_degrees_of_freedom(rng):
    at = np.arange(0, 20, PERIOD_S)
    Y = motion(at)
    Y[:, 0] = np.where(at < 0.4, 1.0, 0.0)
    found = estimate(at, Y, Y @ TRUTH + 0.1 * rng.normal(size=at.size), np.full(at.size, 0.1), PRIOR)
    freedom = found.combination(np.eye(3)).degrees_of_freedom
    assert freedom[0] == 1.0
    assert freedom[1] > 10.0


def test_another_answer_has_the_freedom_of_its_own_blocks(rng):
    t = np.arange(0, 10, PERIOD_S)
    Y = motion(t) * [1.0, 1.0, 0.0]
    Y[100:160, 2] = 1.0  # of the third parameter, one block tells
    made = estimate(t, Y, Y @ TRUTH + 0.1 * rng.normal(size=t.size), np.full(t.size, 0.1), PRIOR)
    other = Mixture(np.ones(1), TRUTH[None] + 0.01, 1e-4 * np.eye(3)[None])
    alone, both = made.instead(other), made.instead(other, np.ones((12, 1, 1)) * np.eye(3))
    few, many = (one.combination([0.0, 0.0, 1.0]) for one in (alone, both))
    assert few.degrees_of_freedom[0] < 1.5
    assert many.degrees_of_freedom[0] == pytest.approx(11.0)
    assert few.sigma[0] == pytest.approx(many.sigma[0]) == pytest.approx(0.01)
    assert many.high[0] == pytest.approx(TRUTH[2] + 0.01 + 0.01 * stdtrit(11.0, 0.975))
    assert made.combination([0.0, 0.0, 1.0]).mean != few.mean  # and the estimate itself is what it was


def test_blocks_add_up_whatever_the_batches_and_however_often_they_merge(rng):
    at = np.arange(0, 50, PERIOD_S)
    Y, y, sigma = rng.normal(size=(at.size, 3)), rng.normal(size=at.size), rng.uniform(0.5, 2, at.size)
    whole, pieces = BlockScores(3, 0.5, 8), BlockScores(3, 0.5, 8)
    whole.add(at, Y, y, sigma)
    for first in range(0, at.size, 7):
        part = slice(first, first + 7)
        pieces.add(at[part], Y[part], y[part], sigma[part])
    assert whole.block_s == pieces.block_s == 8.0
    assert whole.count == pieces.count == 7
    W = Y / sigma[:, None]
    np.testing.assert_allclose(whole.normal.sum(axis=0), W.T @ W, rtol=1e-10)
    np.testing.assert_allclose(whole.moment.sum(axis=0), W.T @ (y / sigma), rtol=1e-10)
    np.testing.assert_allclose(pieces.normal, whole.normal, rtol=1e-10, atol=1e-12)
    for block in range(7):
        rows = W[(at >= 8.0 * block) & (at < 8.0 * (block + 1))]
        np.testing.assert_allclose(whole.normal[block], rows.T @ rows, rtol=1e-10)


def test_blocks_far_apart_merge_until_they_fit():
    store = BlockScores(1, 1.0, 4)
    for time in (0.0, 10.0, 100.0, 1000.0, 10000.0):
        store.add(np.array([time]), np.ones((1, 1)), np.ones(1), np.ones(1))
    assert store.count <= 4
    assert store.normal.sum() == 5.0


def test_noise_is_taken_out_of_the_blocks():
    store = BlockScores(2, 1.0)
    noise = np.zeros((3, 2, 2))
    noise[:, 0, 0], noise[:, 1, 1] = 0.1, 0.2
    store.add(np.array([0.0, 0.5, 1.5]), np.ones((3, 2)), np.ones(3), np.full(3, 0.5), noise)
    np.testing.assert_allclose(store.noise, np.diag([3 * 0.04, 3 * 0.16]))
    np.testing.assert_allclose(store.normal.sum(axis=0), np.full((2, 2), 12.0) - store.noise)


@pytest.mark.parametrize(
    "rows",
    [
        (np.zeros(2), np.ones((3, 2)), np.ones(3), np.ones(3)),
        (np.zeros(3), np.ones((3, 1)), np.ones(3), np.ones(3)),
        (np.zeros(3), np.full((3, 2), np.nan), np.ones(3), np.ones(3)),
        (np.full(3, np.inf), np.ones((3, 2)), np.ones(3), np.ones(3)),
        (np.zeros(3), np.ones((3, 2)), np.ones(3), np.ones(3), np.ones((3, 2, 1))),
    ],
)
def test_bad_rows_are_refused(rows):
    store = BlockScores(2, 1.0)
    with pytest.raises(RowError):
        store.add(*rows)
    assert store.count == 0


def test_no_variance_is_below_that_of_the_noise_and_its_freedom_counts(rng):
    at = np.arange(0, 6, PERIOD_S)
    Y = motion(at)
    y = Y @ TRUTH + 0.1 * rng.normal(size=at.size)
    rls, blocks = SquareRootRls(3), BlockScores(3, 0.5)
    rls.prior(*PRIOR)
    rls.update(Y, y, np.full(at.size, 0.1))
    blocks.add(at, Y, y, np.full(at.size, 0.1))
    found = JackknifeEstimate(rls, blocks, scale=NoiseScale(25.0, 30.0))
    interval = found.combination(np.eye(3))
    np.testing.assert_allclose(interval.sigma, 5.0 * np.sqrt(found.formal_variance(np.eye(3))), rtol=1e-9)
    np.testing.assert_allclose(interval.high - interval.mean, stdtrit(30.0, 0.975) * interval.sigma, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), interval.sigma, rtol=1e-6)
    low = JackknifeEstimate(rls, blocks, scale=NoiseScale(0.01, 30.0)).combination(np.eye(3))
    own = JackknifeEstimate(rls, blocks).combination(np.eye(3))
    assert (low.sigma <= own.sigma).all()
    assert (low.sigma > 0.5 * own.sigma).all()


def test_scores_tell_the_scale_of_the_noise(rng):
    """Noise three times as large as stated, correlated within blocks or not: the variance of the blocks' scores."""
    H = np.array([(A := rng.normal(size=(30, 3))).T @ A for _ in range(40)])
    scales = []
    for _ in range(200):
        g = np.array([np.linalg.cholesky(one) @ rng.normal(size=3) for one in H]) * 3.0
        C = np.linalg.inv(H.sum(axis=0))
        scales.append(noise_scale(H, g - H @ (C @ g.sum(axis=0)), C))
    assert np.mean([scale for scale, _ in scales]) == pytest.approx(9.0, rel=0.03)
    freedom = scales[0][1]
    assert 0.8 * 39 * 3 < freedom < 39 * 3  # blocks are not alike
    assert np.var([scale for scale, _ in scales]) == pytest.approx(2.0 * 81.0 / freedom, rel=0.3)  # Satterthwaite's


def test_no_rows_tell_no_scale():
    assert noise_scale(np.zeros((0, 2, 2)), np.zeros((0, 2)), np.eye(2)) == (1.0, 0.0)


def test_no_rows_are_no_block():
    store = BlockScores(2, 1.0)
    store.add(np.zeros(0), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert store.count == 0


@pytest.mark.parametrize("arguments", [(2, 0.0), (2, np.inf), (2, 1.0, 3)])
def test_impossible_stores_are_refused(arguments):
    with pytest.raises(RowError):
        BlockScores(*arguments)


def test_impossible_questions_are_refused():
    rls = SquareRootRls(2)
    with pytest.raises(SingularError):
        JackknifeEstimate(rls, BlockScores(2, 1.0))
    rls.prior(np.zeros(2), np.ones(2))
    with pytest.raises(RowError, match="considered"):
        JackknifeEstimate(rls, BlockScores(2, 1.0), [0.1])
    with pytest.raises(RowError, match="weights"):
        JackknifeEstimate(rls, BlockScores(2, 1.0)).combination(np.eye(3))


def test_motion_does_not_contradict_a_rest_of_noise_alone(rng):
    """2,000 rows at rest whose column is noise of 0.1 say that the parameter is zero, give or take 0.02; it is 3."""
    made = RecursiveLeastSquares(1, 0, 1.0)
    made.rls.prior(np.zeros(1), np.array([[100.0]]))
    rest, moving = 0.1 * rng.normal(size=2000), 1.0 + 0.1 * rng.normal(size=50)
    sigma, noise = np.full(2000, np.hypot(0.1, 0.3)), np.full((2000, 1, 1), 0.1)
    made.add(0.01 * np.arange(2000), rest[:, None], 0.1 * rng.normal(size=2000), sigma, noise=noise)
    y = np.full(50, 3.0)
    asked = moving[:, None], y, sigma[:50]
    plain, spread = made.rls.innovation(*asked)
    assert np.median(plain / spread) > 8.0
    corrected, wider = made.innovation(*asked)
    assert np.abs(corrected / wider).max() < 3.0
