"""The device clock against clocks whose truth is known: drifting, quantised, restarted, lied to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.timebase.clock import ClockState, DeviceClock, Mark

MILLISECOND = 1e6


class Chip:
    """A 1 kHz sampler whose clock is off and drifts, and which flags the sample a pulse falls into."""

    def __init__(self, rng: np.random.Generator, rate_error: float, drift_per_s: float = 0.0) -> None:
        self.phase_ns = rng.uniform(0, 1e6)
        self.rate_error, self.drift_per_s = rate_error, drift_per_s

    def sample_ns(self, tick: float) -> float:
        nominal_s = tick * 1e-3
        return self.phase_ns + 1e9 * (nominal_s * (1 + self.rate_error) + 0.5 * self.drift_per_s * nominal_s**2)

    def tick_of(self, time_ns: float) -> int:
        tick = int((time_ns - self.phase_ns) / 1e6 / (1 + self.rate_error))
        while self.sample_ns(tick) < time_ns:
            tick += 1
        while self.sample_ns(tick - 1) >= time_ns:
            tick -= 1
        return tick


def pulses(rng: np.random.Generator, seconds: float, dither: bool = True) -> list[int]:
    edges, now = [], 0
    while now < seconds * 1e9:
        now += int(rng.integers(30, 62)) * 5_000_000
        edges.append(now + (int(rng.integers(0, 32)) * 31_250 if dither else 0))
    return edges


def fly(chip: Chip, edges: list[int], clock: DeviceClock) -> None:
    for edge in edges:
        clock.mark(Mark(chip.tick_of(edge) - 0.5, edge, 1e6 / np.sqrt(12)))


@pytest.mark.parametrize("rate_error", [-0.05, -0.01, 0.0, 0.01, 0.05])
def test_locks_and_knows_its_own_error(rng: np.random.Generator, rate_error: float) -> None:
    errors, sigmas = [], []
    for _ in range(100):
        chip = Chip(rng, rate_error, drift_per_s=1e-7)
        clock = DeviceClock(1e6)
        fly(chip, pulses(rng, 10.0), clock)
        assert clock.state is ClockState.LOCKED
        tick = clock.solution.reference_tick
        errors.append(clock.time_ns(np.array([tick]))[0] - chip.sample_ns(tick))
        sigmas.append(clock.sigma_ns(tick))
    one_sample_period_over_ten = 1e5
    assert np.std(errors) < one_sample_period_over_ten
    assert 0.65 < np.std(errors) / np.mean(sigmas) < 1.3  # an honest sigma
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(100)


def test_says_so_when_pulses_beat_with_the_sample_clock(rng: np.random.Generator) -> None:
    errors, sigmas = [], []
    for _ in range(100):
        chip, clock = Chip(rng, 0.0), DeviceClock(1e6)
        fly(chip, pulses(rng, 10.0, dither=False), clock)
        tick = clock.solution.reference_tick
        errors.append(clock.time_ns(np.array([tick]))[0] - chip.sample_ns(tick))
        sigmas.append(clock.solution.sigma_ns)
    assert np.std(errors) > 0.9 * 1e6 / np.sqrt(12)  # one place in the period: nothing averages
    assert np.mean(sigmas) > 0.9 * np.std(errors)


def test_flywheels_with_a_sigma_that_covers(rng: np.random.Generator) -> None:
    inside = []
    for _ in range(100):
        chip = Chip(rng, 0.008, drift_per_s=float(rng.normal(0, 1e-7)))
        clock = DeviceClock(1e6)
        edges = pulses(rng, 30.0)
        fly(chip, edges, clock)
        silent_until = edges[-1] + 20e9
        assert clock.at(int(silent_until)) is ClockState.FLYWHEEL
        tick = chip.tick_of(silent_until)
        error = clock.time_ns(np.array([tick]))[0] - chip.sample_ns(tick)
        assert clock.sigma_ns(tick) > 2 * clock.solution.sigma_ns
        inside.append(abs(error) < 3 * clock.sigma_ns(tick))
    assert np.mean(inside) >= 0.97


def test_a_clock_without_marks_ends_invalid(rng: np.random.Generator) -> None:
    clock = DeviceClock(1e6, invalid_sigma_ns=1e6)
    edges = pulses(rng, 10.0)
    fly(Chip(rng, 0.0), edges, clock)
    assert clock.at(edges[-1] + int(1e12)) is ClockState.INVALID
    assert not clock.trusted


def test_restart_of_the_device_is_noticed_and_never_believed(rng: np.random.Generator) -> None:
    chip = Chip(rng, 0.003)
    clock = DeviceClock(1e6)
    edges = pulses(rng, 20.0)
    half = len(edges) // 2
    fly(chip, edges[:half], clock)
    for edge in edges[half:]:  # ticks 700 ms behind: as after a reset nobody told of
        clock.mark(Mark(chip.tick_of(edge) - 700.5, edge, 1e6 / np.sqrt(12)))
        if clock.state is ClockState.LOCKED:
            tick = chip.tick_of(edge) - 700
            believed = clock.time_ns(np.array([tick]))[0]
            stale = clock.consecutive_rejects > 0
            assert stale or abs(believed - chip.sample_ns(tick + 700)) < MILLISECOND
    assert clock.state is ClockState.LOCKED
    assert clock.rejected >= DeviceClock.REJECTS_TO_REACQUIRE


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    rate_error=st.floats(-0.05, 0.05),
    lies=st.lists(st.tuples(st.integers(0, 60), st.sampled_from(["miss", "late", "twice", "spurious"])), max_size=12),
)
def test_no_lie_makes_a_locked_clock_wrong(seed: int, rate_error: float, lies: list[tuple[int, str]]) -> None:
    rng = np.random.default_rng(seed)
    chip, clock = Chip(rng, rate_error), DeviceClock(1e6)
    told = dict(lies)
    for number, edge in enumerate(pulses(rng, 16.0)):
        lie = told.get(number)
        tick = chip.tick_of(edge)
        if lie == "miss":
            continue
        if lie == "late":
            tick += 40
        if lie == "spurious":
            tick += int(rng.integers(-60, 60))
        for _ in range(2 if lie == "twice" else 1):
            clock.mark(Mark(tick - 0.5, edge, 1e6 / np.sqrt(12)))
        if clock.state is ClockState.LOCKED:
            now = chip.tick_of(edge)
            assert abs(clock.time_ns(np.array([now]))[0] - chip.sample_ns(now)) < MILLISECOND
