"""Short gaps of the joints, on a flight of MuJoCo: filled as the joints moved, however the ticks come."""

import numpy as np
import pytest

from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.prediction.ticks import JointGaps, LONGEST_s, Ticks
from tests.identification.free_flyer.recorded_flights import online, ticks_of


def without(ticks, *gaps):
    """Ticks whose second joint is not known in some intervals of them."""
    ticks = Ticks(*(part.copy() for part in ticks))
    for gap in gaps:
        for part in (ticks.q, ticks.dq, ticks.ddq):
            part[gap, 1] = np.nan
    return ticks


def test_the_joints_move_smoothly_through_a_gap_and_nothing_is_taken_for_measured(held):
    whole = ticks_of(held)
    period_s = whole.time_s[1] - whole.time_s[0]
    gap = slice(200, 200 + round(0.3 / period_s))
    found = JointGaps(period_s, whole.part(slice(0, 0))).take(without(whole, gap))
    np.testing.assert_array_equal(found.time_s, whole.time_s)
    assert np.isnan(found.measured[gap]).all()
    assert np.isfinite(found.joint_sigma[gap]).all()
    for kind in ("q", "dq", "ddq"):
        now, true = getattr(found, kind)[gap], getattr(whole, kind)[gap]
        moved = np.abs(true - true[:1]).max(axis=0)[1]
        assert 0.0 < np.abs(now - true)[:, 1].max() < 0.02 * moved, kind
    after = slice(gap.stop, None)
    np.testing.assert_array_equal(found.measured[after], whole.measured[after])


def test_over_the_longest_gap_the_momentum_is_as_known_as_by_a_reading(held):
    ticks, recursive = ticks_of(held), online(held)
    recursive.update(ticks)
    recursive.finish()
    predictor, state = recursive.predictor, recursive.state
    none, long = ticks.part(slice(0, 0)), round(LONGEST_s / held.period_s) - 1
    errors = []
    for first in range(100, len(ticks.time_s) - long - 4, 23):
        near = ticks.part(slice(first, first + long + 3))
        filled = JointGaps(held.period_s, none).take(without(near, slice(2, long + 1)))
        rates = [predictor.predict(one.q, one.dq, one.ddq, state).values[-1, :3] for one in (near, filled)]
        errors.append(np.abs(rates[1] - rates[0]).max())
    assert 0.1 < max(errors) / held.rate_sigma.max() < 1.0


@pytest.mark.parametrize("longest", [1, 7, 1000])
def test_ticks_come_out_alike_however_they_come_in(held, longest):
    whole = ticks_of(held)
    period_s, none = whole.time_s[1] - whole.time_s[0], whole.part(slice(0, 0))
    too_long = slice(400, 402 + round(LONGEST_s / period_s))
    some = without(whole, slice(0, 3), slice(50, 60), slice(70, 71), too_long, slice(len(whole.time_s) - 5, None))
    gaps = JointGaps(period_s, none)
    parts = [gaps.take(some.part(slice(k, k + longest))) for k in range(0, len(some.time_s), longest)]
    found, at_once = Ticks.joined(parts), JointGaps(period_s, none).take(some)
    for part, other in zip(found, at_once, strict=True):
        np.testing.assert_array_equal(part, other)
    left_out = np.r_[0:3, too_long, len(whole.time_s) - 5 : len(whole.time_s)]
    np.testing.assert_array_equal(found.time_s, np.delete(whole.time_s, left_out))


def test_ticks_that_are_missing_are_not_made(held):
    whole = ticks_of(held)
    period_s = whole.time_s[1] - whole.time_s[0]
    some = without(whole, slice(50, 60))
    some = Ticks(*(np.delete(part, 55, axis=0) for part in some))
    found = JointGaps(period_s, whole.part(slice(0, 0))).take(some)
    np.testing.assert_array_equal(found.time_s, np.delete(whole.time_s, np.arange(50, 60)))


def test_a_payload_is_found_where_no_second_is_without_a_gap(held):
    ticks, recursive = ticks_of(held), online(held)
    every, long = (round(one / recursive.predictor.period_s) for one in (0.8, 0.3))
    gaps = [slice(k, k + long) for k in range(every, len(ticks.time_s), every)]
    recursive.update(without(ticks, *gaps))
    recursive.finish()
    whole = online(held)
    whole.update(ticks)
    whole.finish()
    assert recursive.estimate() is not None
    sigma = np.sqrt(np.diag(recursive.covariance)[PAYLOAD])
    assert (np.abs(recursive.state - whole.state)[PAYLOAD] < 2.0 * sigma).all()
    assert recursive.ticks_used < 0.7 * whole.ticks_used
