"""Ticks of a flight."""

import numpy as np

from onboard.identification.free_flyer.prediction.ticks import Ticks, ticks_of
from onboard.regressor.rows import BaseMotion
from onboard.regressor.signals import SignalNoise, Signals


def test_a_flight_by_the_second_imu_needs_nothing_of_an_instrument_that_is_silent() -> None:
    n, shown = 5, np.arange(13.0)
    sigma = np.tile(0.1 * shown, (n, 1))
    sigma[:, :6] = sigma[:, 12] = np.nan
    q = np.zeros((n, 2))
    ticks = Ticks(
        np.arange(n),
        q,
        q,
        q,
        np.tile(shown, (n, 1)),
        sigma,
        *np.zeros((2, n, 2, 2)),
        np.zeros((n, 3, 0)),
        np.zeros((n, 0)),
        np.ones(n),
    )
    flight = ticks.flight(0.01, 1, slice(6, 12))
    np.testing.assert_array_equal(flight.rate[0], [6, 7, 8])
    np.testing.assert_array_equal(flight.specific_force[0], [9, 10, 11])
    np.testing.assert_allclose(flight.rate_sigma, [0.6, 0.7, 0.8])
    np.testing.assert_allclose(flight.specific_force_sigma, [0.9, 1.0, 1.1])


def test_the_noise_of_rates_is_inflated_and_that_of_accelerations_is_not() -> None:
    q, still, lines = np.zeros((4, 2)), np.zeros((4, 3)), np.zeros((4, 6))
    noise = SignalNoise(q, np.full((4, 2), 3.0), np.full((4, 2), 5.0), still, still, still, 2.0)
    signals = Signals(np.arange(4.0), q, q, q, BaseMotion(still, still, still), lines, lines, noise=noise)
    found = ticks_of(signals, lines).joint_sigma
    np.testing.assert_array_equal(found, np.broadcast_to([[6.0, 6.0], [5.0, 5.0]], (4, 2, 2)))
