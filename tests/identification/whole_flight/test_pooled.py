"""Several flights in one estimate: it is the fit of them all, and tells one of another payload."""

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard.dynamics.model.payload import standard_of
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.pooled import Pool
from onboard.identification.whole_flight.segments import Segment
from tests.dynamics.free_flyer_twin import BOX
from tests.dynamics.free_flyer_twin import PAYLOAD as TRUTH
from tests.identification.free_flyer.recorded_flights import BIASED, WIDE, recorded, ticks_of
from tests.identification.whole_flight.flights import started


def flown(predictor, seed, payload=BOX):
    """A release by hand: another motion and momentum, the same instruments and vehicle."""
    rng = np.random.default_rng(seed)
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), rng.uniform(-0.1, 0.1, 3), payload)
    flight.advance(3500)
    ticks = ticks_of(recorded(flight.history, rng, BIASED))
    return WholeFlight(predictor, WIDE, [Segment(ticks, held=True)])


def fit(predictor, flights):
    starts = [started(flight, predictor, 1.1 * standard_of(TRUTH)) for flight in flights]
    return Pool(flights).fit(starts, starts[0])


@pytest.fixture(scope="module")
def flights(predictor):
    return [flown(predictor, seed) for seed in (11, 12)]


def test_of_one_flight_it_is_its_fit(predictor, flights):
    alone = flights[0].fit(started(flights[0], predictor, standard_of(TRUTH)))
    pooled = fit(predictor, flights[:1])
    sigma = np.sqrt(np.diag(alone.chi_covariance))
    assert (np.abs(pooled.chi - alone.chi) < 0.05 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.diag(pooled.chi_covariance)), sigma, rtol=0.01)
    assert pooled.held_out is None


def test_two_flights_tell_more_than_each_and_agree(predictor, flights):
    pooled = fit(predictor, flights)
    off = pooled.chi - standard_of(TRUTH)
    assert off @ np.linalg.solve(pooled.chi_covariance, off) < 25.2  # 99.5 % of chi-squared with 10
    alone = fit(predictor, flights[:1])
    assert (np.diag(pooled.payload.covariance) < np.diag(alone.payload.covariance)).all()
    assert pooled.misfit == pytest.approx(1.0, abs=0.15)
    assert min(one.chance for one in pooled.disagreements) > 1e-3
    assert pooled.held_out is not None
    assert pooled.held_out.worst.relative_error < 0.2


def test_a_flight_with_another_payload_is_told(predictor, flights):
    other = flown(predictor, 13, free_flyer.Body.box(5.6, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08)))
    pooled = fit(predictor, [*flights, other])
    chances = [one.chance for one in pooled.disagreements]
    assert chances[2] < 1e-6
