"""Low-pass kernel (B-spline) and its derivatives, applied to irregularly timed samples.

Both sides of every measurement row go through the *same* filter, so that a linear relation between signals stays
exact after smoothing: for one kernel h, ``(h * q)'' = h'' * q = h * (q'')``. The kernel is

    h = B - (mu_2 / 2) B''

with B the B-spline of order 8 stretched over the full width W and ``mu_2 = W^2 / 96`` its second moment. The second
moment of h is therefore zero: h passes cubics unchanged, and the error of products of smoothed signals (rows are not
linear in the rates) is of fourth order in the width, not of second.

Known limits: the kernel is centred, so a tick needs samples up to half a width after it (fixed-lag smoothing). It is 3
dB down at 2.2 / W and 40 dB down at 5.2 / W (Hz, W in s). Samples under a kernel and its values there are computed in
``onboard/native/src/smoothing.c``.
"""

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from onboard.estimation.arrays import TINY, BoolArray, FloatArray
from onboard.estimation.errors import RowError
from onboard.native import library, structures

CUTS_OFF = 2.2  # Hz, over the width in s: 3 dB
ORDER = 8  # of the B-spline: degree 7, so that its fourth derivative, needed for h'', is smooth
_MU2 = 1.0 / (12.0 * ORDER)  # second moment of B on a full width of one
_MIN_SAMPLES = 5
_CHUNK_CELLS = 200_000
_FORGOTTEN = 40.0  # delays of a filter after which a sample tells nothing of another


class Smoothed(NamedTuple):
    """Smoothed values at the ticks; rows of invalid ticks are NaN."""

    values: FloatArray  # (n, c)
    valid: BoolArray  # (n,)
    noise_gain: FloatArray  # (n,) sigma of a value per sigma of white sample noise


Shape = Callable[[FloatArray], FloatArray]


class Kernel(NamedTuple):
    """Weighting function of the samples about a tick: ``y(t) = integral K(u) x(t + u W) du`` over -1/2..1/2.

    It is even, and its integral is one.
    """

    parts: tuple[Shape, Shape, Shape]  # K, K', K''
    second_moment: float = 0.0

    @property
    def of_powers(self) -> FloatArray:
        """Value and two derivatives at the tick of the kernel's output for 1, u and u^2, (3, 3)."""
        return np.array([[1.0, 0.0, self.second_moment], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]])


class _Pieces(NamedTuple):
    """Functions that are polynomials on each of :data:`ORDER` intervals of -1/2..1/2, and zero beyond.

    Our own: :mod:`scipy.interpolate` is 12 MB in each process of an estimator.
    """

    coefficients: FloatArray  # (powers of the place in the interval from 0 to 1, functions, intervals)

    def __call__(self, u: FloatArray) -> FloatArray:
        """The functions at ``u``, (functions, ...)."""
        u, (powers, functions, intervals) = library.given(u, *u.shape), self.coefficients.shape
        coefficients = library.given(self.coefficients, powers, functions, intervals)
        numbers = library.address(coefficients), powers, functions, intervals, library.address(u), u.size
        return library.call("heft_pieces", *numbers, out=np.empty((functions, *u.shape)))

    def derived(self) -> "_Pieces":
        """Their derivatives."""
        derivative = np.zeros_like(self.coefficients)
        derivative[:-1] = self.coefficients[1:] * (ORDER * np.arange(1.0, ORDER))[:, None, None]
        return _Pieces(derivative)

    def alone(self, function: int) -> Shape:
        """One of them."""
        return _One(_Pieces(self.coefficients[:, [function]]))


@dataclass(frozen=True, eq=False)
class _One:
    """The first one of some functions, by itself."""

    pieces: _Pieces

    def __call__(self, u: FloatArray) -> FloatArray:
        """The function at ``u``."""
        value: FloatArray = self.pieces(u)[0]
        return value


def _base() -> _Pieces:
    """B: ``ORDER sum_i (-1)^i C(ORDER, i) (x - i)^(ORDER - 1) / (ORDER - 1)!`` over i up to x (Schoenberg, 1946)."""
    degree, intervals = ORDER - 1, range(ORDER)
    whole = [  # exact: integers
        [
            sum((-1) ** i * math.comb(ORDER, i) * math.comb(degree, k) * (j - i) ** (degree - k) for i in range(j + 1))
            for j in intervals
        ]
        for k in range(ORDER)
    ]
    return _Pieces(np.array(whole, np.float64)[:, None] * (ORDER / math.factorial(degree)))


def _unit_kernels() -> tuple[Shape, Kernel, _Pieces]:
    """B, (h, h', h''), and all four of them beside each other, on the full width -1/2..1/2."""
    derivatives = [_base()]
    for _ in range(4):
        derivatives.append(derivatives[-1].derived())
    each = [part.coefficients for part in derivatives]
    together = _Pieces(np.concatenate([each[0], *(each[k] - 0.5 * _MU2 * each[k + 2] for k in range(3))], axis=1))
    return together.alone(0), Kernel((together.alone(1), together.alone(2), together.alone(3))), together


BASE, SPLINE, SPLINE_TOGETHER = _unit_kernels()


class SmoothingWindow:
    """Samples under the kernel at each tick, and their weights for any derivative of signals at these sample times.

    Args:
        times_s: sample times, (k,), strictly increasing, not necessarily even.
        at_s: ticks, (n,), in any order.
        width_s: full width of the kernel.
        max_gap_s: a tick is invalid if two neighbouring samples of its window (or a sample and the window's edge) are
            further apart. Default: a fifth of the width.
        kernel: :data:`SPLINE`, or one of :mod:`onboard.estimation.kinematics`.

    Raises:
        RowError: times that are not finite or do not increase, or a width that is not positive.
    """

    def __init__(
        self,
        times_s: ArrayLike,
        at_s: ArrayLike,
        width_s: float,
        max_gap_s: float | None = None,
        kernel: Kernel = SPLINE,
    ) -> None:
        times = np.asarray(times_s, np.float64)
        at = np.atleast_1d(np.asarray(at_s, np.float64))
        spacing = times[1:] - times[:-1] if times.ndim == 1 else times
        increases = not spacing.size or spacing.min() > 0.0  # False where one is NaN
        ends = times.size == 0 or (math.isfinite(times.flat[0]) and math.isfinite(times.flat[-1]))
        if times.ndim != 1 or at.ndim != 1 or not (ends and increases and np.isfinite(at).all()):
            if times.ndim == 1 == at.ndim and np.isfinite(times).all() and np.isfinite(at).all():
                raise RowError("sample times must increase strictly; sort them and drop duplicates first")
            raise RowError("sample times and ticks must be finite vectors; drop samples without a time first")
        if not 0.0 < width_s < np.inf:
            raise RowError(f"the smoothing width is {width_s} s; it must be positive")
        gap = width_s / 5.0 if max_gap_s is None else max_gap_s
        self.width_s = width_s
        self.kernel = kernel
        self.samples = times.size
        begin, end = at - 0.5 * width_s, at + 0.5 * width_s
        low, high = times.searchsorted(begin, side="right"), times.searchsorted(end, side="left")
        count = high - low
        self.valid: BoolArray = count >= _MIN_SAMPLES  # (n,)
        length = max(int(count.max(initial=1)), 1)
        self._low, self._length = np.ascontiguousarray(low, np.int64), length
        if not self.valid.any():  # it changes below
            return
        given = library.given(times, times.size), library.given(at, at.size), low, high
        windows = structures.UnderKernel(times.size, at.size, length, *given)
        out = np.empty(at.size * (2 * length + 1))
        library.call("heft_under", ctypes.byref(windows), width_s, gap * (1.0 + 1e-9), out=out)
        # (n, l) places in widths, and quadrature weights
        self._u, self._cell, near = library.carved(out, [(at.size, length), (at.size, length), (at.size,)])
        self.valid &= near != 0.0

    @cached_property
    def weights(self) -> tuple[FloatArray, FloatArray]:
        """Of the samples under each window for three derivatives, (n, 3, l); roots of their sums of squares, (3, n).

        Kernel values times trapezoidal cells, plus the smallest correction (weighted with B about its middle) that
        makes the derivative of quadratic polynomials equal to the kernel's, for any sample times. Weights of invalid
        ticks are zero.
        """
        n, length = self.valid.size, self._length
        if not self._some:
            return np.zeros((n, 3, length)), np.full((3, n), np.nan)
        u = self._u
        if self.kernel is SPLINE:
            shapes = SPLINE_TOGETHER(u)
        else:
            shapes = np.stack([part(u) for part in (BASE, *self.kernel.parts)])
        given = u, self._cell, shapes, self.valid.astype(np.float64), self.kernel.of_powers
        pointers, out = (library.address(part) for part in given), np.empty(3 * n * (length + 1))
        library.call("heft_weights", n, length, *pointers, self.width_s, out=out)
        return out[: 3 * n * length].reshape(n, 3, length), out[3 * n * length :].reshape(3, n)

    @cached_property
    def _some(self) -> bool:
        """Whether any tick is valid."""
        return bool(self.valid.any())

    def apply(self, values: ArrayLike, derivative: int = 0) -> Smoothed:
        """The ``derivative``-th derivative of the smoothed ``values`` at every tick: :meth:`derivatives`."""
        [smoothed] = self.derivatives(values, (derivative,))
        return smoothed

    def derivatives(self, values: ArrayLike, orders: Sequence[int]) -> list[Smoothed]:
        """Derivatives of the smoothed ``values`` at every tick.

        Args:
            values: (k,) or (k, c), at the window's sample times.
            orders: each 0, 1 or 2.

        Raises:
            RowError: a wrong length, or a value that is not finite.
        """
        smoothed, gains = self.stacked(values, orders)
        return [Smoothed(smoothed[k], self.valid, gains[k]) for k in range(len(orders))]

    def stacked(self, values: ArrayLike, orders: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Values, (o, n, c), and noise gains, (o, n), of :meth:`derivatives`, which has the arguments."""
        columns = np.asarray(values, np.float64)
        columns = columns[:, None] if columns.ndim == 1 else columns
        if columns.shape[0] != self.samples:
            raise RowError(f"{columns.shape[0]} values for {self.samples} sample times; give as many")
        if not np.isfinite(columns).all():
            raise RowError("values must be finite; drop invalid samples first, the hole counts as a gap")
        n, (weights, gains), leading = self.valid.size, self.weights, tuple(orders) == (0, 1, 2)[: len(orders)]
        if any(order not in (0, 1, 2) for order in orders):
            raise RowError(f"of derivatives {[*orders]} one is not 0, 1 or 2")
        most, given = max(orders, default=-1) + 1, library.given(columns, *columns.shape)
        numbers = n, self._length, most, *columns.shape
        pointers = (library.address(part) for part in (weights, self._low, given))
        values_at = library.call("heft_weighed", *numbers, *pointers, out=np.empty((most, n, columns.shape[1])))
        if not self.valid.all():
            values_at[:, ~self.valid] = np.nan
        return (values_at, gains[:most]) if leading else (values_at[list(orders)], gains[list(orders)])

    def residuals(self, values: FloatArray) -> FloatArray:
        """By what the sample nearest to each tick is off the smoothed curve, (n, c), as large as the samples' noise.

        Args:
            values: of the samples, (k, c).
        """
        ticks = np.flatnonzero(self.valid)
        out = np.full((len(self.valid), values.shape[1]), np.nan)
        if ticks.size:
            near = np.where(self._cell[ticks] > 0.0, np.abs(self._u[ticks]), np.inf).argmin(axis=1)
            after_s = self._u[ticks, near] * self.width_s
            powers = np.stack([np.ones(ticks.size), after_s, 0.5 * after_s**2], axis=1)
            weights = -np.einsum("no,nol->nl", powers, self.weights[0][ticks])
            weights[np.arange(ticks.size), near] += 1.0
            under = np.minimum(self._low[ticks, None] + np.arange(self._length), self.samples - 1)
            off = np.einsum("nl,nlc->nc", weights, values[under])
            out[ticks] = off / np.sqrt(np.maximum((weights**2).sum(axis=1), TINY))[:, None]
        return out


def smooth(times_s: ArrayLike, values: ArrayLike, at_s: ArrayLike, width_s: float, derivative: int = 0) -> Smoothed:
    """Smoothed values, or a derivative of them, at the ticks ``at_s``; in constant memory for any number of ticks.

    Args:
        times_s: sample times, (k,), strictly increasing.
        values: (k,) or (k, c).
        at_s: ticks, (n,).
        width_s: full width of the kernel.
        derivative: 0, 1 or 2.

    Raises:
        RowError: see :class:`SmoothingWindow`.
    """
    times = np.asarray(times_s, np.float64)
    columns = np.asarray(values, np.float64)
    at = np.atleast_1d(np.asarray(at_s, np.float64))
    # Ticks are processed in groups that keep (ticks x samples under the kernel) small; bad arguments are refused below.
    spacing = (times[-1] - times[0]) / (times.size - 1) if times.size > 1 else 0.0
    step = max(1, int(_CHUNK_CELLS * spacing / width_s)) if 0.0 < spacing < np.inf and width_s > 0.0 else at.size
    if at.size <= step:
        return SmoothingWindow(times, at, width_s).apply(columns, derivative)
    parts = []
    for first in range(0, at.size, step):
        some = at[first : first + step]
        low = max(int(np.searchsorted(times, some.min() - width_s)) - 1, 0)
        high = int(np.searchsorted(times, some.max() + width_s)) + 1
        parts.append(SmoothingWindow(times[low:high], some, width_s).apply(columns[low:high], derivative))
    return Smoothed(
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.valid for part in parts]),
        np.concatenate([part.noise_gain for part in parts]),
    )


@lru_cache(maxsize=8)
def _gains_of_unit_width(kernel: Kernel) -> tuple[FloatArray, list[FloatArray]]:
    """Phases over the kernel's width, far beyond any kernel's pass band, and the gain at each, of each derivative."""
    u, phases = np.linspace(-0.5, 0.5, 1001), np.arange(0.0, 60.0, 0.1)
    turns = phases[:, None] * u
    shapes = np.stack([part(u) for part in kernel.parts], axis=1)
    return phases, list(np.hypot(np.cos(turns) @ shapes, np.sin(turns) @ shapes).T * (u[1] - u[0]))


class Response:
    """Frequency response of a kernel: gain of a sine, for the value and the two derivatives.

    Args:
        width_s: full width of the kernel.
        kernel: as given to :class:`SmoothingWindow`.
    """

    def __init__(self, width_s: float, kernel: Kernel = SPLINE) -> None:
        self._width_s = width_s
        self._phases, gains = _gains_of_unit_width(kernel)
        self._gains = [gain / width_s**k for k, gain in enumerate(gains)]

    def gain(self, rate_rad_s: FloatArray, derivative: int = 0) -> FloatArray:
        """Amplitude of the derivative per amplitude of a sine of these angular frequencies."""
        gain = np.interp(np.abs(rate_rad_s) * self._width_s, self._phases, self._gains[derivative], right=0.0)
        return np.asarray(gain, np.float64)


def correlation_inflation(width_s: float, row_period_s: float, kernel: Kernel = SPLINE) -> float:
    """Factor on the sigma of smoothed rows that accounts for their correlation in a least squares without it.

    Neighbouring rows share samples, so their errors are correlated. For a regressor that changes slowly over the
    kernel, N rows with sigma ``s * inflation`` carry the same information as the correlated rows: the square root of
        the sum of the
    row-error autocorrelations, ``sum_k rho(k T)``, white sample noise assumed.

    Args:
        width_s: full width of the kernel.
        row_period_s: time between rows.
        kernel: as given to :class:`SmoothingWindow`.

    Raises:
        RowError: an argument that is not positive.
    """
    if not (width_s > 0.0 and row_period_s > 0.0):
        raise RowError("the kernel's width and the row period must be positive")
    at, autocorrelation = _autocorrelation(kernel, 0)
    lags = np.arange(1, int(width_s / row_period_s) + 1) * (row_period_s / width_s)
    rho = np.interp(lags, at, autocorrelation, right=0.0)
    return float(np.sqrt(max(1.0 + 2.0 * rho.sum(), 1.0)))


@lru_cache(maxsize=8)
def alike_in_products(inflation: float, kernel: Kernel = SPLINE) -> float:
    """Rows in which a product of two errors is one value: ``sum_k rho(k T)^2``, of derivatives, too, to 5 %.

    Args:
        inflation: :func:`correlation_inflation` of the rows.
        kernel: as given to :class:`SmoothingWindow`.
    """
    rho = _autocorrelation(kernel, 0)[1]
    return max(inflation**2 * float(rho @ rho / rho.sum()), 1.0)


def uncorrelated_s(width_s: float, kernel: Kernel = SPLINE) -> float:
    """The least time between two rates of smoothed white noise that are uncorrelated; beyond it they are not alike."""
    at, autocorrelation = _autocorrelation(kernel, 1)
    return width_s * float(at[np.argmax(autocorrelation <= 0.0)])


@lru_cache(maxsize=8)
def jerk_factor(kernel: Kernel = SPLINE) -> float:
    """Of smoothed white noise: variances of the first and third derivative multiplied, over that of the second squared.

    The first and the third are correlated by minus the square root of its inverse; derivatives of neighbouring orders
    are not correlated (Papoulis, Probability, Random Variables, and Stochastic Processes, 1965, section 9-4).
    """
    u = np.linspace(-0.5, 0.5, 4001)
    _, first, second = (part(u) for part in kernel.parts)
    third = np.gradient(second, u)
    return float((third @ third) * (first @ first) / (second @ second) ** 2)


def _autocorrelation(kernel: Kernel, derivative: int) -> tuple[FloatArray, FloatArray]:
    """Of smoothed white noise, or of its derivative: lags in widths of the kernel, and the values there."""
    u = np.linspace(-0.5, 0.5, 4001)
    h = kernel.parts[derivative](u)
    auto = np.correlate(h, h, mode="full")[u.size - 1 :]
    return np.asarray(u + 0.5, np.float64), np.asarray(auto / auto[0], np.float64)


def filtered_inflation(delay_s: float, period_s: float) -> float:
    """Factor on the sigma of a mean of samples that a device's low-pass filter makes alike.

    White noise through a filter of second order (Butterworth) with group delay d has the autocorrelation
    ``rho(t) = exp(-t/d) (cos(t/d) + sin(t/d))``. A mean of many samples then has the variance of a mean of independent
    ones times ``sum_k rho(k T)``; so have neighbouring means together, which a fit takes for independent.

    Args:
        delay_s: of the filter; zero: no filter.
        period_s: between samples.

    Raises:
        RowError: a negative delay, or a period that is not positive.
    """
    if not (delay_s >= 0.0 and period_s > 0.0):
        raise RowError("a filter's delay must not be negative, and a sample's period must be positive")
    apart = period_s / delay_s if delay_s > 0.0 else np.inf
    if apart > _FORGOTTEN:
        return 1.0
    following = ((1.0 - 1.0j) / np.expm1((1.0 - 1.0j) * apart)).real  # sum_k rho(k T) from 1 on, a geometric series
    return float(np.sqrt(max(1.0 + 2.0 * following, 1.0)))
