"""What the tests of a whole flight share: ticks, a predictor and a fit."""

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard.dynamics.model.payload import standard_of
from onboard.identification.whole_flight.fit import WholeFlight
from tests.dynamics.free_flyer_twin import BOX
from tests.dynamics.free_flyer_twin import PAYLOAD as TRUTH
from tests.identification.free_flyer.recorded_flights import BIASED, WIDE, recorded, ticks_of
from tests.identification.whole_flight.flights import CAPTURE_s, END_s, predictor_of, segments, started


@pytest.fixture(scope="module")
def ticks():
    """Nothing held, then a capture."""
    rng = np.random.default_rng(5)
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3))
    capture = free_flyer.Capture(BOX, CAPTURE_s, 0.02 * rng.normal(size=3), 0.02 * rng.normal(size=3))
    free_flyer.fly_with_capture(flight, capture, END_s)
    return ticks_of(recorded(flight.history, rng, BIASED))


@pytest.fixture(scope="module")
def predictor():
    return predictor_of()


@pytest.fixture(scope="module")
def fitted(ticks, predictor):
    flight = WholeFlight(predictor, WIDE, segments(ticks))
    return flight, flight.fit(started(flight, predictor, 1.1 * standard_of(TRUTH)))


@pytest.fixture(scope="module")
def noisy(ticks):
    """Joint accelerations with white noise, which is known, and which the rates do not have."""
    of_each = 0.3 * np.array([[0.0], [1.0]])
    sigma = np.broadcast_to(of_each, ticks.joint_sigma.shape).copy()
    ddq = ticks.ddq + 0.3 * np.random.default_rng(8).standard_normal(ticks.ddq.shape)
    return ticks._replace(ddq=ddq, joint_sigma=sigma, sample_sigma=sigma)
