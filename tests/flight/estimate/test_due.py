"""Ticks of the estimator's rows: on one grid, none where time was left out, and no memory for what was."""

import numpy as np
import pytest

from onboard import config
from onboard.flight.estimate.estimator import Estimator


@pytest.fixture(scope="module")
def vehicle():
    return config.load(config.packaged("rocksat"))


def test_ticks_are_those_of_the_grid_outside_of_what_was_left_out(vehicle, rng):
    estimator = Estimator(vehicle)
    period_ns = round(1e9 / vehicle.file.estimation.row_rate_hz)
    now_ns, last_ns, count = 12_345_678, None, 0
    for _ in range(300):
        since_ns, now_ns = now_ns, now_ns + int(rng.integers(1, 5 * period_ns))
        left_out = []
        if rng.random() < 0.2:
            left_out = [(since_ns, since_ns + int(rng.integers(0, 20 * period_ns)))]
            now_ns = max(now_ns, left_out[0][1])
            estimator.left_out_ns += left_out
        ranges = list(estimator.left_out_ns)
        found = estimator.due(now_ns)
        first_ns = -(-now_ns // period_ns) * period_ns if last_ns is None else last_ns + period_ns
        grid = np.arange(first_ns, now_ns + 1, period_ns)
        last_ns = first_ns + len(grid) * period_ns - period_ns
        for low, high in ranges:
            grid = grid[(grid < low) | (grid > high)]
        assert found.tolist() == grid.tolist()
        count += len(found)
    assert count > 300


def test_a_pause_of_a_century_takes_no_memory(vehicle):
    estimator = Estimator(vehicle)
    estimator.due(10**9)
    century_ns = 100 * 365 * 86_400 * 10**9
    estimator.left_out_ns.append((10**9, 10**9 + century_ns))
    assert 0 < len(estimator.due(2 * 10**9 + century_ns)) < 1000
