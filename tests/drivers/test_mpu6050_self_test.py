"""The self test against a chip at rest whose actuators the test owns; formulas typed again from the register map.

The FIFO decoder: bytes of the data sheet, any bytes, any split.
"""

import errno
import math
import struct

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from drivers.errors import ConfigurationError, DriverError, FrameError, NoAnswerError, SelfTestError, WrongDeviceError
from drivers.inertial.packet import first_misaligned
from drivers.mpu6050 import Mpu6050, Mpu6050Config, decode_packets
from drivers.mpu6050.self_test import deviation, factory_trim
from drivers.records import IMU, SampleStatus
from tests.drivers.mpu6050_model import Mpu6050Model

CONFIG = Mpu6050Config(accel_range_g=4, gyro_range_deg_s=500, filter_code=3)
# register order: accel x, y, z, temperature, gyro x, y, z, high byte first
ONE_G_UP_AT_35_DEG = bytes.fromhex("0001 FFFF 2000 FDF7 8000 7FFF FF7D")


def test_a_packet_of_the_data_sheet():
    (row,) = decode_packets(ONE_G_UP_AT_35_DEG, CONFIG)
    assert row["accel_raw"].tolist() == [1, -1, 8192]
    assert row["gyro_raw"].tolist() == [-32768, 32767, -131]
    assert row["temperature_raw"] == -521  # 35 degC: PS 6.2
    assert row["accel_raw"][2] * row["accel_scale_m_s2"] == pytest.approx(9.80665, rel=1e-6)
    assert row["gyro_scale_rad_s"] == pytest.approx(math.radians(1.0) / 65.5, rel=1e-6)
    assert row["filter_code"] == 3
    assert row["sync"] == 1
    assert (row["sequence"], row["tick"], row["host_ns"]) == (0, 0, 0)


@pytest.mark.parametrize(("accel", "lsb_per_g"), [(2, 16384.0), (4, 8192.0), (8, 4096.0), (16, 2048.0)])
@pytest.mark.parametrize(("gyro", "lsb_per_deg_s"), [(250, 131.0), (500, 65.5), (1000, 32.8), (2000, 16.4)])
def test_scales_of_every_range(accel, lsb_per_g, gyro, lsb_per_deg_s):
    (row,) = decode_packets(bytes(14), Mpu6050Config(accel_range_g=accel, gyro_range_deg_s=gyro))
    assert row["accel_scale_m_s2"] == np.float32(9.80665 / lsb_per_g)
    assert row["gyro_scale_rad_s"] == np.float32(math.pi / 180.0 / lsb_per_deg_s)


@pytest.mark.parametrize("word", range(7))
@pytest.mark.parametrize("value", [32767, -32768])
def test_a_word_at_its_limit_saturates_the_sample_unless_it_is_the_temperature(word, value):
    words = [0] * 7
    words[word] = value
    rows = decode_packets(struct.pack(">7h", *words) + bytes(14), CONFIG)
    expected = SampleStatus.OK if word == 3 else SampleStatus.SATURATED
    assert rows["status"].tolist() == [expected, SampleStatus.OK]


@pytest.mark.parametrize("words", [(0x007F, -0x80), (0x0080, 0x00FF), (0x7FFE, -0x7FFF)])
def test_two_words_whose_halves_look_like_a_limit_do_not_saturate(words):
    rows = decode_packets(struct.pack(">7h", *words, 0, 0, 0, *words), CONFIG)
    assert rows["status"].tolist() == [SampleStatus.OK]


@given(st.binary(max_size=200))
def test_any_bytes_give_rows_that_hold_them_or_a_frame_error(data):
    if len(data) % 14:
        with pytest.raises(FrameError):
            decode_packets(data, CONFIG)
        return
    rows = decode_packets(data, CONFIG)
    assert rows.dtype == IMU
    back = b"".join(struct.pack(">7h", *row["accel_raw"], row["temperature_raw"], *row["gyro_raw"]) for row in rows)
    assert back == data
    assert rows["sync"].tolist() == [byte & 1 for byte in data[7::14]]


@given(st.binary(min_size=14 * 6, max_size=14 * 6), st.integers(0, 6))
def test_where_a_burst_is_cut_between_packets_changes_nothing(data, packets):
    cut = 14 * packets
    parts = [decode_packets(data[:cut], CONFIG), decode_packets(data[cut:], CONFIG)]
    assert b"".join(part.tobytes() for part in parts) == decode_packets(data, CONFIG).tobytes()


def test_rows_are_the_same_to_the_byte_padding_included():
    data = bytes(range(140))
    assert {decode_packets(data, CONFIG).tobytes() for _ in range(50)} == {decode_packets(data, CONFIG).tobytes()}


@pytest.mark.parametrize("slip", range(1, 14))
def test_a_slipped_packet_boundary_shows_in_the_temperature(slip):
    stream = struct.pack(">7h", 8000, 12, 2000, -3920, 900, -700, 60) * 20
    aligned = decode_packets(stream[:140], CONFIG)["temperature_raw"]
    slipped = decode_packets(stream[slip : slip + 140], CONFIG)["temperature_raw"]
    assert first_misaligned(aligned, None) is None
    assert first_misaligned(slipped, int(aligned[-1])) == 0
    assert first_misaligned(np.concatenate([aligned, slipped]), -3920) == 10


def test_a_temperature_that_drifts_is_no_slip():
    words = np.arange(-4000, 4000, 350, dtype=np.int16)
    assert first_misaligned(words, -4300) is None
    assert first_misaligned(words, -4500) == 0
    assert first_misaligned(np.array([-32768, 32767], np.int16), None) == 1


CODES = bytes([0b101_01010, 0b011_11111, 0b110_00001, 0b00_01_10_11])  # accel 21, 14, 27; gyro 10, 31, 1
GYRO_CODES, ACCEL_CODES = (10, 31, 1), (0b10101, 0b01110, 0b11011)


def expected_trim():
    gyro = [sign * 25 * 131 * 1.046 ** (code - 1) for sign, code in zip((1, -1, 1), GYRO_CODES, strict=True)]
    accel = [4096 * 0.34 * (0.92 / 0.34) ** ((code - 1) / (2**5 - 2)) for code in ACCEL_CODES]
    return np.array([*gyro, *accel])


@pytest.fixture
def chip(clock):
    chip = Mpu6050Model(clock)
    chip.factory_codes = CODES
    chip.self_test_response = expected_trim().tolist()
    return chip


def run(chip):
    return Mpu6050("imu", chip).self_test(lambda seconds: chip.clock.advance(round(seconds * 1e9)))


def test_the_trim_is_that_of_the_register_map():
    np.testing.assert_allclose(factory_trim(CODES), expected_trim(), rtol=1e-12)
    assert factory_trim(bytes([1, 0, 0, 0])).tolist() == [3275.0, 0, 0, 0, 0, 0]
    assert factory_trim(bytes([0, 1, 0, 0])).tolist() == [0, -3275.0, 0, 0, 0, 0]
    assert factory_trim(bytes([0, 0, 0, 0b0001_0000]))[3] == 4096 * 0.34
    assert factory_trim(b"\xff" * 4)[3:] == pytest.approx([4096 * 0.92] * 3)


@given(st.binary(max_size=8))
def test_any_codes_are_a_trim_or_a_frame_error(codes):
    if len(codes) == 4:
        trim = factory_trim(codes)
        assert np.all((np.abs(trim[:3]) == 0) | (np.abs(trim[:3]) >= 3275))
    else:
        with pytest.raises(FrameError, match="read four"):
            factory_trim(codes)


def test_a_chip_as_from_the_factory_passes(chip):
    result = run(chip)
    assert np.abs([*result.gyro_deviation, *result.accel_deviation]).max() < 1e-3


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("percent", [-13, 13, -15, 15, -100, 100])
def test_each_axis_is_judged_by_itself(chip, axis, percent):
    chip.self_test_response[axis] *= 1 + percent / 100
    if abs(percent) < 14:
        result = run(chip)
        got = [*result.gyro_deviation, *result.accel_deviation]
        assert got[axis] == pytest.approx(percent / 100, abs=1e-3)
        return
    name = ("gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z")[axis]
    with pytest.raises(
        SelfTestError, match=rf"^imu: {name} \{percent:+d} % off the factory trim.*keep it still"
    ) as caught:
        run(chip)
    assert caught.value.deviations[axis] == pytest.approx(percent / 100, abs=1e-3)
    assert isinstance(caught.value, (DriverError, RuntimeError))


def test_a_y_gyro_of_the_wrong_sign_fails(chip):
    chip.self_test_response[1] *= -1
    with pytest.raises(SelfTestError, match="gyro y -200 %"):
        run(chip)


def test_the_limit_itself_is_within():
    trim = expected_trim()
    deviation(trim * 1.1399, trim)
    with pytest.raises(SelfTestError, match=r"gyro x .*, accel z"):
        deviation(trim * 1.1401, trim)


def test_an_axis_without_trim_cannot_be_judged(chip):
    chip.factory_codes = bytes([0b000_01010, 0b011_00000, 1 | 0x20, 0b00_00_10_11])
    with pytest.raises(SelfTestError, match="no factory trim for gyro y, accel x") as caught:
        run(chip)
    assert caught.value.deviations == ()


@pytest.mark.parametrize("passes", [True, False])
def test_the_chip_keeps_its_settings(chip, passes):
    settings = {0x6B: 0x01, 0x6C: 0x07, 0x19: 9, 0x1A: 0x0B, 0x1B: 0x18, 0x1C: 0x08, 0x23: 0x78, 0x38: 0x11, 0x6A: 0x40}
    chip.registers |= settings
    if not passes:
        chip.self_test_response[0] = 0.0
        with pytest.raises(SelfTestError):
            run(chip)
    else:
        run(chip)
    assert {register: chip.registers[register] for register in settings} == settings


def test_a_sleeping_chip_is_woken_and_put_to_sleep_again(chip):
    assert chip.registers[0x6B] == 0x40
    run(chip)
    assert chip.registers[0x6B] == 0x40
    assert ("write", 0x6B, 0x01) in chip.transfers
    assert ("write", 0x1B, 0xE0) in chip.transfers
    assert ("write", 0x1C, 0xF0) in chip.transfers


def test_a_bus_that_dies_at_any_transaction_is_named_and_what_can_be_is_put_back(clock):
    good = Mpu6050Model(clock)
    good.factory_codes, good.self_test_response = CODES, expected_trim().tolist()
    run(good)
    count = len(good.transfers)
    assert count > 200
    for place in (*range(25), 60, 120, 121, 122, 180, *range(count - 12, count)):
        chip = Mpu6050Model(clock)
        chip.factory_codes, chip.self_test_response = CODES, expected_trim().tolist()
        chip.registers |= {0x1B: 0x08, 0x1C: 0x18}
        chip.fail = lambda number, place=place: errno.EREMOTEIO if place <= number < place + 3 else 0
        with pytest.raises(NoAnswerError, match=r"imu: I2C 0x68 .*\(EREMOTEIO\): check its power"):
            run(chip)
        if place < count - 12:
            assert (chip.registers[0x1B], chip.registers[0x1C], chip.registers[0x6B]) == (0x08, 0x18, 0x40)


def test_an_interrupted_test_puts_back_too(chip):
    def interrupted(seconds):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Mpu6050("imu", chip).self_test(interrupted)
    assert chip.registers[0x6B] == 0x40
    assert chip.registers[0x1C] == 0


def test_one_failed_transaction_is_tried_again(chip):
    chip.fail = lambda number: errno.EREMOTEIO if number % 9 == 0 else 0
    assert max(map(abs, run(chip).gyro_deviation)) < 1e-3


def test_a_clone_a_stranger_and_a_streaming_chip_are_refused(chip, clock):
    chip.registers[0x75] = 0x70
    with pytest.raises(ConfigurationError, match="MPU-6500: its factory trim is not known"):
        run(chip)
    chip.registers[0x75] = 0x12
    with pytest.raises(WrongDeviceError):
        run(chip)
    chip.registers[0x75] = 0x68
    device = Mpu6050("imu", chip)
    device.start(clock())
    with pytest.raises(ConfigurationError, match="streaming: stop it"):
        device.self_test(lambda seconds: None)


def test_after_its_test_it_flies(chip, clock):
    device = Mpu6050("imu", chip)
    device.self_test(lambda seconds: clock.advance(round(seconds * 1e9)))
    batches = device.start(clock())
    for _ in range(40):
        clock.advance(10_000_000)
        batches += device.pump(clock())
    assert sum(len(batch.rows) for batch in batches if batch.channel == "imu") > 150
