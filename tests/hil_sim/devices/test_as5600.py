"""The simulated AS5600: registers, angle, magnet, faults; and adafruit-circuitpython-as5600, unmodified, against it."""

import errno
from math import radians, tau

import adafruit_as5600
import numpy as np
import pytest

from hil_sim.devices.i2c.as5600 import As5600Twin
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.circuitpython_i2c import SlowBusClock
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog


def chip(function=lambda t: 1.0, faults=(), **options):
    plan = FaultPlan([Fault(*one) for one in faults], START_NS)
    return As5600Twin(Analog(function), START_NS, faults=plan.of("joint"), **options)


def read(twin, register, count=1, ms=0.0):
    return twin.transfer(0x36, bytes([register]), count, START_NS + round(ms * MS))


def angle(twin, ms=0.0):
    return int.from_bytes(read(twin, 0x0C, 2, ms), "big")


def test_registers_after_power_up():
    assert read(chip(), 0, 0x20) == bytes(0x20)
    values = read(chip(), 0, 0x20, 10.0)
    assert {at for at, value in enumerate(values) if value} <= {0x0B, 0x0C, 0x0D, 0x0E, 0x0F, 0x1A, 0x1B, 0x1C}
    assert values[0x0B] == 0x20


@pytest.mark.parametrize(("turns", "zero"), [(1.0, 0), (1.0, 1000), (-1.0, 0), (4.0, 4000)])
def test_an_angle_in_counts(turns, zero):
    twin = chip(lambda t: t, turns=turns, zero_count=zero)
    for second in (0.1, 0.7, 3.0, 6.1):
        true = (second * turns / tau * 4096 + zero) % 4096
        assert (angle(twin, 1e3 * second) - true + 2048) % 4096 - 2048 == pytest.approx(0.0, abs=4.0 + 2.0 * abs(turns))


@pytest.mark.parametrize(
    ("code", "settles_ms", "noise_deg"), [(0, 2.2, 0.015), (1, 1.1, 0.021), (2, 0.55, 0.03), (3, 0.286, 0.043)]
)
def test_its_slow_filter_delays_and_quietens(code, settles_ms, noise_deg):
    twin = chip(lambda t: 2.0 * t)
    twin.transfer(0x36, bytes([0x07, code]), 0, START_NS)
    times_ms = np.arange(20.0, 800.0, 1.37)
    found = np.unwrap([angle(twin, ms) / 4096 * tau for ms in times_ms])
    late_s = (2e-3 * times_ms - found).mean() / 2.0
    assert late_s == pytest.approx(0.5e-3 * settles_ms, abs=0.12e-3)
    scatter = (found - 2e-3 * times_ms).std()
    assert scatter == pytest.approx(np.hypot(radians(noise_deg), tau / 4096 / 12**0.5), rel=0.25)


def test_the_pointer_stays_on_an_angle_that_it_was_set_to():
    twin = chip()
    one = read(twin, 0x0C, 2, 20.0)
    assert read(twin, 0x0C, 6, 20.0) == one * 3
    assert read(twin, 0x0B, 3, 20.0)[1:] == one
    assert read(twin, 0x0B, 6, 20.0)[5] == 0  # and stepped on otherwise


@pytest.mark.parametrize(("value", "status"), [(-0.6, 0x30), (0.6, 0x28), (-1.0, 0x10), (-0.3, 0x20)])
def test_a_field_that_is_off_shows(value, status):
    twin = chip(faults=[("field", "joint", 1.0, 2.0, value)])
    assert read(twin, 0x0B, 1, 500.0) == b"\x20"
    assert read(twin, 0x0B, 1, 1500.0) == bytes([status])
    assert read(twin, 0x0B, 1, 2500.0) == b"\x20"


def test_its_other_faults():
    twin = chip(
        lambda t: t, faults=[("stuck", "joint", 1.0, 2.0), ("nack", "joint", 3.0, 4.0), ("off", "joint", 5.0, 6.0)]
    )
    twin.transfer(0x36, b"\x07\x03", 0, START_NS)
    angle(twin, 999.0)
    assert abs(angle(twin, 1100.0) - angle(twin, 1900.0)) < 5
    for ms in (3500.0, 5500.0):
        with pytest.raises(OSError, match=r"\w+") as raised:
            read(twin, 0x0B, 1, ms)
        assert raised.value.errno == errno.EREMOTEIO
    assert read(twin, 0x07, 1, 6500.0) == b"\0"
    with pytest.raises(FaultError, match="cannot have the fault saturated"):
        chip(faults=[("saturated", "joint", 0.0, 1.0, 1.0)])


@pytest.fixture
def adafruit_on(on_bus):
    """Opens the library on a twin; the library and its twin."""

    def make(function=lambda t: 1.0, faults=()):
        twin = chip(function, faults)
        return adafruit_as5600.AS5600(on_bus(twin, SlowBusClock(MS // 2, START_NS + 20 * MS))), twin

    return make


def test_the_library_reads_angle_and_magnet(adafruit_on):
    library, _ = adafruit_on()
    assert library.raw_angle == pytest.approx(4096 / tau, abs=2)
    assert library.angle == pytest.approx(4096 / tau, abs=2)
    assert (library.magnet_detected, library.max_gain_overflow, library.min_gain_overflow) == (True, False, False)
    assert (library.agc, library.magnitude, library.zm_count) == (64, 1500, 0)


def test_the_library_scales_the_angle(adafruit_on):
    library, _ = adafruit_on(lambda t: tau / 4.0)
    library.z_position, library.max_angle = 512, 2048
    assert (library.z_position, library.max_angle) == (512, 2048)
    assert library.raw_angle == pytest.approx(1024, abs=2)
    assert library.angle == pytest.approx(1024, abs=4)


@pytest.mark.parametrize("code", [0, 1, 2, 3])
def test_the_library_sets_every_field_of_conf(adafruit_on, code):
    library, twin = adafruit_on()
    library.slow_filter, library.hysteresis, library.power_mode = code, code, code
    library.pwm_frequency, library.fast_filter_threshold, library.watchdog = code, code + 4, True
    assert (library.slow_filter, library.hysteresis, library.power_mode) == (code, code, code)
    assert (library.pwm_frequency, library.fast_filter_threshold, library.watchdog) == (code, code + 4, True)
    assert read(twin, 0x07, 1, 9_500.0)[0] == 0x20 | (code + 4) << 2 | code


def test_the_library_sees_a_weak_magnet(adafruit_on):
    library, _ = adafruit_on(faults=[("field", "joint", 0.0, 100.0, -0.7)])
    assert library.max_gain_overflow
    assert not library.min_gain_overflow


def test_the_library_says_that_an_address_is_empty(adafruit_on):
    with pytest.raises(ValueError, match="No I2C device found at address 0x36"):
        adafruit_on(faults=[("off", "joint", 0.0, 100.0)])
