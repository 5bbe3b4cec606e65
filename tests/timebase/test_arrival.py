"""Clocks without marks: arrival stamps, and questions with their answers."""

import numpy as np
import pytest

from drivers.records import SCALAR
from onboard.timebase.arrival import ArrivalClock
from onboard.timebase.clock import ClockState
from onboard.timebase.timebase import FreeChannel, PolledChannel, Timebase

TICK_NS = 2170.1
START_NS = 10_000_000_000


def arrivals(
    rng: np.random.Generator, seconds: float, rate_error: float, jitter_ns: float
) -> list[tuple[int, float, int]]:
    """(tick, when it was, arrival) of packets at 150 Hz."""
    taken = START_NS + np.arange(0.0, seconds * 1e9, 1e9 / 150)
    ticks = np.rint((taken - START_NS) / TICK_NS / (1 + rate_error)).astype(int)
    late = 3_300_000 + rng.exponential(jitter_ns, len(taken))
    return list(zip(ticks.tolist(), taken.tolist(), np.rint(taken + late).astype(int).tolist(), strict=True))


@pytest.mark.parametrize(
    "rate_error", [-0.05, 0.0, *(pytest.param(one, marks=pytest.mark.campaign) for one in (1e-4, 0.02))]
)  # between the others, or less
@pytest.mark.parametrize("jitter_ns", [50e3, 1e6])
def test_the_least_late_arrivals_tell_the_time(rng: np.random.Generator, rate_error: float, jitter_ns: float) -> None:
    errors, sigmas = [], []
    for _ in range(20):
        clock = ArrivalClock(TICK_NS, delay_ns=3.3e6)
        for tick, _, host_ns in (packets := arrivals(rng, 20.0, rate_error, jitter_ns)):
            clock.arrived(tick, host_ns)
        tick, taken, _ = packets[-1]
        assert clock.state is ClockState.LOCKED
        errors.append(float(clock.time_ns(np.array([tick]))[0]) - taken)
        sigmas.append(clock.sigma_ns(tick))
    assert np.sqrt(np.mean(np.square(errors))) < jitter_ns / 5 + 20e3
    assert np.sqrt(np.mean(np.square(errors))) < 1.5 * np.mean(sigmas)


def test_an_answer_comes_within_a_quarter_of_a_second(rng: np.random.Generator) -> None:
    clock = ArrivalClock(TICK_NS)
    locked = [host_ns for tick, _, host_ns in arrivals(rng, 1.0, 0.0, 300e3) if clock.arrived(tick, host_ns)]
    assert locked[0] - START_NS < 250_000_000


def test_a_stall_of_the_host_moves_nothing(rng: np.random.Generator) -> None:
    clock = ArrivalClock(TICK_NS, delay_ns=3.3e6)
    packets = arrivals(rng, 30.0, 1e-4, 100e3)
    for tick, taken, host_ns in packets:
        stalled = 20e9 < taken - START_NS < 21.5e9
        clock.arrived(tick, START_NS + 21_600_000_000 if stalled else host_ns)
    tick, taken, _ = packets[-1]
    assert abs(float(clock.time_ns(np.array([tick]))[0]) - taken) < 100e3


def test_silence_ends_in_flywheel_and_then_invalid(rng: np.random.Generator) -> None:
    clock = ArrivalClock(TICK_NS)
    for tick, _, host_ns in arrivals(rng, 10.0, 0.0, 100e3):
        clock.arrived(tick, host_ns)
    before = clock.sigma_ns(clock.tick_at(START_NS + 10_000_000_000))
    assert clock.at(START_NS + 15_000_000_000) is ClockState.FLYWHEEL
    assert clock.sigma_ns(clock.tick_at(START_NS + 15_000_000_000)) > before
    assert clock.at(START_NS + 1_000_000_000_000) is ClockState.INVALID


def test_a_free_channel_is_recorded_and_used(rng: np.random.Generator) -> None:
    timebase = Timebase({"tip": FreeChannel(TICK_NS, 3.3e6, 1e6)}, None)
    packets = arrivals(rng, 5.0, 0.0, 100e3)
    recorded = []
    for first in range(0, len(packets), 15):
        rows = np.zeros(len(packets[first : first + 15]), SCALAR)
        rows["tick"] = [tick for tick, _, _ in packets[first : first + 15]]
        rows["host_ns"] = [host_ns for _, _, host_ns in packets[first : first + 15]]
        recorded.append(timebase.update(int(rows["host_ns"][-1]), {"tip": rows}))
    assert timebase.trusted("tip")
    times = timebase.time_ns("tip", rows)
    assert times is not None
    assert abs(times - [taken for _, taken, _ in packets[-len(rows) :]]).max() < 100e3
    assert 1e6 < timebase.sigma_ns("tip", int(times[-1])) < 1.2e6  # its delay is stated to a millisecond
    assert np.concatenate(recorded)["state"][-1] == ClockState.LOCKED


@pytest.mark.parametrize(("tolerance", "right"), [(0.06, False), (0.2, True)])
def test_an_oscillator_far_from_its_nominal_rate_needs_a_channel_that_says_so(
    rng: np.random.Generator, tolerance: float, right: bool
) -> None:
    """17 % fast, as an HX711 may be."""
    timebase = Timebase({"tip": FreeChannel(1.17 * TICK_NS, 3.3e6, 1e6, tolerance)}, None)
    packets = arrivals(rng, 5.0, 0.0, 100e3)
    for tick, _, host_ns in packets:
        rows = np.zeros(1, SCALAR)
        rows["tick"], rows["host_ns"] = tick, host_ns
        timebase.update(host_ns, {"tip": rows})
    times = timebase.time_ns("tip", rows)
    assert times is not None
    assert (abs(float(times[0]) - packets[-1][1]) < 100e3) == right


def test_what_was_asked_lies_between_question_and_answer(rng: np.random.Generator) -> None:
    question_ns, answer_ns = 700_000, 1_800_000
    timebase = Timebase({"cell": PolledChannel(question_ns, answer_ns)}, None)
    asked = START_NS + np.arange(2000) * 10_000_000
    waits = rng.integers(0, 6_000_000, 2000)
    before = rng.integers(0, waits + 1)  # until it takes the sample
    rows = np.zeros(2000, SCALAR)
    rows["tick"] = asked
    taken = asked + question_ns + before
    rows["host_ns"] = asked + question_ns + waits + answer_ns
    recorded = timebase.update(int(rows["host_ns"][-1]), {"cell": rows})
    times = timebase.time_ns("cell", rows)
    assert times is not None
    assert (abs(times - taken) <= waits / 2 + 1).all()
    assert timebase.sigma_ns("cell", 0) == pytest.approx(np.std(times - taken), rel=0.25)
    assert recorded["sigma_ns"][0] == timebase.sigma_ns("cell", 0)
    assert timebase.trusted("cell")


@pytest.mark.parametrize("read_late_ns", [0, 4_000_000])
def test_a_device_that_answers_at_once_has_sampled_by_then_however_late_the_host_reads(read_late_ns: int) -> None:
    question_ns, answer_ns, longest_ns = 160_000, 500_000, 500_000
    rows = np.zeros(50, SCALAR)
    rows["tick"] = START_NS + np.arange(50) * 5_000_000
    rows["host_ns"] = rows["tick"].astype(np.int64) + question_ns + longest_ns + answer_ns + read_late_ns
    timebase = Timebase({"joint": PolledChannel(question_ns, answer_ns, longest_ns)}, None)
    timebase.update(int(rows["host_ns"][-1]), {"joint": rows})
    times = timebase.time_ns("joint", rows)
    assert times is not None
    np.testing.assert_array_equal(times - rows["tick"].astype(np.int64), question_ns + longest_ns // 2)
    assert timebase.sigma_ns("joint", 0) == pytest.approx(longest_ns / 12**0.5)


def test_a_channel_that_was_never_asked_is_not_trusted() -> None:
    timebase = Timebase({"cell": PolledChannel()}, None)
    assert not timebase.trusted("cell")
    assert np.isinf(timebase.sigma_ns("cell", 0))
