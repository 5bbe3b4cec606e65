"""The noise of encoders is what their samples scatter by, where that is less than what is stated."""

import numpy as np
import pytest

from onboard.estimation.smoothing import SmoothingWindow
from onboard.flight.estimate.readings.scatter import SampleScatter


@pytest.mark.parametrize(("over_stated", "share"), [(0.02, 0.0004), (0.5, 0.25), (1.0, 1.0), (3.0, 1.0)])
def test_noise_is_not_taken_for_larger_than_the_samples_scatter_nor_than_what_is_stated(over_stated, share):
    rng, stated = np.random.default_rng(5), np.array([1e-3, 1e-3])
    times = np.arange(0.0, 20.0, 0.005)
    values = np.sin(times)[:, None] + over_stated * stated * rng.standard_normal((len(times), 2))
    scatter = SampleScatter(["joint_1"])
    assert scatter.share(["joint_1", "wheel"]).tolist() == [1.0, 1.0]
    for first in np.arange(0.2, 19.8, 0.1):
        window = SmoothingWindow(times, first + np.arange(0.0, 0.1, 0.01), 0.1)
        scatter.take(["joint_1", "wheel"], window, values, stated)
    assert scatter.share(["joint_1", "wheel"]) == pytest.approx([share, 1.0], rel=0.1, abs=1e-3)


def test_a_jump_does_not_hide_how_small_the_noise_is():
    times = np.arange(0.0, 20.0, 0.005)
    values = (times > 10.0)[:, None] * 0.5
    scatter = SampleScatter(["joint_1"])
    for first in np.arange(0.2, 19.8, 0.1):
        window = SmoothingWindow(times, first + np.arange(0.0, 0.1, 0.01), 0.1)
        scatter.take(["joint_1"], window, values, np.array([1e-3]))
    assert scatter.share(["joint_1"])[0] < 0.5
