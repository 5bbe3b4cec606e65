"""Alignment of two recorders without a common pulse, from the motion that both measured.

The signals of the reference (a gyro, say) are modelled as a constant linear map of signals predicted from the other
recorder (joint rates through the vehicle model, say), shifted by the offset and rate of the other's clock. The map is
estimated with the clock (variable projection), so payload, mounting and scale need not be known. The share of the
reference's energy explained by the map is maximised: by Fourier transform over all offsets and a grid of rates, then by
Gauss-Newton steps on a growing span, to a small fraction of a sample.

An offset is refused if another one explains the reference nearly as well (periodic motion).
"""

import functools
from typing import NamedTuple

import numpy as np
from scipy import fft, interpolate, linalg

from onboard.estimation.arrays import FloatArray

NATS_REQUIRED = 6.0  # log likelihood of the best offset over any other: odds of 400 to 1
BLOCKS = 12  # blocks of residuals for the covariance
FIRST = 12.0  # periods in the first search window
GROWTH = 1.6
STEPS = 30
SIGMAS_TO_BEND = 4.0  # significance of the drift required to fit it
ORDER = 3  # number of filter passes
GRID = 12.0  # samples per period of the pass frequency
REACH = 4.0  # reach of one filter pass, standard deviations of its Gaussian
SHORTEST = 6.0  # shortest recording, periods


class ResyncError(ValueError):
    """The offset of the two clocks cannot be determined; the message gives reason and remedy."""


class RecorderStream(NamedTuple):
    """Signals of a recorder: times on its own clock, and values."""

    time_s: FloatArray  # (n,), rising
    values: FloatArray  # (n, k)


class Alignment(NamedTuple):
    """Reference time = ``offset_s + (1 + rate) * (other's time - pivot_s) + pivot_s``, plus drift.

    ``drift_per_s``: change of the rate, 1/s, about ``pivot_s``; zero if not significant.
    """

    offset_s: float
    rate: float
    drift_per_s: float
    pivot_s: float
    sigma_offset_s: float
    sigma_rate: float
    explained: float  # share of the reference's energy
    nats: float  # log likelihood over the next best offset
    runner_up_s: float  # next best offset minus the best
    span_s: float  # length of the common time used

    def reference_s(self, time_s: FloatArray) -> FloatArray:
        """Times of the other recorder (n,) on the reference's clock."""
        tau = time_s - self.pivot_s
        placed: FloatArray = self.pivot_s + self.offset_s + (1.0 + self.rate + 0.5 * self.drift_per_s * tau) * tau
        return placed


def align(
    reference: RecorderStream,
    other: RecorderStream,
    peak_Hz: float,
    rate_limit: float = 0.02,
    offset_limit_s: float = np.inf,
    first_s: float | None = None,
) -> Alignment:
    """Find the clock of ``other`` on the time of ``reference``.

    Args:
        reference: k signals.
        other: p signals of which the reference's are an unknown linear map.
        peak_Hz: centre of the band-pass (about half to double this frequency; removes bias and drift): choose the
            frequency of the strongest motion that both measure.
        rate_limit: largest relative rate error of the other clock; 0: the rate is known.
        offset_limit_s: largest offset; default: as far as the recordings overlap.
        first_s: length of the first search window; default: twelve periods.

    Raises:
        ResyncError: too little motion, or more than one offset that explains it.
    """
    step_s = 1.0 / (GRID * peak_Hz)
    seen, told = _band_passed(reference, peak_Hz, step_s), _band_passed(other, peak_Hz, step_s)
    span_s = _first_span_s(seen, told, first_s or FIRST / peak_Hz)
    search = _search(seen, _most_energetic(told, span_s), peak_Hz, rate_limit, offset_limit_s)
    best, nats, runner_up_s = _stands_out(search, peak_Hz)
    pivot_s, first_s = search.pivot_s, search.offsets_s[best]
    theta, rate = np.array([first_s]), 0.0
    if rate_limit:
        # The filter must act alike on both, so the other's is repeated on the approximately corrected clock.
        theta = np.array([first_s, search.rate])
        rate = float(_grown(seen, told, theta, pivot_s, span_s).theta[1])
        nearly = pivot_s + (1.0 + rate) * (other.time_s - pivot_s)
        told = _band_passed(RecorderStream(nearly, other.values), peak_Hz, step_s)
        theta[1] = 0.0
    fit = _grown(seen, told, theta, pivot_s, span_s)
    offset_s, more, drift = (*fit.theta, 0.0, 0.0)[:3]
    sigma_offset_s, sigma_rate = (*np.sqrt(np.diag(fit.covariance)), 0.0)[:2]
    return Alignment(
        offset_s=float(offset_s),
        rate=float((1.0 + rate) * (1.0 + more) - 1.0),
        drift_per_s=float(drift * (1.0 + rate) ** 2),
        pivot_s=pivot_s,
        sigma_offset_s=float(sigma_offset_s),
        sigma_rate=float(sigma_rate),
        explained=fit.explained,
        nats=nats,
        runner_up_s=runner_up_s,
        span_s=fit.span_s,
    )


def _grown(seen: RecorderStream, told: RecorderStream, theta: FloatArray, pivot_s: float, first_s: float) -> "_Fit":
    """Fit on a span about the pivot that grows to the whole, so that the error at its ends stays below a period."""
    spline = interpolate.CubicSpline(told.time_s, told.values)
    low, high = pivot_s - 0.5 * first_s, pivot_s + 0.5 * first_s
    while True:
        low, high = max(told.time_s[0], low), min(told.time_s[-1], high)
        fit = _refine(seen, spline, theta, pivot_s, (low, high))
        if low == told.time_s[0] and high == told.time_s[-1]:
            break
        theta = fit.theta
        low, high = pivot_s - GROWTH * (pivot_s - low), pivot_s + GROWTH * (high - pivot_s)
    if len(fit.theta) == 1:
        return fit
    bent = _refine(seen, spline, np.append(fit.theta, 0.0), pivot_s, (low, high))
    return bent if abs(bent.theta[2]) > SIGMAS_TO_BEND * np.sqrt(bent.covariance[2, 2]) else fit


def _band_passed(stream: RecorderStream, peak_Hz: float, step_s: float) -> RecorderStream:
    """ORDER passes of the derivative of a Gaussian, on a uniform grid of ``step_s``, without phase shift."""
    if np.any(np.diff(stream.time_s) <= 0.0):
        raise ResyncError("times of a recording do not rise: sort it, or mend its clock")
    if not len(stream.time_s) or np.ptp(stream.time_s) < SHORTEST / peak_Hz:
        raise ResyncError(f"a recording is shorter than {SHORTEST:g} periods of {peak_Hz:g} Hz: raise the frequency")
    between_s = float(np.median(np.diff(stream.time_s)))
    if between_s > 0.1 / peak_Hz:
        remedy = f"lower the frequency to {0.1 / between_s:.3g} Hz"
        raise ResyncError(f"a recording has a sample every {between_s:.3g} s: {remedy}")
    # a moving mean first if there are many samples per step: avoids aliasing by decimation
    width = max(1, round(step_s / between_s))
    mean = np.full(width, 1.0 / width)
    times_s = np.convolve(stream.time_s, mean, "valid")
    grid_s = np.arange(times_s[0], times_s[-1], step_s)
    spread = 1.0 / (2.0 * np.pi * peak_Hz * step_s)  # of the Gaussian, in steps
    reach = int(np.ceil(REACH * spread))
    at = np.arange(-reach, reach + 1)
    once = -at / spread * np.exp(-0.5 * (at / spread) ** 2)
    kernel = functools.reduce(np.convolve, [once] * ORDER)
    reach = len(kernel) // 2
    columns = [np.interp(grid_s, times_s, np.convolve(column, mean, "valid")) for column in stream.values.T]
    filtered = np.column_stack([np.convolve(column, kernel, "valid") for column in columns])
    return RecorderStream(grid_s[reach : len(grid_s) - reach], filtered)


def _most_energetic(stream: RecorderStream, span_s: float) -> RecorderStream:
    """The segment of ``span_s`` with the most energy, each signal normalised by its own."""
    step_s = stream.time_s[1] - stream.time_s[0]
    n = max(2, int(span_s / step_s))
    energy = ((stream.values / np.maximum(stream.values.std(axis=0), 1e-300)) ** 2).sum(axis=1)
    total = np.convolve(np.minimum(energy, 9.0 * np.median(energy) + 1e-300), np.ones(n), "valid")
    first = int(np.argmax(total))
    return RecorderStream(stream.time_s[first : first + n], stream.values[first : first + n])


class Candidate(NamedTuple):
    """A possible clock: reference time = ``pivot_s + offset_s + (1 + rate) * (other's time - pivot_s)``."""

    pivot_s: float
    offset_s: float
    rate: float
    explained: float  # share of the reference's energy


class _Search(NamedTuple):
    """Likelihood over all offsets, at the best rate."""

    pivot_s: float
    rate: float
    offsets_s: FloatArray  # (lags,)
    explained: FloatArray  # (lags,)
    likelihood: FloatArray  # (lags,) nats
    chance: float  # nats expected by chance for the best of so many offsets

    def peaks(self, apart_s: float, count: int) -> list[int]:
        """Lags of the highest peaks, at least ``apart_s`` from any higher one."""
        left = self.explained.copy()
        found: list[int] = []
        while len(found) < count and left.any():
            found.append(int(np.argmax(left)))
            left[np.abs(self.offsets_s - self.offsets_s[found[-1]]) < apart_s] = 0.0
        return found


def shocks(stream: RecorderStream, bin_s: float) -> RecorderStream:
    """Shock intensity per bin, (bins, 1), in which taps stand out for any kind of sensor.

    Logarithm of the sample differences in each bin over their median, so that weak and strong taps count alike.

    Args:
        stream: samples, several to a bin.
        bin_s: length of a bin, about the duration of a tap.
    """
    energy = (np.diff(stream.values, axis=0) ** 2).sum(axis=1)
    number = ((stream.time_s[1:] - stream.time_s[0]) // bin_s).astype(np.int64)
    filled, counts = np.unique(number, return_counts=True)
    rms = np.sqrt(np.bincount(number, energy)[filled] / counts)
    middle_s = stream.time_s[0] + (filled + 0.5) * bin_s
    return RecorderStream(middle_s, np.log1p(rms / max(float(np.median(rms)), 1e-300))[:, None])


def candidates(
    reference: RecorderStream, other: RecorderStream, peak_Hz: float, rate_limit: float, count: int
) -> list[Candidate]:
    """The best offsets in order, for a caller with a further criterion to choose among them.

    Args:
        reference: k signals.
        other: p signals, of which the reference's are nearly a linear map.
        peak_Hz: as for :func:`align`.
        rate_limit: largest relative rate error of the other clock.
        count: largest number of candidates.

    Raises:
        ResyncError: recordings too short or too coarse.
    """
    step_s = 1.0 / (GRID * peak_Hz)
    seen, told = _band_passed(reference, peak_Hz, step_s), _band_passed(other, peak_Hz, step_s)
    window = _most_energetic(told, _first_span_s(seen, told, FIRST / peak_Hz))
    found = _search(seen, window, peak_Hz, rate_limit, np.inf)
    return [
        Candidate(found.pivot_s, float(found.offsets_s[lag]), found.rate, float(found.explained[lag]))
        for lag in found.peaks(0.5 / peak_Hz, count)
    ]


def _first_span_s(seen: RecorderStream, told: RecorderStream, wanted_s: float) -> float:
    return float(min(wanted_s, 0.9 * np.ptp(told.time_s), 0.9 * np.ptp(seen.time_s)))


def _search(
    seen: RecorderStream, window: RecorderStream, peak_Hz: float, rate_limit: float, offset_limit_s: float
) -> _Search:
    """Explained share over all offsets, at the best of a grid of rates."""
    step_s = seen.time_s[1] - seen.time_s[0]
    span_s, middle_s = float(np.ptp(window.time_s)), float(window.time_s.mean())
    # a rate error of half a grid step shifts the window's ends by a twentieth of a period
    rate_step = 0.2 / (peak_Hz * span_s)
    rates = np.linspace(-rate_limit, rate_limit, 2 * int(np.ceil(rate_limit / rate_step)) + 1) if rate_limit else [0.0]
    spline = interpolate.CubicSpline(window.time_s, window.values)
    best = (-1.0, 0.0, np.zeros(0), np.zeros(0))
    for rate in rates:
        n = int(span_s * (1.0 + rate) / step_s)
        grid_s = (np.arange(n) - 0.5 * (n - 1)) * step_s
        features = spline(np.clip(middle_s + grid_s / (1.0 + rate), window.time_s[0], window.time_s[-1]))
        explained = _explained(seen.values, features)
        offsets_s = seen.time_s[0] + (np.arange(len(explained)) + 0.5 * (n - 1)) * step_s - middle_s
        explained = np.where(np.abs(offsets_s) <= offset_limit_s, explained, 0.0)
        if explained.max(initial=0.0) > best[0]:
            best = float(explained.max(initial=0.0)), float(rate), explained, offsets_s
    _, rate, explained, offsets_s = best
    per_s = 2.0 * min(_bandwidth(seen), _bandwidth(window))  # independent samples
    signals = seen.values.shape[1]
    # log likelihood of an offset with unknown noise, and the maximum of so many expected by chance
    likelihood = -0.5 * per_s * span_s * signals * np.log1p(-np.minimum(explained, 1.0 - 1e-12))
    tried = max(2.0, np.count_nonzero(explained) * step_s * per_s * len(rates))
    chance = 0.5 * signals * window.values.shape[1] + float(np.log(tried))
    return _Search(middle_s, rate, offsets_s, explained, likelihood, chance)


def _stands_out(found: _Search, peak_Hz: float) -> tuple[int, float, float]:
    """The best lag, its lead in nats, and the next best offset relative to it.

    Raises:
        ResyncError: the lead is too small.
    """
    lags = found.peaks(0.5 / peak_Hz, 2)
    if not lags:
        raise ResyncError("the recordings do not overlap anywhere within the offsets allowed: widen them")
    best, other = lags[0], lags[-1]
    second = float(found.likelihood[other]) if other != best else 0.0
    nats = float(found.likelihood[best]) - max(second, found.chance)
    runner_up_s = float(found.offsets_s[other] - found.offsets_s[best])
    if nats < NATS_REQUIRED:
        share = f"{100 * found.explained[best]:.0f} %"
        why = (
            f"another offset, {runner_up_s:+.3f} s from the best, explains the motion nearly as well: it repeats itself"
            if second > found.chance
            else f"no offset explains more than {share} of it: the recordings have no common motion"
        )
        remedy = "give a longer or livelier stretch, or another frequency"
        raise ResyncError(f"{why} ({nats:.1f} of {NATS_REQUIRED:g} nats): {remedy}")
    return best, nats, runner_up_s


def _bandwidth(stream: RecorderStream) -> float:
    """Equivalent bandwidth of unit-variance signals: half the number of independent samples per second."""
    step_s = stream.time_s[1] - stream.time_s[0]
    power = (np.abs(fft.rfft(stream.values / np.maximum(stream.values.std(axis=0), 1e-300), axis=0)) ** 2).sum(axis=1)
    return float(power.sum() ** 2 / (power**2).sum() / (len(stream.time_s) * step_s))


def _explained(seen: FloatArray, features: FloatArray) -> FloatArray:
    """Share of the energy of ``seen`` (n, k) that a linear map of ``features`` (m, p) explains, (n - m + 1,) lags."""
    n, m = len(seen), len(features)
    if m > n:
        return np.zeros(0)
    size = fft.next_fast_len(n + m)
    transformed = fft.rfft(seen, size, axis=0)
    # whitening the features makes the explained energy a plain sum of squares
    scale = linalg.sqrtm(np.linalg.pinv(features.T @ features, rcond=1e-10, hermitian=True)).real
    correlated = [
        fft.irfft(transformed * np.conj(fft.rfft(column, size))[:, None], size, axis=0)[: n - m + 1]
        for column in (features @ scale).T
    ]
    energy = np.convolve((seen**2).sum(axis=1), np.ones(m), "valid")
    share: FloatArray = sum((c**2).sum(axis=1) for c in correlated) / np.maximum(
        energy, 1e-12 * energy.max(initial=1e-300)
    )
    return share


class _Fit(NamedTuple):
    theta: FloatArray  # offset, rate and perhaps drift
    covariance: FloatArray
    explained: float
    span_s: float


def _refine(
    seen: RecorderStream, spline: interpolate.CubicSpline, theta: FloatArray, pivot_s: float, span: tuple[float, float]
) -> _Fit:
    """Gauss-Newton on offset, rate (and drift), the linear map projected out; covariance from blocks of residuals."""
    theta = theta.copy()
    slope = spline.derivative()
    inside = np.zeros(len(seen.time_s), bool)
    for iteration in range(STEPS):
        tau, stretch = _other_s(seen.time_s - pivot_s, theta)
        if iteration == 0:
            inside = (tau + pivot_s >= span[0]) & (tau + pivot_s <= span[1])
        tau, stretch = tau[inside], stretch[inside]
        times = np.clip(tau + pivot_s, spline.x[0], spline.x[-1])
        features, rates = spline(times), slope(times)
        y = seen.values[inside]
        base, _ = np.linalg.qr(features)
        mapped, *_ = np.linalg.lstsq(features, y, rcond=None)
        residual = y - features @ mapped
        # d tau / d theta = -(1, tau, tau^2 / 2) / stretch
        powers = np.stack([np.ones_like(tau), tau, 0.5 * tau**2][: len(theta)], axis=1)
        moved = -(rates @ mapped)[:, :, None] * (powers / stretch[:, None])[:, None, :]  # (n, k, theta)
        jacobian = moved - np.einsum("ip,pkt->ikt", base, np.einsum("ip,ikt->pkt", base, moved))
        normal = np.einsum("ikt,iks->ts", jacobian, jacobian)
        step = np.linalg.solve(normal, np.einsum("ikt,ik->t", jacobian, residual))
        theta = theta + step
        if np.all(np.abs(step) * np.ptp(tau) ** np.arange(len(step)) < 1e-9):
            break
    blocks = np.array_split(np.arange(len(y)), BLOCKS)
    scores = np.stack([np.einsum("ikt,ik->t", jacobian[b], residual[b]) for b in blocks])
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (scores.T @ scores) @ inverse * BLOCKS / (BLOCKS - len(theta))
    return _Fit(theta, covariance, 1.0 - float((residual**2).sum() / (y**2).sum()), float(np.ptp(tau)))


def _other_s(reference_s: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The other's time for times on the reference, both minus the pivot, and d reference / d other."""
    offset_s, rate, drift = (*theta, 0.0, 0.0)[:3]
    tau = (reference_s - offset_s) / (1.0 + rate)
    for _ in range(3 if drift else 0):
        placed = offset_s + (1.0 + rate + 0.5 * drift * tau) * tau
        tau = tau - (placed - reference_s) / (1.0 + rate + drift * tau)
    return tau, 1.0 + rate + drift * tau
