"""The MPU-6050 driver against a chip typed from the data sheet: set-up, draining, watching."""

import errno

import numpy as np
import pytest

from drivers.errors import NoAnswerError, WrongDeviceError
from drivers.mpu6050 import Mpu6050, Mpu6050Config
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.mpu6050_flight import NAME, SETTINGS, Flight, numbers
from tests.drivers.mpu6050_model import MS, Mpu6050Model, ScriptedI2c


@pytest.fixture
def flight(clock):
    return Flight(clock)


# Setting up


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
    script = [*SET_UP, (b"\x72", b"\x00\x1c"), (b"\x74", packet * 2)]
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


@pytest.mark.parametrize(("identity", "drained_ms"), [(0x68, 20), (0x70, 18)])
def test_a_small_fifo_is_drained_before_it_is_half_full(clock, identity, drained_ms):
    flight = Flight(clock, Mpu6050Config(poll_period_ms=20.0))
    flight.chip.identity = identity
    flight.chip.reset()
    flight.start()
    assert flight.device.period_ns == drained_ms * MS


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


def test_a_chip_whose_samples_carry_marks_rests_and_loses_nothing(flight):
    flight.chip.sync_samples = set(range(0, 100_000, 20))
    flight.start()
    assert flight.device.rests_until(flight.clock()) == flight.clock(), "by arrivals alone each poll counts"
    flight.fly(100)
    for _ in range(40):
        rest_ns = flight.device.rests_until(flight.clock()) - flight.clock()
        assert 50 * MS < rest_ns < 60 * MS
        flight.clock.advance(rest_ns)
        flight.batches += flight.device.pump(flight.clock())
    flight.stop()
    assert flight.device.rests_until(flight.clock()) == flight.clock()
    assert len(flight.check()) > 2400
    assert not [rows for channel, rows in flight.batches if channel == "gap"]


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


def test_a_brown_out_at_any_transaction_is_told_as_one_whichever_register_is_looked_at_first(clock):
    for later in range(60):
        flight = Flight(clock)
        flight.start()
        flight.fly(20)
        at = len(flight.chip.transfers) + later
        flight.chip.fail = lambda number, chip=flight.chip, at=at: chip.reset() if number == at else 0
        flight.fly(40)
        told = [code for code in codes(flight.batches) if code not in {"started", "fifo_overflow", "misaligned"}]
        assert told == ["brown_out"], later


@pytest.mark.parametrize(("register", "value"), [(0x1A, 0x00), (0x1B, 0x18), (0x1C, 0x00), (0x19, 0x01), (0x38, 0)])
def test_a_flipped_bit_is_found_within_a_second_and_set_right(flight, register, value):
    flight.start()
    flight.fly(100)
    flight.chip.registers[register] = value
    made = flight.fly(100)
    assert "configuration_lost" in codes(made)
    assert f"{register:#04x}" in texts(made, "configuration_lost")[0]
    flight.fly(100)
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
