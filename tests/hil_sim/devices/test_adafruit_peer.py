"""adafruit-circuitpython-mpu6050, unmodified, against the twin: in process, over smbus2.

What the library does wrong stands here as it does it, so that a release which mends it is noticed.
"""

import math

import numpy as np
import pytest
from adafruit_mpu6050 import MPU6050, Bandwidth, ClockSource, GyroRange, Range, Rate

from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.circuitpython_i2c import SlowBusClock
from tests.hil_sim.devices.twin_bench import MS, START_NS, RateClock

ACCEL_G = (0.5, -1.0, 0.25)
GYRO_DPS = (10.0, -200.0, 0.5)


class Steady:
    """A constant input, in counts of the range it is asked for; remembers the last setting."""

    def __init__(self):
        self.setting = None

    def counts(self, times_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg):
        self.setting = accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg
        row = [accel_lsb_per_g * a for a in ACCEL_G] + [(25.0 - 36.53) * 340] + [gyro_lsb_per_dps * r for r in GYRO_DPS]
        return np.tile(np.rint(row).astype(np.int16), (len(times_s), 1))


class Numbered(Steady):
    """Accel x, y and z all hold the number of the sample, so that it shows of which sample each was read."""

    def counts(self, times_s, *setting):
        words = super().counts(times_s, *setting)
        words[:, :3] = (np.rint(times_s * 1e3).astype(np.int64) % 30_000)[:, None]
        return words


@pytest.fixture
def adafruit_on(on_bus):
    """Opens the library on a twin with a given input; the library, its clock, the busio object.

    A transfer takes 2 ms: a slow program on a busy bus. The library's sleeps do not move the clock.
    """

    def make(analog, address=0x68, faults=()):
        clock = SlowBusClock(2 * MS)
        i2c = on_bus(Mpu6050Twin(analog, RateClock(), START_NS, faults=FaultPlan(faults, START_NS).of("imu")), clock)
        return MPU6050(i2c, address), clock, i2c

    return make


def peek(i2c, register):
    """A register by a transfer of our own, beside the library."""
    got = bytearray(1)
    i2c.writeto_then_readfrom(0x68, bytes([register]), got)
    return got[0]


def test_it_finds_resets_and_reads_the_chip_in_every_range_and_bandwidth(adafruit_on):
    analog = Steady()
    sensor, _, i2c = adafruit_on(analog)
    assert sensor.clock_source == ClockSource.CLKSEL_INTERNAL_X
    assert not sensor.sleep
    assert (sensor.accelerometer_range, sensor.gyro_range) == (Range.RANGE_2_G, GyroRange.RANGE_500_DPS)
    assert sensor.temperature == pytest.approx(25.0, abs=0.01)
    for accel, lsb_per_g in ((Range.RANGE_2_G, 16384), (Range.RANGE_4_G, 8192), (Range.RANGE_16_G, 2048)):
        sensor.accelerometer_range = accel
        assert sensor.acceleration == pytest.approx([9.80665 * a for a in ACCEL_G], abs=9.9 / lsb_per_g)
        assert analog.setting[0] == lsb_per_g
    for gyro, lsb_per_dps in (
        (GyroRange.RANGE_250_DPS, 131.0),
        (GyroRange.RANGE_1000_DPS, 32.8),
        (GyroRange.RANGE_2000_DPS, 16.4),
    ):
        sensor.gyro_range = gyro
        assert sensor.gyro == pytest.approx([math.radians(r) for r in GYRO_DPS], abs=math.radians(0.51 / lsb_per_dps))
        assert analog.setting[1] == lsb_per_dps
    for code in (Bandwidth.BAND_260_HZ, Bandwidth.BAND_44_HZ, Bandwidth.BAND_5_HZ):
        sensor.filter_bandwidth = code
        assert sensor.acceleration
        assert (sensor.filter_bandwidth, analog.setting[2]) == (code, code)
        assert peek(i2c, 0x1A) == code  # and not in EXT_SYNC_SET, where older releases wrote it


def test_it_sleeps_cycles_and_divides_the_rate(adafruit_on):
    sensor, _, i2c = adafruit_on(Steady())
    sensor.sample_rate_divisor = 9
    assert (sensor.sample_rate_divisor, peek(i2c, 0x19)) == (9, 9)
    sensor.cycle_rate = Rate.CYCLE_20_HZ
    assert peek(i2c, 0x6C) == 0x80
    sensor.cycle = True
    assert peek(i2c, 0x6B) == 0x21  # CYCLE, clock of gyro x
    sensor.cycle = False
    sensor.sleep = True
    assert peek(i2c, 0x6B) == 0x41
    sensor.reset()
    assert peek(i2c, 0x6B) == 0x40  # as from the factory: asleep
    assert peek(i2c, 0x19) == 0


def test_it_drains_the_fifo_whole(adafruit_on):
    sensor, clock, _ = adafruit_on(Numbered())
    sensor.filter_bandwidth = Bandwidth.BAND_94_HZ  # 1 kHz
    sensor.fiforst = True
    sensor.fifo_en = True
    sensor.accel_fifo_en = True
    clock.now_ns += 50 * MS
    sensor.accel_fifo_en = False  # two transfers of 2 ms later, as it was in switching on
    count = sensor.fifo_count
    assert count // 6 == pytest.approx(54, abs=2)
    assert count % 6 == 0
    x, y, z = np.frombuffer(sensor.read_whole_fifo(), ">i2").reshape(-1, 3).T
    assert len(x) == count // 6
    assert (x == y).all()
    assert (y == z).all()
    assert (np.diff(x.astype(int)) == 1).all()
    assert sensor.fifo_count == 0
    with pytest.raises(IndexError):  # its fault: an empty FIFO is no case to it
        sensor.read_whole_fifo()


def test_its_path_reset_writes_bits_5_to_3_which_the_chip_has_not(adafruit_on):
    """RM-MPU-6000A 4.2 has GYRO, ACCEL and TEMP reset in bits 2 to 0; the library writes 38h."""
    sensor, _, i2c = adafruit_on(Steady())
    sensor.accelerometer_range = Range.RANGE_8_G
    sensor._signal_path_reset = 0b111
    assert peek(i2c, 0x68) == 0
    assert sensor.accelerometer_range == Range.RANGE_8_G
    assert sensor.acceleration == pytest.approx([9.80665 * a for a in ACCEL_G], abs=3e-3)


def test_it_reads_the_axes_one_by_one_and_so_mixes_samples(adafruit_on):
    """A transfer an axis: no word is torn, but x, y and z are of three samples."""
    sensor, _, _ = adafruit_on(Numbered())
    sensor.filter_bandwidth = Bandwidth.BAND_94_HZ
    x, y, z = (round(a / 9.80665 * 16384) for a in sensor.acceleration)
    assert x < y < z
    assert z - x <= 6


def test_it_takes_no_clone(adafruit_on):
    with pytest.raises(RuntimeError, match="check your wiring"):
        adafruit_on(Steady(), faults=[Fault("who_am_i", "imu", 0.0, value=0x70)])  # an MPU-6500: our driver knows it


def test_it_says_that_an_address_is_empty(adafruit_on):
    with pytest.raises(ValueError, match="No I2C device at address: 0x69"):
        adafruit_on(Steady(), address=0x69)
