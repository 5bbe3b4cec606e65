"""Burst mode: each sample once, numbers true to the chip's own, what was missed named."""

import errno

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from drivers.errors import ConfigurationError
from drivers.mpu6050 import Mpu6050, Mpu6050Config
from drivers.records import SampleStatus
from tests.conftest import VirtualClock
from tests.drivers.batches import codes, of, whole
from tests.drivers.mpu6050_flight import numbers
from tests.drivers.mpu6050_model import MS, Mpu6050Model, ScriptedI2c

NAME = "imu"
CONFIG = Mpu6050Config(sample_rate_hz=100, mode="burst")
PERIOD_NS = 10 * MS


class Flight:
    """A chip and its driver, polled as often as it asks, each poll late by up to ``jitter_ns``."""

    def __init__(self, clock, drift_percent=0.0, phase_ns=1_234_567.0, config=CONFIG, seed=5):
        self.clock = clock
        self.chip = Mpu6050Model(clock, period_ns=PERIOD_NS * (1 + drift_percent / 100) + 11.3, phase_ns=phase_ns)
        self.chip.byte_ns = 22_500
        self.device = Mpu6050(NAME, self.chip, config)
        self.rng = np.random.default_rng(seed)
        self.batches = self.device.start(clock())
        self.fly(0.25)

    def fly(self, duration_s, jitter_ns=100_000):
        made = []
        end_ns = self.clock() + round(duration_s * 1e9)
        due_ns = self.clock()
        while due_ns < end_ns:
            due_ns += self.device.period_ns
            late_ns = int(self.rng.integers(0, jitter_ns + 1))
            self.clock.advance(max(due_ns + late_ns - self.clock(), 0))
            due_ns = max(due_ns, self.clock() - self.device.period_ns)
            made += self.device.pump(self.clock())
        self.batches += made
        return made

    def slips(self):
        rows = whole(self.batches, NAME)
        np.testing.assert_array_equal(rows["tick"], rows["sequence"])
        got = numbers(rows)
        assert np.all(np.diff(got) > 0), "no sample twice"
        return got - rows["tick"].astype(int)


@pytest.fixture
def flight(clock):
    return Flight(clock)


def test_a_poll_is_one_transfer_of_fifteen_bytes(clock):
    settings_ = [(0x6B, 1), (0x6C, 0), (0x19, 9), (0x1A, 0x0A), (0x1B, 0), (0x1C, 8), (0x37, 0), (0x38, 0x01)]
    words = bytes.fromhex("0001 0002 0003 F0B1 0004 0005 0006")
    script = [
        (b"\x75", b"\x68"),
        (b"\x6b\x80", b""),
        (b"\x6b", b"\x40"),
        (b"\x6b\x01", b""),
        *((bytes(pair), b"") for pair in settings_),
        *((bytes(pair[:1]), bytes(pair[1:])) for pair in settings_),
        (b"\x6a\x00", b""),
        (b"\x23\x00", b""),
        (b"\x3a", b"\x00"),
        (b"\x3a", b"\x00" + words),  # not new
        (b"\x3a", b"\x01" + words),
    ]
    bus = ScriptedI2c(clock, script)
    device = Mpu6050(NAME, bus, CONFIG)
    batches = device.start(clock())
    for _ in range(2):
        clock.advance(100 * MS)
        batches += device.pump(clock())
    clock.advance(5 * MS)
    assert device.pump(clock()) == []
    stamp = clock.advance(5 * MS)
    (batch,) = device.pump(clock())
    bus.done()
    assert codes(batches) == ["started"]
    (row,) = batch.rows
    assert (row["tick"], row["host_ns"], row["sync"]) == (0, stamp, 1)
    assert row["accel_raw"].tolist() == [1, 2, 3]
    assert row["gyro_raw"].tolist() == [4, 5, 6]


@pytest.mark.parametrize(
    "drift_percent",
    [-5.0, 0.0, *(pytest.param(one, marks=pytest.mark.campaign) for one in (-1.0, -0.01, 0.02, 1.0)), 5.0],
)
def test_every_sample_is_taken_once_whatever_the_rate_of_the_chip(clock, drift_percent):
    flight = Flight(clock, drift_percent)
    flight.fly(30.0)
    flight.device.stop(clock())
    assert len(set(flight.slips())) == 1
    assert not len(of(flight.batches, "gap"))
    assert len(of(flight.batches, NAME)) > 2800
    assert codes(flight.batches) == ["started"]


@pytest.mark.parametrize("drift_percent", [-3.0, 0.3, 1.0])
def test_what_a_late_host_missed_is_named_and_the_count_is_right_again(clock, drift_percent):
    flight = Flight(clock, drift_percent)
    flight.fly(5.0)
    for late_ms in (15, 22, 35, 50, 111, 300, 47):
        clock.advance(late_ms * MS)
        flight.fly(2.0)
    slips = flight.slips()
    assert set(of(flight.batches, "gap")["cause"]) == {b"missed"}
    assert slips[-1] == slips[0]
    assert np.count_nonzero(slips != slips[0]) < 7 * 12, "one too few, for a few samples, until it is sure"
    assert slips.min() == slips[0] or slips.max() - slips.min() <= 1


@settings(max_examples=3)
@given(seed=st.integers(0, 2**32 - 1), drift_percent=st.floats(-3.0, 3.0), share=st.sampled_from([0.0, 0.02, 0.2]))
def test_late_stamps_and_late_polls_never_count_too_much(seed, drift_percent, share):
    clock = VirtualClock()
    flight = Flight(clock, drift_percent, phase_ns=float(seed % 10**7), seed=seed)
    flight.fly(3.0)
    rng = flight.rng
    flight.chip.late = lambda: int(rng.integers(0, 40_000)) if rng.random() >= share else int(rng.integers(MS, 31 * MS))
    flight.fly(6.0, jitter_ns=2 * MS)
    flight.chip.late = lambda: 0
    flight.fly(1.0)
    slips = flight.slips()
    assert slips.min() >= slips[0], "a number too high could never be taken back"
    assert slips[-1] - slips[0] <= 1


def test_a_late_poll_before_the_rate_is_known_is_counted_by_the_least_there_can_be(flight):
    flight.clock.advance(57 * MS)
    flight.fly(4.0)
    slips = flight.slips()
    assert slips[-1] == slips[0]
    assert of(flight.batches, "gap")["cause"][0] == b"missed"


@pytest.mark.parametrize("code", [errno.EREMOTEIO, errno.EIO, errno.ETIMEDOUT])
def test_a_bus_away_is_told_once_and_what_it_cost_is_a_gap(flight, code):
    flight.fly(3.0)
    flight.chip.fail = lambda number: code
    flight.fly(0.5)
    flight.chip.fail = lambda number: 0
    flight.fly(5.0)
    flight.batches += flight.device.stop(flight.clock())
    slips = flight.slips()
    assert codes(flight.batches) == ["started", "bus_error", "bus_recovered", "stopped"]
    assert b"bus_error" in of(flight.batches, "gap")["cause"]
    assert slips[-1] == slips[0]


def test_an_error_at_any_transaction_is_mended_by_a_retry(flight):
    flight.chip.fail = lambda number: errno.EREMOTEIO if number % 5 == 0 else 0
    flight.fly(5.0)
    slips = flight.slips()
    assert slips[-1] == slips[0]
    assert codes(flight.batches) == ["started"]


def test_a_brown_out_is_found_by_silence_and_set_right(flight):
    flight.fly(3.0)
    flight.chip.reset()
    flight.fly(3.0)
    flight.batches += flight.device.stop(flight.clock())
    rows = whole(flight.batches, NAME)
    (gap,) = of(flight.batches, "gap")
    assert gap["cause"] == b"brown_out"
    marked = rows["status"] == SampleStatus.AFTER_RESET
    assert rows["sequence"][marked].tolist() == [gap["last_missing"] + 1]
    slips = numbers(rows) - rows["tick"].astype(int)
    assert np.abs(slips - slips[0]).max() <= 1
    assert flight.chip.registers[0x6B] == 0x40


def test_a_flipped_bit_is_found_and_set_right(flight):
    flight.fly(1.0)
    flight.chip.registers[0x1B] = 0x18
    flight.fly(3.0)
    assert "configuration_lost" in codes(flight.batches)
    assert flight.chip.registers[0x1B] == 0


def test_a_second_start_goes_on_numbering(flight):
    flight.fly(1.0)
    flight.batches += flight.device.stop(flight.clock())
    flight.clock.advance(1_000 * MS)
    flight.batches += flight.device.start(flight.clock())
    flight.fly(1.0)
    rows = whole(flight.batches, NAME)
    assert np.count_nonzero(rows["status"]) == 1
    assert not len(of(flight.batches, "gap"))


def test_modes_that_are_none_are_refused():
    with pytest.raises(ConfigurationError, match="use fifo or burst"):
        Mpu6050Config(mode="dmp")
    assert Mpu6050Config(sample_rate_hz=4, poll_period_ms=1e9, mode="burst").mode == "burst"
