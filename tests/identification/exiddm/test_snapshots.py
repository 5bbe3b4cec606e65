"""States to go back to."""

import numpy as np

from onboard.flight.state import Places, from_bytes, to_bytes
from onboard.identification.exiddm.snapshots import Snapshots


def test_a_state_comes_back_whole_and_the_oldest_one_stands_for_those_before_it(rng):
    states, halves = rng.normal(size=(5, 4)), rng.normal(size=(5, 4, 4))
    covariances = halves @ halves.swapaxes(1, 2)
    covariances = 0.5 * (covariances + covariances.swapaxes(1, 2))
    snapshots = Snapshots(3)
    for state, covariance in zip(states, covariances, strict=True):
        snapshots.append(state, covariance)
    assert len(snapshots) == 3
    again = from_bytes(to_bytes(snapshots, Places(None)), Places(None))
    for one in (snapshots, again):
        for back, number in ((0, 4), (1, 3), (2, 2), (9, 2)):
            state, covariance = one.back(back)
            np.testing.assert_array_equal(state, states[number])
            np.testing.assert_array_equal(covariance, covariances[number])
    snapshots.clear()
    assert len(snapshots) == 0
