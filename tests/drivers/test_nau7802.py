"""NAU7802: decoder, count of conversions, and the driver against a chip typed from the data sheet."""

import errno

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.conversions import ConversionCount
from drivers.errors import FrameError
from drivers.i2c.nau7802 import OSCILLATOR, Nau7802, Nau7802Config, decode_sample
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts
from tests.drivers.chip_flight import ConverterFlight
from tests.drivers.i2c_model import Nau7802Model

NAME = "cell"
SATURATED, NOT_VALID, AFTER_RESET = map(int, (SampleStatus.SATURATED, SampleStatus.NOT_VALID, SampleStatus.AFTER_RESET))


class Flight(ConverterFlight):
    def __init__(self, clock, config=None, chip=None, **options):
        model = chip or Nau7802Model(clock, **options)
        super().__init__(clock, model, Nau7802(NAME, model, config))


@pytest.fixture
def flight(clock):
    return Flight(clock)


# The decoder


@pytest.mark.parametrize(
    ("data", "counts", "status"),
    [
        ("000000", 0, 0),
        ("000001", 1, 0),
        ("ffffff", -1, 0),
        ("123456", 0x123456, 0),
        ("7ffffe", 8_388_606, 0),
        ("7fffff", 8_388_607, SATURATED),
        ("800000", -8_388_608, SATURATED),
        ("800001", -8_388_607, 0),
    ],
)
def test_samples_of_the_data_sheets_coding(data, counts, status):
    assert decode_sample(bytes.fromhex(data)) == (counts, status)


@pytest.mark.parametrize(
    ("offset", "ends"),
    [("003713", (-8_388_608, 8_388_607 - 0x3713)), ("803713", (-8_388_608 + 0x3713, 8_388_607))],
)
def test_the_ends_of_the_range_are_off_by_what_calibration_takes_off(offset, ends):
    lowest, highest = ends
    for counts, status in ((lowest, SATURATED), (lowest + 1, 0), (highest - 1, 0), (highest, SATURATED)):
        assert decode_sample(counts.to_bytes(3, "big", signed=True), bytes.fromhex(offset)) == (counts, status)


@given(st.binary(max_size=8))
def test_any_bytes_are_a_sample_or_refused(data):
    if len(data) == 3:
        counts, status = decode_sample(data)
        assert counts.to_bytes(3, "big", signed=True) == data
        assert bool(status) == (abs(counts + 0.5) > 8_388_607)
    else:
        with pytest.raises(FrameError, match="three"):
            decode_sample(data)


# The count


@given(st.floats(-0.03, 0.03), st.floats(0.05, 0.45), st.integers(0, 2**32))
def test_the_count_is_right_whatever_the_phase(error, width, seed):
    """Looks of a given width, a gap of ten: no number is wrong without being said to be unsure."""
    rng, period = np.random.default_rng(seed), 12.5e6
    count = ConversionCount(period, OSCILLATOR)
    true = [period * (1.0 + error) * n for n in [*range(1, 100), *range(110, 140)]]
    numbers, surely = [], []
    for end in true:
        late = rng.uniform(0.0, width * period)
        _, sure = count.seen(round(end + late - width * period), round(end + late))  # None: of late looks only
        numbers.append(count.number)
        surely.append(sure)
    assert numbers[:99] == list(range(99))
    assert all(surely[:99])
    assert numbers[99] - 98 == 11 or not surely[99]
    assert np.diff(numbers[99:]).tolist() == [1] * 29


def looks(rng, ends, of_others):
    """Times of two looks one after the other, the second of which found a conversion, and its number from 0.

    Looks come every millisecond; every ten another device of the bus is read, which takes ``of_others`` ms.
    """
    now = before = following = 0.0
    found = -1
    while now < ends[-2]:
        if now >= following:
            now += 1e6 * rng.uniform(*of_others)
            following = max(following + 10e6, now)
        latest = int(np.searchsorted(ends, now, "right")) - 1
        if latest > found:
            found = latest
            yield round(before), round(now), latest
        before, now = now, now + 1e6 * rng.uniform(0.8, 1.5)


@pytest.mark.parametrize("drift_s", [0.0, -5e-6, 5e-6])
def test_a_bus_that_others_keep_busy_costs_few_rows_and_no_number(rng, drift_s):
    """An oscillator that drifts; drains of 5 to 8 ms now and then hide when a conversion of 12.5 ms ended."""
    steps = np.arange(8000)
    ends = 3e6 + 12.53e6 * (steps + 0.5 * drift_s * 12.53e-3 * steps**2)
    count, dropped, off = ConversionCount(12.5e6, OSCILLATOR), 0, set()
    for before, now, number in looks(rng, ends, (5.0, 8.0)):
        if count.seen(before, now) is None:
            dropped += 1
        else:
            off.add(number - count.number)
    assert len(off) == 1
    assert dropped < 0.02 * len(ends)


@pytest.mark.parametrize(("lost", "sure"), [(3000, True), (6000, False)])
def test_how_many_conversions_an_outage_may_hide_is_what_its_oscillator_drifts_by(rng, lost, sure):
    """The fit of 500 to 1000 conversions is good for 5e-6/s of its 6 to 12 s: a quarter of a conversion in 4000."""
    count, ends = ConversionCount(12.5e6, OSCILLATOR), 3e6 + 12.53e6 * np.arange(3001)
    for before, now, _ in looks(rng, ends, (0.0, 1.0)):
        count.seen(before, now)
    end_ns = round(ends[-1] + 12.53e6 * lost)
    found = count.seen(end_ns - 500_000, end_ns + 500_000)
    assert found is not None
    assert found[1] == sure


# Set-up


def test_the_set_up_is_these_transactions(flight):
    flight.fly(0.45)
    assert codes(flight.batches) == ["started"]
    wrote = [data for kind, *data in flight.chip.transfers if kind == "write"]
    assert wrote == [
        [0x00, 0x01],
        [0x00, 0x02],
        [0x01, 0x2F],  # 3.0 V, gain 128
        [0x02, 0x30],  # 80 a second
        [0x1C, 0x80],
        [0x15, 0x30],
        [0x00, 0x86],
        [0x02, 0x34],
        [0x00, 0x96],
    ]


@pytest.mark.parametrize(("rate", "code"), [(10, 0x00), (20, 0x10), (40, 0x20), (80, 0x30), (320, 0x70)])
@pytest.mark.parametrize(("gain", "supply", "control"), [(1, 4.5, 0x00), (2, 2.4, 0x39), (64, 0.0, 0x06)])
def test_rate_gain_and_supply_are_in_the_registers(clock, rate, code, gain, supply, control):
    flight = Flight(clock, Nau7802Config(sample_rate_hz=rate, amplifier=gain, supply_V=supply))
    flight.fly(2.0)
    assert flight.chip.registers[2] == code
    assert flight.chip.registers[1] == control
    assert bool(flight.chip.registers[0] & 0x80) == bool(supply)
    assert len(flight.rows()) > rate
    np.testing.assert_array_equal(flight.true_numbers(), flight.rows()["tick"])


def test_a_calibration_that_fails_is_told(flight):
    flight.chip.calibrates = False
    flight.fly(1.0)
    assert codes(flight.batches) == ["configuration"]
    assert "offset calibration fails" in texts(flight.batches, "configuration")[0]
    flight.chip.calibrates = True
    flight.fly(2.0)
    assert codes(flight.batches)[-1] == "started"


# Samples


@pytest.mark.parametrize("error", [-0.02, 0.0, 1e-6, 0.013])
def test_every_conversion_is_a_row_with_its_number(clock, error):
    flight = Flight(clock, rate_error=error)
    flight.fly(10.0)
    rows = flight.rows()
    assert len(of(flight.batches, "gap")) == 0
    np.testing.assert_array_equal(flight.true_numbers(), rows["tick"])
    assert rows["status"].tolist() == [NOT_VALID] * 4 + [0] * (len(rows) - 4)
    spacing = np.diff(rows["host_ns"])
    assert np.abs(spacing - 12.5e6 * (1.0 + error)).max() <= 1e6


def test_a_brown_out_is_found_and_the_zero_is_put_back(flight):
    flight.fly(2.0)
    calibrated = [flight.chip.registers[place] for place in (3, 4, 5)]
    assert calibrated == [0x80, 0x01, 0x23]
    flight.chip.reset()
    flight.fly(2.0)
    assert codes(flight.batches) == ["started", "brown_out", "started"]
    assert [flight.chip.registers[place] for place in (3, 4, 5)] == calibrated
    assert sum(data == [2, 0x34] for kind, *data in flight.chip.transfers if kind == "write") == 1  # one calibration
    rows = flight.rows()
    assert (rows["status"] & AFTER_RESET != 0).sum() == 1
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"brown_out"
    due = 4.0 - 0.35
    assert len(rows) + gap["last_missing"] - gap["first_missing"] + 1 == pytest.approx(80 * due, abs=8)


def test_a_data_ready_bit_that_hangs_makes_no_rows_of_nothing(flight):
    flight.fly(2.0)
    before = len(flight.rows())
    flight.chip.stuck[0] = 0x86 | 0x08 | 0x20
    flight.fly(2.0)
    assert "no_samples" in codes(flight.batches)
    assert len(flight.rows()) - before < 2.2 * 80
    del flight.chip.stuck[0]
    flight.fly(2.0)
    assert codes(flight.batches)[-1] == "started"


def test_an_outage_longer_than_the_period_is_known_for_begins_its_clock_anew(flight):
    """3 % of 400 conversions are 12: the number that follows is a guess, and said to be one."""
    flight.fly(0.45)
    flight.chip.fail = lambda number: errno.ENXIO
    flight.fly(5.0)
    flight.chip.fail = lambda number: 0
    flight.fly(2.0)
    rows = flight.rows()
    after = np.flatnonzero(np.diff(rows["sequence"].astype(int)) > 1) + 1
    assert rows["status"][after].tolist() == [AFTER_RESET]
    assert (rows["status"] & AFTER_RESET != 0).sum() == 1
