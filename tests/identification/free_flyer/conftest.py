"""Flights flown once for all tests: one that holds a payload, one that captures and releases it."""

import numpy as np
import pytest

from bench.true_flights import free_flyer
from tests.dynamics.free_flyer_twin import BOX, twin
from tests.identification.free_flyer.recorded_flights import CAPTURE_s, END_s, RELEASE_s, recorded


def sealed(signals):
    """No test changes what the next ones fly."""
    for part in signals:
        if isinstance(part, np.ndarray):
            part.setflags(write=False)
    return signals


@pytest.fixture(scope="session")
def flown():
    return twin(8.0)


@pytest.fixture(scope="session")
def held(flown):
    return sealed(recorded(flown.flight, np.random.default_rng(3)))


@pytest.fixture(scope="session")
def mission():
    """Nothing held, a capture, a release."""
    rng = np.random.default_rng(11)
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3))
    capture = free_flyer.Capture(BOX, CAPTURE_s, 0.02 * rng.normal(size=3), 0.02 * rng.normal(size=3))
    free_flyer.fly_with_capture(flight, capture, RELEASE_s)
    flight.release()
    flight.advance(round((END_s - RELEASE_s) / flight.step_s))
    return sealed(recorded(flight.history, rng))
