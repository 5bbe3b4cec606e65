"""A log of parabolas is cut by a state machine: made-up ticks in, releases, motions, bumps and catches out."""

import re

import numpy as np
import pytest

from onboard.config.bases.parabola import Parabola
from onboard.ground.identify.kinds.parabolic_log import Stage, cut, stages
from onboard.identification.free_flyer.prediction.ticks import Ticks

PERIOD_s, SIGMA_m_s2 = 0.01, 0.028
SETTINGS = Parabola()


def ticks(rng, low, free, moving, bump=None, seconds=40.0):
    """1.8 g but for ``low``; rough but for ``free``; one joint turns within ``moving``; spans in s."""
    time_s = PERIOD_s * np.arange(round(seconds / PERIOD_s))
    n = len(time_s)

    def within(span):
        return (time_s >= span[0]) & (time_s < span[1])

    force = SIGMA_m_s2 * rng.standard_normal((n, 3))
    force[~within(free)] += 0.15 * rng.standard_normal((int((~within(free)).sum()), 3))
    force[~within(low), 2] += 17.65
    if bump is not None:
        force[within((bump, bump + 0.06)), 0] += 1.0
    measured = np.hstack([np.zeros((n, 3)), force])
    sigma = np.tile([6e-4] * 3 + [SIGMA_m_s2] * 3, (n, 1))
    dq = np.where(within(moving), 0.3, 0.0)[:, None]
    return Ticks(
        100.0 + time_s,
        0.0 * dq,
        dq,
        0.0 * dq,
        measured,
        sigma,
        *np.zeros((2, n, 2, 1)),
        np.zeros((n, 3, 0)),
        np.zeros((n, 0)),
        np.ones(n),
    )


def test_a_run_is_a_release_a_motion_and_a_catch(rng):
    flown = ticks(rng, (8.0, 30.0), (12.0, 27.0), (14.0, 26.0))
    (run,) = cut(flown, PERIOD_s, SETTINGS)
    assert run.reason == ""
    assert run.release_s == pytest.approx(112.0, abs=0.2)
    assert run.catch_s == pytest.approx(127.0, abs=0.2)
    assert run.bumps_s == ()
    (motion,) = run.motions_s
    assert motion == pytest.approx((114.0, 126.0), abs=0.05)
    (part,) = run.parts
    used = flown.time_s[part]
    assert used[0] >= 112.0 + 0.2
    assert used[-1] <= 127.0 - 0.2
    at = stages(flown, PERIOD_s, SETTINGS)
    order = [stage for k, stage in enumerate(at) if k == 0 or stage != at[k - 1]]
    assert order == [Stage.SECURED, Stage.HELD, Stage.FREE, Stage.MOTION, Stage.FREE, Stage.HELD, Stage.SECURED]


def test_a_bump_divides_a_run(rng):
    flown = ticks(rng, (8.0, 30.0), (12.0, 27.0), (14.0, 26.0), bump=20.0)
    (run,) = cut(flown, PERIOD_s, SETTINGS)
    assert run.bumps_s == (pytest.approx(120.03, abs=0.1),)
    first, second = (flown.time_s[part] for part in run.parts)
    assert first[-1] < 120.0 - SETTINGS.settle_s
    assert second[0] > 120.06 + SETTINGS.settle_s


def test_a_contact_that_lasts_longer_than_what_is_left_out_beside_it_is_a_catch(rng):
    flown = ticks(rng, (8.0, 30.0), (12.0, 27.0), (14.0, 26.0))
    touched = (flown.time_s > 119.0) & (flown.time_s < 119.8)
    flown.measured[touched, 3:6] += 0.3 * rng.standard_normal((int(touched.sum()), 3))
    first, second = cut(flown, PERIOD_s, SETTINGS)
    assert first.catch_s == pytest.approx(119.0, abs=0.2)
    assert second.release_s == pytest.approx(119.8, abs=0.2)
    (run,) = cut(flown, PERIOD_s, SETTINGS.model_copy(update={"settle_s": 0.6}))
    assert len(run.bumps_s) == 1


@pytest.mark.parametrize(("pause_s", "motions"), [(0.15, 1), (0.3, 2)])
def test_a_pause_of_twenty_ticks_ends_a_motion_however_slow(rng, pause_s, motions):
    flown = ticks(rng, (8.0, 30.0), (12.0, 27.0), (14.0, 26.0))
    flown.dq[:] *= 0.015 / 0.3  # rad/s
    flown.dq[(flown.time_s > 118.0) & (flown.time_s < 118.0 + pause_s)] = 0.0
    (run,) = cut(flown, PERIOD_s, SETTINGS)
    assert len(run.motions_s) == motions


@pytest.mark.parametrize(
    ("free", "moving", "reason"),
    [
        ((0.0, 0.0), (14.0, 26.0), "never let go"),
        ((12.0, 14.5), (12.0, 14.0), r"free for 2\.\d s only"),
        ((12.0, 27.0), (0.0, 0.0), "the arm did not move"),
    ],
)
def test_what_is_no_run_says_why(rng, free, moving, reason):
    (run,) = cut(ticks(rng, (8.0, 30.0), free, moving), PERIOD_s, SETTINGS)
    assert re.search(reason, run.reason)


def test_joints_that_are_missing_divide_a_run(rng):
    flown = ticks(rng, (8.0, 30.0), (12.0, 27.0), (14.0, 26.0))
    flown.q[(flown.time_s > 119.0) & (flown.time_s < 119.5)] = np.nan
    (run,) = cut(flown, PERIOD_s, SETTINGS)
    assert [round(float(flown.time_s[part.start]), 1) for part in run.parts][1] == pytest.approx(119.5, abs=0.1)


def test_level_flight_has_no_run(rng):
    assert cut(ticks(rng, (0.0, 0.0), (0.0, 0.0), (14.0, 26.0)), PERIOD_s, SETTINGS) == []
    none = ticks(rng, (8.0, 30.0), (12.0, 27.0), (14.0, 26.0))
    none.measured[:] = np.nan
    assert cut(none, PERIOD_s, SETTINGS) == []
