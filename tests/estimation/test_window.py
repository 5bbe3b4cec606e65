"""A window is the batch solution of its rows, after any number of steps; fading and windowed blocks still cover."""

import numpy as np
import pytest

from onboard.estimation.errors import RowError
from onboard.estimation.recursive.consistency import BlockScores
from onboard.estimation.recursive.memory import Memory, RecursiveLeastSquares, WindowRls
from onboard.estimation.recursive.rls import SquareRootRls


def batch(parts, prior=None):
    p = parts[0][0].shape[1]
    whole = SquareRootRls(p, 1)
    if prior:
        whole.prior(*prior)
    for Y, y, sigma, C in parts:
        whole.update(Y, y, sigma, C)
    return whole.solve()


@pytest.mark.parametrize("blocks", [0, 1, 2, 7])
@pytest.mark.parametrize("prior", [None, (np.array([1.0, -1.0, 0.5]), np.full(3, 2.0))])
def test_window_equals_the_batch_of_its_rows_at_every_step(rng, blocks, prior):
    window, kept = WindowRls(3, 1, blocks), [[]]
    if prior:
        window.prior(*prior)
    for _ in range(40):
        for _ in range(rng.integers(1, 3)):
            m = int(rng.integers(3, 6))
            scale = 10.0 ** rng.uniform(-3, 3)  # blocks that leave weigh up to 10^12 times what stays
            part = (
                scale * rng.normal(size=(m, 3)),
                scale * rng.normal(size=m),
                np.full(m, 0.1),
                rng.normal(size=(m, 1)),
            )
            window.update(*part)
            kept[-1].append(part)
            found, wanted = window.solve(), batch([one for block in kept for one in block], prior)
            np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-8, atol=1e-9)
            np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-8, atol=1e-16)
            np.testing.assert_allclose(found.sensitivity, wanted.sensitivity, rtol=1e-7, atol=1e-9)
            assert found.residual_sum == pytest.approx(wanted.residual_sum, rel=1e-8)
            assert found.rows == wanted.rows
        window.close_block()
        kept = [*kept, []][-(blocks + 1) :]


def test_no_digit_is_lost_over_many_steps(rng):
    window, newest = WindowRls(3, 1, 4), []
    window.prior(np.zeros(3), np.ones(3))
    for step in range(8_000):
        scale = 1e6 if step % 7 == 0 else 1.0
        part = (scale * rng.normal(size=(4, 3)), rng.normal(size=4), np.ones(4), np.ones((4, 1)))
        window.update(*part)
        newest = [*newest, part][-5:]
        if step < 7_999:
            window.close_block()
    wanted = batch(newest, (np.zeros(3), np.ones(3)))
    np.testing.assert_allclose(window.solve().mean, wanted.mean, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(window.solve().covariance, wanted.covariance, rtol=1e-10)


def rows_of(rng, seconds, period=0.01):
    at = np.arange(0.0, seconds, period)
    Y = rng.normal(size=(at.size, 2))
    return at, Y, Y @ [2.0, -1.0] + 0.1 * rng.normal(size=at.size), np.full(at.size, 0.1)


def fed(memory, at, Y, y, sigma, step):
    found = RecursiveLeastSquares(2, 0, 0.5, memory)
    found.rls.prior(np.zeros(2), np.full(2, 10.0))
    for first in range(0, at.size, step):
        some = slice(first, first + step)
        found.add(at[some], Y[some], y[some], sigma[some])
    return found


@pytest.mark.parametrize("step", [1, 7, 64, 10_000])
def test_time_window_holds_the_blocks_it_says_however_the_rows_came(rng, step):
    at, Y, y, sigma = rows_of(rng, 7.3)
    found = fed(Memory(window_s=2.0), at, Y, y, sigma, step)
    inside = at // 0.5 >= at[-1] // 0.5 - 4
    wanted = SquareRootRls(2)
    wanted.prior(np.zeros(2), np.full(2, 10.0))
    wanted.update(Y[inside], y[inside], sigma[inside])
    np.testing.assert_allclose(found.rls.solve().mean, wanted.solve().mean, rtol=1e-10)
    assert found.rls.rows == inside.sum()
    assert at[inside][-1] - at[inside][0] >= 2.0
    only = BlockScores(2, 0.5)
    only.add(at[inside], Y[inside], y[inside], sigma[inside])
    np.testing.assert_allclose(np.sort(found.blocks.normal, axis=0), np.sort(only.normal, axis=0), rtol=1e-10)


def test_forgetting_weighs_by_age_however_the_rows_came(rng):
    at, Y, y, sigma = rows_of(rng, 6.0)
    for step in (1, 10):
        found = fed(Memory(forgetting_s=1.5), at, Y, y, sigma, step)
        age = at[-1] - (at if step == 1 else at.reshape(-1, 10)[:, -1:].repeat(10, 1).ravel())
        W = np.exp(-age / 1.5) / sigma**2
        information = (Y.T * W) @ Y + np.eye(2) / 100.0
        np.testing.assert_allclose(found.rls.information(), information, rtol=1e-9)
        np.testing.assert_allclose(found.blocks.normal.sum(axis=0), (Y.T * W) @ Y, rtol=1e-9)


@pytest.mark.parametrize("memory", [Memory(forgetting_s=2.0), Memory(window_s=4.0)])
def test_intervals_of_a_fading_or_windowed_estimate_cover(rng, memory):
    inside = 0
    for _ in range(150):
        at = np.arange(0.0, 20.0, 0.02)
        Y = np.column_stack([np.sin(2 * np.pi * 0.9 * at), np.cos(2 * np.pi * 1.3 * at)])
        slow = np.convolve(rng.normal(size=at.size + 9), np.ones(10) / 10, mode="valid")  # correlated over 0.2 s
        found = RecursiveLeastSquares(2, 0, 0.5, memory)
        found.rls.prior(np.zeros(2), np.full(2, 100.0))
        y = Y @ [2.0, -1.0] + slow
        for first in range(0, at.size, 200):
            some = slice(first, first + 200)
            found.add(at[some], Y[some], y[some], np.full(200, 0.1))
        interval = found.block_jackknife().combination(np.eye(2))
        inside += int(((interval.low <= [2.0, -1.0]) & (interval.high >= [2.0, -1.0])).sum())
    assert 0.92 <= inside / 300 <= 0.995


def test_noise_of_the_regressor_fades_and_leaves_with_its_rows(rng):
    at, Y, y, sigma = rows_of(rng, 6.0)
    noise = 0.01 * np.ones((at.size, 3, 2))
    windowed = RecursiveLeastSquares(2, 0, 0.5, Memory(window_s=1.0))
    windowed.add(at, Y, y, sigma, None, noise)
    kept = at // 0.5 >= at[-1] // 0.5 - 2
    expected = np.einsum("msi,msj->ij", noise[kept], noise[kept]) / 0.01
    np.testing.assert_allclose(windowed.blocks.noise, expected, rtol=1e-9)


def test_a_log_that_begins_anew_goes_on_where_the_first_ended(rng):
    at, Y, y, sigma = rows_of(rng, 3.0)
    for memory in (Memory(window_s=100.0), Memory(forgetting_s=1e9)):
        found = fed(memory, at, Y, y, sigma, 50)
        found.add(at, Y, y, sigma)
        assert found.rls.rows == pytest.approx(2 * at.size, rel=1e-6)
        np.testing.assert_allclose(found.blocks.normal.sum(axis=0), 200.0 * Y.T @ Y, rtol=1e-6)


def test_nothing_in_nothing_out():
    found = RecursiveLeastSquares(2, 0, 0.5, Memory(window_s=1.0))
    found.add(np.zeros(0), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    found.rls.update(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert found.rls.rows == 0


def test_what_makes_no_sense_is_refused():
    with pytest.raises(RowError, match="remove either"):
        Memory(1.0, 1.0)
    for given in ({"forgetting_s": 0.0}, {"window_s": -1.0}, {"window_s": np.inf}):
        with pytest.raises(RowError, match="positive time"):
            Memory(**given)
    with pytest.raises(RowError, match="closed blocks"):
        WindowRls(2, 0, -1)
    window = WindowRls(2)
    with pytest.raises(RowError, match="no forgetting factor"):
        window.update(np.eye(2), np.ones(2), np.ones(2), forgetting=0.9)
    with pytest.raises(RowError, match="a triangle"):
        window.restore(SquareRootRls(2).state())
    with pytest.raises(RowError, match=r"\(0, 1\]"):
        SquareRootRls(2).update(np.eye(2), np.ones(2), np.ones(2), forgetting=0.0)
