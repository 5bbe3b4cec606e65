"""BMI088: decoders, and the driver against two dies typed from the data sheet."""

from math import radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import FrameError
from drivers.inertial.bmi088 import Bmi088, Bmi088Config, decode_forces, decode_temperature, identify
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of
from tests.drivers.chip_flight import ChipFlight
from tests.drivers.i2c_model import MS, Chip

NAME = "imu"
SATURATED, RESET = int(SampleStatus.SATURATED), int(SampleStatus.AFTER_RESET)
ACCEL, GYRO = 0x000, 0x100  # of register numbers here: the die


class Bmi088Model(Chip):
    """Both dies, data sheet BST-BMI088-DS001; words by CLOCK_MONOTONIC ns."""

    addresses = (0x18, 0x68)
    reset_values = {0x00: 0x1E, 0x40: 0xA8, 0x41: 0x01, 0x7C: 0x03, GYRO: 0x0F, GYRO | 0x10: 0x80}  # noqa: RUF012

    def __init__(self, clock, **options) -> None:
        self.force = self.rate = lambda now_ns: (100, -200, 300)
        self.temperature = 0x0FE0  # 127 counts: 23 + 15.875 degC
        self.stands_still = False
        self.rate_of_ticks, self.ahead = 1.0, 0
        self.die = 0
        super().__init__(clock, **options)

    def reset(self) -> None:
        super().reset()
        self.on_ns, self.blocked_ns, self.gyro_ns = None, 0, 0

    def begins(self, address: int, transfer: tuple) -> None:
        self.die = 256 * self.addresses.index(address) if address in self.addresses else 0
        self.address = address if address in self.addresses else -1
        super().begins(address, (transfer[0], self.die, *transfer[1:]))

    def wrote(self, register: int, value: int) -> None:
        now_ns = self.clock()
        if (self.die | register, value) in ((0x7E, 0xB6), (GYRO | 0x14, 0xB6)):
            for at in [one for one in self.registers if one & 0x100 == self.die]:
                del self.registers[at]
            self.registers |= {at: v for at, v in self.reset_values.items() if at & 0x100 == self.die}
            self.gyro_ns = now_ns + 30 * MS if self.die else self.gyro_ns
        elif now_ns >= (self.gyro_ns if self.die else self.blocked_ns):
            if not self.die and self.registers[0x7C] & 3:  # suspended: it takes a millisecond for a write
                self.blocked_ns = now_ns + MS
            super().wrote(self.die | register, value | 0x80 if self.die | register == GYRO | 0x10 else value)
            if (self.die | register, value) == (0x7D, 4):
                self.on_ns = now_ns + 50 * MS

    def run(self) -> None:
        now_ns, r = self.clock(), self.registers
        if r.get(0x7D) == 4 and not r[0x7C] and self.on_ns is not None and now_ns >= self.on_ns:
            if not self.stands_still:
                self.ticks = int(now_ns / 39_062.5 * self.rate_of_ticks) + self.ahead & 0xFFFFFF
            data = np.array(self.force(now_ns), "<i2").tobytes() + self.ticks.to_bytes(3, "little")
            r.update(zip(range(0x12, 0x1B), data, strict=True))
            r.update({0x22: self.temperature >> 8, 0x23: self.temperature & 0xFF})
        if not r.get(GYRO | 0x11):
            r.update(zip(range(GYRO | 2, GYRO | 8), np.array(self.rate(now_ns), "<i2").tobytes(), strict=True))

    def byte(self, register: int) -> int:
        where = self.die | register
        return self.stuck.get(where, self.registers.get(where, 0))


class Flight(ChipFlight):
    def __init__(self, clock, config=None, chip=None):
        model = chip or Bmi088Model(clock)
        super().__init__(clock, model, Bmi088(NAME, model, config))


@pytest.fixture
def flight(clock):
    return Flight(clock)


def test_words_of_the_data_sheets_coding():
    words, ticks = decode_forces(bytes.fromhex("0100 ff7f 0080 010203"))
    assert words.tolist() == [1, 32767, -32768]
    assert ticks == 0x030201
    assert [decode_temperature(bytes.fromhex(one)) for one in ("0000", "3e00", "7fe0", "8000", "c100", "ffe0")] == [
        *(0, 496, 1023, -1024, -504, -1)
    ]


@given(st.binary(max_size=12))
def test_any_bytes_are_forces_or_refused(data):
    if len(data) != 9:
        with pytest.raises(FrameError, match="check bus and address"):
            decode_forces(data)
    else:
        words, ticks = decode_forces(data)
        assert words.tobytes() + ticks.to_bytes(3, "little") == data


@pytest.mark.parametrize(
    ("config", "written"),
    [
        (Bmi088Config(), [0x8C, 0, 0, 3, 0x02]),
        (Bmi088Config(accel_range_g=24, gyro_range_deg_s=2000, filter_code=0), [0xAC, 3, 0, 0, 0x00]),
        (Bmi088Config(accel_range_g=6, gyro_range_deg_s=125, filter_code=3), [0x8A, 1, 0, 4, 0x03]),
    ],
)
def test_it_is_set_up_as_the_data_sheet_wants(clock, config, written):
    flight = Flight(clock, config)
    flight.fly(0.3)
    assert codes(flight.batches) == ["started"]
    writes = [transfer[1:] for transfer in flight.chip.transfers if transfer[0] == "write"]
    where = [(0, 0x40), (0, 0x41), (256, 0x11), (256, 0x0F), (256, 0x10)]
    assert writes == [
        *((0, 0x7E, 0xB6), (256, 0x14, 0xB6), (0, 0x7C, 0x00), (0, 0x7D, 0x04)),
        *((die, register, value) for (die, register), value in zip(where, written, strict=True)),
    ]


def test_rows_have_words_scales_and_both_ends_of_their_time(clock):
    chip = Bmi088Model(clock, transfer_ns=200_000)
    flight = Flight(clock, Bmi088Config(sample_period_ms=2.0), chip)
    flight.fly(2.0)
    rows = flight.rows()
    assert (rows["accel_raw"] == (100, -200, 300)).all()
    assert (rows["gyro_raw"] == (100, -200, 300)).all()
    assert set(rows["temperature_raw"]) == {127}
    assert rows["accel_scale_m_s2"][0] == pytest.approx(3.0 * 9.80665 / 32768)
    assert rows["gyro_scale_rad_s"][0] == pytest.approx(radians(250.0) / 32768)
    span_ns = rows["host_ns"] - rows["tick"].astype(int)
    assert set(span_ns.tolist()) == {400_000, 600_000}  # with the temperature, now and then
    assert not rows["status"].any()


def test_a_word_at_an_end_of_its_range_is_saturated(flight):
    flight.fly(0.3)
    flight.chip.rate = lambda now_ns: (1, 2, -32768)
    flight.fly(0.1)
    flight.chip.rate, flight.chip.force = lambda now_ns: (1, 2, 3), lambda now_ns: (32767, 0, 0)
    flight.fly(0.1)
    assert flight.rows()["status"].tolist().count(SATURATED) == 40


def test_it_is_known_by_its_identity(clock):
    chip = Bmi088Model(clock)
    assert "BMI088" in identify(chip, 0x18)
    chip.registers[0] = 0x1F
    assert identify(chip, 0x18) is None


def test_a_brown_out_of_both_dies_is_seen_at_once_by_the_sensor_time(flight):
    flight.fly(1.0)
    flight.chip.reset()
    flight.fly(1.0)
    assert codes(flight.batches) in (["started", "no_samples", "started"], ["started", "brown_out", "started"])
    rows = flight.rows()
    assert rows["status"].tolist().count(RESET) == 1
    assert (rows["accel_raw"] == (100, -200, 300)).all()  # none of the zeros that it reads meanwhile
    (gap,) = of(flight.batches, "gap")
    assert gap["last_missing"] - gap["first_missing"] < 40


@pytest.mark.parametrize(("off", "noticed"), [(0.08, False), (-0.08, False), (0.15, True), (-0.15, True)])
def test_a_sensor_time_may_be_a_tenth_off_the_host_s(clock, off, noticed):
    chip = Bmi088Model(clock)
    chip.rate_of_ticks = 1.0 + off
    flight = Flight(clock, chip=chip)
    flight.fly(2.0)
    assert ("no_samples" in codes(flight.batches)) == noticed


def test_its_sensor_time_begins_again_at_0_after_24_bits(clock):
    chip = Bmi088Model(clock)
    chip.ahead = (1 << 24) - int(clock() / 39_062.5) % (1 << 24) - 20_000
    flight = Flight(clock, chip=chip)
    flight.fly(2.0)
    assert codes(flight.batches) == ["started"]


def test_an_accelerometer_that_stands_still_is_set_up_again(flight):
    flight.fly(1.0)
    flight.chip.stands_still = True
    flight.fly(0.02)
    assert codes(flight.batches) == ["started", "no_samples"]
    flight.chip.stands_still = False
    flight.fly(1.0)
    assert codes(flight.batches) == ["started", "no_samples", "started"]
    assert len(flight.rows()) > 300
