"""States to go back to."""

import numpy as np

from onboard.flight.estimate.state import UnwrittenParts, from_bytes
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded
from onboard.identification.free_flyer.recursion.snapshots import TIERS, Snapshots
from onboard.identification.free_flyer.steps import Adds
from tests.flight.estimate.state_bytes import to_bytes


def test_a_state_comes_back_whole_and_the_oldest_one_stands_for_those_before_it(rng):
    states, halves = rng.normal(size=(5, 4)), rng.normal(size=(5, 4, 4))
    covariances = halves @ halves.swapaxes(1, 2)
    covariances = 0.5 * (covariances + covariances.swapaxes(1, 2))
    snapshots = Snapshots(0.01, [(3, 1)])
    step = Adds(np.array([2, 3]), rng.normal(size=4), rng.normal(size=(4, 2)))
    for number, (state, covariance) in enumerate(zip(states, covariances, strict=True)):
        noise = NoiseAdded(2.0 * state, 3.0 * covariance) if number > 1 else NoiseAdded.none(4)
        snapshots.append(state, covariance, noise, step if number == 3 else None)
    assert len(snapshots) == 3
    again = from_bytes(to_bytes(snapshots, UnwrittenParts(None)), UnwrittenParts(None))
    for one in (snapshots, again):
        for back, number in ((0, 4), (1, 3), (2, 2), (9, 2)):
            (state, covariance), believed, noise = one.back(back)
            assert (believed is not None) == (number == 3)
            np.testing.assert_array_equal(state, states[number])
            np.testing.assert_array_equal(covariance, covariances[number])
            np.testing.assert_array_equal(noise.gradient, 2.0 * states[number])
            np.testing.assert_array_equal(noise.information, 3.0 * covariances[number])
    believed, (state, _) = again.back(1).step, again.back(0).known
    np.testing.assert_array_equal(believed.at, step.at)
    np.testing.assert_array_equal(believed.shift, step.shift)
    np.testing.assert_array_equal(believed.root, step.root)
    snapshots.become(lambda known: (2.0 * known[0], known[1]))
    np.testing.assert_array_equal(snapshots.back(0).known[0], 2.0 * state)
    assert snapshots.back(1).step is None
    snapshots.clear()
    assert len(snapshots) == 0


def test_of_older_states_some_are_kept_and_the_next_older_one_is_given():
    snapshots = Snapshots(0.01)
    for number in range(300):
        snapshots.append(np.array([float(number)]), np.eye(1), NoiseAdded.none(1))
    given = [int(snapshots.back(batches).known[0][0]) for batches in range(80)]
    assert given[:8] == list(range(299, 291, -1))
    for first, (last, every) in zip((0, 8, 28), TIERS, strict=True):
        for batches in range(first, last):
            assert 299 - batches - every < given[batches] <= 299 - batches
    assert len(snapshots) <= 19
