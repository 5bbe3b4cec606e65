"""States to go back to."""

import numpy as np

from onboard.flight.estimate.state import Places, from_bytes, to_bytes
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


def test_of_older_states_every_fourth_is_kept_and_the_next_older_one_is_given():
    snapshots = Snapshots(28)
    for number in range(100):
        snapshots.append(np.array([float(number)]), np.eye(1))
    given = [int(snapshots.back(batches)[0][0]) for batches in range(28)]
    assert given[:8] == list(range(99, 91, -1))
    assert all(99 - batches - 4 < number <= 99 - batches for batches, number in enumerate(given))
    assert len(snapshots) <= 14
