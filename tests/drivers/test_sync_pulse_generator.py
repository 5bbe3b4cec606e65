"""The generator: its schedule against the code, the device under a virtual clock with a line and a bus of our own."""

import errno
import os
import time

import gpiod
import hypothesis.strategies as st
import numpy as np
import pytest
from gpiod.line import Direction, Value
from hypothesis import given

from drivers.ports import CanFrame, Driven
from drivers.sync_pulse import PulseGenerator, PulseGeneratorConfig, PulseSchedule, intervals
from drivers.transports import open_pulse_output
from drivers.transports.clock import wait_until
from tests.drivers.batches import codes, of, texts, whole

MS = 1_000_000
LENGTH = 32**3
CYCLE_PERIODS = 1_490_944  # sum of the intervals, SYNC periods


class Line:
    """An output line in virtual time: waking up and driving take what the test says."""

    def __init__(self, clock, wake_ns=lambda: 0, drive_ns=2_000):
        self.clock = clock
        self.wake_ns = wake_ns
        self.drive_ns = drive_ns
        self.levels = []  # (instant, level)
        self.failing = False
        self.waits = 0

    def wait_until(self, instant_ns):
        self.waits += 1
        if instant_ns > self.clock():
            self.clock.advance(instant_ns - self.clock())
        self.clock.advance(self.wake_ns())

    def drive(self, high):
        if self.failing:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        before = self.clock()
        after = self.clock.advance(self.drive_ns)
        self.levels.append((before + self.drive_ns // 2, high))
        return Driven(before, after)

    def close(self):
        pass

    @property
    def rises(self):
        return [instant for instant, level in self.levels if level]


class Bus:
    """A CAN port that keeps what is sent."""

    def __init__(self, clock):
        self.clock = clock
        self.sent = []
        self.down = False
        self.received = 0

    def send(self, identifier, data):
        if self.down:
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        self.clock.advance(5_000)
        self.sent.append((self.clock(), identifier, data))

    def receive(self, timeout_s):
        assert timeout_s == 0.0, "it must not wait here"
        self.received += 1
        return [CanFrame(0, 0x281, bytes(4))]

    def mute(self):
        raise AssertionError("an slcan adapter that is muted cannot send")

    def close(self):
        pass


@pytest.fixture
def line(clock):
    return Line(clock)


@pytest.fixture
def bus(clock):
    return Bus(clock)


def fly(generator, clock, duration_s, timeout_s=0.1):
    batches = []
    end_ns = clock() + round(duration_s * 1e9)
    while clock() < end_ns:
        batches += generator.pump(clock(), timeout_s)
    return batches


# The schedule


@given(st.integers(0, 3 * LENGTH), st.integers(0, 10**15), st.sampled_from([5 * MS, 10 * MS, 2_500_000]))
def test_each_pulse_rises_its_interval_after_the_last_by_its_own_dither(number, start_ns, period_ns):
    schedule = PulseSchedule(start_ns, period_ns)
    one, two = schedule.pulse(number), schedule.pulse(number + 1)
    assert two.sync_number - one.sync_number == intervals()[(number + 1) % LENGTH]
    for pulse in (one, two):
        dither_ns = (19 * pulse.number) % 32 * 31_250
        assert pulse.rise_ns == start_ns + pulse.sync_number * period_ns + dither_ns
        assert schedule.sync_ns(pulse.sync_number) == pulse.rise_ns - dither_ns


def test_pulse_zero_is_the_start_and_the_code_goes_round():
    schedule = PulseSchedule(1_000, 5 * MS)
    assert schedule.pulse(0) == (0, 0, 1_000)
    assert schedule.pulse(LENGTH) == (LENGTH, CYCLE_PERIODS, 1_000 + CYCLE_PERIODS * 5 * MS)


# The device


def test_pulses_and_syncs_go_out_to_the_schedule(clock, line, bus):
    generator = PulseGenerator("pulse_out", line, clock, can=bus)
    start_ns = clock()
    batches = generator.start(start_ns)
    batches += fly(generator, clock, 20.0)
    batches += generator.stop(clock())
    zero_ns = start_ns + 4 * 5 * MS
    assert str(zero_ns) in texts(batches, "started")[0]
    pulses, syncs = whole(batches, "pulse_out"), whole(batches, "sync_sent")
    assert 60 < len(pulses) == len(line.rises)
    assert len(syncs) == len(bus.sent) > 3_950
    schedule = PulseSchedule(zero_ns, 5 * MS)
    for row, rise_ns in zip(pulses, line.rises, strict=True):
        due_ns = schedule.pulse(int(row["sequence"])).rise_ns
        assert row["edge_ns"] <= rise_ns <= row["host_ns"]
        assert 0 <= row["edge_ns"] - due_ns <= 10_000, "the SYNC of the same instant may go first by what it takes"
    for row, (sent_ns, identifier, data) in zip(syncs, bus.sent, strict=True):
        tick = int(row["tick"])
        assert (identifier, data) == (0x080, bytes([tick % 240 + 1]))
        assert row["sync_counter"] == tick % 240 + 1
        assert row["host_ns"] == sent_ns
    assert syncs["tick"].tolist() == list(range(len(syncs)))
    assert pulses["line_sequence"].tolist() == pulses["sequence"].tolist()
    assert codes(batches) == ["started", "stopped"]
    assert bus.received > 10, "what others say does not pile up"


def test_the_edges_are_those_of_the_code_and_bind_to_the_syncs(clock, line, bus):
    generator = PulseGenerator("pulse_out", line, clock, can=bus)
    batches = generator.start(clock()) + fly(generator, clock, 60.0)
    pulses, syncs = whole(batches, "pulse_out"), whole(batches, "sync_sent")
    steps = np.round(np.diff(pulses["edge_ns"]) / (5 * MS)).astype(int)
    assert len(steps) > 200
    assert steps.tolist() == intervals()[pulses["sequence"][1:] % len(intervals())].tolist()
    before = np.searchsorted(syncs["host_ns"], pulses["edge_ns"] + 20_000) - 1
    schedule = PulseSchedule(0, 5 * MS)
    expected = [schedule.pulse(int(number)).sync_number for number in pulses["sequence"]]
    assert syncs["tick"][before].tolist() == expected


def test_pulses_are_as_wide_as_asked(clock, line):
    generator = PulseGenerator("pulse_out", line, clock, PulseGeneratorConfig(width_ms=0.4))
    generator.start(clock())
    fly(generator, clock, 5.0)
    generator.stop(clock())
    assert [level for _, level in line.levels] == [True, False] * (len(line.levels) // 2)
    widths = [fall - rise for (rise, _), (fall, _) in zip(line.levels[::2], line.levels[1::2], strict=True)]
    assert len(widths) > 15
    assert all(400_000 <= width <= 410_000 for width in widths)


def test_the_jitter_of_the_host_is_in_the_rows(clock, rng):
    line = Line(clock, wake_ns=lambda: int(rng.integers(0, 900_000)))
    generator = PulseGenerator("pulse_out", line, clock)
    start_ns = clock()
    batches = generator.start(start_ns) + fly(generator, clock, 60.0) + generator.stop(clock())
    pulses = whole(batches, "pulse_out")
    schedule = PulseSchedule(start_ns + 20 * MS, 5 * MS)
    late = np.array([row["edge_ns"] - schedule.pulse(int(row["sequence"])).rise_ns for row in pulses])
    assert late.max() > 700_000
    np.testing.assert_array_equal(pulses["edge_ns"] + 1_000, line.rises)
    assert f"the latest {late.max() // 1000} us late" in texts(batches, "stopped")[0]
    assert "pulse_wide" in codes(batches)


def test_it_is_the_same_to_the_byte_every_time(clock):
    logs = []
    for _ in range(2):
        clock.now_ns = 10**9
        generator = PulseGenerator("pulse_out", Line(clock), clock, can=Bus(clock))
        batches = generator.start(clock()) + fly(generator, clock, 3.0) + generator.stop(clock())
        logs.append([(batch.channel, batch.rows.tobytes()) for batch in batches])
    assert logs[0] == logs[1]


def test_a_pump_without_waiting_sends_only_what_is_due(clock, line, bus):
    generator = PulseGenerator("pulse_out", line, clock, can=bus)
    generator.start(clock())
    assert generator.pump(clock()) == []
    assert (line.levels, bus.sent) == ([], [])
    clock.advance(20 * MS)
    generator.pump(clock())
    assert (len(line.rises), len(bus.sent)) == (1, 1)
    assert generator.period_ns == 0


def test_a_host_that_was_away_leaves_out_what_is_overdue_and_names_it(clock, line, bus):
    generator = PulseGenerator("pulse_out", line, clock, can=bus)
    batches = generator.start(clock()) + fly(generator, clock, 3.0)
    sent, rises = len(bus.sent), len(line.rises)
    clock.advance(1_003 * MS)
    batches += fly(generator, clock, 3.0) + generator.stop(clock())
    pulses, syncs = whole(batches, "pulse_out"), whole(batches, "sync_sent")
    gaps = {row["channel"].decode(): row for row in of(batches, "gap")}
    assert set(gaps) == {"pulse_out", "sync_sent"}
    assert {row["cause"] for row in gaps.values()} == {b"host_late"}
    lost = int(gaps["sync_sent"]["last_missing"]) - int(gaps["sync_sent"]["first_missing"]) + 1
    assert lost in {199, 200}
    assert len(bus.sent) > sent
    assert len(line.rises) > rises
    assert syncs["host_ns"][-1] - syncs["host_ns"][0] == pytest.approx(5 * MS * int(syncs["tick"][-1]), abs=5 * MS)
    assert np.diff(pulses["edge_ns"]).max() < 1_700 * MS
    assert "real-time priority" in texts(batches, "host_late")[0]


def test_a_line_that_cannot_be_driven_is_told_once_and_syncs_go_on(clock, line, bus):
    generator = PulseGenerator("pulse_out", line, clock, can=bus)
    batches = generator.start(clock()) + fly(generator, clock, 2.0)
    line.failing = True
    batches += fly(generator, clock, 3.0)
    line.failing = False
    batches += fly(generator, clock, 2.0) + generator.stop(clock())
    assert codes(batches).count("bus_error") in {1, 2}, "once for the edges, once more if it failed while high"
    assert codes(batches).count("bus_recovered") == 1
    (gap,) = of(batches, "gap")
    assert (gap["channel"], gap["cause"]) == (b"pulse_out", b"bus_error")
    whole(batches, "pulse_out")
    assert len(whole(batches, "sync_sent")) > 1_390


def test_a_bus_that_is_down_is_told_once_and_pulses_go_on(clock, line, bus):
    generator = PulseGenerator("pulse_out", line, clock, can=bus)
    batches = generator.start(clock()) + fly(generator, clock, 2.0)
    bus.down = True
    batches += fly(generator, clock, 2.0)
    bus.down = False
    batches += fly(generator, clock, 2.0)
    bus.down = True
    batches += fly(generator, clock, 1.0) + generator.stop(clock())
    assert codes(batches).count("bus_recovered") == 1
    gaps = of(batches, "gap")
    assert gaps["channel"].tolist() == [b"sync_sent"] * 2, "the last one is named by the stop"
    assert 390 < int(gaps[0]["last_missing"]) - int(gaps[0]["first_missing"]) + 1 < 410
    syncs = whole(batches, "sync_sent")
    np.testing.assert_array_equal(syncs["sync_counter"], syncs["tick"] % 240 + 1)
    assert not len(gaps[gaps["channel"] == b"pulse_out"])


def test_a_bus_that_cannot_be_read_raises_nothing(clock, line, bus):
    def gone(timeout_s):
        raise OSError(errno.ENODEV, "gone")

    bus.receive = gone
    generator = PulseGenerator("pulse_out", line, clock, can=bus)
    batches = generator.start(clock()) + fly(generator, clock, 1.0)
    assert "bus_error" in codes(batches)
    assert len(whole(batches, "pulse_out")) >= 3


def test_a_stop_leaves_the_line_low_and_a_start_begins_the_code_anew(clock, line):
    generator = PulseGenerator("pulse_out", line, clock)
    assert generator.pump(clock()) == []
    assert codes(generator.stop(clock())) == []
    generator.start(clock())
    clock.advance(20 * MS)
    generator.pump(clock())
    assert line.levels[-1][1]
    generator.stop(clock())
    assert not line.levels[-1][1]
    assert generator.pump(clock(), 0.1) == []
    generator.start(clock())
    (batch,) = [batch for batch in fly(generator, clock, 0.1) if batch.channel == "pulse_out"]
    assert batch.rows["sequence"].tolist() == [0]


# The line of the kernel


def test_a_gpio_line_is_asked_for_as_an_output_that_is_low(monkeypatch, clock):
    asked, values = {}, []

    class Request:
        released = False

        def set_value(self, line, value):
            clock.advance(700)
            values.append((line, value))

        def release(self):
            Request.released = True

    def request_lines(path, config, **named):
        asked.update(path=path, config=config, **named)
        return Request()

    monkeypatch.setattr(gpiod, "request_lines", request_lines)
    port = open_pulse_output("gpio-out:///dev/gpiochip0?line=27", clock)
    (settings,) = asked["config"].values()
    assert (asked["path"], list(asked["config"])) == ("/dev/gpiochip0", [27])
    assert (settings.direction, settings.output_value) == (Direction.OUTPUT, Value.INACTIVE)
    before = clock()
    assert port.drive(True) == (before, before + 700)
    port.drive(False)
    port.close()
    assert values == [(27, Value.ACTIVE), (27, Value.INACTIVE), (27, Value.INACTIVE)]
    assert Request.released


def test_a_wait_sleeps_most_of_it_and_watches_the_clock_for_the_rest():
    now = [1_000_000]
    slept = []

    def clock():
        now[0] += 10
        return now[0]

    def sleep(seconds):
        slept.append(seconds)
        now[0] += round(seconds * 1e9)

    wait_until(6_000_000, clock, sleep, spin_ns=150_000)
    assert 6_000_000 <= now[0] < 6_000_100
    assert slept == [pytest.approx(4.85e-3, abs=1e-7)]
    wait_until(5_000_000, clock, sleep)
    assert len(slept) == 1, "what has passed is not waited for"


def test_a_real_wait_is_never_early():
    for _ in range(20):
        due_ns = time.monotonic_ns() + 1 * MS
        wait_until(due_ns, time.monotonic_ns)
        assert time.monotonic_ns() >= due_ns
