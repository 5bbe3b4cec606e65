"""A converter that runs by itself: when it samples, on whose clock, and what it holds."""

import pytest

from hil_sim.devices.serial_line.sampled_scalar import SampledScalar
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock


@pytest.mark.parametrize("rate_error", [0.0, 0.01, -0.01])
def test_it_samples_on_its_own_clock_from_power_up(rate_error):
    analog = Analog(lambda t: t)
    cell = SampledScalar(analog, RateClock(rate_error), START_NS, 100.0)
    cell.power_up(START_NS)
    made = cell.settle(START_NS + 95 * MS)
    assert made == pytest.approx([k * 0.01 / (1 + rate_error) for k in range(10)], abs=1e-9)
    assert cell.value == made[-1]
    assert cell.samples == 10


def test_nothing_new_between_two_samples():
    cell = SampledScalar(Analog(lambda t: t), RateClock(), START_NS, 100.0)
    cell.power_up(START_NS)
    assert len(cell.settle(START_NS + 5 * MS)) == 1
    assert cell.settle(START_NS + 9 * MS) == []
    assert cell.value == 0.0
    assert cell.settle(START_NS + 10 * MS) == [0.01]


def test_it_begins_again_at_another_power_up_and_at_another_rate():
    cell = SampledScalar(Analog(lambda t: t), RateClock(0.005), START_NS, 100.0)
    cell.power_up(START_NS)
    cell.settle(START_NS + 42 * MS)
    cell.power_up(START_NS + 1003 * MS, 50.0)
    assert cell.settle(START_NS + 1002 * MS) == []
    made = cell.settle(START_NS + 1053 * MS)
    assert made == pytest.approx([1.003 + k * 0.02 / 1.005 for k in range(3)], abs=1e-8)


def test_it_never_asks_for_the_future():
    analog = Analog(lambda t: t)
    cell = SampledScalar(analog, RateClock(1e-7), START_NS, 300.0)
    cell.power_up(START_NS)
    for step in range(1, 5000):
        now_ns = START_NS + step * 333_333
        cell.settle(now_ns)
        assert analog.times_s[-1] <= (now_ns - START_NS) * 1e-9
    assert cell.samples == 500


def test_a_clock_whose_two_directions_disagree_asks_for_now_at_the_latest():
    class Coarse(RateClock):
        def times_s(self, chip_ns):
            return super().times_s(chip_ns) + 1e-6

    cell = SampledScalar(analog := Analog(lambda t: t), Coarse(), START_NS, 100.0)
    cell.power_up(START_NS)
    cell.settle(START_NS + 30 * MS)
    assert analog.times_s == pytest.approx([1e-6, 0.010_001, 0.020_001, 0.03], abs=1e-12)
