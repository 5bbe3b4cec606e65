"""The MPU-6050 driver against a chip typed from the data sheet: every fault, and nothing lost in silence."""

import errno

import numpy as np
import pytest

from drivers.errors import NoAnswerError, WrongDeviceError
from drivers.mpu6050 import Mpu6050, Mpu6050Config
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.mpu6050_model import MS, Mpu6050Model, ScriptedI2c

NAME = "imu_base"


def numbers(rows: np.ndarray) -> np.ndarray:
    """The sample numbers that the model wrote into the rows."""
    return rows["accel_raw"][:, 0].astype(int) | rows["accel_raw"][:, 1].astype(int) << 14


class Flight:
    """A chip, its driver, and all batches so far, stepped on a grid of polls."""

    def __init__(self, clock, config=None, **chip) -> None:
        self.clock = clock
        self.chip = Mpu6050Model(clock, **chip)
        self.device = Mpu6050(NAME, self.chip, config)
        self.batches = []
        self.rng = np.random.default_rng(5)

    def start(self):
        self.batches += self.device.start(self.clock())
        return self.fly(30)

    def fly(self, polls, period_ns=10 * MS, jitter_ns=0):
        """Poll on a grid, each poll late by up to ``jitter_ns``."""
        made = []
        for _ in range(polls):
            late = int(self.rng.integers(0, jitter_ns + 1))
            due = self.clock.now_ns // period_ns * period_ns + period_ns
            self.clock.advance(due + late - self.clock.now_ns)
            made += self.device.pump(self.clock())
        self.batches += made
        return made

    def stop(self):
        self.batches += self.device.stop(self.clock())

    def check(self, tolerance=0):
        """Sequence and gaps add up; tick is the chip's own number of the sample; returns the rows."""
        rows = whole(self.batches, NAME)
        assert len(rows) > 0
        np.testing.assert_array_equal(rows["tick"], rows["sequence"])
        np.testing.assert_allclose(numbers(rows), rows["tick"], rtol=0, atol=tolerance)
        return rows


@pytest.fixture
def flight(clock):
    return Flight(clock)


# Setting up


SETTINGS = [  # register, value for 4 g, 250 deg/s, DLPF 2, 1 kHz
    (0x6B, 0x01),
    (0x6C, 0x00),
    (0x19, 0x00),
    (0x1A, 0x0A),
    (0x1B, 0x00),
    (0x1C, 0x08),
    (0x37, 0x00),
    (0x38, 0x10),
]
FIFO_START = [
    (b"\x23\x00", b""),
    (b"\x6a\x00", b""),
    (b"\x6a\x04", b""),
    (b"\x6a\x40", b""),
    (b"\x3a", b"\x00"),
    (b"\x23\xf8", b""),
    (b"\x72", b"\x00\x00"),
]
SET_UP = [
    (b"\x75", b"\x68"),
    (b"\x6b\x80", b""),
    (b"\x6b", b"\x40"),
    (b"\x6b\x01", b""),
    *((bytes(pair), b"") for pair in SETTINGS),
    *((bytes(pair[:1]), bytes(pair[1:])) for pair in SETTINGS),
    *FIFO_START,
]


def set_up(device, clock):
    batches = device.start(clock())
    for _ in range(2):
        clock.advance(99 * MS)
        assert not device.pump(clock())  # not before its time
        clock.advance(1 * MS)
        batches += device.pump(clock())
    return batches


def test_set_up_and_a_drain_are_these_transactions(clock):
    packet = bytes.fromhex("0001 0002 0003 F0B0 0004 0005 0006")
    script = [*SET_UP, (b"\x72", b"\x00\x1c"), (b"\x74", packet * 2), (b"\x3a", b"\x01")]
    bus = ScriptedI2c(clock, script)
    device = Mpu6050(NAME, bus)
    assert codes(set_up(device, clock)) == ["started"]
    counted_ns = clock.advance(10 * MS)
    rows = of(device.pump(clock()), NAME)
    bus.done()
    assert rows["tick"].tolist() == [0, 1]
    assert rows["host_ns"].tolist() == [counted_ns] * 2
    assert rows["gyro_raw"].tolist() == [[4, 5, 6]] * 2


@pytest.mark.parametrize("rate", [1000, 500, 200, 100, 50])
@pytest.mark.parametrize("accel", [2, 4, 8, 16])
@pytest.mark.parametrize("gyro", [250, 500, 1000, 2000])
@pytest.mark.parametrize("filter_code", [0, 1, 6])
def test_every_range_rate_and_filter_is_in_the_registers(clock, rate, accel, gyro, filter_code):
    config = Mpu6050Config(sample_rate_hz=rate, accel_range_g=accel, gyro_range_deg_s=gyro, filter_code=filter_code)
    flight = Flight(clock, config)
    flight.start()
    registers = flight.chip.registers
    assert registers[0x1C] == {2: 0x00, 4: 0x08, 8: 0x10, 16: 0x18}[accel]
    assert registers[0x1B] == {250: 0x00, 500: 0x08, 1000: 0x10, 2000: 0x18}[gyro]
    assert registers[0x1A] == 0x08 | filter_code
    assert (8000 if filter_code == 0 else 1000) / (registers[0x19] + 1) == rate


@pytest.mark.parametrize("place", range(len(SET_UP)))
@pytest.mark.parametrize("code", [errno.EREMOTEIO, errno.EIO])
def test_one_failed_transaction_of_the_set_up_is_tried_again(clock, place, code):
    script = [*SET_UP[:place], (SET_UP[place][0], code), *SET_UP[place:]]
    bus = ScriptedI2c(clock, script)
    device = Mpu6050(NAME, bus)
    assert codes(set_up(device, clock)) == ["started"]
    bus.done()
    assert device.bus_errors == 1


@pytest.mark.parametrize("place", range(len(SET_UP)))
def test_a_bus_that_stays_dead_in_the_set_up_is_told_once_and_tried_again(clock, place):
    flight = Flight(clock)
    dead = {"until": 10**9}
    flight.chip.fail = lambda number: errno.EREMOTEIO if place <= number < dead["until"] else 0
    flight.start()
    flight.fly(300)
    assert codes(flight.batches) == ["no_answer"] if place == 0 else ["bus_error", "no_answer"]
    assert "check its power" in texts(flight.batches, "no_answer")[0]
    dead["until"] = 0
    flight.chip.reset()
    flight.chip.first = None  # samples of before the stream was ever counted are nobody's
    flight.fly(200)
    assert codes(flight.batches)[-2:] == ["bus_recovered", "started"]
    flight.check()


def test_tries_of_a_dead_bus_back_off_to_one_a_second(flight):
    flight.chip.fail = lambda number: errno.EREMOTEIO
    flight.start()
    flight.fly(1000)
    before = len(flight.chip.transfers)
    flight.fly(1000)
    assert len(flight.chip.transfers) - before == 3 * 10


def test_a_bus_held_low_is_not_tried_again_at_once(flight):
    flight.chip.fail = lambda number: errno.ETIMEDOUT
    flight.batches += flight.device.start(flight.clock())
    assert len(flight.chip.transfers) == 1
    assert "SDA may be held low" in texts(flight.batches, "no_answer")[0]


@pytest.mark.parametrize(
    ("identity", "name", "temperature"),
    [
        (0x70, "MPU-6500", "333.87"),
        (0x71, "MPU-9250", "333.87"),
        (0x73, "MPU-9255", "333.87"),
        (0x98, "20689", "326.8"),
    ],
)
def test_clones_are_named_and_flown(flight, identity, name, temperature):
    flight.chip.identity = identity
    flight.chip.reset()
    flight.start()
    (text,) = texts(flight.batches, "clone")
    assert name in text
    assert temperature in text
    assert flight.chip.registers[0x1D] & 0x07 == 2
    flight.check()


@pytest.mark.parametrize(("identity", "named"), [(0x12, "ICM-20602"), (0x00, "unknown"), (0xFF, "unknown")])
def test_another_device_is_named_by_address_and_value(flight, identity, named):
    flight.chip.identity = identity
    flight.chip.reset()
    with pytest.raises(
        WrongDeviceError, match=rf"imu_base: I2C 0x68 has WHO_AM_I {identity:#04x} \({named}\).*correct"
    ):
        flight.device.probe()
    flight.start()
    flight.fly(500)
    assert codes(flight.batches) == ["wrong_device"]
    assert not len(of(flight.batches, NAME))


def test_no_device_is_named_by_address(clock):
    device = Mpu6050(NAME, Mpu6050Model(clock), Mpu6050Config(address=0x69))
    with pytest.raises(NoAnswerError, match=r"imu_base: I2C 0x69 does not answer \(EREMOTEIO\)"):
        device.probe()


def test_a_register_that_does_not_hold_is_a_configuration_error(flight):
    write = flight.chip.write

    def stuck(address, data):
        write(address, data if data[0] != 0x1C else b"\x1c\x00")

    flight.chip.write = stuck
    flight.start()
    flight.fly(100)
    assert codes(flight.batches) == ["configuration"]
    assert "register 0x1c reads 0x00, not 0x08" in texts(flight.batches, "configuration")[0]


def test_a_reset_that_does_not_end_is_told(flight):
    read = flight.chip.write_read

    def resetting(address, data, count):
        reply = read(address, data, count)
        return reply._replace(data=b"\xc0") if data == b"\x6b" else reply

    flight.chip.write_read = resetting
    flight.start()
    flight.fly(200)
    assert "DEVICE_RESET does not clear" in texts(flight.batches, "configuration")[0]


# Draining


def test_produced_is_recorded_and_stop_leaves_nothing(flight):
    flight.start()
    flight.fly(500)
    flight.clock.advance(7 * MS)
    flight.stop()
    rows = flight.check()
    assert len(rows) == flight.chip.written > 5000
    assert not len(of(flight.batches, "gap"))
    assert codes(flight.batches) == ["started", "stopped"]
    assert flight.chip.registers[0x6B] == 0x40


def test_rows_carry_the_stamp_of_the_count_and_the_newest_is_less_than_a_period_old(clock):
    flight = Flight(clock, byte_ns=22_500)
    flight.start()
    flight.fly(200)
    rows = flight.check()
    stamps, places = np.unique(rows["host_ns"][::-1], return_index=True)
    newest = rows["tick"][::-1][places]
    made_ns = (newest + flight.chip.first + 1) * flight.chip.period_ns + flight.chip.phase_ns
    age_ns = stamps - made_ns
    transfer_ns = 2 * 22_500
    assert age_ns.min() >= 0
    assert age_ns.max() <= flight.chip.period_ns + transfer_ns


def test_transfers_are_whole_packets_of_bounded_size(clock):
    flight = Flight(clock, Mpu6050Config(max_transfer_bytes=32))
    flight.start()
    flight.fly(20)
    sizes = {transfer[2] for transfer in flight.chip.transfers if transfer[:2] == ("read", 0x74)}
    assert sizes == {28, 14} or sizes == {28}
    flight.check()


def test_the_sync_bit_marks_its_sample(flight):
    flight.chip.sync_samples = {17, 200, 201, 999}
    flight.start()
    flight.fly(120)
    rows = flight.check()
    assert rows["tick"][rows["sync"] == 1].tolist() == [17, 200, 201, 999]


def test_a_second_start_goes_on_numbering_and_says_so(flight):
    flight.start()
    flight.stop()
    before = int(of(flight.batches, NAME)["tick"][-1])
    flight.clock.advance(5_000 * MS)
    flight.start()
    rows = whole(flight.batches, NAME)
    after = rows[rows["tick"] > before]
    assert after["status"][0] == SampleStatus.AFTER_RESET
    assert not after["status"][1:].any()
    assert not len(of(flight.batches, "gap"))


# Losing


@pytest.mark.parametrize("late_ms", [75, 100, 321, 2000, 9876])
@pytest.mark.parametrize("period_ns", [990_099.2, 999_970.0, 1_000_000.0, 1_009_998.7])
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


@pytest.mark.parametrize("seed", range(12))
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


@pytest.mark.parametrize("place", range(40))
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


# Watching


def test_a_brown_out_is_set_right_and_its_cost_is_a_gap(flight):
    flight.start()
    flight.fly(200)
    flight.clock.advance(3 * MS)
    flight.chip.reset()
    flight.fly(100)
    flight.stop()
    rows = whole(flight.batches, NAME)
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"brown_out"
    assert 200 <= int(gap["last_missing"]) - int(gap["first_missing"]) <= 300
    assert "check its supply" in texts(flight.batches, "brown_out")[0]
    marked = rows["status"] == SampleStatus.AFTER_RESET
    assert rows["sequence"][marked].tolist() == [gap["last_missing"] + 1]
    assert np.abs(numbers(rows) - rows["tick"].astype(int)).max() <= 1
    assert flight.chip.registers[0x1C] == 0x08


@pytest.mark.parametrize(("register", "value"), [(0x1A, 0x00), (0x1B, 0x18), (0x1C, 0x00), (0x19, 0x01), (0x38, 0)])
def test_a_flipped_bit_is_found_within_a_second_and_set_right(flight, register, value):
    flight.start()
    flight.fly(100)
    flight.chip.registers[register] = value
    made = flight.fly(100)
    assert "configuration_lost" in codes(made)
    assert f"{register:#04x}" in texts(made, "configuration_lost")[0]
    flight.fly(50)
    assert flight.chip.registers[register] == dict(SETTINGS)[register]
    flight.stop()
    assert of(flight.batches, "gap")["cause"].tolist() == [b"configuration_lost"]
    whole(flight.batches, NAME)


def test_a_chip_that_makes_no_samples_is_reset(flight):
    flight.start()
    flight.fly(100)
    flight.chip.broken = True
    made = flight.fly(60)
    assert "no_samples" in codes(made)
    flight.chip.broken = False
    flight.fly(100)
    flight.stop()
    rows = whole(flight.batches, NAME)
    assert set(of(flight.batches, "gap")["cause"]) == {b"no_samples"}
    assert rows["status"].max() == SampleStatus.AFTER_RESET


def test_it_never_raises_whatever_the_bus_does(clock, rng):
    """Random errno at random transfers, random resets, random late polls, for a minute of flight."""
    flight = Flight(clock)
    choices = [0] * 40 + [errno.EREMOTEIO, errno.EIO, errno.ETIMEDOUT, errno.EAGAIN]
    flight.chip.fail = lambda number: int(rng.choice(choices))
    flight.start()
    for _ in range(400):
        if rng.random() < 0.02:
            flight.chip.reset()
        flight.chip.pops_before_failure = int(rng.integers(0, 140))
        flight.fly(int(rng.integers(1, 25)), jitter_ns=5 * MS)
        clock.advance(int(rng.integers(0, 100)) * MS if rng.random() < 0.1 else 0)
    flight.chip.fail = lambda number: 0
    flight.fly(300)
    flight.stop()
    rows = whole(flight.batches, NAME)
    assert len(rows) > 5_000
    assert np.all(np.diff(numbers(rows)) > 0), "never backwards, never twice"
