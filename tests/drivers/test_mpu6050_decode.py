"""The FIFO decoder: bytes of the data sheet, any bytes, any split."""

import math
import struct

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from drivers.errors import ConfigurationError, FrameError
from drivers.inertial.packet import first_misaligned
from drivers.mpu6050 import Mpu6050Config, decode_packets
from drivers.records import IMU, SampleStatus

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


@pytest.mark.parametrize(
    "wrong",
    [
        {"address": 0x6A},
        {"accel_range_g": 3},
        {"gyro_range_deg_s": 300},
        {"filter_code": 7},
        {"filter_code": -1},
        {"sample_rate_hz": 300},
        {"sample_rate_hz": 2},
        {"sample_rate_hz": 0},
        {"poll_period_ms": 37.0},
        {"poll_period_ms": 0.0},
        {"poll_period_ms": math.nan},
        {"max_transfer_bytes": 13},
        {"max_transfer_bytes": 8193},
    ],
    ids=str,
)
def test_what_the_chip_does_not_have_is_refused(wrong):
    with pytest.raises(ConfigurationError, match=next(iter(wrong)) if "address" not in wrong else "0x6a"):
        Mpu6050Config(**wrong)
