"""The noise of encoders is what their samples scatter by."""

import numpy as np
import pytest

from onboard.estimation.smoothing import SmoothingWindow
from onboard.flight.estimate.readings.scatter import SampleScatter


@pytest.mark.parametrize(("over_stated", "power"), [(0.02, 0.0004), (0.5, 0.25), (1.0, 1.0), (3.0, 9.0)])
def test_noise_is_what_the_samples_scatter_by_and_no_more_than_stated_where_a_gear_adds_to_it(over_stated, power):
    rng, stated = np.random.default_rng(5), np.full(3, 1e-3)
    times = np.arange(0.0, 20.0, 0.005)
    values = np.sin(times)[:, None] + over_stated * stated * rng.standard_normal((len(times), 3))
    scatter, names = SampleScatter({"joint_1": False, "joint_2": True}), ["joint_1", "joint_2", "wheel"]
    assert scatter.power(names).tolist() == [1.0, 1.0, 1.0]
    for first in np.arange(0.2, 19.8, 0.1):
        window = SmoothingWindow(times, first + np.arange(0.0, 0.1, 0.01), 0.1)
        scatter.take(names, window, values, stated)
    assert scatter.power(names) == pytest.approx([power, min(power, 1.0), 1.0], rel=0.1, abs=1e-3)


def test_a_jump_does_not_hide_how_small_the_noise_is():
    times = np.arange(0.0, 20.0, 0.005)
    values = (times > 10.0)[:, None] * 0.5
    scatter = SampleScatter({"joint_1": False})
    for first in np.arange(0.2, 19.8, 0.1):
        window = SmoothingWindow(times, first + np.arange(0.0, 0.1, 0.01), 0.1)
        scatter.take(["joint_1"], window, values, np.array([1e-3]))
    assert scatter.power(["joint_1"])[0] < 0.5
