"""Steps of an instrument in a flight that is fitted as a whole."""

import numpy as np
import pytest

from onboard.dynamics.model.payload import standard_of
from onboard.identification.whole_flight.blocks import total_of
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.segments import divided
from onboard.identification.whole_flight.witnesses import StepsInside
from tests.dynamics.free_flyer_twin import PAYLOAD as TRUTH
from tests.identification.free_flyer.recorded_flights import WIDE
from tests.identification.whole_flight.flights import CAPTURE_s, fitted_freely, segments, spoilt_from


@pytest.mark.parametrize(
    ("columns", "factor"), [([3, 4, 5], 1.1), pytest.param([0, 1, 2], 0.97, marks=pytest.mark.campaign)]
)  # of the gyro alike
def test_a_step_in_flight_is_named_and_an_unknown_from_its_time_on(ticks, predictor, fitted, columns, factor):
    """Two seconds after the capture; beside what is right, the answer is hardly wider."""
    _, whole = fitted
    measured, at = ticks.measured.copy(), int(np.searchsorted(ticks.time_s, CAPTURE_s + 2.0))
    measured[at:, columns] *= factor
    stepped = segments(ticks._replace(measured=measured))
    made = fitted_freely(WholeFlight(predictor, WIDE, stepped), whole)
    assert made.names[0] == "a step of imu"
    assert made.passes
    assert np.abs(made.found.chi - standard_of(TRUTH))[0] < 2.0 * np.sqrt(made.found.chi_covariance[0, 0])
    assert made.found.chi_covariance[0, 0] < 2.0 * whole.chi_covariance[0, 0]
    assert sum("_from_" in name for name in made.found.names) == 1
    which = next(k for k, name in enumerate(made.found.names) if "_from_" in name)
    assert 0.1 * made.found.fit.x[which] == pytest.approx(factor - 1.0, abs=0.01)


def test_a_step_is_taken_once_where_the_joints_are_noisy(noisy, predictor, fitted):
    """Their noise is in the derivatives by a step as it is in those by the constant."""
    flight = WholeFlight(predictor, WIDE, segments(spoilt_from(noisy, CAPTURE_s + 2.0, 1.1)))
    made = fitted_freely(flight, fitted[1])
    assert [name for name in made.found.names if "_from_" in name] == ["a step of imu_from_0"]
    again = StepsInside.of(made.flight, made.found)
    assert not [one for one in again.hypotheses(again.changed) if one.nats > 2.0]


def test_steps_of_a_flight_are_those_of_normal_equations_with_more_unknowns(ticks, predictor, fitted):
    """Mean and covariance with two of them, by the bank and by the flight in which both are unknowns."""
    _, whole = fitted
    flight = WholeFlight(predictor, WIDE, segments(spoilt_from(ticks, CAPTURE_s + 2.0, 1.01)))
    found = flight.fit(whole.fit.x)
    steps = StepsInside.of(flight, found)
    kind = next(k for k, one in enumerate(steps.kinds) if flight.names[one.at[0]] == "accelerometer_scale_x")
    which = [len(steps.kinds) * int(np.abs(steps.times_s - at_s).argmin()) + kind for at_s in (8.0, 11.0)]
    size, root = steps.changed.sizes(which)
    x = found.fit.x + steps.changed.D[:, which] @ size
    sigma = np.sqrt(
        np.diag(found.fit.covariance + steps.changed.D[:, which] @ root @ root.T @ steps.changed.D[:, which].T)
    )
    p = len(x)
    total = total_of(found.blocks, p)
    more, gradient = np.zeros((p + 2, p + 2)), np.zeros(p + 2)
    more[:p, :p], gradient[:p] = total.information + flight.prior_information, 0.0
    along = np.zeros((p, 1))
    along[steps.kinds[kind].at] = steps.kinds[kind].along
    later = [total_of([b for b in found.blocks if b.middle_s > steps.taken(k)[1][1]], p) for k in which]
    for k, one in enumerate(later):
        more[:p, p + k] = more[p + k, :p] = (one.information @ along)[:, 0]
        gradient[p + k] = float(along[:, 0] @ one.gradient)
        for j in range(2):
            more[p + k, p + j] = float(along[:, 0] @ later[max(k, j)].information @ along[:, 0]) + (k == j)
    P = np.linalg.inv(more)
    wanted = -P @ gradient
    np.testing.assert_allclose(size, wanted[p:], rtol=1e-4)
    np.testing.assert_allclose((x - found.fit.x)[:10], wanted[:10], rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(sigma[:10], np.sqrt(np.diag(P))[:10], rtol=1e-3)


def test_what_may_have_stepped_is_not_read_about_the_time_of_it(ticks):
    """Which is known to a block; the other lines are."""
    free, held = segments(ticks)
    at_s = CAPTURE_s + 3.0
    parts = divided([free, held], [slice(3, 6)], (at_s - 1.0, at_s, at_s + 2.0))
    assert [one.held for one in parts] == [free.held, held.held, held.held]
    assert parts[1].ticks.time_s[-1] < at_s <= parts[2].ticks.time_s[0]
    time_s = np.concatenate([one.ticks.time_s for one in parts])
    np.testing.assert_array_equal(time_s, np.concatenate([free.ticks.time_s, held.ticks.time_s]))
    measured = np.concatenate([one.ticks.measured for one in parts])
    unread = (time_s > at_s - 1.0) & (time_s < at_s + 2.0)
    assert np.isnan(measured[unread, 3:6]).all()
    assert np.isfinite(measured[~unread]).all()
    assert np.isfinite(measured[:, :3]).all()
    assert np.isfinite(held.ticks.measured).all()  # the readings that were given stay
