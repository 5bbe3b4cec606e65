"""A second IMU that the estimator does not use: its rates are compared with the first one's."""

import numpy as np
import pytest

from onboard import config
from onboard.flight.identification import build_model
from onboard.flight.roles import roles_of
from onboard.flight.signals import ChannelAtTicks
from onboard.flight.witness import RateWitness

NOISE_rad_s = 6e-4


class Shown:
    """What two IMUs show of one motion, the second one's rates off by a scale."""

    def __init__(self, axes, scale: float) -> None:
        self._axes, self._scale = axes, scale
        self._rng = np.random.default_rng(2)

    def means(self, names, timebase, at_ns, period_ns) -> ChannelAtTicks:
        second = names[0] == "imu_2"
        t = at_ns[:, None] * 1e-9
        rate = (self._scale if second else 1.0) * 0.1 * np.sin(t * [1.0, 1.7, 2.9]) @ self._axes[int(second)]
        rate = rate + NOISE_rad_s * self._rng.standard_normal(rate.shape) + 0.02  # noise and a bias
        return ChannelAtTicks((rate,), (np.full((len(t), 6), NOISE_rad_s),), np.zeros(len(t), np.int64))


@pytest.mark.parametrize(("scale", "contradicts"), [(1.0, False), (1.04, False), (0.8, True), (-1.0, True)])
def test_rates_that_differ_by_a_scale_contradict_each_other(scale: float, contradicts: bool) -> None:
    vehicle = config.load(config.packaged("dymaflex"))
    model, imus = build_model(vehicle), roles_of(vehicle).imus
    axes = [model.pose_in_base(imu.frame)[0] for imu in imus]
    witness, shown = RateWitness(model, (imus[0], imus[1]), 0.003), Shown(axes, scale)
    begun = [witness.check(shown, None, 10_000_000 * np.arange(k, k + 10), 10_000_000) for k in range(0, 600, 10)]
    assert sum(begun) == int(contradicts)
    assert ("imu_base and imu_2 contradict each other" in witness.contradiction) == contradicts
