"""FIFOs of the simulated BMI088, byte by byte."""

import numpy as np
import pytest

from tests.hil_sim.devices.test_bmi088 import ACCEL, GYRO, WORDS, Ramp, Session, SpiSession

FORCE, RATE = np.array(WORDS[:3], "<i2").tobytes(), np.array(WORDS[4:], "<i2").tobytes()
FRAME = b"\x84" + FORCE


def running(**options):
    """Both dies at 1600 and 1000 Hz, their FIFOs empty."""
    one = Session(**options).on()
    for address, register, value in ((ACCEL, 0x40, 0x8C), (GYRO, 0x10, 0x02), (ACCEL, 0x49, 0x50), (GYRO, 0x3E, 0x80)):
        one.write(address, register, value)
    one.read(ACCEL, 0x26, 1024), one.read(GYRO, 0x3F, 600)
    return one


def length(one):
    return int.from_bytes(one.read(ACCEL, 0x24, 2), "little")


def test_reset_values_of_the_fifos():
    one = Session()
    assert one.read(ACCEL, 0x45) + one.read(ACCEL, 0x48, 2) == b"\x80\x02\x10"
    assert (one.read(GYRO, 0x0E), one.read(GYRO, 0x3D, 2)) == (b"\0", b"\0\0")


def test_who_reads_beyond_the_frames_gets_the_sensor_time_and_then_nothing():
    one = running().after(10)
    assert length(one) == 16 * 7
    ticks = one.read(ACCEL, 0x18, 3)
    assert one.read(ACCEL, 0x26, 16 * 7 + 6) == 16 * FRAME + b"\x44" + ticks + b"\x80\x80"
    assert one.read(ACCEL, 0x26, 5) == b"\x44" + ticks + b"\x80"
    assert length(one) == 0


def test_samples_fall_on_multiples_of_their_period_in_the_sensor_time():
    one = running(imu=Ramp()).after(10.31)
    data = one.read(ACCEL, 0x26, length(one) + 4)
    newest = int.from_bytes(data[-10:-8], "little")  # units of 0.1 ms
    ticks = int.from_bytes(data[-3:], "little")
    assert newest == pytest.approx((ticks - ticks % 16) * 0.390625, abs=1.0)


def test_a_frame_that_is_cut_comes_again_whole():
    one = running().after(5)
    count = length(one) // 7
    assert one.read(ACCEL, 0x26, 10) == (2 * FRAME)[:10]
    assert length(one) == 7 * (count - 1)
    assert one.read(ACCEL, 0x26, 7) == FRAME


def test_of_the_accelerometer_the_oldest_give_way_and_are_counted():
    one = running().after(100)
    assert length(one) == 2 + 146 * 7
    assert one.read(ACCEL, 0x26, 9) == bytes([0x40, 160 - 146]) + FRAME
    assert one.read(ACCEL, 0x26, 7) == FRAME


def test_of_the_gyroscope_the_oldest_give_way_until_a_write_empties_it():
    one = running().after(50)
    assert one.read(GYRO, 0x0E) == bytes([50])
    assert one.read(GYRO, 0x3F, 20) == (4 * RATE)[:20]
    assert one.read(GYRO, 0x0E) == bytes([47])
    one.after(60)
    assert one.read(GYRO, 0x0E) == bytes([0x80 | 100])
    assert one.read(GYRO, 0x3F, 606) == 100 * RATE + bytes(6)
    assert one.read(GYRO, 0x0E) == b"\x80"
    one.write(GYRO, 0x3E, 0x80)
    assert one.read(GYRO, 0x0E) in (b"\1", b"\2")  # a write takes 2 ms here


def test_a_write_after_a_reading_takes_nothing_out():
    one = running().after(50)
    one.read(GYRO, 0x3F, 60)
    before = length(one)
    one.read(GYRO, 0x3F, 60)
    one.bus.transfer(ACCEL, bytes([0x41, 0]), 0, one.now_ns)
    assert length(one) == before


def test_a_die_that_is_off_or_not_let_in_gives_nothing():
    one = running().write(ACCEL, 0x49, 0x10).write(GYRO, 0x11, 0x80)
    one.read(ACCEL, 0x26, 64), one.read(GYRO, 0x3F, 64)
    one.after(50)
    assert length(one) == 0
    assert one.read(GYRO, 0x0E) == b"\0"


def test_on_spi_an_identity_read_on_to_the_fifo_takes_out_of_it():
    one = SpiSession()
    one(0, "80 00 00")
    for frame in ("7c 00", "7d 04"):
        one(0, frame)
    one.at_ms += 60
    for frame in ("40 8c", "49 50"):
        one(0, frame)
    one.at_ms += 10
    assert one(0, "a6" + "00" * 8) == "00 00 " + FRAME.hex(" ")
    lengths = []
    for frame in ("80" + "00" * 39, "80" + "00" * 46):  # 00h to 25h; and seven bytes of 26h
        for asked in (frame, "a4" + "00" * 3):
            one.at_ms -= 2  # no sample is made meanwhile
            said = one(0, asked)
        lengths.append(bytes.fromhex(said)[2])
    assert lengths[0] - lengths[1] == 7
