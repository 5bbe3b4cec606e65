"""How many samples a chip has made: bounds of the count reads, late stamps, near-commensurate polls."""

import numpy as np
import pytest

from drivers.inertial.sample_clock import SampleClock

NOMINAL_NS = 1_000_000


def made(host_ns, period_ns, first_ns):
    """Samples made by ``host_ns``."""
    return int((host_ns - first_ns) // period_ns)


def watched(period_ns, first_ns, polls, late_ns=lambda place: 0, poll_ns=10_000_000):
    """A clock that has seen that many polls, and the time of the last."""
    clock = SampleClock(NOMINAL_NS)
    for place in range(polls):
        counted_ns = place * poll_ns + 123_457
        clock.observe(counted_ns + late_ns(place), made(counted_ns, period_ns, first_ns))
    return clock, counted_ns


def test_one_read_goes_by_the_nominal_period_to_half_a_sample():
    clock = SampleClock(NOMINAL_NS)
    assert not clock
    clock.observe(1_000_000_000, 7)
    assert clock
    assert clock.produced(1_000_000_000) == 7
    assert clock.produced(1_000_000_000 + 490_000) == 7
    assert clock.produced(1_000_000_000 + 510_000) == 8
    assert clock.produced(1_000_000_000 + 100 * NOMINAL_NS) == 107


@pytest.mark.parametrize("period_ns", [990_123.4, 999_171.3, 1_003_217.3, 1_009_987.6])
def test_the_period_is_that_of_the_stream(period_ns):
    clock, _ = watched(period_ns, 55_555.0, 1000)
    assert clock.period_ns() == pytest.approx(period_ns, rel=5e-6)


@pytest.mark.parametrize("period_ns", [990_123.4, 999_171.3, 1_003_217.3, 1_009_987.6])
def test_a_second_ahead_is_exact_wherever_in_a_sample_it_falls(period_ns, rng):
    clock, last_ns = watched(period_ns, 55_555.0, 1000)
    times = last_ns + rng.integers(50_000_000, 1_000_000_000, 500)
    errors = [clock.produced(int(time_ns)) - made(time_ns, period_ns, 55_555.0) for time_ns in times]
    assert np.mean(np.array(errors) == 0) > 0.95
    assert max(map(abs, errors)) <= 1


def test_polls_that_beat_with_the_samples_do_not_put_it_off_by_one():
    """Every poll a tenth of a microsecond further into a sample: the phase is never seen but at one place."""
    period_ns = NOMINAL_NS * (1 + 1e-8)
    for first_ns in (123_000.0, 123_400.0, -400_000.0, -876_000.0):
        clock, last_ns = watched(period_ns, first_ns, 300)
        ahead_ns = last_ns + 350_000_000  # a poll as any other
        assert clock.produced(ahead_ns) == made(ahead_ns, period_ns, first_ns)


def test_late_stamps_do_not_shift_the_phase(rng):
    """One poll in five is stamped up to 8 ms late: later than true, never earlier."""
    period_ns = 1_003_217.3
    late = np.where(rng.random(1000) < 0.2, rng.integers(0, 8_000_000, 1000), 0)
    late[-1] = 7_500_000
    clock, last_ns = watched(period_ns, 55_555.0, 1000, late_ns=lambda place: int(late[place]))
    times = last_ns + rng.integers(20_000_000, 200_000_000, 500)
    errors = [clock.produced(int(time_ns)) - made(time_ns, period_ns, 55_555.0) for time_ns in times]
    assert np.mean(np.array(errors) == 0) > 0.85
    assert max(map(abs, errors)) <= 1


def test_it_never_goes_back():
    clock, last_ns = watched(1_003_217.3, 55_555.0, 10)
    assert clock.produced(last_ns - 5_000_000) == made(last_ns, 1_003_217.3, 55_555.0)


def test_after_a_new_phase_the_period_is_remembered():
    clock, last_ns = watched(1_009_987.6, 55_555.0, 500)
    clock.forget_phase()
    assert not clock
    clock.observe(last_ns, 100)
    assert clock.period_ns() == pytest.approx(1_009_987.6, rel=1e-5)
    assert clock.produced(last_ns + 1_000_000_000) == 100 + round(1e9 / 1_009_987.6)


def test_a_chip_that_makes_nothing_leaves_the_period_alone():
    clock = SampleClock(NOMINAL_NS)
    for place in range(100):
        clock.observe(place * 10_000_000, 5)
    assert clock.period_ns() == NOMINAL_NS
