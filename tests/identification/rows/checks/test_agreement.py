"""What speaks against answers: steps of a gain, what is left over, what does not react; who is left out."""

import numpy as np
import pytest

from onboard.identification.rows.checks.agreement import (
    Blocks,
    GainTests,
    InstrumentFit,
    instrument_fits,
    judged_between,
    judged_fit,
    with_stated,
)
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import Considered

PHYSICAL = np.array([True, True, False])
TRUTH = np.array([0.5, -0.2, 3.0])  # two of bodies, and a bias


def fits(rng, y_of, n=3000, sigma=0.05, drawn=TRUTH):
    t = 0.01 * np.arange(n)
    Y = np.column_stack([np.sin(5.0 * t), np.cos(7.0 * t), np.ones(n)])
    y = y_of(t, Y @ (TRUTH * PHYSICAL)) + TRUTH[2] + sigma * rng.normal(size=n)
    mean = np.linalg.lstsq(Y, y, rcond=None)[0]
    seen = RowBlocks(3, 0.5, ("cell",))
    seen.add(t, np.ones(n, bool), np.zeros(n, np.intp), Y, y, np.full(n, sigma), np.full(n, sigma), None)
    return instrument_fits(seen, mean, mean, drawn, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0)[0]


def test_honest_rows_have_nothing_against_them(rng):
    fit = fits(rng, lambda _, y: y)
    assert fit.rows == 3000
    assert fit.misfit == pytest.approx(1.0, rel=0.1)
    assert fit.response == pytest.approx(1.0, rel=0.05)
    assert judged_fit(fit, 1.0) == ([], [])


@pytest.mark.parametrize(
    ("misfit", "unexplained", "response", "reasons"),
    [
        (3.5, 0.35, 1.0, (0, 0)),
        (5.0, 0.14, 1.0, (0, 0)),
        (5.0, 0.2, 1.0, (0, 1)),
        (5.0, 0.35, 1.0, (1, 0)),
        (1.0, 0.0, 0.15, (0, 0)),
        (1.0, 0.0, 0.09, (1, 0)),
    ],
)
def test_how_much_is_left_over_and_how_little_is_read_decides(misfit, unexplained, response, reasons):
    """Refused, and doubted; nothing by what may be noise."""
    fit = InstrumentFit("cell", 1000.0, misfit, unexplained, response, None)
    against, doubts = judged_fit(fit, 1.0)
    assert (len(against), len(doubts)) == reasons


def drifting(rng, sigma, jump=1.0):
    """A slow motion, read by a cell of which the zero drifts by 0.02 a second; with the drift's column C."""
    t = 0.01 * np.arange(3000)
    Y = np.column_stack([np.sin(0.4 * t), np.cos(0.7 * t), np.ones(3000)])
    y = np.where(t > 15.0, jump, 1.0) * (Y @ (TRUTH * PHYSICAL)) + TRUTH[2] + 0.02 * t + 0.05 * rng.normal(size=3000)
    mean = np.linalg.lstsq(Y, y, rcond=None)[0]
    seen, held, noise = RowBlocks(3, 0.5, ("cell",), 1), np.ones(3000, bool), np.full(3000, 0.05)
    seen.add(t, held, np.zeros(3000, np.intp), Y, y, noise, noise, None, t[:, None])
    asked = mean, mean, TRUTH, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0
    return instrument_fits(seen, *asked, considered=np.array([sigma]))[0]


def test_a_drift_that_is_considered_is_no_step_of_a_scale(rng):
    """Stated as exact it is one, and a step beside it is found and sized."""
    assert judged_fit(drifting(rng, 0.02), 1.0) == ([], [])
    assert drifting(rng, 0.0).step.is_significant
    found = drifting(rng, 0.02, 1.3).step
    assert found.is_significant
    assert found.size == pytest.approx(0.3, abs=0.05)
    assert found.moved.shape == (3,)


def test_blocks_with_errors_are_those_without_and_the_columns_between(rng):
    Y, C, y = rng.normal(size=(50, 3)), rng.normal(size=(50, 2)), rng.normal(size=50)
    one, times = np.full(50, 2.0), 0.01 * np.arange(50)
    seen = RowBlocks(3, 10.0, ("cell",), 2)
    seen.add(times, np.ones(50, bool), np.zeros(50, np.intp), Y, y, one, one, None, C)
    whole, alone = np.column_stack([Y, C, y, one]) / 2.0, np.column_stack([Y, y, one]) / 2.0
    assert seen.with_errors(True, 0)[0][0] == pytest.approx(whole.T @ whole)
    assert seen.apart(True, 0)[0][0] == pytest.approx(alone.T @ alone)


@pytest.mark.parametrize("at_s", [4.0, 15.0, 26.0])
def test_a_scale_that_jumps_is_seen_wherever_it_does(rng, at_s):
    fit = fits(rng, lambda t, y: np.where(t > at_s, 1.1, 1.0) * y)
    assert fit.step is not None
    assert fit.step.size == pytest.approx(0.1, rel=0.3)
    assert fit.step.time_s == pytest.approx(at_s, abs=1.0)
    assert "cell reads" in judged_fit(fit, 1.0)[0][0]


def noisy_fits(rng, late_s, vibration, jump=0.06, drawn=TRUTH):
    """Ten quiet seconds of a slow sweep, then twenty of a fast one that vibrates; a jump of the gain at ``late_s``."""
    t = 0.01 * np.arange(3000)
    fast, sigma = np.where(t > 10.0, 3.0, 1.0), np.full(t.size, 0.05)
    Y = np.column_stack([fast * np.sin(5.0 * t), fast * np.cos(7.0 * t), np.ones(t.size)])
    y = (1.0 + jump * (t > late_s)) * (Y @ (TRUTH * PHYSICAL)) + TRUTH[2]
    y += (sigma + vibration * (t > 10.0)) * rng.normal(size=t.size)
    mean = np.linalg.lstsq(Y, y, rcond=None)[0]
    seen = RowBlocks(3, 0.5, ("cell",))
    seen.add(t, np.ones(t.size, bool), np.zeros(t.size, np.intp), Y, y, sigma, sigma, None)
    return instrument_fits(seen, mean, mean, drawn, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0)[0]


def test_vibration_of_a_fast_sweep_hides_no_step_that_a_slow_one_shows():
    """Residuals of vibration count in the blocks that vibrate: the quiet blocks before have their own gain."""
    chances = [noisy_fits(np.random.default_rng(seed), 8.0, 0.2).step.chance for seed in range(10)]
    assert np.median(chances) < 1e-4
    sound = [noisy_fits(np.random.default_rng(seed), 8.0, 0.2, jump=0.0).step.chance for seed in range(60)]
    assert min(sound) > 1e-3


def test_an_interval_contains_what_a_suspected_step_does():
    """Most rows read 3 % too much: the parameters of bodies are off by as much, and that is reported."""
    suspected = [noisy_fits(np.random.default_rng(seed), 4.0, 0.05, jump=0.03).step for seed in range(10)]
    off = [np.abs(step.suspected[:2] / (0.03 * TRUTH[:2])).max() for step in suspected]
    assert np.median(off) == pytest.approx(1.0, abs=0.4)
    sound = [noisy_fits(np.random.default_rng(seed), 4.0, 0.05, jump=0.0).step for seed in range(60)]
    assert np.mean([step.suspected.any() for step in sound]) < 0.15


def test_of_two_cells_one_that_jumps_at_the_release_is_seen(rng):
    """By itself such a jump is another arm; the other cell, with the payload and without, makes it one of the gain."""
    t = 0.01 * np.arange(2000)
    held = t < 10.0
    swing, one = np.sin(5.0 * t), np.ones(t.size)
    seen, rows = RowBlocks(4, 0.5, ("cell_1", "cell_2")), []
    for number, scale in enumerate((1.0, 1.1)):
        bias = [one * (number == 0), one * (number == 1)]
        Y = np.column_stack([swing, held * swing, *bias])
        y = np.where(held, 1.0, scale) * (Y @ [0.5, 0.8, 0.0, 0.0]) + number + 0.01 * rng.normal(size=t.size)
        seen.add(t, held, np.full(t.size, number), Y, y, 0.01 * one, 0.01 * one, None)
        rows.append((Y, y))
    mean = np.linalg.lstsq(np.vstack([Y for Y, _ in rows]), np.concatenate([y for _, y in rows]), rcond=None)[0]
    physical = np.array([True, True, False, False])
    fits = instrument_fits(seen, mean, mean, mean, np.zeros(4), physical, 1e-6 * np.eye(4), 1.0)
    for fit, sign in zip(fits, (-1.0, 1.0), strict=True):
        assert fit.step is not None
        assert fit.step.size == pytest.approx(0.1 * sign, rel=0.2)
        assert fit.step.time_s == pytest.approx(10.0)
        assert any("s after its first row on" in said for said in judged_fit(fit, 1.0)[0])


@pytest.mark.parametrize(("cut_s", "between"), [(10.0, True), (15.0, False)])
def test_a_gain_that_changed_between_two_recordings_is_told_and_refuses_nothing(rng, cut_s, between):
    """5 % more of one of three torques from the recording with the payload on; within one it is a fault."""
    t = 0.01 * np.arange(2000)
    held, swing, one = t >= 10.0, np.sin(5.0 * t), np.ones(t.size)
    torques = ("joint_1", "joint_2", "joint_3")
    seen, rows = RowBlocks(2, 0.5, torques), []
    for number in range(len(torques)):
        Y = np.column_stack([swing, held * swing])
        y = np.where((t >= cut_s) & (number == 1), 1.05, 1.0) * (Y @ [0.5, 0.8]) + 0.01 * rng.normal(size=t.size)
        seen.add(t, held, np.full(t.size, number), Y, y, 0.01 * one, 0.01 * one, None)
        rows.append((Y, y))
    mean = np.linalg.lstsq(np.vstack([Y for Y, _ in rows]), np.concatenate([y for _, y in rows]), rcond=None)[0]
    asked = mean, mean, mean, np.zeros(2), np.ones(2, np.bool_), 1e-6 * np.eye(2), 1.0
    fits = instrument_fits(seen, *asked, recorded_apart=True)
    against, doubts = judged_between(fits)[:2] if between else judged_fit(fits[1], 1.0)
    assert fits[1].step is not None
    assert fits[1].step.between is between
    assert bool(against or doubts) is not between
    if between:
        assert judged_fit(fits[1], 1.0) == ([], [])
        assert judged_between(fits)[2] == [
            "of the same motion the recording with the payload, from 10.0 s on, reads joint_2 +5%: gains or friction "
            "have changed between the recordings, and the intervals hold what that does"
        ]
        twice = judged_between([*fits, fits[1]._replace(instrument="joint_4")])[2]
        assert [said.count("reads joint_2 +5%, joint_4 +5%: ") for said in twice] == [1]
        large = fits[1]._replace(step=fits[1].step._replace(size=-0.2))
        assert ["joint_2 -20%: gains or" in said for said in judged_between([large])[1]] == [True]
        assert fits[1].step.suspected.any()  # which intervals contain
        for stated, as_stated in ((0.01, False), (0.03, True)):
            step = fits[1].step._replace(stated=stated)
            assert step.suspected.any() is not as_stated  # they contain it already
            said = judged_between([fits[1]._replace(step=step)])[2][0]
            assert said.endswith("joint_2 +5%: within what is stated between recordings") is as_stated
    else:
        assert f"from {cut_s:.1f} s after its first row on" in (*against, *doubts)[0]


def two_cells(rng, noises):
    """Fits of two healthy cells, stated to have a noise of 0.01, and a payload that goes in the middle."""
    t = 0.01 * np.arange(2000)
    held, one = t < 10.0, np.ones(t.size)
    seen, rows = RowBlocks(4, 0.5, ("cell_1", "cell_2")), []
    for number, noise in enumerate(noises):
        Y = np.column_stack([np.sin(5.0 * t), held * np.sin(5.0 * t), one * (number == 0), one * (number == 1)])
        y = Y @ [0.5, 0.8, 0.0, 0.0] + number + noise * rng.normal(size=t.size)
        seen.add(t, held, np.full(t.size, number), Y, y, 0.01 * one, 0.01 * one, None)
        rows.append((Y, y))
    mean = np.linalg.lstsq(np.vstack([Y for Y, _ in rows]), np.concatenate([y for _, y in rows]), rcond=None)[0]
    return instrument_fits(seen, mean, mean, mean, np.zeros(4), np.arange(4) < 2, 1e-6 * np.eye(4), 1.0)


def scaled_cells(rng, scale, n=2000):
    """Fits of two cells, the second scaled, and the estimate of both."""
    t, one = 0.01 * np.arange(n), np.ones(n)
    seen, rows = RowBlocks(4, 0.5, ("cell_1", "cell_2")), []
    for number in range(2):
        Y = np.column_stack([np.sin(5.0 * t), np.cos(7.0 * t), one * (number == 0), one * (number == 1)])
        y = (1.0 + scale * number) * (Y @ [0.5, 0.8, 0.0, 0.0]) + number + 0.01 * rng.normal(size=n)
        seen.add(t, one > 0.0, np.full(n, number), Y, y, 0.01 * one, 0.01 * one, None)
        rows.append((Y, y))
    mean = np.linalg.lstsq(np.vstack([Y for Y, _ in rows]), np.concatenate([y for _, y in rows]), rcond=None)[0]
    return instrument_fits(seen, mean, mean, mean, np.zeros(4), np.arange(4) < 2, 1e-6 * np.eye(4), 1.0), mean


def test_a_gain_that_is_wrong_from_the_beginning_shows_against_the_other_cell(rng):
    """Either may be the wrong one, and what each does to the estimate is in the intervals."""
    (first, second), mean = scaled_cells(rng, -0.3)
    assert first.gain.size == pytest.approx(0.3 / 0.85, rel=0.1)
    assert second.gain.size == pytest.approx(-0.3 / 0.85, rel=0.1)
    assert first.gain.chance < 1e-6
    for fit, true in ((first, 0.7), (second, 1.0)):
        off = np.abs(mean[:2] - true * np.array([0.5, 0.8]))
        np.testing.assert_allclose(np.abs(fit.gain.suspected[:2]), off, rtol=0.25)


def test_healthy_cells_seldom_have_a_suspected_gain_and_one_cell_has_none():
    each = [scaled_cells(np.random.default_rng(seed), 0.0)[0] for seed in range(60)]
    assert np.mean([fit.gain.suspected.any() for fits in each for fit in fits]) < 0.1
    assert fits(np.random.default_rng(0), lambda _, y: 0.7 * y).gain is None


def test_a_gain_that_is_within_what_is_stated_of_both_moves_nothing(rng):
    def stated(sigma):
        return [Considered(f"scale of {name}", name, "scale", sigma) for name in ("cell_1", "cell_2")]

    (fit, _), _ = scaled_cells(rng, 0.02)
    assert fit.gain.suspected.any()
    assert not with_stated([fit], stated(0.008))[0].gain.suspected.any()
    assert with_stated([fit], stated(0.004))[0].gain.suspected.any()


def test_what_is_left_of_a_wrench_that_is_zero_is_a_share_of_what_the_known_bodies_leave(rng):
    """Body and wheel balance, and nothing is read: a tenth of what the wheel alone leaves over is a tenth."""
    t = 0.01 * np.arange(2000)
    wheel = 2.0 * np.sin(5.0 * t)
    Y, none, one = np.column_stack([-wheel / 0.5, wheel]), np.zeros(t.size), np.ones(t.size)
    Y[:, 0] += 0.1 * np.sqrt(2.0) / 0.5 * rng.normal(size=t.size)
    seen = RowBlocks(2, 0.5, ("base IMU",))
    seen.add(t, np.zeros(t.size, np.bool_), np.zeros(t.size, np.intp), Y, none, 0.01 * one, 0.01 * one, None)
    mean, known, physical = np.array([0.5, 1.0]), np.array([0.0, 1.0]), np.ones(2, np.bool_)
    [fit] = instrument_fits(seen, mean, mean, mean, known, physical, 1e-6 * np.eye(2), 1.0)
    assert fit.unexplained == pytest.approx(0.1, abs=0.005)
    assert judged_fit(fit, 1.0) == ([], [])


def test_what_the_other_cell_leaves_over_is_no_step_of_this_one():
    """A step at the release is seen by the other cell alone: as well as that one fits, not as well as this one does."""
    steps = [two_cells(np.random.default_rng(seed), (0.01, 0.2))[0].step for seed in range(40)]
    assert min(step.chance for step in steps if step is not None) > 1e-3


def test_a_step_is_looked_for_where_the_parameters_leave_more_than_a_hundredth_of_it():
    """Of 70 alike blocks the first alone reads a tenth more: all but a 70th of such a step is taken for the body."""
    n, size = 70, 0.1
    scores = np.full((n, 1), -1e4 * size / n)
    scores[0] += 1e4 * size
    blocks = Blocks(np.arange(float(n)), np.full((n, 1, 1), 1e4), scores, np.ones(n), np.ones(n))
    step = GainTests([blocks], [], np.ones(1), np.full((1, 1), 1e4 * n)).step(np.inf)
    assert step is not None
    assert step.time_s == 1.0
    assert step.size == pytest.approx(-size, rel=0.02)


def test_a_step_that_a_released_payload_would_take_up_is_none(rng):
    """A twentieth of the readings, which hardly tells a gain, is another one after the release: no jump of the gain."""
    t = 0.01 * np.arange(2000)
    held, one = t < 10.0, np.ones(t.size)
    swing, faint = np.sin(5.0 * t), 0.02 * np.cos(7.0 * t)
    Y = np.column_stack([swing, held * swing, faint, one])
    y = Y @ [0.5, 0.8, 1.0, 3.0] - np.where(held, 0.0, 1.5) * faint + 0.002 * rng.normal(size=t.size)
    seen = RowBlocks(4, 0.5, ("cell",))
    seen.add(t, held, np.zeros(t.size, np.intp), Y, y, 0.002 * one, 0.002 * one, None)
    mean, physical = np.linalg.lstsq(Y, y, rcond=None)[0], np.array([True, True, True, False])
    [fit] = instrument_fits(seen, mean, mean, mean, np.zeros(4), physical, 1e-6 * np.eye(4), 1.0)
    assert fit.step is None or abs(fit.step.time_s - 10.0) > 0.5
    assert judged_fit(fit, 1.0)[0] == []


@pytest.mark.parametrize("scale", [1.0, 1.05])
def test_a_long_rest_before_the_motion_hides_no_jump_and_makes_none(rng, scale):
    """Rows of rest are exact: 100 times as large a signal, were it one."""
    t = 0.01 * np.arange(3000)
    moves, sigma = t > 20.0, np.where(t > 20.0, 0.05, 0.0005)
    Y = np.column_stack([np.where(moves, np.sin(5.0 * t), 0.7), np.where(moves, np.cos(7.0 * t), 0.2), np.ones(t.size)])
    y = np.where(t > 25.0, scale, 1.0) * (Y @ (TRUTH * PHYSICAL)) + TRUTH[2] + sigma * rng.normal(size=t.size)
    mean = np.linalg.lstsq(Y / sigma[:, None], y / sigma, rcond=None)[0]
    seen = RowBlocks(3, 0.5, ("cell",))
    seen.add(t, np.ones(t.size, bool), np.zeros(t.size, np.intp), Y, y, sigma, sigma, None)
    fit = instrument_fits(seen, mean, mean, TRUTH, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0)[0]
    assert fit.step is not None
    if scale == 1.0:
        assert judged_fit(fit, 1.0) == ([], [])
    else:
        assert fit.step.size == pytest.approx(scale - 1.0, rel=0.3)
        assert fit.step.time_s == pytest.approx(25.0, abs=1.0)
        assert "cell reads +" in judged_fit(fit, 1.0)[0][0]


@pytest.mark.parametrize("block", [0, 59])
def test_one_block_that_is_off_at_an_end_is_no_step(rng, block):
    fit = fits(rng, lambda t, y: np.where(np.floor(t / 0.5) == block, 1.3, 1.0) * y)
    assert fit.step is not None
    assert fit.step.chance > 0.01
    assert judged_fit(fit, 1.0) == ([], [])


def test_what_vibration_leaves_over_is_seldom_a_step():
    """Twenty times the stated noise: of two blocks at an end, alike by chance, 3 % of the runs made a step."""

    def has_stepped(seed):
        fit = fits(
            np.random.default_rng(seed),
            lambda t, y: y + 0.1 * np.random.default_rng(seed).normal(size=t.size),
            sigma=0.005,
        )
        return any("s after its first row on" in said for part in judged_fit(fit, 1.0) for said in part)

    assert not any(has_stepped(seed) for seed in range(150))


def test_rows_that_read_nothing_have_no_gain():
    """A wrench that is known to be zero: the fit finds what makes it so, and no reading is there to change."""
    n, sigma = 600, 0.05
    t = 0.01 * np.arange(n)
    Y = np.column_stack([np.sin(5.0 * t), np.sin(5.0 * t) * np.where(t > 3.0, 1.4, 1.0) + 0.1, np.full(n, 0.1)])
    seen = RowBlocks(3, 0.5, ("base IMU",))
    seen.add(t, np.ones(n, bool), np.zeros(n, np.intp), Y, np.zeros(n), np.full(n, sigma), np.full(n, sigma), None)
    [fit] = instrument_fits(
        seen, np.array([1.0, -0.9, 0.5]), TRUTH, TRUTH, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0
    )
    assert fit.step is None
    assert np.isnan(fit.response)


def test_an_instrument_that_hardly_reacts_is_told(rng):
    fit = fits(rng, lambda _, y: 0.01 * y)
    assert fit.response == pytest.approx(0.01, rel=0.8)
    assert any("of what the drawing makes of this motion" in said for said in judged_fit(fit, 1.0)[0])


def test_readings_that_no_body_explains_are_told(rng):
    fit = fits(rng, lambda t, y: y + 0.4 * np.sin(11.0 * t))
    assert any("left over" in said for said in judged_fit(fit, 1.0)[0])


def test_what_is_left_over_is_held_against_the_noise_at_the_answer(rng):
    """Sigmas of the rows were made with parameters that were far off: the motion's noise counted a hundredfold."""
    t, noise = 0.01 * np.arange(3000), 0.01
    Y = np.column_stack([np.sin(5.0 * t), np.cos(7.0 * t), np.ones(t.size)])
    y = Y @ TRUTH + 0.4 * np.sin(11.0 * t) + 0.002 * rng.normal(size=t.size)
    doubt = np.zeros((t.size, 1, 4))
    doubt[:, 0, 0] = noise
    wide, own = np.full(t.size, noise * 100.0), np.full(t.size, 0.002)
    seen = RowBlocks(3, 0.5, ("cell",))
    seen.add(t, np.ones(t.size, bool), np.zeros(t.size, np.intp), Y, y, wide, own, doubt)
    fit = instrument_fits(seen, TRUTH, TRUTH, TRUTH, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0)[0]
    assert fit.misfit == pytest.approx(0.5 * 0.4**2 / (own[0] ** 2 + (noise * TRUTH[0]) ** 2), rel=0.05)
    assert any("left over" in said for said in judged_fit(fit, 1.0)[0])


def test_rows_without_the_payload_are_judged_by_themselves(rng):
    """A tenth of all power is left over late: the mean of the whole hides it, a part shows it."""
    t = 0.01 * np.arange(4000)
    held = t < 30.0
    Y = np.column_stack([np.where(held, 3.0, 0.0) * np.sin(5.0 * t), np.sin(5.0 * t), np.ones(t.size)])
    late = np.column_stack([Y[:, 0], np.where(held, Y[:, 1], np.sin(5.0 * t + 0.5)), Y[:, 2]])
    y = late @ TRUTH + 0.002 * rng.normal(size=t.size)
    mean = np.linalg.lstsq(Y, y, rcond=None)[0]
    seen = RowBlocks(3, 0.5, ("cell",))
    seen.add(t, held, np.zeros(t.size, np.intp), Y, y, np.full(t.size, 0.002), np.full(t.size, 0.002), None)
    fit = instrument_fits(seen, mean, mean, TRUTH, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0)[0]
    assert fit.unexplained > 0.4
    assert any("left over" in said for said in judged_fit(fit, 1.0)[0])


def test_a_parameter_that_ran_away_lets_the_noise_of_the_motion_explain_nothing(rng):
    """The second column is noise alone, so that the corrected estimate may be anything there; readings are late."""
    t, noise, own = 0.01 * np.arange(3000), 0.01, np.full(3000, 0.002)
    Y = np.column_stack([np.sin(5.0 * t), noise * rng.normal(size=t.size), np.ones(t.size)])
    y = TRUTH[0] * np.sin(5.0 * t - 0.5) + TRUTH[2] + 0.002 * rng.normal(size=t.size)
    doubt = np.zeros((t.size, 1, 4))
    doubt[:, 0, 1] = noise
    seen = RowBlocks(3, 0.5, ("cell",))
    seen.add(t, np.ones(t.size, bool), np.zeros(t.size, np.intp), Y, y, own, own, doubt)
    away = TRUTH + np.array([0.0, 40.0, 0.0])
    fit = instrument_fits(seen, away, TRUTH, TRUTH, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0)[0]
    assert fit.misfit > 100.0
    assert any("left over" in said for said in judged_fit(fit, 1.0)[0])


def test_a_kind_of_rows_that_noise_explains_hides_none_that_it_does_not(rng):
    """Late readings while the payload is held; after the release there is little more than noise."""
    t = 0.01 * np.arange(4000)
    held, own = t < 30.0, np.full(4000, 0.002)
    Y = np.column_stack([np.where(held, 1.0, 0.0) * np.sin(5.0 * t), 0.01 * np.cos(7.0 * t), np.ones(t.size)])
    y = Y @ TRUTH + np.where(held, 0.5 * (np.sin(5.0 * t - 0.5) - np.sin(5.0 * t)), 0.0) + 0.002 * rng.normal(size=4000)
    seen = RowBlocks(3, 0.5, ("cell",))
    seen.add(t, held, np.zeros(t.size, np.intp), Y, y, own, own, None)
    fit = instrument_fits(seen, TRUTH, TRUTH, TRUTH, np.zeros(3), PHYSICAL, 1e-6 * np.eye(3), 1.0)[0]
    assert any("left over" in said for said in judged_fit(fit, 1.0)[0])


# --- hypotheses -------------------------------------------------------------------------------------------------------
