"""cedargrove-nau7802, unmodified, against the twin: in process, over smbus2.

What the library does wrong stands here as it does it, so that a release which mends it is noticed.
"""

import types

import cedargrove_nau7802
import pytest
from cedargrove_nau7802 import NAU7802

from hil_sim.devices.i2c.nau7802 import Nau7802Twin
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.circuitpython_i2c import SlowBusClock
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock

COUNTS_N = 2.0 * 128 * (1 << 23) * 2e-3 / 50.0


@pytest.fixture
def library_on(monkeypatch, on_bus):
    """Opens the library on a twin with a given force; the library and its clock."""

    def make(force, faults=(), **options):
        clock = SlowBusClock(MS // 5)
        names = types.SimpleNamespace(sleep=clock.sleep, monotonic=clock.monotonic)
        monkeypatch.setattr(cedargrove_nau7802, "time", names)
        plan = FaultPlan([Fault(*one) for one in faults], START_NS)
        twin = Nau7802Twin(Analog(lambda t: force), RateClock(), START_NS, faults=plan.of("cell"))
        return NAU7802(on_bus(twin, clock), **options), clock

    return make


def sample(library, clock, discard=0):
    for _ in range(discard + 1):
        while not library.available():
            clock.sleep(0.001)
        value = library.read()
    return value


def test_it_finds_sets_up_calibrates_and_weighs(library_on):
    library, clock = library_on(20.0)
    assert library.chip_revision == 0x0F
    assert (library.gain, library.ldo_voltage, library.channel) == (128, "3V0", 1)
    library.poll_rate = 80
    assert library.poll_rate == 3
    assert library.calibrate("INTERNAL")
    twice = sample(library, clock, discard=4)  # its fault: it divides by 128 what is 256 times the counts
    assert twice / 2 == pytest.approx(20.0 * COUNTS_N, abs=2)


@pytest.mark.parametrize("gain", [1, 16, 64])
def test_its_gains_are_the_chips(library_on, gain):
    library, clock = library_on(-20.0)
    library.gain = gain
    library.poll_rate = 320
    library.calibrate()
    assert sample(library, clock, discard=4) / 2 == pytest.approx(-20.0 * COUNTS_N * gain / 128, abs=2)


@pytest.mark.parametrize(("rate", "period_ms"), [(10, 100), (40, 25), (320, 3.125)])
def test_its_rates_are_the_chips(library_on, rate, period_ms):
    library, clock = library_on(1.0)
    library.poll_rate = rate
    sample(library, clock)
    began_ns = clock.now_ns
    for _ in range(20):
        sample(library, clock)
    assert (clock.now_ns - began_ns) / 20 / MS == pytest.approx(period_ms, rel=0.05)


def test_the_second_channel_has_no_cell_here(library_on):
    library, clock = library_on(20.0, active_channels=2)
    library.poll_rate = 80
    assert library.channel == 1
    library.channel = 2
    assert library.channel == 2
    assert abs(sample(library, clock, discard=2)) < 2e5


def test_a_calibration_with_a_load_that_is_not_there_fails(library_on):
    library, _ = library_on(0.0)
    assert not library.calibrate("GAIN")


def test_it_says_that_an_address_is_empty(library_on):
    with pytest.raises(ValueError, match="No I2C device at address: 0x2a"):
        library_on(0.0, faults=[("off", "cell", 0.0, 100.0)])
