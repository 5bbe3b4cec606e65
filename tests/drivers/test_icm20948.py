"""ICM-20948: packets, banks, and the driver against a chip typed from the data sheet."""

import errno

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import FrameError
from drivers.i2c.banked import BankedBus
from drivers.inertial.icm20948 import ORDER, Icm20948, Icm20948Config, identify
from drivers.inertial.packet import decode_words
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of
from tests.drivers.chip_flight import ChipFlight
from tests.drivers.i2c_model import MS
from tests.drivers.icm20948_model import Icm20948Model

NAME = "imu"
SATURATED, AFTER_RESET = int(SampleStatus.SATURATED), int(SampleStatus.AFTER_RESET)
STEADY = ["started"]


class Flight(ChipFlight):
    def __init__(self, clock, config=None, chip=None, **options):
        model = chip or Icm20948Model(clock, **options)
        super().__init__(clock, model, Icm20948(NAME, model, config))

    def worst(self):
        """Largest error of a number, in samples, against those of the chip from the first row on."""
        rows = self.rows()
        true = rows["accel_raw"][:, 0].astype(int)
        return int(np.abs(np.diff(true) - np.diff(rows["sequence"].astype(int))).max())


@pytest.fixture
def flight(clock):
    return Flight(clock)


def test_a_packet_is_accel_gyro_and_temperature_in_big_endian_words():
    data = bytes.fromhex("0001 fffe 7fff 0010 8000 ff00 0b37 0001 0002 0003 0004 0005 0006 0b36")
    rows = decode_words(data, ORDER, Icm20948Config(accel_range_g=8, gyro_range_deg_s=1000))
    assert rows["accel_raw"].tolist() == [[1, -2, 32767], [1, 2, 3]]
    assert rows["gyro_raw"].tolist() == [[16, -32768, -256], [4, 5, 6]]
    assert rows["temperature_raw"].tolist() == [0x0B37, 0x0B36]
    assert rows["sync"].tolist() == [1, 0]
    assert rows["status"].tolist() == [SATURATED, 0]
    assert rows["accel_scale_m_s2"][0] == pytest.approx(9.80665 / 4096.0)
    assert rows["gyro_scale_rad_s"][0] == pytest.approx(np.deg2rad(1.0 / 32.8))


@given(st.binary(max_size=60))
def test_any_bytes_are_packets_or_refused(data):
    if len(data) % 14:
        with pytest.raises(FrameError, match="no whole number"):
            decode_words(data, ORDER, Icm20948Config())
    else:
        assert len(decode_words(data, ORDER, Icm20948Config())) == len(data) // 14


@pytest.mark.parametrize("longest", [14, 30, 8192])
def test_rows_are_the_same_however_the_fifo_is_read(clock, longest):
    flight = Flight(clock, Icm20948Config(max_transfer_bytes=longest))
    flight.fly(1.0)
    assert codes(flight.batches) == STEADY
    rows = flight.rows()
    true = rows["accel_raw"][:, 0].astype(int)
    assert np.array_equal(true - true[0], rows["tick"])
    assert rows["gyro_raw"].tolist() == [[3, 4, 5]] * len(rows)
    assert np.array_equal(rows["sync"], true % 7 == 0)
    reads = [transfer[2] for transfer in flight.chip.transfers if transfer[:2] == ("read", 0x72)]
    assert max(reads) <= longest


def test_the_set_up_is_these_transactions(flight):
    flight.fly(0.3)
    wrote = [data for kind, *data in flight.chip.transfers if kind == "write"]
    assert wrote == [
        *([0x06, 0x80], [0x06, 0x01], [0x06, 0x01], [0x07, 0x00], [0x05, 0x00]),
        *([0x7F, 0x20], [0x01, 0x11], [0x7F, 0x00], [0x7F, 0x20], [0x7F, 0x00]),  # 250 deg/s, 119.5 Hz; read back
        *([0x7F, 0x20], [0x14, 0x13], [0x7F, 0x00], [0x7F, 0x20], [0x7F, 0x00]),  # 4 g, 111.4 Hz
        *([0x7F, 0x20], [0x52, 0x01], [0x7F, 0x00], [0x7F, 0x20], [0x7F, 0x00]),  # FSYNC into the temperature
        *([0x7F, 0x20], [0x09, 0x01], [0x7F, 0x00], [0x7F, 0x20], [0x7F, 0x00]),
        *([0x7F, 0x20], [0x00, 0x01], [0x7F, 0x00], [0x7F, 0x20], [0x7F, 0x00]),  # 562.5 Hz
        *([0x7F, 0x20], [0x10, 0x00], [0x7F, 0x00], [0x7F, 0x20], [0x7F, 0x00]),
        *([0x7F, 0x20], [0x11, 0x01], [0x7F, 0x00], [0x7F, 0x20], [0x7F, 0x00]),
        *([0x12, 0x1F], [0x69, 0x00], [0x66, 0x00]),
        *([0x67, 0x00], [0x03, 0x40], [0x68, 0x1F], [0x68, 0x00], [0x67, 0x1F]),
    ]


@pytest.mark.parametrize(("accel", "accel_code"), [(2, 0), (8, 4), (16, 6)])
@pytest.mark.parametrize(("gyro", "gyro_code", "rate", "divider"), [(500, 2, 1125.0, 0), (2000, 6, 225.0, 4)])
def test_ranges_rate_and_filter_are_in_the_registers(clock, accel, accel_code, gyro, gyro_code, rate, divider):
    config = Icm20948Config(accel_range_g=accel, gyro_range_deg_s=gyro, sample_rate_hz=rate, filter_code=5)
    flight = Flight(clock, config)
    flight.fly(1.0)
    registers = flight.chip.registers
    assert (registers[0x214], registers[0x201]) == (0x29 | accel_code, 0x29 | gyro_code)
    assert (registers[0x200], registers[0x211]) == (divider, divider)
    assert len(flight.rows()) == pytest.approx(0.79 * rate / 1.004, abs=0.02 * rate)


def test_it_is_known_by_its_identity(clock):
    chip = Icm20948Model(clock)
    assert identify(chip, 0x69) == "ICM-20948"
    chip.registers[0x000] = 0x71
    assert identify(chip, 0x69) is None


@pytest.mark.parametrize("bank", [1, 2, 3])
def test_a_chip_that_was_left_in_another_bank_is_found(clock, bank):
    flight = Flight(clock)
    flight.chip.bank = bank
    flight.batches = flight.device.start(clock())
    flight.fly(1.0)
    assert codes(flight.batches) == STEADY


def test_a_bank_whose_selection_fails_is_selected_before_the_next_access(clock):
    chip = Icm20948Model(clock)
    bus = BankedBus(chip, 0x69, 0x7F)
    assert bus.byte(0x214) == 0x01
    first = len(chip.transfers)
    chip.fail = lambda number: errno.EIO if first + 2 <= number < first + 5 else 0  # back to bank 0, all three tries
    with pytest.raises(OSError, match="Input/output"):
        bus.byte(0x214)
    assert chip.bank == 2
    assert bus.byte(0x000) == 0xEA
    assert chip.bank == 0


# Samples


@pytest.mark.parametrize("error", [-0.02, 0.0, 1e-6, 0.013])
def test_every_sample_is_a_row_with_its_number(clock, error):
    flight = Flight(clock, rate_error=error)
    flight.fly(8.0)
    assert len(of(flight.batches, "gap")) == 0
    assert flight.worst() == 0
    assert set(flight.rows()["status"]) == {0}


def test_late_polls_overflow_the_fifo_and_what_is_lost_is_counted(flight, rng):
    flight.fly(4.0)
    for _ in range(20):
        flight.clock.advance(int(rng.uniform(70.0, 200.0) * MS))
        flight.fly(0.3)
    gaps = of(flight.batches, "gap")
    assert len(gaps) == 20
    assert set(gaps["cause"]) == {b"fifo_overflow"}
    assert flight.worst() <= 1


@pytest.mark.parametrize("count", [513, 4096])
def test_a_count_beyond_the_data_sheets_size_is_an_overflow(flight, count):
    """Parts have been seen to hold 4096 bytes."""
    flight.fly(4.0)
    flight.clock.advance(1000 * MS)
    flight.chip.stuck |= {0x70: count >> 8, 0x71: count & 0xFF}
    flight.fly(0.01)
    flight.chip.stuck.clear()
    flight.fly(1.0)
    assert codes(flight.batches)[:2] == ["started", "fifo_overflow"]
    assert flight.worst() <= 1


def test_a_brown_out_is_found_and_it_is_set_up_again(flight):
    flight.fly(4.0)
    flight.chip.reset()
    flight.fly(2.0)
    assert codes(flight.batches) == ["started", "brown_out", "started"]
    rows = flight.rows()
    assert (rows["status"] & AFTER_RESET != 0).sum() == 1
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"brown_out"
    assert flight.chip.registers[0x252] == 1


def test_samples_that_repeat_are_not_valid(flight):
    flight.chip.values = lambda number: [7, 1, 2, 3, 4, 5, 100]
    flight.fly(2.0)
    assert "stuck" in codes(flight.batches)
    assert set(flight.rows()["status"][-100:]) == {int(SampleStatus.NOT_VALID)}
