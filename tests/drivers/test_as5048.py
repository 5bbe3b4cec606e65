"""AS5048A and B: decoder, and the driver against chips typed from the data sheet."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import FrameError
from drivers.i2c.as5048 import As5048, As5048aPort, decode_output, framed, identify
from drivers.ports import I2cReply
from drivers.records import SampleStatus
from tests.drivers.batches import codes, texts
from tests.drivers.chip_flight import ChipFlight
from tests.drivers.i2c_model import Chip

NAME = "joint"
NOT_VALID = int(SampleStatus.NOT_VALID)


class As5048bModel(Chip):
    """AS5048B, data sheet 1-06, figure 31; ``angle`` by CLOCK_MONOTONIC ns, ``diagnostics`` as it is to be."""

    address = 0x40

    def __init__(self, clock, **options) -> None:
        self.angle = lambda now_ns: 3000
        self.diagnostics, self.gain, self.magnitude = 0x01, 50, 4713
        super().__init__(clock, **options)

    def run(self) -> None:
        counts = self.angle(self.clock()) % 16384
        outputs = (self.gain, self.diagnostics, *divmod(self.magnitude, 64), *divmod(counts, 64))
        self.registers |= dict(zip(range(0xFA, 0x100), outputs, strict=True))


class As5048aModel(As5048bModel):
    """AS5048A, figures 12 to 22: an ``SpiPort`` with the chip; ``fail`` is by the number of the transfer."""

    address = 0

    def __init__(self, clock, **options) -> None:
        self.answer, self.errors = 0, 0
        self.spoils = lambda word: word  # what the wires make of an answer
        super().__init__(clock, **options)

    def transfer(self, data: bytes, size: int) -> I2cReply:
        assert size == 2
        self.begins(0, ("spi", data.hex()))
        got = b""
        for at in range(0, len(data), 2):
            word = self.answer | (0x4000 if self.errors else 0)
            word |= (bin(word).count("1") % 2) << 15
            got += self.spoils(word).to_bytes(2, "big")
            self.answer = self.answered(int.from_bytes(data[at : at + 2], "big"))
        return I2cReply(got, self.clock())

    def answered(self, word: int) -> int:
        assert bin(word).count("1") % 2 == 0
        r = self.registers
        if word & 0x3FFF == 1:
            errors, self.errors = self.errors, 0
            return errors
        two = {0x3FFD: (0xFB, 8, 0xFA), 0x3FFE: (0xFC, 6, 0xFD), 0x3FFF: (0xFE, 6, 0xFF)}
        if word & 0x3FFF in two:
            high, bits, low = two[word & 0x3FFF]
            return self.stuck.get(high, r[high]) << bits | r[low]
        return r.get(word & 0x3FFF, 0)


def flown(clock, kind, config=None, chip=None):
    model = chip or (As5048aModel(clock) if kind == "A" else As5048bModel(clock))
    port, address = (As5048aPort(model), 0) if kind == "A" else (model, 0x40)
    return ChipFlight(clock, model, As5048(NAME, port, address, config))


def model_of(clock, kind, **options):
    return As5048aModel(clock, **options) if kind == "A" else As5048bModel(clock, **options)


BOTH = pytest.mark.parametrize("kind", ["A", "B"])


@pytest.mark.parametrize(
    ("data", "output"),
    [
        ("320149293f3f", (4095, 1, 50, 0x49 << 6 | 0x29)),
        ("000500000000", (0, 5, 0, 0)),
        ("ff08ff3fff3f", (16383, 8, 255, 16383)),
    ],
)
def test_outputs_of_the_data_sheets_coding(data, output):
    assert decode_output(bytes.fromhex(data)) == output


@given(st.binary(max_size=8))
def test_any_bytes_are_an_output_or_refused(data):
    if len(data) != 6 or data[1] & 0xF0 or data[3] & 0xC0 or data[5] & 0xC0:
        with pytest.raises(FrameError, match="check bus and address"):
            decode_output(data)
    else:
        counts, diagnostics, gain, magnitude = decode_output(data)
        assert bytes([gain, diagnostics, magnitude >> 6, magnitude & 63, counts >> 6, counts & 63]) == data


def test_commands_are_the_words_that_public_drivers_send():
    """FFFFh angle, 7FFDh diagnostics and gain, 7FFEh magnitude, 4001h errors: github.com/AlwaysFrozen/J_ESC."""
    assert [framed(0x4000 | register).hex() for register in (0x3FFF, 0x3FFD, 0x3FFE, 0x0001)] == [
        *("ffff", "7ffd", "7ffe", "4001")
    ]
    assert framed(0) == b"\0\0"


def test_a_reading_of_the_a_is_three_commands_and_of_the_b_one_transfer(clock):
    for kind, asked in (("A", ("spi", "7ffd7ffeffff0000")), ("B", ("read", 0xFA, 6))):
        flight = flown(clock, kind)
        flight.fly(0.1)
        assert set(flight.chip.transfers[-5:]) == {asked}
        assert set(flight.rows()["value_raw"]) == {3000}
        assert codes(flight.batches) == ["started"]
        assert all(transfer[0] != "write" for transfer in flight.chip.transfers)


def test_it_is_known_by_its_reserved_bits_and_that_it_has_started(clock):
    chip = As5048bModel(clock)
    assert "AS5048B" in identify(chip, 0x40)
    chip.diagnostics = 0
    assert identify(chip, 0x40) is None
    chip.diagnostics = 0x81
    assert identify(chip, 0x40) is None


@pytest.mark.parametrize("line", [0x0000, 0xFFFF])
def test_a_line_that_no_chip_drives_is_no_angle(clock, line):
    flight = flown(clock, "A")
    flight.fly(0.5)
    flight.chip.spoils = lambda word: line
    flight.fly(1.0)
    flight.chip.spoils = lambda word: word
    flight.fly(1.0)
    assert codes(flight.batches) == ["started", "bus_error", "bus_recovered"]
    assert "ENXIO" in texts(flight.batches, "bus_error")[0]
    assert set(flight.rows()["value_raw"]) == {3000}


def test_a_bit_that_turns_on_the_wires_is_read_again(clock):
    """Each of the 16 bits of each answer: by the parity, or the error flag's."""
    for bit in range(16):
        for place in range(1, 4):
            chip, seen = As5048aModel(clock), {"words": 0}

            def spoils(word, bit=bit, place=place, seen=seen):
                seen["words"] += 1
                return word ^ (1 << bit) if seen["words"] == 82 + place else word

            chip.spoils = spoils
            flight = flown(clock, "A", chip=chip)
            flight.fly(0.3)
            assert codes(flight.batches) == ["started"]
            assert flight.device.bus_errors == 1, (bit, place)
            assert set(flight.rows()["value_raw"]) == {3000}


def test_an_error_flag_is_cleared_and_the_reading_repeated(clock):
    flight = flown(clock, "A")
    flight.fly(0.5)
    flight.chip.errors = 0x04
    flight.fly(0.5)
    assert ("spi", "40010000") in flight.chip.transfers
    assert flight.chip.errors == 0
    assert codes(flight.batches) == ["started"]
    assert flight.device.bus_errors == 1


@BOTH
def test_a_zero_position_of_its_own_is_kept_and_one_that_changes_is_told(clock, kind):
    chip = model_of(clock, kind)
    chip.registers |= {0x16: 0x12, 0x17: 0x03}
    flight = flown(clock, kind, chip=chip)
    flight.fly(3.0)
    assert codes(flight.batches) == ["started"]
    chip.registers[0x17] = 0x04
    flight.fly(2.0)
    assert codes(flight.batches) == ["started", "configuration_lost", "started"]


def test_nothing_is_written_to_an_as5048a(clock):
    with pytest.raises(OSError, match="not written"):
        As5048aPort(As5048aModel(clock)).write(0, b"\3\1")
