"""The simulated ICM-20948: by its registers, and by adafruit-circuitpython-icm20x, unmodified, over smbus2."""

import math
import types

import adafruit_icm20x
import numpy as np
import pytest
from adafruit_icm20x import ICM20948, AccelRange, GyroRange

from hil_sim.devices.inertial.icm20948 import Icm20948Twin
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.circuitpython_i2c import SlowBusClock
from tests.hil_sim.devices.twin_bench import MS, START_NS, RateClock, StairImu

AD = 0x69
ACCEL_G = (0.5, -1.0, 0.25)
GYRO_DPS = (10.0, -200.0, 0.5)


class Bench:
    def __init__(self, *faults, rate_error=0.0):
        self.analog = StairImu()
        plan = FaultPlan([Fault(*one) for one in faults], START_NS)
        self.chip = Icm20948Twin(self.analog, RateClock(rate_error), START_NS, faults=plan.of("imu"))
        self.now_ns = START_NS

    def wait(self, ms):
        self.now_ns += round(ms * MS)

    def write(self, register, *values, bank=0):
        for data in ([0x7F, bank << 4], [register, *values], [0x7F, 0]):
            self.chip.transfer(AD, bytes(data), 0, self.now_ns)

    def read(self, register, count=1, bank=0):
        self.chip.transfer(AD, bytes([0x7F, bank << 4]), 0, self.now_ns)
        got = self.chip.transfer(AD, bytes([register]), count, self.now_ns)
        self.chip.transfer(AD, b"\x7f\0", 0, self.now_ns)
        return got

    def run(self, divider=0, sensors=0x1F):
        self.write(0x06, 0x01)
        self.write(0x00, divider, bank=2)
        self.write(0x11, divider, bank=2)
        self.write(0x03, 0x40)
        self.write(0x67, sensors)
        return self

    def fill(self):
        return int.from_bytes(self.read(0x70, 2), "big")


def test_reset_values_are_those_of_the_register_map():
    bench = Bench()
    shown = {(bank, at): bench.read(at, bank=bank)[0] for bank in range(4) for at in range(0x7F) if bank or at != 0x72}
    told = {(0, 0x00): 0xEA, (0, 0x05): 0x40, (0, 0x06): 0x41, (2, 0x01): 0x01, (2, 0x14): 0x01}
    assert {where: value for where, value in shown.items() if value} == told


@pytest.mark.parametrize("bank", [1, 2, 3])
def test_every_bank_has_registers_of_its_own_and_a_reset_selects_the_first(bank):
    bench = Bench()
    bench.chip.transfer(AD, bytes([0x7F, bank << 4]), 0, START_NS)
    bench.chip.transfer(AD, bytes([0x14 if bank < 3 else 0x13, 0x2B]), 0, START_NS)
    assert bench.chip.transfer(AD, b"\x7f", 1, START_NS) == bytes([bank << 4])
    assert bench.chip.transfer(AD, bytes([0x14 if bank < 3 else 0x13]), 1, START_NS) == b"\x2b"
    bench.chip.transfer(AD, b"\x7f\0", 0, START_NS)
    bench.chip.transfer(AD, b"\x06\x80", 0, START_NS)
    assert bench.read(0x06)[0] & 0x80
    bench.wait(2)
    assert bench.read(0x06) == b"\x41"
    assert bench.read(0x14 if bank < 3 else 0x13, bank=bank)[0] == (1 if bank == 2 else 0)


@pytest.mark.parametrize(("fs", "lsb"), [(0, 131.0), (1, 65.5), (2, 32.8), (3, 16.4)])
@pytest.mark.parametrize(("afs", "lsb_g"), [(0, 16384.0), (1, 8192.0), (2, 4096.0), (3, 2048.0)])
def test_ranges_and_filters_reach_the_sensing_elements(fs, lsb, afs, lsb_g):
    bench = Bench().run()
    bench.write(0x01, 4 << 3 | fs << 1 | 1, bank=2)
    bench.write(0x14, 3 << 3 | afs << 1 | 1, bank=2)
    bench.wait(20)
    bench.read(0x2D, 14)
    assert [call[1:] for call in bench.analog.calls[-2:]] == [(lsb_g, lsb, 4), (lsb_g, lsb, 3)]  # gyro, accel


@pytest.mark.parametrize(("divider", "rate_error"), [(0, 0.0), (1, 0.01), (9, -0.01)])
def test_its_own_clock_divides_1125_hz(divider, rate_error):
    bench = Bench(rate_error=rate_error).run(divider)
    bench.wait(1000)
    bench.read(0x00)
    assert bench.chip.produced == pytest.approx(1125.0 / (1 + divider) * (1.0 + rate_error), abs=1.01)


def test_a_packet_has_the_order_of_the_registers():
    bench = Bench().run()
    bench.wait(20)
    words = np.frombuffer(bench.read(0x72, 14), ">i2")
    assert (words[1:6] - words[0]).tolist() == [100, 200, 400, 500, 600]  # gyro is behind the temperature there
    shown = np.frombuffer(bench.read(0x2D, 14), ">i2")
    assert (shown[1:6] - shown[0]).tolist() == [100, 200, 400, 500, 600]
    kelvin = (300 + int(words[0])) / 340.0 + 36.53 - 21.0
    assert words[6] == round(333.87 * kelvin)


@pytest.mark.parametrize(("sensors", "size"), [(0x10, 6), (0x0E, 6), (0x01, 2), (0x12, 8), (0x1F, 14)])
def test_the_fifo_holds_the_sensors_that_are_enabled(sensors, size):
    bench = Bench().run(sensors=sensors)
    bench.wait(9.9)
    assert bench.fill() == 11 * size


def test_an_overflow_forgets_the_oldest_and_sets_a_flag_until_it_is_read():
    bench = Bench().run()
    bench.wait(32.1)  # 36 samples
    assert (bench.fill(), bench.read(0x1B)) == (504, b"\0")
    bench.wait(10)
    assert bench.fill() == 512
    assert (bench.read(0x1B), bench.read(0x1B)) == (b"\1", b"\0")
    bench.write(0x68, 0x1F)
    bench.wait(5)
    bench.write(0x68, 0x00)
    assert bench.fill() == 0
    bench.wait(5)
    assert bench.fill() > 0


@pytest.mark.parametrize(("code", "word"), [(1, 6), (2, 3), (3, 4), (4, 5), (5, 0), (6, 1), (7, 2)])
def test_fsync_marks_the_word_that_is_selected(code, word):
    bench = Bench().run()
    bench.write(0x52, code, bank=2)
    bench.chip.fsync(START_NS + 5 * MS, 300_000)
    bench.wait(10)
    words = np.frombuffer(bench.read(0x72, 11 * 14), ">i2").reshape(-1, 7)
    assert (words[:, word] & 1).nonzero()[0].tolist() == [5]  # 6 ticks of 0.889 ms are 5.33 ms


def test_a_sensor_that_is_off_holds_its_word_and_sleep_makes_none():
    bench = Bench().run()
    bench.wait(10)
    held = bench.read(0x33, 6)
    bench.write(0x07, 0x07)
    bench.wait(11)
    assert bench.read(0x33, 6) == held
    bench.write(0x06, 0x41)
    made = bench.chip.produced
    bench.wait(50)
    bench.read(0x00)
    assert bench.chip.produced == made


def test_its_faults():
    bench = Bench(("who_am_i", "imu", 0.0, 0.1, 0x71), ("off", "imu", 0.2, 0.3), ("pulse_drop", "imu", 0.4, 0.5))
    assert bench.read(0x00) == b"\x71"
    bench.run()
    bench.wait(250)
    with pytest.raises(OSError, match="Remote I/O"):
        bench.read(0x00)
    bench.wait(60)
    assert bench.read(0x06) == b"\x41"


# Adafruit's library


class Steady:
    """A constant input, in counts of the range it is asked for."""

    def counts(self, times_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg):
        row = [accel_lsb_per_g * a for a in ACCEL_G] + [(25.0 - 36.53) * 340] + [gyro_lsb_per_dps * r for r in GYRO_DPS]
        return np.tile(np.rint(row).astype(np.int16), (len(times_s), 1))


@pytest.fixture
def library(monkeypatch, on_bus):
    """Adafruit's library on a chip, and the clock of both."""
    clock = SlowBusClock(MS // 5)
    monkeypatch.setattr(adafruit_icm20x, "sleep", clock.sleep)
    sensor = ICM20948(on_bus(Icm20948Twin(Steady(), RateClock(), START_NS), clock))
    return types.SimpleNamespace(sensor=sensor, clock=clock)


def test_the_library_finds_resets_and_reads_it_in_every_range(library):
    sensor = library.sensor
    assert (sensor.accelerometer_range, sensor.gyro_range) == (AccelRange.RANGE_8G, GyroRange.RANGE_500_DPS)
    for accel, lsb in (("2G", 16384), ("4G", 8192), ("8G", 4096), ("16G", 2048)):
        sensor.accelerometer_range = getattr(AccelRange, f"RANGE_{accel}")
        library.clock.sleep(0.05)
        assert sensor.acceleration == pytest.approx([9.80665 * g for g in ACCEL_G], abs=6.0 / lsb)
    for gyro, lsb in (("250", 131.0), ("500", 65.5), ("1000", 32.8), ("2000", 16.4)):
        sensor.gyro_range = getattr(GyroRange, f"RANGE_{gyro}_DPS")
        assert sensor.gyro == pytest.approx([math.radians(dps) for dps in GYRO_DPS], abs=math.radians(0.6 / lsb))


def test_the_librarys_rates_and_filters_are_the_chips(library):
    sensor = library.sensor
    assert (sensor.accelerometer_data_rate_divisor, sensor.gyro_data_rate_divisor) == (20, 10)
    sensor.accelerometer_data_rate_divisor = 300
    sensor.gyro_data_rate_divisor = 112
    assert (sensor.accelerometer_data_rate_divisor, sensor.gyro_data_rate_divisor) == (300, 112)
    for code in (1, 4, 6):
        sensor.gyro_dlpf_cutoff = sensor.accel_dlpf_cutoff = code
        assert (sensor.gyro_dlpf_cutoff, sensor.accel_dlpf_cutoff) == (code, code)
    sensor.data_ready()  # 10 Hz by now
    began_ns, times_ns = library.clock.now_ns, []
    while library.clock.now_ns < began_ns + 2_000_000_000:
        if sensor.data_ready():
            times_ns.append(library.clock.now_ns)
    assert np.diff(times_ns).mean() / MS == pytest.approx(1e3 * 113 / 1125, rel=0.01)
