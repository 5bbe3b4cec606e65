"""Two recorders without a common pulse: what one clock is on the other's time, or a refusal."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal

from onboard.timebase.resync import Alignment, RecorderStream, ResyncError, align, shocks

Floats = NDArray[np.float64]

FINE_S = 5e-4
PEAK_HZ = 1.5
LENGTH_S = 40.0


def wander(rng: np.random.Generator, columns: int, cutoff_Hz: float = 2.0) -> Floats:
    """Smooth random motion, (n, columns), unit variance, a sample every FINE_S."""
    low_pass = signal.butter(3, cutoff_Hz, fs=1.0 / FINE_S, output="sos")
    made = signal.sosfilt(low_pass, rng.standard_normal((round(LENGTH_S / FINE_S), columns)), axis=0)
    return made / made.std(axis=0)


def seen_at(times_s: Floats, motion: Floats) -> Floats:
    """The motion (n, columns) at ``times_s``."""
    grid_s = np.arange(len(motion)) * FINE_S
    return np.column_stack([np.interp(times_s, grid_s, column) for column in motion.T])


def recorders(
    rng: np.random.Generator, rate: float, start_s: float, drift_per_s: float = 0.0, noise: float = 0.02
) -> tuple[RecorderStream, RecorderStream, Floats]:
    """A gyro on the reference's clock, five joints on another, and the true reference times of the latter's samples."""
    joints = wander(rng, 5)
    gyro_s = np.arange(0.0, LENGTH_S, 1e-3)
    gyro = 0.3 + seen_at(gyro_s, joints @ rng.standard_normal((5, 3)))
    own_s = np.arange(0.0, 0.75 * LENGTH_S, 2e-3)
    true_s = start_s + (1.0 + rate + 0.5 * drift_per_s * own_s) * own_s
    encoders = seen_at(true_s, joints)
    return (
        RecorderStream(gyro_s, gyro + noise * rng.standard_normal(gyro.shape)),
        RecorderStream(own_s + 1000.0, encoders),
        true_s,
    )


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32), rate=st.floats(-0.02, 0.02), start_s=st.floats(0.0, 9.0))
def test_any_offset_and_rate_are_found_through_an_unknown_map(seed: int, rate: float, start_s: float) -> None:
    reference, other, true_s = recorders(np.random.default_rng(seed), rate, start_s)

    found = align(reference, other, PEAK_HZ)

    error_s = found.reference_s(other.time_s) - true_s
    half_a_millisecond = 5e-4
    assert np.abs(error_s).max() < half_a_millisecond
    assert found.explained > 0.98


def test_stated_sigma_is_that_of_the_error() -> None:
    found: list[tuple[Alignment, float]] = []
    for seed in range(20):
        reference, other, true_s = recorders(np.random.default_rng(seed), 0.01, 3.0, noise=1.0)
        one = align(reference, other, PEAK_HZ)
        middle = int(np.argmin(np.abs(other.time_s - one.pivot_s)))
        found.append((one, float(one.reference_s(other.time_s)[middle] - true_s[middle])))
    normalised = np.array([error / one.sigma_offset_s for one, error in found])
    assert 0.7 < np.sqrt(np.mean(normalised**2)) < 1.4


def test_drift_of_the_other_clock_is_followed() -> None:
    reference, other, true_s = recorders(np.random.default_rng(1), 0.01, 3.0, drift_per_s=2e-5)

    found = align(reference, other, PEAK_HZ)

    assert found.drift_per_s == pytest.approx(2e-5, rel=0.1)
    assert np.abs(found.reference_s(other.time_s) - true_s).max() < 5e-4


def test_rate_that_is_known_is_not_fitted() -> None:
    reference, other, _ = recorders(np.random.default_rng(2), 0.0, 3.0)

    found = align(reference, other, PEAK_HZ, rate_limit=0.0)

    assert (found.rate, found.drift_per_s, found.sigma_rate) == (0.0, 0.0, 0.0)
    assert found.offset_s + 1000.0 == pytest.approx(3.0, abs=2e-4)


def test_periodic_motion_is_refused_and_the_period_named(rng: np.random.Generator) -> None:
    times_s = np.arange(0.0, LENGTH_S, 1e-3)
    own_s = np.arange(0.0, 20.0, 2e-3)

    def stroke(at_s: Floats) -> Floats:  # to and fro once in 2 s, with pauses at the ends
        return signal.sawtooth(2 * np.pi * 0.5 * at_s, 0.5).clip(-0.6, 0.6)

    gyro = stroke(times_s)[:, None] * [1.0, 0.3, -0.5] + 0.02 * rng.standard_normal((len(times_s), 3))
    joint = stroke(own_s)[:, None]

    with pytest.raises(ResyncError, match=r"another offset, [+-]\d+\.\d+ s from the best"):
        align(RecorderStream(times_s, gyro), RecorderStream(own_s, joint), PEAK_HZ)


def test_recordings_of_different_motions_are_refused() -> None:
    reference, _, _ = recorders(np.random.default_rng(3), 0.0, 3.0)
    _, other, _ = recorders(np.random.default_rng(4), 0.0, 3.0)

    with pytest.raises(ResyncError, match="the recordings have no common motion"):
        align(reference, RecorderStream(other.time_s, other.values[:, :1]), PEAK_HZ)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s: RecorderStream(s.time_s[::-1], s.values), "do not rise"),
        (lambda s: RecorderStream(s.time_s[:1000], s.values[:1000]), "shorter than 6 periods"),
        (lambda s: RecorderStream(s.time_s[::100], s.values[::100]), "lower the frequency to 0.5 Hz"),
    ],
)
def test_recordings_that_cannot_serve_are_named(spoil, message) -> None:  # type: ignore[no-untyped-def]
    reference, other, _ = recorders(np.random.default_rng(5), 0.0, 3.0)
    with pytest.raises(ResyncError, match=message):
        align(reference, spoil(other), PEAK_HZ)


def tapped(times_s: Floats, taps_s: Floats, rng: np.random.Generator, columns: int, noise: float) -> Floats:
    """What a recorder shows of a mallet: rings at 180 Hz for 10 ms, another strength each time, in each column."""
    since_s = times_s[:, None] - taps_s
    ring = np.where(since_s >= 0.0, np.exp(-since_s.clip(0.0) / 0.01) * np.sin(2 * np.pi * 180.0 * since_s), 0.0)
    return ring @ rng.uniform(2.0, 9.0, (len(taps_s), columns)) + noise * rng.standard_normal((len(times_s), columns))


def test_taps_of_a_mallet_align_recorders_that_measure_nothing_alike(rng: np.random.Generator) -> None:
    taps_s = np.sort(rng.uniform(12.0, 28.0, 7))
    imu_s, own_s = np.arange(0.0, 40.0, 1e-3), np.arange(0.0, 30.0, 2e-3)
    true_s = 6.0 + 1.004 * own_s
    imu = shocks(RecorderStream(imu_s, tapped(imu_s, taps_s, rng, 3, 0.1)), 0.005)
    encoder = shocks(RecorderStream(own_s, tapped(true_s, taps_s, rng, 1, 0.1)), 0.005)

    found = align(imu, encoder, 15.0, rate_limit=0.02, first_s=28.0)

    between = (true_s > taps_s[0]) & (true_s < taps_s[-1])
    two_milliseconds = 2e-3
    assert np.abs(found.reference_s(own_s) - true_s)[between].max() < two_milliseconds


def test_evenly_spaced_taps_are_refused(rng: np.random.Generator) -> None:
    taps_s = np.arange(12.0, 28.0, 2.0)
    imu_s, own_s = np.arange(0.0, 40.0, 1e-3), np.arange(8.0, 20.0, 2e-3)
    imu = shocks(RecorderStream(imu_s, tapped(imu_s, taps_s, rng, 3, 0.1)), 0.005)
    encoder = shocks(RecorderStream(own_s, tapped(own_s, taps_s, rng, 1, 0.1)), 0.005)

    with pytest.raises(ResyncError, match="explains the motion nearly as well"):
        align(imu, encoder, 15.0, rate_limit=0.0, first_s=10.0)


def test_a_delay_put_on_the_wheel_of_recorded_throws_is_found(datasets: Path) -> None:
    """Real throws (TU Delft): gyro and flywheel; its own lag of 0 to 3 ms is there both times."""
    throws = sorted((datasets / "tudelft_tumbling").glob("*.npz"))
    assert len(throws) == 33
    for delay_s, throw in zip(np.linspace(0.004, 0.05, len(throws)), throws, strict=True):
        recorded = np.load(throw)
        time_s = (recorded["time_us"] - recorded["time_us"][0]) * 1e-6
        gyro = RecorderStream(time_s, np.deg2rad(recorded["gyro_raw"] / 16.384))
        wheel = recorded["erpm_raw"].reshape(-1, 1).astype(float)
        late_s = time_s[::2] + delay_s  # another recorder: half as many samples, from another one on
        as_recorded = align(gyro, RecorderStream(time_s, wheel), 35.0, rate_limit=0.0, offset_limit_s=0.1)
        delayed = align(gyro, RecorderStream(late_s[60:], wheel[::2][60:]), 35.0, rate_limit=0.0, offset_limit_s=0.1)
        half_a_millisecond = 5e-4
        assert as_recorded.offset_s - delayed.offset_s == pytest.approx(delay_s, abs=half_a_millisecond), throw.name
