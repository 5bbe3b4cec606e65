"""Ticks of a flight."""

import numpy as np

from onboard.identification.exiddm.prediction.ticks import Ticks


def test_a_flight_by_the_second_imu_needs_nothing_of_an_instrument_that_is_silent() -> None:
    n, shown = 5, np.arange(13.0)
    sigma = np.tile(0.1 * shown, (n, 1))
    sigma[:, :6] = sigma[:, 12] = np.nan
    q = np.zeros((n, 2))
    ticks = Ticks(
        np.arange(n), q, q, q, np.tile(shown, (n, 1)), sigma, np.zeros((n, 2, 2)), np.zeros((n, 3, 0)), np.zeros((n, 0))
    )
    flight = ticks.flight(0.01, 1, slice(6, 12))
    np.testing.assert_array_equal(flight.rate[0], [6, 7, 8])
    np.testing.assert_array_equal(flight.specific_force[0], [9, 10, 11])
    np.testing.assert_allclose(flight.rate_sigma, [0.6, 0.7, 0.8])
    np.testing.assert_allclose(flight.specific_force_sigma, [0.9, 1.0, 1.1])
