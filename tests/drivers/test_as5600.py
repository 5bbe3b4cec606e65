"""AS5600: decoder, and the driver against a chip typed from the data sheet."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import FrameError
from drivers.i2c.as5600 import As5600, As5600Config, decode_reading
from drivers.records import SampleStatus
from tests.drivers.batches import codes
from tests.drivers.chip_flight import ChipFlight
from tests.drivers.i2c_model import As5600Model

NAME = "joint"
NOT_VALID = int(SampleStatus.NOT_VALID)


class Flight(ChipFlight):
    def __init__(self, clock, config=None, chip=None):
        model = chip or As5600Model(clock)
        super().__init__(clock, model, As5600(NAME, model, config))


@pytest.fixture
def flight(clock):
    return Flight(clock)


@pytest.mark.parametrize(
    ("data", "counts", "status"),
    [("200000", 0, 0x20), ("200fff", 4095, 0x20), ("300800", 2048, 0x30), ("280001", 1, 0x28), ("000000", 0, 0)],
)
def test_readings_of_the_data_sheets_coding(data, counts, status):
    assert decode_reading(bytes.fromhex(data)) == (counts, status)


@given(st.binary(max_size=6))
def test_any_bytes_are_a_reading_or_refused(data):
    reserved = len(data) == 3 and (data[0] & 0xC7 or data[1] & 0xF0)
    if len(data) != 3 or reserved:
        with pytest.raises(FrameError, match="check bus and address"):
            decode_reading(data)
    else:
        counts, status = decode_reading(data)
        assert 0 <= counts < 4096
        assert bytes([status, counts >> 8, counts & 0xFF]) == data


@pytest.mark.parametrize(("taps", "code"), [(16, 0), (8, 1), (4, 2), (2, 3)])
def test_the_set_up_leaves_what_is_not_its_own(clock, taps, code):
    chip = As5600Model(clock)
    chip.registers |= {0x07: 0xC0 | 0x3C, 0x08: 0xA0 | 0x0F}  # factory bits, output stage, PWM; FTH, hysteresis, LPM
    flight = Flight(clock, As5600Config(slow_filter=taps), chip)
    flight.fly(0.1)
    assert codes(flight.batches) == ["started"]
    assert chip.registers[0x07] == 0xC0 | code
    assert chip.registers[0x08] == 0xA0
    assert [data for kind, *data in chip.transfers if kind == "write"] == [[7, 0xC0 | code], [8, 0xA0]]


def test_an_impossible_step_is_not_valid_and_leaves_no_turn_behind(flight):
    flight.fly(0.5)
    flight.chip.angle = lambda now_ns: 2200
    flight.fly(0.005)
    flight.chip.angle = lambda now_ns: 100
    flight.fly(0.5)
    rows = flight.rows()
    assert rows["status"].tolist().count(NOT_VALID) == 1
    assert set(rows["value_raw"][rows["status"] == 0]) == {100}


def test_a_brown_out_loses_the_filter_and_not_the_turns(clock):
    chip = As5600Model(clock)
    began_ns = clock()
    chip.angle = lambda now_ns: round((now_ns - began_ns) * 1e-9 * 900)
    flight = Flight(clock, chip=chip)
    flight.fly(8.0)
    chip.reset()
    flight.fly(2.0)
    assert codes(flight.batches) == ["started", "brown_out", "started"]
    assert chip.registers[7] == 3
    rows = flight.rows()
    np.testing.assert_allclose(rows["value_raw"], (rows["tick"].astype(np.int64) - began_ns) * 9e-7, atol=1.0)
