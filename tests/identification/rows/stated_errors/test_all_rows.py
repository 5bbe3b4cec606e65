"""Errors of cells by the sums over rows that were made here: what is found, and when it is no explanation."""

import numpy as np
import pytest

from onboard.estimation.policy import LIKELY_SIZE, ODDS
from onboard.identification.evidence.bank import Bank, Suspect
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.all_rows import as_stated, explained, that_agree
from onboard.identification.rows.stated_errors.equations import ErrorEquations, RowErrors

CELLS, P, BLOCK_S = ("a", "b", "c"), 4, 1.0
STATED = 0.01  # sigma of each scale
PRIOR = 3.0
BETA = np.array([2.0, -1.0, 1.5, 0.5])


def flown(rng, factors=(1.0, 1.0, 1.0), slow=0.0, motion=0.0, seconds=40, own=1.0, rests_s=np.inf):
    """Rows of three cells, 20 a second of each: ``factor Y beta`` and noise, ``own`` times that stated.

    ``slow``: of what no parameter explains, by the block, of each cell or of all; ``motion``: noise of the regressor,
    as it is read; ``rests_s``: from when on nothing tells of the first parameter.
    """
    seen = RowBlocks(P, BLOCK_S, CELLS)
    times_s = np.repeat(np.arange(0.0, seconds, 0.05), len(CELLS))
    cell = np.tile(np.arange(len(CELLS)), len(times_s) // len(CELLS))
    true = 10.0 * (rng.standard_normal((len(times_s), P)) + rng.standard_normal((seconds, P))[times_s.astype(int)])
    true[times_s >= rests_s, 0] = 0.0
    block = rng.standard_normal((seconds, len(CELLS)))[times_s.astype(int), cell]
    y = (
        np.array(factors)[cell] * (true @ BETA)
        + own * rng.standard_normal(len(cell))
        + np.broadcast_to(slow, 3)[cell] * block
    )
    Y = true + motion * rng.standard_normal(true.shape)
    sigma = np.full(len(y), np.sqrt(1.0 + motion**2 * (BETA @ BETA)))
    noise = np.tile(motion * np.eye(P, P + 1), (len(y), 1, 1)) if motion else None
    seen.add(times_s, np.ones(len(y), np.bool_), cell, Y, y, sigma, np.ones(len(y)), noise)
    return seen


def equations(seen, *more, since_s=-np.inf):
    """Of a prior about zero and a scale of each cell, and of errors of these sigmas that have columns."""
    sigma, columns = np.array([*np.full(3, STATED), *more]), [*np.full(3, -1), *range(len(more))]
    gains = np.eye(len(sigma), 3, dtype=np.bool_)
    errors = RowErrors(PRIOR * np.eye(P), np.zeros(P), sigma, columns, gains, np.ones(P, np.bool_))
    return ErrorEquations(seen, errors, 1.0, (since_s, since_s))


def asked(seen):
    rows = equations(seen)
    suspects = [
        Suspect(cell, np.array([P + k]), np.array([[LIKELY_SIZE / STATED]]), ODDS) for k, cell in enumerate(CELLS)
    ]
    return rows, Bank(suspects, np.ones(P + 3))


def found(seen, about=BETA):
    """Hypotheses, and mean and sigma of beta under the likeliest where it explains all rows."""
    rows, bank = asked(seen)
    weighed, more, _ = explained(rows, bank, np.concatenate([about / PRIOR, np.zeros(3)]))
    if more is None:
        return weighed, None, None
    x, P_ = weighed.known(weighed.likeliest)
    return weighed, PRIOR * x[:P], PRIOR * np.sqrt(np.diag(P_ + more))[:P]


def test_with_all_as_stated_nothing_is_explained(rng):
    weighed, mean, _ = found(flown(rng))
    assert weighed.likeliest.suspect is None
    assert mean is None


@pytest.mark.parametrize("factor", [0.85, 1.06, 1.2])
def test_a_wrong_scale_is_named_and_taken_out(rng, factor):
    """About an estimate that the wrong cell has moved, too."""
    weighed, mean, sigma = found(flown(rng, (1.0, factor, 1.0)), BETA * (1.0 + 0.3 * (factor - 1.0)))
    assert weighed.names == ("b",)
    assert weighed.likeliest.size == pytest.approx(abs(np.log(factor)) / LIKELY_SIZE, abs=0.15)
    assert (np.abs(mean - BETA) < 4.0 * sigma).all()
    assert (sigma < 0.02 * np.abs(BETA)).all()  # two cells that are as stated to 1 % each


def test_a_scale_of_half_as_much_again_is_of_another_kind(rng):
    weighed, mean, _ = found(flown(rng, (1.0, 1.5, 1.0)))
    assert weighed.too_far == "b"
    assert mean is None


def test_what_is_left_over_and_alike_for_a_block_is_no_explanation(rng):
    weighed, mean, _ = found(flown(rng, (1.0, 1.2, 1.0), slow=0.4))
    assert weighed.likeliest.suspect is not None
    assert mean is None


def test_noise_of_a_cell_that_is_six_times_what_is_stated_is_no_explanation(rng):
    weighed, mean, _ = found(flown(rng, (1.0, 1.2, 1.0), own=np.sqrt(6.0)))
    assert weighed.likeliest.suspect.name == "b"
    assert mean is None
    assert found(flown(rng, (1.0, 1.2, 1.0), own=np.sqrt(3.0)))[1] is not None


def test_noise_of_the_motion_is_not_taken_for_a_scale(rng):
    """A third of the information is noise: without the correction all scales are a quarter too small."""
    weighed, mean, sigma = found(flown(rng, (1.0, 1.15, 1.0), motion=5.0, seconds=120))
    assert weighed.likeliest.suspect.name == "b"
    assert (np.abs(mean - BETA) < 4.0 * sigma).all()


def test_what_scatters_more_than_it_is_known_widens_the_answer(rng):
    x, quiet, wider = np.concatenate([BETA / PRIOR, np.zeros(3)]), np.ones(3), []
    for slow, colour in ((0.0, 1.5), (1.0, 20.0)):
        rows, _ = asked(flown(rng, slow=slow))
        x, known = rows.information(rows.at(x), quiet).known()
        told = rows.information(rows.at(x), quiet)
        assert 0.25 * colour < told.colour() < colour
        wider.append(PRIOR**2 * np.diag(told.scatter(known))[:P])
    assert (wider[1] > 5.0 * wider[0]).all()  # noise of a block's sums is some ten times as large
    assert wider[1] == pytest.approx(np.full(P, 9.0 / 100.0 / 2400.0), rel=0.7)  # over the rows' information


def test_readings_that_no_noise_explains_are_a_misfit(rng):
    rows, _ = asked(flown(rng, slow=3.0))
    x = rows.at(np.concatenate([BETA / PRIOR, np.zeros(3)]))
    assert rows.misfit(x, x) == pytest.approx(10.0, rel=0.4)
    assert rows.misfit(x, x) == pytest.approx(rows.noise(x).max())
    loud, _ = asked(flown(rng, motion=5.0))
    assert loud.misfit(x, x) == pytest.approx(1.0, rel=0.1)
    assert loud.misfit(10.0 * x, x) > 50.0  # whose own noise of the motion would explain anything


def test_errors_of_rows_of_before_the_estimate_settled_are_left_out(rng):
    """In the first 15 of 40 s they were made of a body of next to no mass: what is left of the error misleads."""
    seen = RowBlocks(P, BLOCK_S, CELLS, 1)
    times_s = np.repeat(np.arange(0.0, 40.0, 0.05), len(CELLS))
    cell, Y = np.tile(np.arange(len(CELLS)), 800), 10.0 * rng.standard_normal((len(times_s), P))
    effect = rng.standard_normal(len(times_s))
    y = Y @ BETA + 3.0 * effect + rng.standard_normal(len(times_s))
    C = np.where(times_s < 15.0, 0.1, 1.0) * effect
    one = np.ones(len(times_s))
    seen.add(times_s, one > 0, cell, Y, y, one, one, None, C[:, None])
    x, found = np.concatenate([BETA / PRIOR, np.zeros(4)]), []
    for since_s in (-np.inf, 15.0):
        rows = equations(seen, 1.0, since_s=since_s)
        found.append((rows.share, rows.information(rows.at(x), rows.noise(rows.at(x))).known()[0][-1]))
    assert found[0][0] == 1.0
    assert found[1][0] == pytest.approx(25.0 / 40.0, rel=0.01)
    assert found[1][1] == pytest.approx(3.0, abs=0.06)
    assert found[0][1] > 3.1


def test_noise_in_the_column_of_an_error_makes_that_no_smaller(rng):
    """Half of the column's power is noise of a signal: without the correction the error comes out at half its size."""
    seen, n = RowBlocks(P, BLOCK_S, CELLS, 1), 7200
    times_s, cell = np.repeat(np.arange(0.0, 120.0, 0.05), len(CELLS)), np.tile(np.arange(len(CELLS)), n // 3)
    Y, effect = 10.0 * rng.standard_normal((n, P)), rng.standard_normal(n)
    y, C = Y @ BETA + 3.0 * effect + rng.standard_normal(n), effect + rng.standard_normal(n)
    one, sigma = np.ones(n), np.full(n, np.sqrt(1.0 + 3.0**2))
    noise = np.zeros((n, 1, P + 1)), np.ones((n, 1, 1))
    seen.add(times_s, one > 0, cell, Y, y, sigma, one, noise[0], C[:, None], np.zeros(P), noise[1])
    rows, x = equations(seen, 10.0), np.concatenate([BETA / PRIOR, np.zeros(4)])
    found, P_ = rows.information(rows.at(x), np.ones(3)).known()
    assert 10.0 * found[-1] == pytest.approx(3.0, abs=0.3)
    assert abs(10.0 * found[-1] - 3.0) < 3.0 * 10.0 * np.sqrt(P_[-1, -1])


def test_scores_of_regressors_that_are_noise_are_no_information(rng):
    """Of a parameter that no motion tells, whose column is noise, and less of it than is stated."""
    seen, n = RowBlocks(P, BLOCK_S, CELLS), 2400
    times_s, cell = np.repeat(np.arange(0.0, 40.0, 0.05), len(CELLS)), np.tile(np.arange(len(CELLS)), n // 3)
    Y = 10.0 * rng.standard_normal((n, P)) * [1.0, 1.0, 1.0, 0.09]
    y, one = 10.0 * rng.standard_normal(n), np.ones(n)
    noise = np.tile(np.diag([0.0, 0.0, 0.0, 1.0]) @ np.eye(P, P + 1), (n, 1, 1))
    seen.add(times_s, one > 0, cell, Y, y, one, one, noise)
    rows = equations(seen)
    told = rows.information(rows.at(np.zeros(P + 3)), np.ones(3))
    assert np.linalg.matrix_rank(told.A, 1e-6 * np.abs(told.A).max()) < P
    assert np.abs(told.A @ np.linalg.pinv(told.A, 1e-9) @ told.r - told.r).max() < 1e-6 * np.abs(told.r).max()


def test_an_estimate_that_has_gone_where_no_gain_is_ends_the_search(rng):
    rows = equations(flown(rng))
    assert np.isfinite(rows.noise(np.array([*BETA, 0.5, 0.0, 0.0]))).all()
    for gain in (1e3, -1e3, np.nan):
        with pytest.raises(np.linalg.LinAlgError, match="where no gain is"):
            rows.noise(np.array([*BETA, gain, 0.0, 0.0]))


def test_a_parameter_is_known_by_the_blocks_that_tell_of_it(rng):
    """Errors of gains beside it included: nobody tells more of these than the prior of them."""
    rows, _ = asked(flown(rng, rests_s=4.0))
    x, P_ = rows.information(np.append(BETA, np.zeros(3)), np.ones(3)).known()
    along = PRIOR * P_[:, :P]
    shares = rows.shares(rows.at(x), along)
    assert shares.sum(axis=0) == pytest.approx(along.T @ rows.information(rows.at(x), np.ones(3)).A @ along, rel=1e-6)
    each = np.einsum("bii->bi", shares)
    many = each.sum(axis=0) ** 2 / (each**2).sum(axis=0)
    assert 2.0 < many[0] <= 4.0 + 0.5
    assert (many[1:] > 15.0).all()


def test_a_cell_that_contradicts_all_others_counts_as_one_row(rng):
    """Alike for as long as it lasts: taken for noise, however large, it moved the answer with its whole weight."""
    x = np.concatenate([BETA / PRIOR, np.zeros(3)])
    seen = flown(rng, (1.0, 1.0, 1.0), slow=(0.0, 4.0, 0.0), rests_s=4.0)
    rows, which = that_agree(equations(seen), x, range(3))
    assert which == 1
    quiet, loud = (as_stated(one, x) for one in (rows, equations(seen)))
    assert rows.noise(rows.at(x))[1] > 100.0 * equations(seen).noise(rows.at(x))[1]
    assert (np.abs(PRIOR * quiet[0][:P] - BETA) < 4.0 * PRIOR * np.sqrt(np.diag(quiet[1]))[:P]).all()
    assert np.diag(quiet[1])[:P] == pytest.approx(np.diag(loud[1])[:P], rel=1.0)  # the others are known as well
    assert that_agree(equations(seen), x, [0, 2])[1] is None  # one that the others do not check


@pytest.mark.parametrize("slow", [0.0, (3.0, 3.0, 0.0), 3.0])
def test_where_no_cell_or_several_contradict_the_others_all_count(rng, slow):
    rows = equations(flown(rng, slow=slow))
    assert that_agree(rows, np.concatenate([BETA / PRIOR, np.zeros(3)]), range(3)) == (rows, None)


def test_derivatives_of_what_is_left_over_are_differences(rng):
    rows = equations(flown(rng))
    X, step = np.concatenate([BETA, [0.3, -0.2, 0.1]]), 1e-6
    for part in rows._parts:
        J, _ = rows._linear(part, X)
        for k in range(len(X)):
            plus, minus = (rows._linear(part, X + way * step * np.eye(len(X))[k])[1] for way in (1.0, -1.0))
            np.testing.assert_allclose(J[:, k], (plus - minus) / (2.0 * step), atol=1e-8)
