"""BMI088 on SPI: the driver against two dies with a select line each, typed from the data sheet."""

import os

import pytest

from drivers.inertial.bmi088 import Bmi088, Bmi088SpiPort
from drivers.ports import I2cReply
from tests.drivers.batches import codes, of, texts
from tests.drivers.chip_flight import ChipFlight
from tests.drivers.test_bmi088 import GYRO, NAME, RESET, Bmi088Model


class Bmi088SpiModel(Bmi088Model):
    """Both dies, with what came and went on their lines; ``absent``: what a line reads that no die drives."""

    def __init__(self, clock, **options) -> None:
        self.absent = {}
        self.turned = {}  # by the number of a transfer: what is turned in its answer, byte and bits
        super().__init__(clock, **options)

    def reset(self) -> None:
        super().reset()
        self.on_i2c = True

    def wrote(self, register: int, value: int) -> None:
        super().wrote(register, value)
        self.on_i2c = self.on_i2c or (self.die | register, value) == (0x7E, 0xB6)

    def exchange(self, die: int, data: bytes, size: int) -> I2cReply:
        number = len(self.transfers)
        self.transfers.append((die, data, size))
        self.clock.advance(self.transfer_ns)
        self.run()
        code = self.fail(number)
        if code:
            raise OSError(code, os.strerror(code))
        got = bytearray(b"".join(self.frame(die, data[at : at + size]) for at in range(0, len(data), size)))
        if number in self.turned:
            byte, bits = self.turned[number]
            got[byte] ^= bits
        return I2cReply(bytes(got), self.clock())

    def frame(self, die: int, frame: bytes) -> bytes:
        self.die = GYRO * die
        if die in self.absent:
            return bytes([self.absent[die]]) * len(frame)
        if not die and self.on_i2c:
            self.on_i2c = False
            return bytes(len(frame))
        if frame[0] < 0x80:
            self.wrote(*frame)
            return bytes(len(frame))
        begin, register = 1 if die else 2, frame[0] & 0x7F
        return bytes(begin) + bytes(self.byte(register + place) for place in range(len(frame) - begin))


class Line:
    """The select line of a die."""

    def __init__(self, chip: Bmi088SpiModel, die: int) -> None:
        self.chip, self.die, self.closed = chip, die, False

    def transfer(self, data: bytes, size: int) -> I2cReply:
        return self.chip.exchange(self.die, data, size)

    def close(self) -> None:
        self.closed = True


class Flight(ChipFlight):
    def __init__(self, clock, chip=None):
        model = chip or Bmi088SpiModel(clock)
        port = Bmi088SpiPort(Line(model, 0), Line(model, 1))
        super().__init__(clock, model, Bmi088(NAME, port, bus="SPI"))


@pytest.fixture
def flight(clock):
    return Flight(clock)


def test_what_goes_over_the_lines(flight):
    flight.fly(0.3)
    assert codes(flight.batches) == ["started"]
    before = len(flight.chip.transfers)
    asked = [(die, data.hex(" "), size) for die, data, size in flight.chip.transfers[:6]]
    assert asked == [
        *((0, "80 00 00 80 00 00", 3), (1, "80 00 80 00", 2)),
        *((0, "7e b6", 2), (1, "14 b6", 2)),
        *((0, "80 00 00 80 00 00", 3), (0, "7c 00", 2)),
    ]
    flight.fly(0.005)
    forces, rates = flight.chip.transfers[before : before + 2]
    assert forces == (0, (b"\x80" + bytes(10) + b"\x92" + bytes(10)), 11)
    assert rates == (1, (b"\x80" + bytes(6) + b"\x82" + bytes(6)), 7)
    rows = flight.rows()
    assert len(rows) > 30
    assert (rows["accel_raw"] == (100, -200, 300)).all()
    assert (rows["gyro_raw"] == (100, -200, 300)).all()
    assert set(rows["temperature_raw"]) == {127}


@pytest.mark.parametrize("die", [0, 1])
@pytest.mark.parametrize("level", [0x00, 0xFF])
def test_a_die_that_is_gone_is_told_before_a_row_of_it(flight, die, level):
    flight.fly(1.0)
    flight.chip.absent[die] = level
    flight.fly(0.5)
    assert codes(flight.batches) == ["started", "bus_error"]
    flight.chip.absent.clear()
    flight.fly(1.5)
    assert codes(flight.batches) == ["started", "bus_error", "bus_recovered"]
    rows = flight.rows()
    assert (rows["accel_raw"] == (100, -200, 300)).all()
    assert (rows["gyro_raw"] == (100, -200, 300)).all()
    assert len(of(flight.batches, "gap")) == 1


@pytest.mark.parametrize("die", [0, 1])
@pytest.mark.parametrize("level", [0x00, 0xFF])
def test_one_that_is_not_there_is_told_as_such(clock, die, level):
    chip = Bmi088SpiModel(clock)
    chip.absent[die] = level
    flight = Flight(clock, chip)
    flight.fly(1.0)
    assert codes(flight.batches) == ["no_answer"]
    assert "SPI does not answer" in texts(flight.batches, "no_answer")[0]


@pytest.mark.parametrize(("ahead", "byte"), [(0, 2), (1, 1)])
def test_an_identity_with_a_bit_that_turned_is_read_again(flight, ahead, byte):
    flight.fly(0.3)
    flight.chip.turned[len(flight.chip.transfers) + ahead] = byte, 0x40
    flight.fly(0.3)
    assert codes(flight.batches) == ["started"]
    assert flight.device.bus_errors == 1


def test_a_brown_out_takes_it_to_i2c_and_back(flight):
    flight.fly(1.0)
    flight.chip.reset()
    flight.fly(1.0)
    assert codes(flight.batches) in (["started", "no_samples", "started"], ["started", "brown_out", "started"])
    rows = flight.rows()
    assert rows["status"].tolist().count(RESET) == 1
    assert (rows["accel_raw"] == (100, -200, 300)).all()


def test_both_lines_are_released(clock):
    lines = [Line(Bmi088SpiModel(clock), die) for die in (0, 1)]
    Bmi088SpiPort(*lines).close()
    assert [line.closed for line in lines] == [True, True]
