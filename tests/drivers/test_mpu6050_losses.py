"""The MPU-6050 driver when samples are lost: every loss is counted, or named in a gap."""

import errno

import numpy as np
import pytest

from drivers.mpu6050 import Mpu6050Config
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.mpu6050_flight import NAME, Flight, numbers
from tests.drivers.mpu6050_model import MS


@pytest.fixture
def flight(clock):
    return Flight(clock)


@pytest.mark.parametrize(
    "late_ms", [75, *(pytest.param(one, marks=pytest.mark.campaign) for one in (100, 321)), 2000, 9876]
)  # between the others, as the period is
@pytest.mark.parametrize(
    "period_ns", [990_099.2, pytest.param(999_970.0, marks=pytest.mark.campaign), 1_000_000.0, 1_009_998.7]
)
def test_an_overflow_loses_exactly_what_the_gap_says(clock, late_ms, period_ns):
    flight = Flight(clock, period_ns=period_ns)
    flight.start()
    flight.fly(300)
    clock.advance(late_ms * MS)
    flight.fly(100)
    flight.stop()
    # 3 s of stream tell a period to 1 in 3000 where it beats with the polls: not enough for a gap of 10 s
    flight.check(tolerance=1 if late_ms > 3000 else 0)
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"fifo_overflow"
    lost = int(gap["last_missing"]) - int(gap["first_missing"]) + 1
    assert lost > 70
    assert gap["duration_ns"] == pytest.approx(lost * period_ns, rel=1e-3)
    assert codes(flight.batches).count("fifo_overflow") == 1


def test_overflows_on_a_slow_bus_with_a_late_host_are_counted_exactly(clock):
    flight = Flight(clock, byte_ns=22_500, period_ns=1_004_321.7)
    flight.start()
    flight.fly(100, jitter_ns=3 * MS)
    for late_ms in (80, 150, 400, 90, 1000):
        clock.advance(late_ms * MS)
        flight.fly(100, jitter_ns=3 * MS)
    flight.stop()
    flight.check()
    assert len(of(flight.batches, "gap")) == 5


def test_an_overflow_before_the_first_drain_is_counted_too(clock):
    flight = Flight(clock)
    flight.batches += flight.device.start(clock())
    for _ in range(2):
        clock.advance(100 * MS)
        flight.batches += flight.device.pump(clock())
    clock.advance(500 * MS)
    flight.fly(10)
    rows = whole(flight.batches, NAME)
    # the period is only known to be nominal here: 0.3 % of 500 samples
    assert abs(int(numbers(rows)[0]) - int(rows["tick"][0])) <= 2


def test_an_overflow_loses_no_less_than_the_fifo_held(clock):
    """A chip faster than it may be, and no stream yet to know it by: the clock alone would say 71 samples."""
    flight = Flight(clock, period_ns=950_000.0)
    flight.batches += flight.device.start(clock())
    for _ in range(2):
        clock.advance(100 * MS)
        flight.batches += flight.device.pump(clock())
    clock.advance(71 * MS)
    flight.batches += flight.device.pump(clock())
    (gap,) = of(flight.batches, "gap")
    assert (gap["first_missing"], gap["last_missing"]) == (0, 73)


def test_after_a_brown_out_losses_are_counted_by_the_new_phase(flight):
    flight.start()
    flight.fly(500)
    flight.chip.phase_ns += 600_000.0
    flight.chip.reset()
    flight.fly(400)
    before = whole(flight.batches, NAME)
    for _ in range(5):
        flight.clock.advance(100 * MS)
        flight.fly(60)
    flight.stop()
    after = whole(flight.batches, NAME)
    slip = int(before["tick"][-1]) - numbers(before)[-1]
    np.testing.assert_array_equal(after["tick"][len(before) :].astype(int) - numbers(after)[len(before) :], slip)
    assert of(flight.batches, "gap")["cause"].tolist() == [b"brown_out"] + [b"fifo_overflow"] * 5


@pytest.mark.parametrize("count", [b"\xff\xff", b"\x00\x05", b"\x03\xf8"], ids=bytes.hex)
def test_a_count_that_cannot_be_is_asked_for_again_and_loses_nothing(flight, count):
    flight.start()
    flight.fly(100)
    read = flight.chip.write_read
    floating = [True]

    def glitch(address, data, size):
        reply = read(address, data, size)
        return reply._replace(data=count) if data == b"\x72" and floating and floating.pop() else reply

    flight.chip.write_read = glitch
    flight.fly(100)
    flight.stop()
    assert codes(flight.batches).count("bus_error") == 1
    assert "invalid data" in texts(flight.batches, "bus_error")[0]
    assert len(flight.check()) == flight.chip.written


@pytest.mark.parametrize(
    "seed", [pytest.param(one, marks=pytest.mark.campaign if one > 2 else ()) for one in range(12)]
)  # other bytes
def test_garbage_for_a_while_loses_no_more_than_was_made_in_it(flight, seed):
    """Every byte read is random, the chip's WHO_AM_I and counts among them: it is believed no number of samples."""
    rng = np.random.default_rng(seed)
    flight.start()
    flight.fly(200)
    read, began_ns = flight.chip.write_read, flight.clock()

    def garbled(address, data, size):
        reply = read(address, data, size)
        is_over = flight.clock() - began_ns > 600 * MS
        return reply if is_over else reply._replace(data=rng.bytes(size))

    flight.chip.write_read = garbled
    flight.fly(400)
    flight.stop()
    rows = whole(flight.batches, NAME)
    before, after = rows[rows["host_ns"] < began_ns], rows[rows["host_ns"] > began_ns + 1_200 * MS]
    assert len(after) > 2_000
    np.testing.assert_array_equal(numbers(before), before["tick"])
    np.testing.assert_allclose(numbers(after), after["tick"], rtol=0, atol=1)


def test_a_fifo_just_short_of_full_is_drained_and_loses_nothing(clock):
    flight = Flight(clock, period_ns=1_000_000.0, phase_ns=500_000.0)
    flight.start()
    flight.fly(50)
    clock.advance(61 * MS)
    flight.fly(20)
    flight.stop()
    assert len(flight.check()) == flight.chip.written
    assert not len(of(flight.batches, "gap"))


def test_a_full_fifo_that_has_lost_nothing_yet_costs_what_it_held(clock):
    """73 packets, 1022 bytes: no room for another, and the oldest is still there."""
    flight = Flight(clock, period_ns=1_000_000.0, phase_ns=500_000.0)
    flight.start()
    flight.fly(50)
    clock.advance(73 * MS)
    flight.batches += flight.device.pump(clock())
    flight.fly(20)
    flight.stop()
    flight.check()
    (gap,) = of(flight.batches, "gap")
    assert int(gap["last_missing"]) - int(gap["first_missing"]) + 1 == 73


def test_an_overflow_while_draining_is_noticed(clock):
    """72 packets counted; while they are read at 100 kbit/s, the FIFO first runs over."""
    flight = Flight(clock, period_ns=1_000_000.0, phase_ns=500_000.0)
    flight.start()
    flight.fly(50)
    clock.advance(62 * MS)
    original = flight.chip.write_read

    def slow(address, data, count):
        if data == b"\x74":
            clock.advance(4 * MS)
        return original(address, data, count)

    flight.chip.write_read = slow
    made = flight.fly(1)
    flight.chip.write_read = original
    assert codes(made) == ["fifo_overflow"]
    flight.fly(50)
    flight.stop()
    flight.check()
    assert len(of(flight.batches, "gap")) == 1


@pytest.mark.parametrize("bytes_gone", range(1, 14))
def test_a_slipped_fifo_is_reset_before_it_lies(flight, bytes_gone):
    flight.start()
    flight.fly(100)
    flight.clock.advance(5 * MS)
    flight.chip.sample()
    del flight.chip.fifo[:bytes_gone]
    made = flight.fly(3)
    assert "misaligned" in codes(made)
    flight.fly(100)
    flight.stop()
    flight.check()
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"misaligned"


def test_a_temperature_that_jumps_ends_the_trust_in_that_burst(flight):
    flight.start()
    flight.fly(100)
    flight.chip.words = lambda number: (*(number & 0x3FFF, number >> 14, 100), -3000, *(-200, 300, 5))
    assert codes(flight.fly(1)) == ["misaligned"]
    flight.fly(100)  # it stays so: now it is the temperature
    flight.stop()
    flight.check()
    assert len(of(flight.batches, "gap")) == 1


@pytest.mark.parametrize("code", [errno.EREMOTEIO, errno.ENXIO])
def test_a_fifo_read_not_acknowledged_is_tried_again_and_loses_nothing(flight, code):
    flight.start()
    flight.chip.fail = lambda number: code if number % 7 == 0 else 0
    flight.fly(300)
    flight.chip.fail = lambda number: 0
    flight.stop()
    assert len(flight.check()) == flight.chip.written
    assert not len(of(flight.batches, "gap"))
    assert flight.device.bus_errors > 50


@pytest.mark.parametrize("popped", [0, 5, 14, 70, 126, 140])
@pytest.mark.parametrize("code", [errno.EIO, errno.ETIMEDOUT])
def test_a_fifo_read_that_breaks_off_is_accounted_for(flight, code, popped):
    flight.start()
    flight.fly(100)
    flight.chip.pops_before_failure = popped
    transfers = flight.chip.transfers
    flight.chip.fail = lambda number: code if transfers[number][:2] == ("read", 0x74) else 0
    made = flight.fly(1)
    flight.chip.fail = lambda number: 0
    assert codes(made) == ["bus_error"]
    flight.fly(100)
    flight.stop()
    flight.check()
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"bus_error"


def test_what_was_read_before_the_bus_died_is_kept(clock):
    flight = Flight(clock, Mpu6050Config(max_transfer_bytes=28))
    flight.start()
    flight.fly(50)
    transfers = flight.chip.transfers
    begun = len(transfers)
    flight.chip.fail = lambda number: errno.EREMOTEIO if number >= begun + 4 else 0
    made = flight.fly(1)
    assert len(of(made, NAME)) == 6  # three transfers of two packets
    assert codes(made) == ["bus_error"]
    flight.fly(1)
    flight.chip.fail = lambda number: 0
    flight.fly(50)
    flight.stop()
    assert len(flight.check()) == flight.chip.written
    assert not len(of(flight.batches, "gap"))


@pytest.mark.parametrize("outage_ms", [30, 200, 5000])
def test_a_bus_away_in_flight_is_told_once_and_what_it_cost_is_a_gap(flight, outage_ms):
    flight.start()
    flight.fly(200)
    flight.chip.fail = lambda number: errno.EREMOTEIO
    flight.fly(outage_ms // 10)
    flight.chip.fail = lambda number: 0
    flight.fly(300)
    told = codes(flight.batches)
    assert told.count("bus_error") == told.count("bus_recovered") == 1
    expected = [] if outage_ms == 30 else [b"bus_error"]
    assert [row["cause"] for row in of(flight.batches, "gap")] == expected
    if outage_ms == 30:
        assert len(flight.check()) == flight.chip.written - len(flight.chip.fifo) // 14
    flight.clock.advance(500 * MS)
    flight.fly(10)
    flight.stop()
    flight.check()
    assert [row["cause"] for row in of(flight.batches, "gap")] == [*expected, b"fifo_overflow"], "not the bus of before"


def test_a_stop_while_the_bus_is_away_names_what_is_missing(flight):
    flight.start()
    flight.fly(100)
    flight.chip.fail = lambda number: errno.EREMOTEIO
    flight.fly(100)
    flight.stop()
    flight.chip.sample()
    rows = whole(flight.batches, NAME)
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"bus_error"
    assert abs(int(gap["last_missing"]) + 1 - flight.chip.written) <= 1
    assert gap["first_missing"] == len(rows)


@pytest.mark.parametrize(
    "place", [pytest.param(one, marks=pytest.mark.campaign if one % 3 else ()) for one in range(40)]
)  # places between those of the others
def test_an_error_at_any_transaction_of_a_recovery_leaves_the_count_whole(clock, place):
    """An overflow, and while it is mended the bus dies at transaction ``place`` for a while."""
    flight = Flight(clock)
    flight.start()
    flight.fly(200)
    clock.advance(200 * MS)
    begun = len(flight.chip.transfers)
    flight.chip.fail = lambda number: errno.EREMOTEIO if begun + place <= number < begun + place + 3 else 0
    flight.fly(300)
    flight.stop()
    rows = whole(flight.batches, NAME)
    assert numbers(rows)[-1] - int(rows["tick"][-1]) in {-1, 0, 1}
    assert numbers(rows)[0] == 0


@pytest.mark.parametrize("place", range(6))
def test_a_stop_whose_transactions_fail_names_what_it_could_not_take(flight, place):
    """FIFO_EN off, count, burst, status, FIFO_EN off, count: dead from one of them on."""
    flight.start()
    flight.fly(100)
    flight.clock.advance(9 * MS)
    begun = len(flight.chip.transfers)
    flight.chip.fail = lambda number: errno.EREMOTEIO if number >= begun + place else 0
    flight.stop()
    rows = whole(flight.batches, NAME)
    assert codes(flight.batches)[-2:] == ["bus_error", "stopped"]
    assert int(rows["tick"][-1]) == flight.chip.written - (1 if place > 2 else 10)
