"""Whitens the noise of rows in time, so that slow motion is weighed by what noise there is at its frequencies.

White noise of samples behind the smoothing kernel K has the spectrum ``|K(w)|^2``; differentiated k times, ``w^2k`` of
it. A row has all of it: of its reading and of angles (k = 0), of rates (k = 1), of accelerations (k = 2),

    S(w) = |K(w)|^2 (a + b w^2 + c w^4) = |K(w)|^2 a / |H(w)|^2,    H(s) = 1 / (1 + beta s + gamma s^2),
    gamma = (c / a)^(1/2),    beta = (b / a + 2 gamma)^(1/2).

Rows are linear in the parameters, so both of their sides may go through the same filter H, which leaves noise of the
spectrum ``|K|^2 a``: generalised least squares (Aitken, 1935), by a low pass of each row's own. It is taken in backward
differences, which are stable for every beta and gamma. Noise of a known rhythm (cyclic errors, errors of time) is none
of samples: it counts in a as before.

beta and gamma follow the noise at once where it grows, as when a joint begins to move, and within a second where it
falls: too large ones cost information, too small ones let noise pass that nothing states. Where they double, and after
a hole of a kernel or more, the filter begins anew. Of noise that is differentiated it then passes its integral at the
start, times the impulse response h; the sigma of these rows contains that, with a bound of h:

    h(t) <= t / gamma exp(-beta t / 2 gamma),  or 1.5 / beta exp(-t / beta) where beta^2 > 4 gamma.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.estimation.smoothing import Response
from onboard.regressor.signals import Signals

ORDERS = 3  # of derivatives
_MEMORY_S = 1.0  # of the noise's levels, as they fall
_GROWN = 2.0  # times as slow: the filter begins anew
_PHASES = np.arange(0.05, 60.0, 0.1)  # phases over the kernel's width at which spectra are summed


class NoisyRows(NamedTuple):
    """Rows of some ticks, r in all."""

    Y: FloatArray  # (r, p)
    y: FloatArray  # (r,)
    C: FloatArray | None  # (r, k) of considered parameters
    sigma: FloatArray  # (r,)
    own: FloatArray  # (r,) of the readings by themselves
    noise: FloatArray | None  # (r, s, p + 1) change of row and reading per sigma of a signal


class Whitening:
    """Filters of a model's rows.

    Args:
        rows: m.
        columns: c, of both sides together.
        period_s: of the ticks.
        width_s: of the kernel.
        response: of the kernel.
    """

    def __init__(self, rows: int, columns: int, period_s: float, width_s: float, response: Response) -> None:
        self._period_s, self._width_s = period_s, width_s
        self._rates = _PHASES / width_s  # rad/s
        self._spectra = np.stack([response.gain(self._rates, order) ** 2 for order in range(ORDERS)])  # (3, f)
        self._power = self._spectra.sum(axis=1)  # (3,)
        self._levels = np.zeros((rows, ORDERS))  # variances, the largest of late
        self._before = np.zeros((3, rows, columns))  # last input, last output, the one before it
        self._last_s, self._first_s = np.full(rows, -np.inf), np.zeros(rows)  # its rows since it began
        self._slowness = np.zeros((2, rows))  # beta and gamma when it began

    def filter(
        self,
        signals: Signals,
        at: IndexArray,
        use: BoolArray,
        rows: NoisyRows,
        effect: FloatArray,
        widening: FloatArray,
    ) -> NoisyRows:
        """The rows of new ticks, behind the filter; as they are where nothing is known of their noise.

        Args:
            signals: smoothed.
            at: the ticks, (n,), going on from those before.
            use: which rows are good, (n, m), r in all; the filter goes over others as if they repeated the last one.
            rows: these; of equal weight behind the filter, whatever their sigma.
            effect: of a sigma of each signal on the rows, correlation inflation included, (r, s).
            widening: of the rows' sigmas, (r,).
        """
        if signals.noise is None or signals.noise.of_samples is None:
            return rows
        of_samples, tick = signals.noise.of_samples, np.nonzero(use)[0]
        share = of_samples.share[at][tick] * (of_samples.order > 0)  # (r, s)
        variance = np.zeros((*use.shape, ORDERS))
        square = effect * effect
        own = [(rows.own / widening) ** 2 + (square * (1.0 - share)).sum(axis=1)]
        own += [(square * share)[:, of_samples.order == order].sum(axis=1) for order in range(1, ORDERS)]
        variance[use] = np.stack(own, axis=1)
        beta, gamma, white = self._shaped(use, variance)
        both = [rows.Y, rows.y[:, None], *(() if rows.C is None else (rows.C,))]
        columns = np.zeros((*use.shape, self._before.shape[2]))
        columns[use] = np.concatenate(both, axis=1)
        grown = (np.stack([beta, gamma]) > _GROWN * self._slowness).any(axis=0)
        self._last_s[grown], self._slowness[:, grown] = -np.inf, np.stack([beta, gamma])[:, grown]
        made, age_s = (part[use] for part in self._filtered(signals.time_s[at], use, columns, beta, gamma))
        left = 1.0 / np.abs(1.0 + 1j * beta[:, None] * self._rates - gamma[:, None] * self._rates**2) ** 2  # (m, f)
        passed = np.sqrt((left @ self._spectra.T) / self._power)[np.nonzero(use)[1]]  # (r, 3)
        p = rows.Y.shape[1]
        noise = None
        if rows.noise is not None:
            of_share = share * passed[:, of_samples.order] ** 2 + (1.0 - share) * passed[:, :1] ** 2
            noise = rows.noise * np.sqrt(of_share)[..., None]
        C = None if rows.C is None else made[:, p + 1 :]
        row = np.nonzero(use)[1]
        variance_of_start = self._levels[:, 1:] @ (self._power[:-1] / self._power[1:])  # of the noise's integral
        started = variance_of_start[row] * _impulse(age_s, beta[row], gamma[row]) ** 2
        sigma = np.sqrt(white[row] + started) * widening
        return NoisyRows(made[:, :p], made[:, p], C, sigma, rows.own * passed[:, 0], noise)

    def _filtered(
        self, time_s: FloatArray, use: BoolArray, columns: FloatArray, beta: FloatArray, gamma: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Columns of both sides behind the filter, (n, m, c), and how long it had run, (n, m)."""
        T, out, age_s = self._period_s, np.zeros_like(columns), np.zeros(use.shape)
        fresh, one, two = 1.0 + beta / T + gamma / T**2, beta / T + 2.0 * gamma / T**2, gamma / T**2  # (m,) each
        for k, now_s in enumerate(time_s.tolist()):
            mine = np.flatnonzero(use[k])
            steps = np.round((now_s - self._last_s[mine]) / T)
            anew = (steps < 1.0) | (steps * T > self._width_s)
            self._before[:, mine[anew]] = 0.0
            holes = np.where(anew, 0.0, steps - 1.0)
            a, b, c = (part[mine, None] for part in (fresh, one, two))
            held, last, other = self._before[:, mine]
            for hole in range(int(holes.max(initial=0.0))):
                due = (hole < holes)[:, None]
                last, other = np.where(due, (held + b * last - c * other) / a, last), np.where(due, last, other)
            made = (columns[k, mine] + b * last - c * other) / a
            self._before[:, mine] = columns[k, mine], made, last
            self._last_s[mine], self._first_s[mine[anew]] = now_s, now_s
            out[k, mine], age_s[k, mine] = made, now_s - self._first_s[mine]
        return out, age_s

    def _shaped(self, use: BoolArray, variance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """beta, gamma, and the variance of white rows, (m,) each; by the levels with these ticks taken in."""
        fade = np.exp(-use.sum(axis=0) * self._period_s / _MEMORY_S)
        self._levels = np.maximum(fade[:, None] * self._levels, variance.max(axis=0, initial=0.0))
        a, b, c = (self._levels * (self._power[0] / self._power)).T
        safe, slowest = np.where(a > 0.0, a, 1.0), self._width_s**2  # blocks are five widths
        of_rates, of_accelerations = np.where(a > 0.0, b / safe, 0.0), np.where(a > 0.0, c / safe, 0.0)
        gamma = np.minimum(np.sqrt(of_accelerations), slowest)
        square = np.minimum(of_rates, slowest)  # beta^2 - 2 gamma
        # what a filter that may not be slower leaves besides
        more = np.maximum(_over(of_accelerations, gamma**2), _over(of_rates, square))
        return np.sqrt(square + 2.0 * gamma), gamma, a * np.maximum(more, 1.0)


def _impulse(t: FloatArray, beta: FloatArray, gamma: FloatArray) -> FloatArray:
    """A bound of the impulse response after t; zero of a filter that passes all."""
    none = np.zeros_like(t)
    rate = np.divide(beta, 2.0 * gamma, out=none.copy(), where=gamma > 0.0)
    swinging = np.divide(t, gamma, out=none.copy(), where=gamma > 0.0) * np.exp(-rate * t)
    slow = np.divide(1.5, beta, out=none.copy(), where=beta > 0.0)
    falling = slow * np.exp(-np.divide(t, beta, out=none.copy(), where=beta > 0.0))
    return np.where(beta**2 > 4.0 * gamma, falling, swinging)


def _over(wanted: FloatArray, given: FloatArray) -> FloatArray:
    return np.divide(wanted, given, out=np.ones_like(wanted), where=given > 0.0)
