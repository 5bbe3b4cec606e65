"""Which instrument its own corrections accuse."""

import numpy as np
import pytest

from onboard.identification.exiddm.fusion import Accusation, Fusion
from onboard.identification.exiddm.innovation import Innovation, Innovations

SIGMA = 0.003


class Scales:
    """What is asked of a predictor of two IMUs with nothing but the scales of their accelerometers."""

    names = tuple(f"accelerometer_scale_{axis}{of}" for of in ("", "_imu_2") for axis in "xyz")
    sigma = stated = np.full(6, SIGMA)
    lines = slice(0, 6), slice(6, 12)
    imu_frames = further = ("imu", "imu_2")
    of_each = np.arange(3), np.arange(3, 6)
    of_further = (np.arange(3, 6),)
    biases = ()


@pytest.mark.parametrize(
    ("sigmas", "accused"),
    [((1.2, 1.2, 1.2), True), ((-1.2, -1.2, -1.2), True), ((0.8, 0.8, 0.8), False), ((1.2, -1.2, 1.2), False)],
)
def test_a_scale_of_all_axes_is_noticed_long_before_it_is_many_stated_sigmas(sigmas, accused) -> None:
    """The data tell a tenth of the variance, so of three axes together a sigma of 0.55 stated ones."""
    fusion = Fusion(("imu", "imu_2"), Scales.lines)
    state = SIGMA * np.array([0.0, 0.0, 0.0, *sigmas])
    nothing = Innovation(np.zeros((0, 6)), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), 0)
    found = Innovations(Scales(), fusion).contradicting(nothing, 0, state, 0.9 * SIGMA**2 * np.eye(6))
    assert found == (Accusation(1, 0, for_good=True) if accused else None)
