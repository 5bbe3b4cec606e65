"""Instrumental variables: least squares where the instruments are the rows, unbiased where those are noisy; covers."""

import numpy as np
import pytest

from onboard.estimation.errors import RowError, SingularError
from onboard.estimation.recursive.instrumental import RecursiveInstrumental
from onboard.estimation.recursive.memory import FOR_EVER, Memory

TRUTH = np.array([2.0, -1.0, 0.5])
PRIOR = (np.array([1.0, 0.0, 0.0]), np.full(3, 50.0))


def motion(at):
    return np.column_stack([np.sin(2.5 * at), np.cos(4.4 * at), np.sin(7.0 * at + 1.0)])


def fed(at, Y, y, sigma, Z, C=None, memory=FOR_EVER, step=25, considered=0):
    one = RecursiveInstrumental(3, considered, 0.5, memory)
    one.rls.prior(*PRIOR)
    for first in range(0, at.size, step):
        some = slice(first, first + step)
        own = None if C is None else C[some]
        one.add(at[some], Y[some], y[some], sigma[some], own)
        one.add_instruments(at[some], Y[some], y[some], sigma[some], Z[some], own)
    return one


def noisy(rng, seconds=20.0):
    """Rows and instruments of the same motion, each with noise of its own, the rows' slow enough to be correlated."""
    at = np.arange(0.0, seconds, 0.01)
    exact = motion(at)
    smooth = [np.convolve(rng.normal(size=at.size + 9), np.ones(10) / np.sqrt(10), mode="valid") for _ in range(3)]
    Y = exact + 0.5 * np.column_stack(smooth)
    return (
        at,
        Y,
        exact @ TRUTH + 0.1 * rng.normal(size=at.size),
        np.full(at.size, 0.1),
        exact + 0.1 * rng.normal(size=Y.shape),
    )


@pytest.mark.parametrize("memory", [FOR_EVER, Memory(forgetting_s=3.0), Memory(window_s=2.0)])
def test_rows_as_their_own_instruments_make_the_least_squares(rng, memory):
    at, Y, y, sigma, _ = noisy(rng, 8.0)
    C = rng.normal(size=(at.size, 1))
    one = fed(at, Y, y, sigma, Y, C, memory, considered=1)
    solution = one.rls.solve()
    np.testing.assert_allclose(one.mean, solution.mean, rtol=1e-9)
    jackknife, plain = one.block_jackknife([0.3]), super(RecursiveInstrumental, one).block_jackknife([0.3])
    for a, b in zip(jackknife.combination(np.eye(3)), plain.combination(np.eye(3)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)
    np.testing.assert_allclose(jackknife.covariance, plain.covariance, rtol=1e-6)
    np.testing.assert_allclose(jackknife.causes(np.eye(3)), plain.causes(np.eye(3)), rtol=1e-6)
    np.testing.assert_allclose(one.least_squares(), solution.mean, rtol=1e-9)


def test_noise_in_the_rows_biases_least_squares_and_not_this(rng):
    means, plain, inside = [], [], np.zeros(3)
    for _ in range(200):
        one = fed(*noisy(rng), step=200)
        interval = one.block_jackknife().combination(np.eye(3))
        means.append(interval.mean)
        plain.append(one.rls.solve().mean)
        inside += (interval.low <= TRUTH) & (interval.high >= TRUTH)
    assert (np.abs(np.mean(plain, axis=0) / TRUTH - 1.0) > 0.2).all()
    scatter = np.std(means, axis=0) / np.sqrt(200)
    assert (np.abs(np.mean(means, axis=0) - TRUTH) < 4.0 * scatter).all()
    assert (scatter < 0.01).all()
    assert ((inside / 200 >= 0.90) & (inside / 200 <= 0.99)).all(), inside


def test_better_instruments_replace_those_that_were_not_settled(rng):
    at, Y, y, sigma, Z = noisy(rng, 4.0)
    first, late = slice(0, 200), slice(200, None)
    one = fed(at[first], Y[first], y[first], sigma[first], Z[first])
    one.add_instruments(at[late], Y[late], y[late], sigma[late], rng.normal(size=Z[late].shape), None, False)
    one.unsettle()
    one.add_instruments(at[late], Y[late], y[late], sigma[late], Z[late])
    np.testing.assert_allclose(one.mean, fed(at, Y, y, sigma, Z).mean, rtol=1e-10)


def test_what_no_instrument_shows_stays_the_priors(rng):
    at, Y, y, sigma, Z = noisy(rng, 4.0)
    Z[:, 2] = Y[:, 2] = 0.0
    one = fed(at, Y, y, sigma, Z)
    interval = one.block_jackknife().combination(np.eye(3))
    assert interval.mean[2] == pytest.approx(0.0, abs=1e-9)
    assert interval.sigma[2] == pytest.approx(50.0, rel=1e-6)


def test_impossible_rows_and_questions_are_refused(rng):
    at, Y, y, sigma, Z = noisy(rng, 1.0)
    one = RecursiveInstrumental(3, 0, 0.5)
    with pytest.raises(RowError, match="of each"):
        one.add_instruments(at, Y, y, sigma, Z[:, :2])
    for instruments, rows in ((np.where(Z > 1.0, np.nan, Z), Y), (Z, np.where(Y > 1.0, np.inf, Y))):
        with pytest.raises(RowError, match="finite"):
            one.add_instruments(at, rows, y, sigma, instruments)
    with pytest.raises(SingularError, match="every parameter"):
        _ = one.mean
    one.add_instruments(at[:0], Y[:0], y[:0], sigma[:0], Z[:0])
    assert one.instruments.count == 0
    one.add_instruments(at, np.column_stack([Y[:, 0]] * 3), y, sigma, Z)
    one.instruments.sums[0][:] = 1.0
    with pytest.raises(SingularError, match="instruments"):
        _ = one.mean
    with pytest.raises(RowError, match="considered"):
        one.block_jackknife([1.0])
