"""/dev/i2c-9 as programs that know nothing of us see it. Register numbers are those of RM-MPU-6000A 4.2."""

import errno
import fcntl
import math
import os
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import busio
import pytest
import smbus2
from adafruit_blinka.microcontroller.generic_linux import i2c as generic_linux
from adafruit_mpu6050 import MPU6050, Bandwidth, GyroRange, Range
from smbus2 import SMBus, i2c_msg

from tests.kernel.conftest import Served
from tests.kernel.devices import ACCEL_Z, TEMPERATURE

CHIP, NOBODY = 0x68, 0x69
WHO_AM_I, PWR_MGMT_1, ACCEL_XOUT_H, FIFO_EN, USER_CTRL = 0x75, 0x6B, 0x3B, 0x23, 0x6A
INT_STATUS, FIFO_COUNT_H, FIFO_R_W, ACCEL_CONFIG = 0x3A, 0x72, 0x74, 0x1C
I2C_SLAVE, I2C_SLAVE_FORCE, I2C_FUNCS, I2C_RDWR, I2C_PEC, I2C_TENBIT = 0x703, 0x706, 0x705, 0x707, 0x708, 0x704

Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def bus(chip: Served) -> Iterator[SMBus]:
    del chip
    with SMBus(9) as bus:
        yield bus


@pytest.fixture
def node(chip: Served) -> Iterator[int]:
    """The bare file."""
    del chip
    node = os.open("/dev/i2c-9", os.O_RDWR)
    yield node
    os.close(node)


def burst(bus: SMBus, register: int, count: int) -> bytes:
    reading = i2c_msg.read(CHIP, count)
    bus.i2c_rdwr(i2c_msg.write(CHIP, [register]), reading)
    return bytes(reading)


# i2c-tools


def test_i2cdetect_finds_the_chip_alone(chip: Served, run: Run) -> None:
    for way in ("-q", "-r"):
        done = run("i2cdetect", "-y", way, "9", "0x08", "0x77")
        cells = [cell for line in done.stdout.splitlines()[1:] for cell in line.split()[1:]]
        assert done.returncode == 0
        assert cells.count("--") == 0x77 - 0x08
        assert [cell for cell in cells if cell != "--"] == ["68"]


def test_i2cget_reads_and_i2cset_writes_a_register(chip: Served, run: Run) -> None:
    assert run("i2cget", "-y", "9", "0x68", "0x75").stdout == "0x68\n"
    assert run("i2cget", "-y", "9", "0x68", "0x6b").stdout == "0x40\n"  # asleep
    assert run("i2cset", "-y", "9", "0x68", "0x1c", "0x18").returncode == 0
    assert run("i2cget", "-y", "9", "0x68", "0x1c").stdout == "0x18\n"
    assert run("i2cget", "-y", "9", "0x68", "0x1b", "w").stdout == "0x1800\n"  # a word is little-endian
    assert run("i2cset", "-y", "9", "0x68", "0x19", "0x07", "0x03", "i").returncode == 0
    assert run("i2cget", "-y", "9", "0x68", "0x19", "i", "2").stdout == "0x07 0x03\n"
    assert run("i2cget", "-y", "9", "0x68", "0x19", "i", "32").stdout.split()[:4] == ["0x07", "0x03", "0x00", "0x18"]


def test_i2cget_says_that_nobody_answers(chip: Served, run: Run) -> None:
    done = run("i2cget", "-y", "9", "0x69", "0x75")
    assert (done.returncode, done.stderr) == (2, "Error: Read failed\n")


def test_i2ctransfer_reads_a_burst_of_the_sleeping_and_of_the_woken_chip(chip: Served, run: Run) -> None:
    burst = ("i2ctransfer", "-y", "9", "w1@0x68", "0x3b", "r14")
    assert run(*burst).stdout.split() == ["0x00"] * 14
    assert run("i2ctransfer", "-y", "9", "w2@0x68", "0x6b", "0x01").returncode == 0
    time.sleep(0.05)
    words = struct.unpack(">7h", bytes(int(byte, 16) for byte in run(*burst).stdout.split()))
    assert words[2:] == (ACCEL_Z, TEMPERATURE, 131, -262, 393)
    assert words[0] > 0


# smbus2


def test_smbus2_in_every_size(bus: SMBus) -> None:
    assert bus.read_byte_data(CHIP, WHO_AM_I) == 0x68
    assert bus.read_byte(CHIP) == 0x00  # the pointer has gone on, to 0x76
    bus.write_quick(CHIP)
    bus.write_byte(CHIP, WHO_AM_I)
    assert bus.read_byte(CHIP) == 0x68
    bus.write_byte_data(CHIP, ACCEL_CONFIG, 0x08)
    bus.write_word_data(CHIP, 0x19, 0x0304)
    assert bus.read_word_data(CHIP, 0x19) == 0x0304
    assert bus.read_i2c_block_data(CHIP, 0x19, 4) == [0x04, 0x03, 0x00, 0x08]
    bus.write_i2c_block_data(CHIP, 0x13, [1, 2, 3, 4, 5, 6])
    assert bus.read_i2c_block_data(CHIP, 0x13, 6) == [1, 2, 3, 4, 5, 6]
    bus.write_block_data(CHIP, 0x13, [7, 8])  # the length travels too
    assert bus.read_block_data(CHIP, 0x13) == [7, 8]
    assert bus.process_call(CHIP, 0x13, 0x0A09) == 0x0408  # writes 0x13 and 0x14, reads on at 0x15
    assert bus.block_process_call(CHIP, 0x13, [2, 0x20, 0x21]) == [6, 4, 3, 0, 8]  # 0x17 holds 5, a length


def test_smbus2_drains_the_fifo_that_pops(bus: SMBus) -> None:
    for register, value in ((PWR_MGMT_1, 1), (USER_CTRL, 0x40), (0x1A, 2), (0x19, 0)):
        bus.write_byte_data(CHIP, register, value)
    bus.write_byte_data(CHIP, FIFO_EN, 0xF8)
    time.sleep(0.03)
    bus.write_byte_data(CHIP, FIFO_EN, 0)
    count = int.from_bytes(burst(bus, FIFO_COUNT_H, 2))
    assert count % 14 == 0
    samples = count // 14
    assert samples >= 25
    first, rest = burst(bus, FIFO_R_W, 14), burst(bus, FIFO_R_W, count - 14)
    numbers = [x for x, *_ in struct.iter_unpack(">7h", first + rest)]
    assert numbers == list(range(numbers[0], numbers[0] + samples))
    assert int.from_bytes(burst(bus, FIFO_COUNT_H, 2)) == 0
    assert burst(bus, FIFO_R_W, 3) == rest[-1:] * 3  # an empty FIFO repeats itself


def test_the_fifo_runs_over_and_the_flag_clears_on_read(bus: SMBus) -> None:
    for register, value in ((PWR_MGMT_1, 1), (0x1A, 2), (USER_CTRL, 0x40), (FIFO_EN, 0xF8)):
        bus.write_byte_data(CHIP, register, value)
    time.sleep(0.12)
    assert int.from_bytes(burst(bus, FIFO_COUNT_H, 2)) == 1024
    bus.write_byte_data(CHIP, FIFO_EN, 0)
    assert bus.read_byte_data(CHIP, INT_STATUS) & 0x10
    assert not bus.read_byte_data(CHIP, INT_STATUS) & 0x10
    assert len(burst(bus, FIFO_R_W, 1024)) == 1024


def test_a_transfer_lasts_as_long_as_on_wires_of_400_kbit_s(bus: SMBus) -> None:
    started_ns = time.monotonic_ns()
    burst(bus, FIFO_R_W, 1008)
    assert time.monotonic_ns() - started_ns >= 1_011 * 9 * 2_500


# mpu6050-raspberrypi


def test_mpu6050_raspberrypi_reads_the_chip(chip: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "smbus", smbus2)  # the API it was written for
    from mpu6050 import mpu6050  # type: ignore[import-untyped]  # noqa: PLC0415 - ships no hints

    sensor = mpu6050(CHIP, bus=9)
    time.sleep(0.05)
    assert sensor.get_temp() == pytest.approx(TEMPERATURE / 340.0 + 36.53)
    assert sensor.get_accel_data()["z"] == pytest.approx(9.80665)
    assert sensor.get_gyro_data() == pytest.approx({"x": 1.0, "y": -2.0, "z": 3.0})
    sensor.set_accel_range(sensor.ACCEL_RANGE_8G)
    sensor.set_gyro_range(sensor.GYRO_RANGE_500DEG)
    time.sleep(0.05)
    assert (sensor.read_accel_range(), sensor.read_gyro_range()) == (8, 500)
    assert sensor.get_accel_data(g=True)["z"] == pytest.approx(1.0)
    assert sensor.get_gyro_data()["x"] == pytest.approx(2.0)  # the same counts, twice the range
    sensor.bus.close()


# adafruit-circuitpython-mpu6050 on Blinka, which reads and writes the file and joins messages by I2C_RDWR


class NodeI2c(busio.I2C):
    """``busio.I2C`` of Blinka on a node given by its number instead of by the pins of a board."""

    def init(self, scl: int, sda: int, frequency: int) -> None:
        del sda, frequency
        self._i2c = generic_linux.I2C(scl)


def test_adafruit_mpu6050_reads_the_chip(chip: Served) -> None:
    i2c = NodeI2c(9, 0)
    assert i2c.scan() == [CHIP]
    sensor = MPU6050(i2c)
    assert not sensor.sleep
    assert sensor.temperature == pytest.approx(TEMPERATURE / 340.0 + 36.53)
    assert sensor.acceleration[2] == pytest.approx(9.80665)
    for gyro_range, lsb_per_dps in ((GyroRange.RANGE_250_DPS, 131.0), (GyroRange.RANGE_2000_DPS, 16.4)):
        sensor.gyro_range = gyro_range
        assert sensor.gyro == pytest.approx([math.radians(raw / lsb_per_dps) for raw in (131, -262, 393)])
    sensor.accelerometer_range = Range.RANGE_8_G
    assert sensor.acceleration[2] == pytest.approx(9.80665)
    sensor.filter_bandwidth = Bandwidth.BAND_94_HZ  # 1 kHz
    for register_bit in ("fiforst", "fifo_en", "accel_fifo_en"):
        setattr(sensor, register_bit, True)
    time.sleep(0.03)
    sensor.accel_fifo_en = False
    count = sensor.fifo_count
    assert count >= 6 * 25
    samples = list(struct.iter_unpack(">3h", sensor.read_whole_fifo()))
    numbers = [x for x, *_ in samples]
    assert numbers == list(range(numbers[0], numbers[0] + count // 6))
    assert {z for *_, z in samples} == {ACCEL_Z // 4}
    with pytest.raises(OSError, match="Remote I/O"):  # not at its probe, an empty write: CUSE passes none on
        MPU6050(i2c, NOBODY)
    i2c.deinit()


# The file itself


def test_read_and_write_go_to_the_slave_of_this_file(node: int) -> None:
    other = os.open("/dev/i2c-9", os.O_RDWR)
    fcntl.ioctl(node, I2C_SLAVE, CHIP)
    fcntl.ioctl(other, I2C_SLAVE_FORCE, NOBODY)
    assert os.write(node, bytes([WHO_AM_I])) == 1
    assert os.read(node, 1) == b"\x68"
    with pytest.raises(OSError, match="Remote I/O") as caught:
        os.read(other, 1)
    assert caught.value.errno == errno.EREMOTEIO
    os.write(node, bytes([FIFO_R_W]))
    assert len(os.read(node, 10_000)) == 8192  # as much as i2c-dev gives
    assert os.write(node, bytes([0x76]) + bytes(9_999)) == 8192
    os.close(other)


def test_functionality_is_that_of_a_whole_adapter(node: int) -> None:
    word = bytearray(8)
    fcntl.ioctl(node, I2C_FUNCS, word)
    functions = int.from_bytes(word, "little")
    assert functions & 0x0FFF_8001 == 0x0FFF_8001  # I2C and every SMBus size
    assert not functions & 0x0000_000E  # no 10-bit addresses, no mangling, no PEC


@pytest.mark.parametrize(
    ("request_code", "argument", "code"),
    [
        (I2C_SLAVE, 0x80, errno.EINVAL),
        (I2C_TENBIT, 1, errno.EINVAL),
        (I2C_PEC, 1, errno.EINVAL),
        (0x07FF, 0, errno.ENOTTY),
        (I2C_RDWR, 0, errno.EFAULT),
    ],
)
def test_what_the_adapter_refuses(node: int, request_code: int, argument: int, code: int) -> None:
    with pytest.raises(OSError, match=r".") as caught:
        fcntl.ioctl(node, request_code, argument)
    assert caught.value.errno == code


@pytest.mark.parametrize(
    ("messages", "flags", "length", "code"),
    [(0, 0, 1, errno.EINVAL), (43, 0, 1, errno.EINVAL), (1, 1, 8193, errno.EINVAL), (1, 0x4000, 1, errno.EOPNOTSUPP)],
)
def test_messages_that_no_adapter_takes(bus: SMBus, messages: int, flags: int, length: int, code: int) -> None:
    message = i2c_msg.read(CHIP, max(length, 1))
    message.flags = flags
    with pytest.raises(OSError, match=r".") as caught:
        bus.i2c_rdwr(*[message] * messages)
    assert caught.value.errno == code


def test_writes_joined_by_repeated_starts_keep_their_order(bus: SMBus) -> None:
    reading, again = i2c_msg.read(CHIP, 2), i2c_msg.read(CHIP, 1)
    bus.i2c_rdwr(
        i2c_msg.write(CHIP, [0x19, 0x09]),
        i2c_msg.write(CHIP, [0x1B, 0x18]),
        i2c_msg.write(CHIP, [0x19]),
        reading,
        i2c_msg.write(CHIP, [0x1B]),
        again,
    )
    assert (bytes(reading), bytes(again)) == (b"\x09\x00", b"\x18")


# Errors


def test_nobody_at_the_address_is_remote_io_error(bus: SMBus) -> None:
    for attempt in (
        lambda: bus.read_byte_data(NOBODY, WHO_AM_I),
        lambda: bus.write_quick(NOBODY),
        lambda: bus.i2c_rdwr(i2c_msg.write(NOBODY, [0]), i2c_msg.read(NOBODY, 1)),
    ):
        with pytest.raises(OSError, match="Remote I/O") as caught:
            attempt()
        assert caught.value.errno == errno.EREMOTEIO


@pytest.mark.parametrize("code", [errno.ENXIO, errno.ETIMEDOUT])
def test_a_fault_of_the_bus_reaches_the_program_with_its_errno(serve: Callable[..., Served], code: int) -> None:
    serve(faults=[{"kind": "nack", "device": "i2c_1", "start_s": 0.0, "value": code}])
    with SMBus(10) as bus, pytest.raises(OSError, match=r".") as caught:
        bus.read_byte_data(CHIP, WHO_AM_I)
    assert caught.value.errno == code


def test_a_node_that_goes_away_and_comes_back(serve: Callable[..., Served]) -> None:
    first = serve()
    with SMBus(10) as bus:
        assert bus.read_byte_data(CHIP, WHO_AM_I) == 0x68
        first.kill()
        for _ in range(2):
            with pytest.raises(OSError, match=r".") as caught:
                bus.read_byte_data(CHIP, WHO_AM_I)
            assert caught.value.errno == errno.ENOTCONN
        second = serve()
        with pytest.raises(OSError, match=r"."):  # the old file stays dead
            bus.read_byte_data(CHIP, WHO_AM_I)
    with SMBus(10) as bus:
        assert bus.read_byte_data(CHIP, WHO_AM_I) == 0x68
    assert second.end()["server"]["i2c_1"]["transfers"] == 1
