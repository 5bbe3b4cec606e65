"""The simulated BMI088: both dies' registers, power, rates and faults, byte by byte."""

import errno
import sys

import numpy as np
import pytest
from smbus2 import smbus2

from hil_sim.buses.i2c_dev import install_i2c
from hil_sim.buses.media import I2cBus
from hil_sim.buses.spi import SpiBus
from hil_sim.devices.inertial.bmi088 import Bmi088SpiTwin, Bmi088Twin
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, FlatImu, RateClock

ACCEL, GYRO = 0x18, 0x68
WORDS = [100, -200, 300, 400, 32767, -32768, -7]  # force, temperature, rate


class Ramp:
    """Words are the mission time in units of 0.1 ms, in all columns."""

    def counts(self, times_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg):
        self.asked = accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg
        return np.tile(np.rint(1e4 * times_s).astype(np.int16)[:, None], (1, 7))


class Session:
    """A chip on a bus, and the time."""

    def __init__(self, faults=(), imu=None, ppm=(0.0, 0.0)) -> None:
        plan = FaultPlan([Fault(*one) for one in faults], START_NS)
        clocks = RateClock(ppm[0], start_ns=START_NS), RateClock(ppm[1], start_ns=START_NS)
        self.twin = Bmi088Twin(imu or FlatImu(WORDS), clocks, START_NS, faults=plan.of("imu"))
        self.bus, self.now_ns = I2cBus(), START_NS
        self.bus.add(self.twin)

    def after(self, ms):
        self.now_ns += round(ms * MS)
        return self

    def write(self, address, register, value):
        self.bus.transfer(address, bytes([register, value]), 0, self.now_ns)
        return self.after(2)

    def read(self, address, register, count=1):
        return self.bus.transfer(address, bytes([register]), count, self.now_ns)

    def on(self):
        return self.after(40).write(ACCEL, 0x7C, 0).write(ACCEL, 0x7D, 4).after(60)


def test_identities_and_reset_values_of_both_dies():
    one = Session()
    assert (one.read(ACCEL, 0), one.read(GYRO, 0)) == (b"\x1e", b"\x0f")
    assert one.read(ACCEL, 0x40, 2) == b"\xa8\x01"
    assert one.read(ACCEL, 0x7C, 2) == b"\x03\x00"
    assert one.read(GYRO, 0x0F, 3) == b"\x00\x80\x00"
    with pytest.raises(ValueError, match="taken"):
        one.bus.add(one.twin)


def test_the_accelerometer_is_suspended_until_it_is_switched_on_and_then_takes_50_ms():
    one = Session().after(100)
    assert one.read(ACCEL, 0x12, 9) == bytes(9)
    one.write(ACCEL, 0x7C, 0).write(ACCEL, 0x7D, 4).after(46)
    assert one.read(ACCEL, 0x12, 6) == bytes(6)
    one.after(4)
    assert one.read(ACCEL, 0x12, 6) == np.array(WORDS[:3], "<i2").tobytes()
    assert one.read(ACCEL, 0x03) == b"\x80"


def test_a_suspended_accelerometer_loses_a_write_within_a_millisecond():
    one = Session().after(40)
    for register, value in ((0x41, 3), (0x40, 0x8C)):
        one.bus.transfer(ACCEL, bytes([register, value]), 0, one.now_ns)
    assert one.read(ACCEL, 0x40, 2) == b"\xa8\x03"


def test_rates_and_temperature_as_they_are_coded():
    one = Session().on()
    assert np.frombuffer(one.read(GYRO, 0x02, 6), "<i2").tolist() == WORDS[4:]
    high, low = one.read(ACCEL, 0x22, 2)
    kelvin = 400 / 340.0 + 36.53 - 23.0
    assert (high << 3 | low >> 5) == round(8 * kelvin)
    one.write(GYRO, 0x11, 0x80)
    assert one.read(GYRO, 0x02, 6) == np.array(WORDS[4:], "<i2").tobytes()  # suspended: the last ones stay


@pytest.mark.parametrize(
    ("conf", "bandwidth", "periods_ms", "code"),
    [(0xAC, 0, (0.625, 0.5), 0), (0x8C, 2, (0.625, 1.0), 2), (0x8A, 3, (2.5, 2.5), 3), (0xA8, 7, (2.5, 2.5), 3)],
)
def test_each_die_has_its_own_rate_range_and_clock(conf, bandwidth, periods_ms, code):
    ramp = Ramp()
    one = Session(imu=ramp, ppm=(0.01, -0.01)).on()
    one.write(ACCEL, 0x40, conf).write(ACCEL, 0x41, 1).write(GYRO, 0x10, bandwidth).write(GYRO, 0x0F, 3)
    ages = []
    for _ in range(400):
        one.after(0.37)
        force, rate = one.read(ACCEL, 0x12, 2), one.read(GYRO, 0x02, 2)
        now = (one.now_ns - START_NS) * 1e-5
        ages.append([0.1 * (now - int.from_bytes(word, "little")) for word in (force, rate)])
    assert np.max(ages, axis=0) == pytest.approx(periods_ms, rel=0.2, abs=0.06)
    assert np.min(ages, axis=0) == pytest.approx([0.0, 0.0], abs=0.1)
    assert ramp.asked == (32768 / 6, 32768 / 250, code)


def test_its_sensor_time_is_that_of_the_accelerometer_s_clock():
    one = Session(ppm=(0.01, 0.0)).on()
    before = int.from_bytes(one.read(ACCEL, 0x18, 3), "little")
    one.after(1000)
    assert int.from_bytes(one.read(ACCEL, 0x18, 3), "little") - before == pytest.approx(1.01 * 25600, abs=2)
    one.after(655_360 / 1.01)
    assert int.from_bytes(one.read(ACCEL, 0x18, 3), "little") < 1 << 24


def test_soft_resets_are_of_each_die_alone():
    one = Session().on().write(GYRO, 0x0F, 4)
    one.write(ACCEL, 0x7E, 0xB6)
    assert one.read(ACCEL, 0x7C, 2) == b"\x03\x00"
    assert one.read(GYRO, 0x0F) == b"\x04"
    one.write(GYRO, 0x14, 0xB6).write(GYRO, 0x0F, 4)
    assert one.read(GYRO, 0x0F) == b"\x00"  # it is away for 30 ms
    assert one.after(30).write(GYRO, 0x0F, 4).read(GYRO, 0x0F) == b"\x04"


def test_its_faults():
    faults = [
        *(
            ("off", "imu", 1.0, 1.1),
            ("nack", "imu", 2.0, 2.1),
            ("timeout", "imu", 3.0, 3.1),
            ("silent", "imu", 4.0, 4.1),
        ),
        *(("who_am_i", "imu", 5.0, 5.1, 0x68), ("saturated", "imu", 6.0, 6.1, 1.0)),
    ]
    one = Session(faults).on()
    for at_s, code in (
        (1.05, errno.EREMOTEIO),
        (2.05, errno.EREMOTEIO),
        (3.05, errno.ETIMEDOUT),
        (4.05, errno.EREMOTEIO),
    ):
        one.now_ns = START_NS + round(at_s * 1e9)
        for address in (ACCEL, GYRO):
            with pytest.raises(OSError, match=r"\w+") as raised:
                one.read(address, 0)
            assert raised.value.errno == code
    one.now_ns = START_NS + round(5.05e9)
    assert one.read(ACCEL, 0) == one.read(GYRO, 0) == b"\x68"
    one.on()
    one.now_ns = START_NS + round(6.05e9)
    assert one.read(ACCEL, 0x12, 2) == b"\xff\x7f"
    with pytest.raises(FaultError):
        Session([("field", "imu", 0.0, 1.0, 1.0)])


def test_pollen_s_driver_reads_it_once_its_power_register_is_right(monkeypatch):
    """Package ``pollen-bmi088-imu-library``, whose smbus3 is given smbus2's kernel; it wants the gyroscope at 69h.

    Its ACC_POWER_CONF is 7Dh, the data sheet's 7Ch: as it is published, the accelerometer stays suspended.
    """
    maker = pytest.importorskip("bmi088.bmi088", reason="pip install pollen-bmi088-imu-library==1.0.0rc1")
    now = {"ns": START_NS + 40 * MS}

    def clock():
        now["ns"] += 2 * MS  # a transfer
        return now["ns"]

    clocks = RateClock(start_ns=START_NS), RateClock(start_ns=START_NS)
    bus = I2cBus()
    bus.add(Bmi088Twin(FlatImu(WORDS), clocks, START_NS, addresses=(ACCEL, 0x69)))
    installed = install_i2c("/dev/i2c-1", bus, clock)
    try:
        kernel = vars(sys.modules["smbus3.smbus3"])
        monkeypatch.setitem(kernel, "ioctl", vars(smbus2)["ioctl"])
        monkeypatch.setitem(kernel, "os", vars(smbus2)["os"])
        sensor = maker.BMI088(1, gyro_range=maker.GyroRange.RANGE_125_DPS)
        now["ns"] += 60 * MS
        assert sensor.read_gyroscope(deg_per_s=True) == pytest.approx(np.array(WORDS[4:]) / 262.144)
        assert sensor.read_accelerometer() == (0.0, 0.0, 0.0)
        sensor.close()
        monkeypatch.setattr(maker, "ACC_POWER_CONF", 0x7C)
        sensor = maker.BMI088(1, acc_range=maker.AccRange.RANGE_12G)
        now["ns"] += 60 * MS
        assert sensor.read_accelerometer() == pytest.approx(12.0 * np.array(WORDS[:3]) / 32768.0, rel=1e-3)
        assert sensor.read_temperature() == pytest.approx(400 / 340.0 + 36.53, abs=0.07)
        sensor.close()
    finally:
        installed.uninstall()


class SpiSession:
    """A chip on two select lines, and the time; frames in hex."""

    def __init__(self, *faults) -> None:
        plan = FaultPlan([Fault(*one) for one in faults], START_NS)
        clocks = RateClock(start_ns=START_NS), RateClock(start_ns=START_NS)
        second = SpiBus()
        self.lines = SpiBus(second), second
        self.lines[0].add(Bmi088SpiTwin(FlatImu(WORDS), clocks, START_NS, faults=plan.of("imu")))
        self.at_ms = 40.0

    def __call__(self, die, frame):
        data = bytes.fromhex(frame)
        self.at_ms += 2
        return self.lines[die].transfer(len(data), data, len(data), START_NS + round(self.at_ms * MS)).hex(" ")


def test_on_spi_the_accelerometer_answers_a_byte_later_and_loses_its_first_frame():
    one = SpiSession()
    assert one(1, "80 00") == "00 0f"
    assert one(0, "80 00 00") == "00 00 00"
    assert one(0, "80 00 00") == "00 00 1e"
    for frame in ("7c 00", "7d 04", "41 01"):
        assert one(0, frame) == "00 00"
    one.at_ms += 60
    assert one(0, "92" + "00" * 7) == "00 00 " + np.array(WORDS[:3], "<i2").tobytes().hex(" ")
    assert one(1, "82" + "00" * 6) == "00 " + np.array(WORDS[4:], "<i2").tobytes().hex(" ")
    assert one(0, "c1 00 00") == "00 00 01"
    assert one(0, "80") == "00"
    one(0, "7e b6")
    assert [one(0, "c1 00 00") for _ in range(2)] == ["00 00 00", "00 00 01"]  # to I2C, and back
    one(0, "41 03")
    one(1, "14 b6")
    assert one(0, "c1 00 00") == "00 00 03"  # the gyroscope's reset leaves it there


def test_on_spi_one_that_is_off_drives_no_line():
    one = SpiSession(("off", "imu", 1.0, 1.1), ("silent", "imu", 2.0, 2.1), ("garbage", "imu", 3.0, 3.1))
    for at_ms, expected in ((500, "00 0f"), (1050, "00 00"), (1500, "00 0f"), (2050, "00 00"), (2500, "00 0f")):
        one.at_ms = at_ms
        assert one(1, "80 00") == expected
    one.at_ms = 3050
    assert len({one(1, "80 00") for _ in range(20)}) > 1
    with pytest.raises(FaultError):
        SpiSession(("nack", "imu", 0.0, 1.0))
