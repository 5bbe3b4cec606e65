"""Spectra and intervals between samples, against signals whose spectra and intervals are known."""

import numpy as np
import pytest

from onboard.ground.report.flight.streams import SEGMENT, Intervals, Spectrum

RATE_HZ = 1000.0
ROW = np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), ("tick", "<u8")])


def test_white_noise_has_the_density_of_its_variance(rng: np.random.Generator) -> None:
    """One-sided: sigma^2 spread over half the rate."""
    spectrum = Spectrum(2)
    values = rng.normal(size=(200_000, 2)) * [1.0, 3.0]
    for start in range(0, len(values), 8192):
        block = values[start : start + 8192]
        spectrum.add(np.arange(start, start + len(block)), block)
    frequency, density = spectrum.density(RATE_HZ)
    assert frequency[0] == pytest.approx(RATE_HZ / SEGMENT)
    inner = slice(4, -4)  # the mean of a segment is taken out of the first bins
    expected = np.array([1.0, 3.0]) * np.sqrt(2.0 / RATE_HZ)
    assert np.sqrt((density[inner] ** 2).mean(axis=0)) == pytest.approx(expected, rel=0.02)


def test_segments_end_at_gaps_and_unusable_samples() -> None:
    spectrum = Spectrum(1)
    sequence = np.concatenate([np.arange(SEGMENT), np.arange(SEGMENT) + 2 * SEGMENT])  # a gap in the middle
    spectrum.add(sequence, np.ones((2 * SEGMENT, 1)))
    assert spectrum.segments == 2
    values = np.ones((2 * SEGMENT, 1))
    values[SEGMENT - 1] = np.nan  # no whole segment before it, one after it
    spectrum.add(np.arange(2 * SEGMENT), values)
    assert spectrum.segments == 3


def test_intervals_leave_gaps_out_and_know_the_longest() -> None:
    rows = np.zeros(1000, ROW)
    rows["sequence"] = rows["tick"] = np.arange(1000)
    rows["host_ns"] = np.arange(1000) * 5_000_000
    rows["host_ns"][500:] += 700_000  # one late arrival, of a sample that follows the one before
    rows["sequence"][800:] += 10  # a gap: the step over it is no jitter
    rows["host_ns"][800:] += 50_000_000
    intervals = Intervals()
    intervals.add(rows)
    arrival, sampled = intervals.arrival(), intervals.sampled(5e6)
    assert arrival is not None
    assert sampled is not None
    assert (arrival.median, arrival.most, len(arrival.kept)) == (5e6, 5.7e6, 998)
    assert (sampled.median, sampled.rms, sampled.most) == (5e6, 0.0, 5e6)
