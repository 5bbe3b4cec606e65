"""What holds of every chip on I2C or SPI: faults of its bus at any transaction, stuck registers, other chips."""

import errno
from collections.abc import Callable
from typing import NamedTuple

import pytest

from drivers.records import SampleStatus
from tests.drivers import (
    test_as5048,
    test_as5600,
    test_bmi088,
    test_bmi088_spi,
    test_hx711,
    test_icm20948,
    test_nau7802,
)
from tests.drivers.batches import codes, of, texts
from tests.drivers.chip_flight import MS, ChipFlight
from tests.drivers.i2c_model import Chip


class Sensor(NamedTuple):
    """A chip and its driver.

    Attributes:
        model: Makes the chip, of a clock.
        fly: Its driver on it, started.
        where: It is named so where it does not answer.
        stuck: Registers that the driver reads back, and what they hold for good.
        other: What another chip shows, and what is said of it.
        readings: Transfers of readings that the laws of transfers hold of; of a FIFO they are others.
    """

    model: Callable[..., Chip]
    fly: Callable[..., ChipFlight]
    where: str
    stuck: dict[int, int]
    other: list[tuple[dict[int, int], str]]
    readings: int = 4


SENSORS = {
    "as5048a": Sensor(
        test_as5048.As5048aModel,
        lambda clock, chip: test_as5048.flown(clock, "A", chip=chip),
        "SPI does not answer",
        {},
        [({0xFB: 0x11}, "check bus and address"), ({0xFB: 0}, "one that does not start")],
    ),
    "as5048b": Sensor(
        test_as5048.As5048bModel,
        lambda clock, chip: test_as5048.flown(clock, "B", chip=chip),
        "I2C 0x40 does not answer",
        {},
        [({0xFB: 0x11}, "check bus and address"), ({0xFB: 0}, "one that does not start")],
    ),
    "as5600": Sensor(
        test_as5600.As5600Model,
        lambda clock, chip: test_as5600.Flight(clock, chip=chip),
        "I2C 0x36 does not answer",
        {0x07: 0x09, 0x08: 0x09},
        # a MAX17048, a fuel gauge, answers at 36h too
        [({0x0B: 0x01}, "check bus and address"), ({0x0C: 0x40}, "check bus and address")],
    ),
    "bmi088": Sensor(
        test_bmi088.Bmi088Model,
        lambda clock, chip: test_bmi088.Flight(clock, chip=chip),
        "does not answer",
        {0x41: 0x03},
        [({0x00: 0x68}, "accelerometer"), ({test_bmi088.GYRO: 0x68}, "gyroscope")],
    ),
    "bmi088_spi": Sensor(
        test_bmi088_spi.Bmi088SpiModel,
        test_bmi088_spi.Flight,
        "SPI does not answer",
        {},
        [({0x00: 0x68}, "accelerometer on SPI"), ({test_bmi088.GYRO: 0x68}, "gyroscope on SPI")],
    ),
    "icm20948": Sensor(
        test_icm20948.Icm20948Model,
        lambda clock, chip: test_icm20948.Flight(clock, chip=chip),
        "I2C 0x69 does not answer",
        {0x007: 0x2A, 0x201: 0x2A, 0x211: 0x2A, 0x252: 0x2A},
        [({0x000: 0x71}, "WHO_AM_I 0x71")],
        readings=0,
    ),
    "nau7802": Sensor(
        test_nau7802.Nau7802Model,
        lambda clock, chip: test_nau7802.Flight(clock, chip=chip),
        "I2C 0x2a does not answer",
        {0x00: 0x49, 0x01: 0x49, 0x02: 0x49, 0x1C: 0x49},
        [({0x1F: 0x42}, "revision 0x42")],
    ),
}
EACH = pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)


def first_transfers(sensor, clock):
    """Number of those of the set-up, and of the first readings."""
    return sensor.fly(clock, sensor.model(clock)).set_up_transfers() + sensor.readings


@EACH
@pytest.mark.parametrize("odd", [0, pytest.param(1, marks=pytest.mark.campaign)])  # the other error at each place
def test_one_failed_transaction_at_any_place_is_tried_again(clock, sensor, odd):
    for place in range(first_transfers(sensor, clock)):
        chip, code = sensor.model(clock), (errno.EREMOTEIO, errno.EIO)[(place + odd) % 2]
        chip.fail = lambda number, place=place, code=code: code if number == place else 0
        flight = sensor.fly(clock, chip)
        flight.fly(0.6)
        assert codes(flight.batches) == ["started"], place
        assert flight.device.bus_errors == 1
        assert len(of(flight.batches, "gap")) == 0
        assert len(flight.rows()) > 10


@EACH
@pytest.mark.parametrize("every", [8, pytest.param(4, marks=pytest.mark.campaign)])  # places between those of the other
@pytest.mark.parametrize(
    ("first", "code", "remedy"),
    [
        (0, errno.EREMOTEIO, "check its power"),
        (1, errno.EIO, "check the bus"),
        (2, errno.ETIMEDOUT, "power-cycle it"),
        (3, errno.ENODEV, "plug it in"),
    ],
)
def test_a_bus_that_dies_at_any_transaction_is_told_once_and_survived(clock, sensor, first, code, remedy, every):
    for place in range(first, first_transfers(sensor, clock), every):
        chip, dead = sensor.model(clock), {"until": 1 << 30}
        chip.fail = lambda number, place=place, dead=dead: code if place <= number < dead["until"] else 0
        flight = sensor.fly(clock, chip)
        flight.fly(3.0)
        (told,) = [one for one in codes(flight.batches) if one != "started"]
        assert told in ("no_answer", "bus_error"), place
        assert sensor.where in texts(flight.batches, told)[0]
        assert remedy in texts(flight.batches, told)[0]
        flew, dead["until"] = len(of(flight.batches, flight.device.name)), 0
        flight.fly(2.0)
        assert codes(flight.batches)[-1] in ("started", "bus_recovered")
        assert len(flight.rows()) > 80
        if flew:
            (gap,) = [one for one in of(flight.batches, "gap") if one["cause"] == b"bus_error"]
            seconds = 1e-9 * gap["duration_ns"]
            assert seconds == pytest.approx(3.3, abs=0.6)  # and the back-off


@pytest.mark.parametrize("kind", ["icm20948", "nau7802"])
@pytest.mark.parametrize(
    ("parity", "code"),
    [
        (0, errno.EIO),
        (1, errno.EREMOTEIO),
        *(pytest.param(*one, marks=pytest.mark.campaign) for one in ((0, errno.ETIMEDOUT), (1, errno.ENODEV))),
    ],
)  # further errors of the bus: in the set-up, above
def test_a_bus_error_at_any_transaction_in_flight_is_told_once_and_costs_no_count(clock, kind, parity, code):
    sensor = SENSORS[kind]
    for later in range(parity, 12, 2):
        flight = sensor.fly(clock, sensor.model(clock))
        flight.fly(4.0 if kind == "icm20948" else 1.0)
        first = len(flight.chip.transfers) + later
        flight.chip.fail = lambda number, first=first: code if first <= number < first + 5 else 0
        flight.fly(1.0)
        said = [one for one in codes(flight.batches) if one != "fifo_overflow"]
        assert said == ["started", "bus_error", "bus_recovered"], later
        assert flight.worst() <= (1 if kind == "icm20948" else 0)


@pytest.mark.parametrize(
    ("kind", "register", "value"),
    [
        *(("icm20948", *one) for one in ((0x006, 0x41), (0x201, 0x13), (0x214, 0x01), (0x252, 0), (0x067, 1))),
        *(("nau7802", *one) for one in ((0x01, 0x2E), (0x02, 0x70), (0x03, 0x00), (0x07, 0x40), (0x1C, 0x00))),
        ("bmi088", test_bmi088.GYRO | 0x0F, 0x01),
    ],
)
def test_a_flipped_bit_is_found_within_a_second(clock, kind, register, value):
    sensor = SENSORS[kind]
    flight = sensor.fly(clock, sensor.model(clock))
    flight.fly(2.0)
    flight.chip.registers[register] = value
    flight.fly(2.5)
    assert codes(flight.batches)[1:] in (["configuration_lost", "started"], ["brown_out", "started"])
    assert flight.chip.registers[register] != value


@EACH
def test_a_chip_that_comes_late_is_taken_then(clock, sensor):
    chip = sensor.model(clock)
    chip.fail = lambda number: errno.ENXIO
    flight = sensor.fly(clock, chip)
    flight.fly(5.0)
    assert codes(flight.batches) == ["no_answer"]
    chip.fail = lambda number: 0
    flight.fly(2.0)
    assert codes(flight.batches) == ["no_answer", "bus_recovered", "started"]
    assert flight.rows()["sequence"][0] == 0


@pytest.mark.parametrize(
    ("sensor", "shows", "said"), [(one, *other) for one in SENSORS.values() for other in one.other]
)
def test_another_chip_is_named(clock, sensor, shows, said):
    chip = sensor.model(clock)
    chip.stuck |= shows
    flight = sensor.fly(clock, chip)
    flight.fly(2.0)
    assert codes(flight.batches) == ["wrong_device"]
    assert said in texts(flight.batches, "wrong_device")[0]


@pytest.mark.parametrize(("sensor", "register"), [(one, place) for one in SENSORS.values() for place in one.stuck])
def test_a_register_that_is_stuck_is_told_and_gives_no_rows(clock, sensor, register):
    chip = sensor.model(clock)
    chip.stuck[register] = sensor.stuck[register]
    flight = sensor.fly(clock, chip)
    flight.fly(3.0)
    assert codes(flight.batches) == ["configuration"]
    assert len(of(flight.batches, flight.device.name)) == 0


@EACH
def test_rows_and_gaps_add_up_through_stops_and_starts(clock, sensor):
    chip = sensor.model(clock)
    flight = sensor.fly(clock, chip)
    flight.fly(1.0)
    flight.batches += flight.device.stop(clock())
    clock.advance(3_000 * MS)
    flight.batches += flight.device.start(clock())
    flight.fly(1.0)
    chip.fail = lambda number: errno.ENXIO
    flight.fly(1.0)
    flight.batches += flight.device.stop(clock())
    assert len(flight.rows()) > 80
    assert codes(flight.batches)[-1] == "stopped"


@pytest.mark.parametrize(
    ("flight_of", "asleep"),
    [
        (test_bmi088.Flight, lambda chip: chip.transfers[-1] == ("write", 0, 0x7D, 0x00)),
        (test_icm20948.Flight, lambda chip: chip.registers[0x006] == 0x41 and not chip.fifo),
        (test_nau7802.Flight, lambda chip: chip.registers[0] & 0x06 == 0),
        (test_hx711.Flight, lambda chip: chip.high),
    ],
    ids=["bmi088", "icm20948", "nau7802", "hx711"],
)
def test_it_is_put_to_rest_in_the_end(clock, flight_of, asleep):
    flight = flight_of(clock)
    flight.fly(1.0)
    flight.batches += flight.device.stop(clock())
    assert asleep(flight.chip)
    assert codes(flight.batches) == ["started", "stopped"]


@pytest.mark.parametrize(
    ("flight_of", "hz", "known_s", "also"),
    [(test_icm20948.Flight, 562.5, 20.0, ["fifo_overflow"]), (test_nau7802.Flight, 80 / 1.004, 30.0, [])],
    ids=["icm20948", "nau7802"],
)
def test_unplugged_for_ten_seconds_it_goes_on_with_the_number_that_is_due(clock, flight_of, hz, known_s, also):
    flight = flight_of(clock)
    flight.fly(known_s)
    flight.chip.fail = lambda number: errno.ENXIO
    flight.fly(10.0)
    flight.chip.fail = lambda number: 0
    flight.fly(4.0)
    assert codes(flight.batches) == ["started", "bus_error", "bus_recovered", *also]
    assert flight.worst() <= 1 + len(also)
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"bus_error"
    assert gap["last_missing"] - gap["first_missing"] == pytest.approx(10 * hz, abs=1.1 * hz)  # and the back-off


@pytest.mark.parametrize(
    ("flight_of", "runs", "rows"),
    [(test_icm20948.Flight, "runs", 1500), (test_nau7802.Flight, "converts", 200)],
    ids=["icm20948", "nau7802"],
)
def test_a_chip_that_stops_sampling_is_reset(clock, flight_of, runs, rows):
    flight = flight_of(clock)
    flight.fly(2.0)
    setattr(flight.chip, runs, False)
    flight.fly(1.0)
    assert codes(flight.batches)[1] == "no_samples"
    setattr(flight.chip, runs, True)
    flight.fly(2.0)
    assert len(flight.rows()) > rows


CONVERTERS = pytest.mark.parametrize("flight_of", [test_nau7802.Flight, test_hx711.Flight], ids=["nau7802", "hx711"])


@pytest.mark.parametrize("rail", [0x7FFFFF, -0x800000])
@CONVERTERS
def test_a_sample_at_the_rail_is_saturated(clock, flight_of, rail):
    flight = flight_of(clock)
    flight.chip.values = lambda number: rail if number > 30 else number
    flight.fly(1.5)
    rows = flight.rows()[-10:]
    assert set(rows["status"]) == {SampleStatus.SATURATED}
    assert set(rows["value_raw"]) == {rail}


@CONVERTERS
def test_late_polls_lose_what_they_lose_and_count_it(clock, rng, flight_of):
    flight = flight_of(clock)
    flight.fly(2.0)
    for _ in range(40):
        clock.advance(int(rng.uniform(1.0, 90.0) * MS))
        flight.fly(0.2)
    gaps = of(flight.batches, "gap")
    assert len(gaps) > 10
    assert set(gaps["cause"]) == {b"missed"}
    assert flight.worst() == 0


@pytest.mark.parametrize(
    ("flight_of", "calls", "most"),
    [
        (test_nau7802.Flight, lambda chip: len(chip.transfers), 6.0),
        (test_hx711.Flight, lambda chip: chip.calls, 75 + 8),
    ],
    ids=["nau7802", "hx711"],
)
def test_it_looks_when_a_conversion_is_due_and_hardly_before(clock, flight_of, calls, most):
    flight = flight_of(clock)
    flight.fly(1.0)
    before, rows = calls(flight.chip), len(flight.rows())
    flight.fly(4.0)
    assert (calls(flight.chip) - before) / (len(flight.rows()) - rows) < most
