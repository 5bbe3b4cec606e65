"""HX711: decoder, and the driver by libgpiod's calls on a chip that is typed from the data sheet."""

import errno

import gpiod
import numpy as np
import pytest
from gpiod.line import Bias, Direction
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import FrameError
from drivers.hx711 import Hx711, Hx711Config, decode_reading
from drivers.records import SampleStatus
from drivers.transports import open_pair
from drivers.transports.gpio_pair import GpiodPair
from tests.drivers.batches import codes, of, texts
from tests.drivers.chip_flight import ConverterFlight
from tests.drivers.hx711_model import CLOCK, DATA, MS, US, Hx711Model

NAME = "cell"
SATURATED, NOT_VALID, AFTER_RESET = map(int, (SampleStatus.SATURATED, SampleStatus.NOT_VALID, SampleStatus.AFTER_RESET))


class Flight(ConverterFlight):
    def __init__(self, clock, config=None, **chip):
        model = Hx711Model(clock, **chip)
        super().__init__(clock, model, Hx711(NAME, GpiodPair(model, DATA, CLOCK, clock), config))


@pytest.fixture
def flight(clock):
    return Flight(clock)


# The decoder


@pytest.mark.parametrize(
    ("word", "counts", "status"),
    [
        (0x000000, 0, 0),
        (0x000001, 1, 0),
        (0xFFFFFF, -1, 0),
        (0x123456, 0x123456, 0),
        (0x7FFFFE, 8_388_606, 0),
        (0x7FFFFF, 8_388_607, SATURATED),
        (0x800000, -8_388_608, SATURATED),
        (0x800001, -8_388_607, 0),
    ],
)
@pytest.mark.parametrize(("pulses", "ones"), [(25, 1), (26, 3), (27, 7)])
def test_readings_of_the_data_sheets_coding(word, counts, status, pulses, ones):
    assert decode_reading(word << (pulses - 24) | ones, pulses) == (counts, status)


def test_bits_that_another_program_printed_with_their_value():
    """Of a board on a Raspberry Pi: github.com/ggurov/hx711, pull request 12."""
    printed = "0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 1 1 1 0 1 1 1 1 1 1 0 0 0 n: 7672"
    bits, _, value = printed.replace(" ", "").partition("n:")
    assert decode_reading(int(bits[-24:] + "1", 2), 25) == (int(value), 0)


@given(st.integers(0, 1 << 32), st.integers(0, 40))
def test_any_bits_are_a_reading_or_refused(bits, pulses):
    if 25 <= pulses <= 27 and bits < 1 << pulses and f"{bits:0{pulses}b}"[24:] == "1" * (pulses - 24):
        counts, status = decode_reading(bits, pulses)
        assert counts % (1 << 24) == bits >> (pulses - 24)
        assert bool(status) == (abs(counts + 0.5) > 8_388_607)
    else:
        with pytest.raises(FrameError, match="check the chip's supply"):
            decode_reading(bits, pulses)


# Samples


def test_the_lines_are_asked_for_as_they_are_wired(monkeypatch, clock):
    asked = {}

    def request_lines(path, config, **named):
        asked.update(path=path, config=config)
        return Hx711Model(clock)

    monkeypatch.setattr(gpiod, "request_lines", request_lines)
    port = open_pair("gpio-pair:///dev/gpiochip4?data=5&clock=6", clock)
    assert port.look().high
    assert asked["path"] == "/dev/gpiochip4"
    assert asked["config"][DATA].direction is Direction.INPUT
    assert asked["config"][DATA].bias is Bias.PULL_UP
    assert asked["config"][CLOCK].direction is Direction.OUTPUT


@pytest.mark.parametrize(("rate", "seconds"), [(80, 10.0), (10, 30.0)])
@pytest.mark.parametrize("error", [-0.1, 0.0, 0.08, 0.17])
def test_every_conversion_is_a_row_with_its_number_whatever_the_oscillator(clock, rate, seconds, error):
    flight = Flight(clock, Hx711Config(sample_rate_hz=rate), rate=rate, rate_error=error)
    flight.fly(seconds)
    rows = flight.rows()
    assert codes(flight.batches) == ["started"]
    assert len(of(flight.batches, "gap")) == 0
    assert len(rows) > 0.95 * (seconds - 9.0 / rate) * rate * (1.0 + error)
    np.testing.assert_array_equal(flight.true_numbers(), rows["tick"])
    assert not (rows["status"] & AFTER_RESET).any()
    assert np.abs(np.diff(rows["host_ns"]) - 1e9 / rate / (1.0 + error)).max() <= 1.3e6
    assert set(flight.chip.gains) == {128}
    assert flight.chip.resets == 2  # its own, at power-up, and that of the start


def test_what_it_shows_before_it_has_settled_is_not_valid(clock):
    """Whether it shows such conversions its data sheet does not say."""
    flight = Flight(clock)
    flight.chip.shows_unsettled = True
    flight.fly(2.0)
    rows = flight.rows()
    unsettled = rows["value_raw"] == 0x155555
    assert unsettled.sum() == 7
    assert (rows["status"][unsettled] & NOT_VALID).all()
    assert ((rows["status"] & NOT_VALID) != 0).sum() <= 10


@pytest.mark.parametrize(("gain", "pulses"), [(64, 27), (32, 26)])
def test_input_and_gain_are_chosen_by_the_number_of_pulses(clock, gain, pulses):
    flight = Flight(clock, Hx711Config(amplifier=gain))
    flight.fly(2.0)
    assert flight.chip.gains[0] == 128
    assert set(flight.chip.gains[1:]) == {gain}
    rows = flight.rows()
    assert rows["status"][0] & NOT_VALID
    assert not rows["status"][-100:].any()
    assert not (rows["status"][2:] & AFTER_RESET).any()  # how many it hides while it settles is not sure


# Pulses that last too long


def reading_at(flight):
    """Number of the first call of the next reading, after a look; nothing is read meanwhile."""
    while flight.chip.word is None:
        flight.clock.advance(MS // 4)
        flight.chip.run()
    return flight.chip.calls + 1


@pytest.mark.parametrize("pulse", [0, 11, 24])
@pytest.mark.parametrize(("stall_us", "broken"), [(40, 0), (55, 1), (150, 1), (3000, 1)])
def test_a_reading_within_which_a_pulse_lasts_too_long_is_discarded_and_counted(clock, pulse, stall_us, broken):
    flight = Flight(clock)
    flight.fly(2.0)
    rows, first = len(flight.rows()), reading_at(flight)
    flight.chip.stall = lambda number: stall_us * US if number == first + 3 * pulse else 0
    flight.fly(2.0)
    assert flight.device.broken == broken
    assert codes(flight.batches) == ["started", "read_broken"][: 1 + broken]
    gaps = of(flight.batches, "gap")
    assert [gap["cause"] for gap in gaps] == [b"read_broken"] * broken
    missing = sum(int(gap["last_missing"] - gap["first_missing"]) + 1 for gap in gaps)
    assert (6 <= missing <= 10) == bool(broken)  # settles again
    assert len(flight.rows()) - rows == pytest.approx(2.0 * 80 - missing, abs=3)
    good = flight.rows()[flight.rows()["status"] == 0]
    assert (good["value_raw"] < 0x100000).all()  # none of what it read meanwhile
    assert flight.chip.resets == 2 + broken + (broken and stall_us > 60)


def test_a_reading_that_lasts_longer_than_half_a_conversion_is_discarded(flight):
    """Interrupted between two pulses: the clock line is low, and the chip does not mind, but may begin anew."""
    flight.fly(2.0)
    first = reading_at(flight)
    flight.chip.stall = lambda number: 7 * MS if number == first + 32 else 0  # after a pulse
    flight.fly(1.0)
    assert codes(flight.batches) == ["started", "read_broken"]
    assert "PD_SCK high for 4 us, 7" in texts(flight.batches, "read_broken")[0]
    flight.chip.stall = lambda number: 0
    first = reading_at(flight)
    flight.chip.stall = lambda number: 5 * MS if number == first + 32 else 0
    flight.fly(1.0)
    assert flight.device.broken == 1


def test_where_most_readings_are_broken_it_says_so_and_gives_no_wrong_row(flight):
    flight.fly(1.0)
    flight.chip.stall = lambda number: 80 * US if number % 50 == 0 else 0
    flight.fly(5.0)
    flight.batches += flight.device.stop(flight.clock())
    assert flight.device.broken > 40
    assert set(of(flight.batches, "gap")["cause"]) == {b"read_broken"}
    assert f"{flight.device.broken} of" in texts(flight.batches, "stopped")[0]
    assert (flight.rows()["value_raw"] < 0x100000).all()


# Lines and chip


def test_an_error_of_any_call_is_told_once_and_survived(clock):
    for later in range(80):  # every call of a reading, and the looks beside it
        code = (errno.ENODEV, errno.EBUSY, errno.EIO)[later % 3]
        flight = Flight(clock)
        flight.fly(0.3)
        first = flight.chip.calls + later
        flight.chip.fail = lambda number, first=first, code=code: code if first <= number < first + 3 else 0
        flight.fly(1.0)
        assert codes(flight.batches) == ["started", "bus_error", "bus_recovered"], later
        assert {gap["cause"] for gap in of(flight.batches, "gap")} <= {b"bus_error"}
        good = flight.rows()[flight.rows()["status"] & NOT_VALID == 0]
        assert (np.diff(good["value_raw"]) > 0).all()


def test_an_error_of_any_call_of_the_start_is_told_once_and_survived(clock):
    for place in range(5):
        flight = Flight.__new__(Flight)
        flight.clock, flight.chip = clock, Hx711Model(clock)
        flight.chip.fail = lambda number, place=place: errno.EBUSY if number == place else 0
        flight.device = Hx711(NAME, GpiodPair(flight.chip, DATA, CLOCK, clock))
        flight.batches = flight.device.start(clock())
        flight.fly(1.0)
        assert codes(flight.batches) == ["bus_error", "bus_recovered"], place
        assert "who else has the lines" in texts(flight.batches, "bus_error")[0]
        assert len(flight.rows()) > 50


@pytest.mark.parametrize(("level", "why"), [(True, "stays high"), (False, "is not high after 25 pulses")])
def test_a_line_that_nobody_drives_is_told_once_and_gives_no_rows(flight, level, why):
    flight.fly(30.0)
    before, flight.chip.held = len(flight.rows()), level
    flight.fly(10.0)
    assert len(flight.rows()) == before
    flight.chip.held = None
    flight.fly(3.0)
    assert codes(flight.batches) == ["started", "no_samples", "bus_recovered"]
    assert why in texts(flight.batches, "no_samples")[0]
    assert {gap["cause"] for gap in of(flight.batches, "gap")} == {b"no_samples"}
    rows = flight.rows()
    (first,) = np.flatnonzero(rows["status"] & AFTER_RESET)
    assert rows["status"][first] & NOT_VALID
    assert rows["sequence"][first] - rows["sequence"][first - 1] == pytest.approx(80 * 1.004 * 10, rel=0.12)


def test_a_chip_that_comes_late_is_taken_then(clock):
    flight = Flight(clock)
    flight.chip.held = True
    flight.fly(5.0)
    assert codes(flight.batches) == ["no_samples"]
    flight.chip.held = None
    flight.fly(2.0)
    assert codes(flight.batches) == ["no_samples", "bus_recovered"]
    assert flight.rows()["sequence"][0] == 0


@pytest.mark.parametrize("gain", [128, 64])
def test_a_brown_out_is_found_by_the_conversion_that_does_not_come(clock, gain):
    flight = Flight(clock, Hx711Config(amplifier=gain))
    flight.fly(5.0)
    flight.chip.reset()
    flight.fly(2.0)
    assert codes(flight.batches) == ["started", "brown_out"]
    gap = of(flight.batches, "gap")[-1 if gain == 128 else -2]
    assert gap["cause"] == b"brown_out"
    rows = flight.rows()[100:]
    (first,) = np.flatnonzero(rows["status"] & AFTER_RESET)[:1]
    assert rows["sequence"][first] == gap["last_missing"] + 1
    assert rows["status"][first] & NOT_VALID
    assert not rows["status"][-100:].any()
    assert set(flight.chip.gains[-100:]) == {gain}
    assert 6 <= gap["last_missing"] - gap["first_missing"] + 1 <= 9


def test_rows_and_gaps_add_up_through_stops_and_starts(clock, flight):
    flight.fly(1.0)
    flight.batches += flight.device.stop(clock())
    assert flight.chip.high  # asleep
    clock.advance(3_000 * MS)
    flight.batches += flight.device.start(clock())
    flight.fly(1.0)
    flight.chip.held = True
    flight.fly(1.0)
    flight.batches += flight.device.stop(clock())
    assert flight.device.stop(clock()) == []
    flight.rows()
    assert codes(flight.batches)[-1] == "stopped"
