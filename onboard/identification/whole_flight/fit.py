"""Batch fit of a whole flight: segments with the payload held and segments without, one set of instruments and links.

The likelihood of :mod:`onboard.identification.free_flyer.recursion.recursive` without its linearisation errors: all
unknowns are constant over the flight, but the base's rate at the start of each segment and the IMU's biases, and every
iteration predicts the whole flight anew about the same estimate (Gauss-Newton,
:mod:`onboard.estimation.maximum_likelihood`). What is flown free determines biases, scales, links and joints, and so
narrows the payload's interval. All instruments of the predictor take part but those that are left out, be it the first
IMU.

A bias is a straight line over the flight with a kink every ``WINDOW_s``: the sigma of a kink's change of slope is that
of the random walk of the filter's drift, ``drift sqrt(2 WINDOW_s / DRIFT_MEMORY_s)``. A delay that wanders (a clock
without marks) is a constant and, in stretches of its correlation time T, a deviation of its stated sigma s: noise along
the effect d of a delay, so that rows are whitened by ``(1 + s^2 d d')^(-1/2)``.

Normal equations are kept for each block of ticks and each instrument, of the parameters that it depends on, so that
agreement of parts of the flight (:mod:`onboard.identification.whole_flight.pooled`) costs no further prediction, and
memory hardly grows with the flight.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from onboard.dynamics.model.payload import body_estimate
from onboard.estimation.arrays import ROUNDING, BoolArray, FloatArray, IndexArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import NEAR_MINIMUM, ROUGH_MINIMUM, Fit, Normal, fit_normal
from onboard.estimation.policy import MOST_CONTRADICTED, READING
from onboard.identification.evidence.bank import Suspect
from onboard.identification.free_flyer.guesses import first_rate
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE, DRIFT_MEMORY_s, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import LineNoise, root_of
from onboard.identification.free_flyer.prediction.noise_in_gradient import added_by_line, is_noisy
from onboard.identification.free_flyer.steps import OtherError
from onboard.identification.whole_flight.blocks import (
    Along,
    BlockNoise,
    FlightFit,
    Instrument,
    NormalEquations,
    apart,
    give_up,
    instruments_of,
    misfit_by_instrument,
    sum_of,
    total_of,
)
from onboard.identification.whole_flight.segments import Changed, Segment, divided, others_in
from onboard.identification.windows import SHORTEST, WINDOW_s

_BLOCK_TICKS = 200
_FEWEST_TICKS = 4  # of a prediction
_EVALUATIONS = 25  # predictions of the flight in a stage
_SAME = 0.05  # relative change of a sigma that counts as none: 0.1 % in the mean


class _Minimum(NamedTuple):
    """Where the residual sum is least."""

    fit: Fit
    blocks: tuple[NormalEquations, ...]  # there
    promised: float  # decrease of the residual sum by the last step, whose end was not predicted


class WholeFlight:
    """Predicts the instruments in every segment of a flight and fits the unknowns to them.

    Args:
        predictor: of the vehicle's instruments.
        payload_sigma: wide prior: standard deviations of the payload's standard parameters about zero, (10,).
        segments: in the order of their times; too short ones are left out.
        without: numbers of the predictor's instruments that take no part.
        changed: errors that are others from some time on, s; no segment has ticks of before and after.

    Attributes:
        predictor: the one given.
        names: of the p parameters: those of the predictor without the rate, rates, kinks of biases.
        stated: standard deviations (p,) before the flight; NaN where nothing is known.
        sigma: those that the fit takes: as stated, or wider by :meth:`free`, (p,).
        prior_information: of that, about zero, (p, p).
        segments: those that are fitted.
        time_s: of all their ticks, (n,).
        further: the predictor's instruments besides the first IMU, be they left out or not.
        key_of: what states the sigma of a parameter, by its name; see :class:`ImuPredictor`.
        instruments: those that take part.
        devices: their numbers.
        constants: how many of the first parameters are the predictor's without the rate.
        of_bodies: indices of the parameters that are errors of links, joints and thrusters.
        of_a_part: indices of the parameters that differ from part to part of a flight: rates and biases.
    """

    def __init__(
        self,
        predictor: ImuPredictor,
        payload_sigma: FloatArray,
        segments: Sequence[Segment],
        without: Collection[int] = (),
        changed: Sequence[Changed] = (),
    ) -> None:
        self._given = predictor, payload_sigma, without, changed
        self.predictor, self.further, self.key_of = predictor, predictor.further, predictor.key_of
        self.instruments = tuple(one for one in instruments_of(predictor) if one.device not in without)
        self.devices = tuple(dict.fromkeys(one.device for one in self.instruments))
        self._imu = next((k for k in self.devices if k < len(predictor.imu_frames)), 0)
        self.segments = [one for one in segments if len(one.ticks.time_s) >= SHORTEST]
        self._begin_s = min((float(one.ticks.time_s[0]) for one in self.segments), default=0.0)
        end_s = max((float(one.ticks.time_s[-1]) for one in self.segments), default=0.0)
        self._kinks_s = np.arange(1, int((end_s - self._begin_s) / WINDOW_s)) * WINDOW_s
        walk = np.sqrt(2.0 * WINDOW_s / DRIFT_MEMORY_s)
        drifts = [drift_at for _, drift_at in predictor.biases]
        self.constants = len(predictor.names) - PAYLOAD.start
        self.of_bodies = predictor.of_bodies - PAYLOAD.start
        of_others, self._other = others_in(self.segments, changed, len(predictor.names))
        of_rates = (f"{name}_{k}" for k in range(len(self.segments)) for name in predictor.names[RATE])
        of_kinks = (f"{predictor.names[at]}_kink_{k}" for k in range(len(self._kinks_s)) for at in drifts)
        self.names: tuple[str, ...] = (*predictor.names[PAYLOAD.start :], *of_rates, *of_kinks, *of_others)
        kinks = np.tile(walk * predictor.sigma[drifts], len(self._kinks_s))
        rest = np.full(3 * len(self.segments), np.nan), kinks, np.ones(len(of_others))
        self.stated = np.concatenate([payload_sigma, predictor.sigma[PAYLOAD.stop :], *rest])
        self.free(())
        pairs, first = len(drifts), self.constants + 3 * len(self.segments)
        self._of_lines: list[IndexArray] = [
            np.array([bias_at - 3, drift_at - 3, *(first + i + pairs * np.arange(len(self._kinks_s)))], np.intp)
            for i, (bias_at, drift_at) in enumerate(predictor.biases)
        ]
        self.of_a_part = np.unique(np.concatenate([np.arange(self.constants, len(self.names)), *self._of_lines]))
        self.time_s = np.concatenate([one.ticks.time_s for one in self.segments]) if self.segments else np.zeros(0)
        self._use: list[BoolArray] = [  # (n, devices)
            np.stack([np.isfinite(one.ticks.measured[:, own]).all(axis=1) for own in predictor.lines], axis=1)
            for one in self.segments
        ]
        self._sigma = [one.ticks.sigma for one in self.segments]
        self._glitches = 0  # lines left out by all fits
        self._left: list[FloatArray] = []  # whitened residuals of each segment, (n, lines), at the last evaluation
        of_base = np.array([*range(3, PAYLOAD.stop), *predictor.of_bodies], np.intp)
        lines = [*sum(predictor.biases, ()), *(drift for _, drift in predictor.pushes)]  # a force is constant here
        self._seen = [  # what the readings of each instrument depend on, but rates and biases
            np.setdiff1d(np.concatenate([of_base, own]), lines).astype(np.intp) for own in predictor.of_each
        ]
        self._wander = {
            device: (at, max(1, round(memory_s / predictor.period_s)))
            for device, own in enumerate(predictor.of_further, 1)
            for at, memory_s in predictor.wandering
            if at in own
        }

    def with_step(self, other: OtherError, when_s: tuple[float, float, float]) -> "WholeFlight":
        """The same flight, as stated, in which an error may be another one; ``when_s`` as :func:`.divided`."""
        predictor, sigma, without, changed = self._given
        own = [lines for lines, at in zip(predictor.lines, predictor.of_each, strict=True) if other.at[0] in at]
        parts = divided(self.segments, own if len(self.devices) > 1 else [], when_s)
        return WholeFlight(predictor, sigma, parts, without, [*changed, (when_s[1], [other])])

    def zeros(self, fit: Fit, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Of the first IMU at a time, gyro and accelerometer, (6,), and their covariance; zeros if constant."""
        L = np.zeros((6, len(self.names)))
        for row, at in zip(L, self._of_lines if len(self._of_lines) >= len(L) else (), strict=False):
            row[at] = self._lines(np.array([time_s]))[0]
        return L @ fit.x, L @ fit.covariance @ L.T

    def start(self, constants: FloatArray) -> FloatArray:
        """Initial parameters, (p,): constants of the predictor's state, rates by the first readings of each segment."""
        x = np.zeros(len(self.names))
        x[: self.constants] = constants
        for k, one in enumerate(self.segments):
            at = self.constants + 3 * k
            x[at : at + 3] = first_rate(self.predictor, one.ticks, self.state(x, k), self._imu)
        return x

    def free(self, suspects: Sequence[Suspect]) -> None:
        """Take what is stated for the prior, but that each of these suspects, places as in ``names``, may be wrong."""
        self.sigma = self.stated.copy()
        self.prior_information = np.diag(np.nan_to_num(1.0 / self.sigma**2))
        at = np.unique(np.concatenate([np.zeros(0, np.intp), *(one.at for one in suspects)]))
        C = np.diag(self.stated[at] ** 2)
        for one in suspects:
            own = np.searchsorted(at, one.at)
            C[np.ix_(own, own)] += one.along @ one.along.T
        self.sigma[at], self._freed = np.sqrt(np.diag(C)), at + RATE.stop
        self.prior_information[np.ix_(at, at)] = np.linalg.inv(C)

    def fit(self, start: FloatArray, stages_s: Sequence[float] = ()) -> FlightFit:
        """Maximum likelihood, first of the parts of each segment up to so many seconds, then of all ticks.

        Args:
            start: (p,), see :meth:`start`.
            stages_s: lengths of these parts.

        Raises:
            ConvergenceError, SingularError, RowError: see :func:`onboard.estimation.maximum_likelihood.fit_normal`.
            SignalError: a payload without a mass.
        """
        x = start
        for length_s in stages_s:
            self.weigh(x)
            x = self._settle(x, ROUGH_MINIMUM, length_s).fit.x
            x = self.start(np.concatenate([start[:10], x[10 : self.constants]]))
        self.weigh(x)
        found = self._settle(x, ROUGH_MINIMUM)
        glitches, as_before = self._leave_out(), self.weigh(found.fit.x)
        self._glitches += glitches
        if glitches or not as_before or found.promised > NEAR_MINIMUM:
            found = self._settle(found.fit.x, NEAR_MINIMUM)
        return self._found(found)

    def _found(self, minimum: _Minimum) -> FlightFit:
        found, blocks, added = minimum.fit, minimum.blocks, self._noise_added(minimum.fit.x)
        noise = sum_of(added, len(self.names), len(self.instruments))
        correction = root_of(found.covariance, noise, self.sigma)
        if added:  # in one step, of gradient and noise alike: either alone, anew at its end, would be off
            shift = correction.shift
            found = found._replace(x=found.x + shift)
            blocks = tuple(b.moved(shift).without(n.at(shift)) for b, n in zip(blocks, added, strict=True))
        chi, covariance = found.x[:10], found.covariance[:10, :10] + correction.part(slice(10)).covariance
        freedom = sum(block.rows for block in blocks) + int(np.isfinite(self.sigma).sum()) - found.x.size
        misfit = found.residual_sum / max(freedom, 1)
        told = found, self.names, chi, covariance, correction, blocks, misfit, misfit_by_instrument(blocks)
        return FlightFit(body_estimate(chi, covariance), *told, np.concatenate(self._left), self._glitches)

    def _noise_added(self, x: FloatArray) -> list[BlockNoise]:
        """What noise of the joints' samples adds to each block at x; empty for nothing."""
        found, c = list[BlockNoise](), self.constants
        widths = [own.stop - own.start for own in self.predictor.lines]
        each = [(np.repeat(use, widths, axis=1), sigma) for use, sigma in zip(self._use, self._sigma, strict=True)]
        ticks_of = ((one.ticks, self.state(x, k)) for k, one in enumerate(self.segments))
        noise = (self.predictor.joint_noise(ticks.q, ticks.sample_sigma, state) for ticks, state in ticks_of)
        noisy = any(is_noisy(one[1:-1], sigma[1:-1], use[1:-1]) for one, (use, sigma) in zip(noise, each, strict=True))
        for k, (one, (use, sigma)) in enumerate(zip(self.segments, each, strict=True) if noisy else ()):
            by_x = np.zeros((c, len(self.names)))  # of the predictor's constants
            by_x[:, :c], by_x[:, len(self.names) - self._other.shape[2] :] = np.eye(c), self._other[k, RATE.stop :]
            by_x[:10] *= one.held
            for along in self._along(x, k, np.inf):
                here, before = along.ticks, along.ticks.start - 1
                seen = use[here] & ~self.predictor.of_poses
                whitening = LineNoise.alone(sigma[here]).whitening(seen)
                known = one.ticks.part(slice(before, here.stop + 1)), whitening, along.state
                of_lines = added_by_line(self.predictor, *known, before, along.predicted)
                for own in self.instruments:
                    if use[here, own.lines].any():
                        found.append(BlockNoise(of_lines.of(own.lines, slice(RATE.stop, None)), by_x))
        return found

    def blocks(self, x: FloatArray, length_s: float = np.inf) -> list[NormalEquations]:
        """Normal equations of all ticks up to so many seconds after the start of each segment, at x, (p,)."""
        found = []
        self._left = [np.full(one.ticks.measured.shape, np.nan) for one in self.segments]
        for k, one in enumerate(self.segments):
            for along in self._along(x, k, length_s):
                middle_s = float(one.ticks.time_s[along.ticks].mean())
                for instrument in self.instruments:
                    use = self._use[k][along.ticks, instrument.device]
                    if use.any():
                        r, J, columns = self._rows(along, k, instrument, use)
                        ticks = np.arange(along.ticks.start, along.ticks.stop)[use]
                        self._left[k][ticks, instrument.lines] = r.reshape(len(ticks), -1)
                        known = Normal.of(r, J), columns, r.size, instrument.name, one.held, middle_s
                        found.append(NormalEquations(*known, np.zeros(columns.size)))
        return found

    def without_payload(self, x: FloatArray) -> list[tuple[float, float]]:
        """Residual sums of the held segments if nothing were held, all else as in x, (p,), rates by readings.

        Returns:
            The middle, s, and the sum of each block.
        """
        bare = x[: self.constants].copy()
        bare[:10] = 0.0
        at, found = self.start(bare), []
        for k, one in enumerate(self.segments):
            for along in self._along(at, k, np.inf) if one.held else ():
                for instrument in self.instruments:
                    use = self._use[k][along.ticks, instrument.device]
                    if use.any():
                        r = self._whitened(along, k, instrument, use)[0]
                        found.append((float(one.ticks.time_s[along.ticks].mean()), float(r @ r)))
        return found

    def _settle(self, x: FloatArray, tolerance: float, length_s: float = np.inf) -> _Minimum:
        best = np.inf, x, tuple[NormalEquations, ...](), self._left
        bests: list[float] = []

        def evaluate(at: FloatArray) -> Normal:
            nonlocal best
            if len(bests) == _EVALUATIONS:
                raise ConvergenceError(f"not converged after {_EVALUATIONS} predictions of the flight")
            blocks = tuple(self.blocks(at, length_s))
            total = total_of(blocks, len(self.names))
            cost = total.squares + float(at @ self.prior_information @ at)
            if cost < best[0]:
                best = cost, at, blocks, self._left
            bests.append(best[0])
            give_up(bests, sum(block.rows for block in blocks), _EVALUATIONS)
            return total

        found = fit_normal(evaluate, x, np.zeros_like(x), self.prior_information, _EVALUATIONS, tolerance, ROUNDING)
        cost, at, blocks, self._left = best
        here = tuple(block.moved(found.x - at) for block in blocks)
        return _Minimum(found, here, cost - found.residual_sum)

    def weigh(self, x: FloatArray) -> bool:
        """Add the effect of the joints' noise, with the payload of x, to the IMU's; whether it is about as before."""
        before, self._sigma = self._sigma, []
        for k, one in enumerate(self.segments):
            off = np.union1d(self._freed, self._other[k].any(axis=1).nonzero()[0])
            noise = self.predictor.joint_noise(one.ticks.q, self.predictor.rippled(one.ticks, off), self.state(x, k))
            self._sigma.append(np.hypot(one.ticks.sigma, noise))
        return all((np.abs(new - old) <= _SAME * old).all() for new, old in zip(self._sigma, before, strict=True))

    def _leave_out(self) -> int:
        """Leave out ticks of an instrument that the last fit contradicts, if these are few; returns how many lines."""
        out = 0
        for device, own in enumerate(self.predictor.lines):
            limit = float(chdtri(own.stop - own.start, READING))
            far = [np.nan_to_num(left[:, own] ** 2).sum(axis=1) > limit for left in self._left]
            count = sum(int(one.sum()) for one in far)
            if count <= MOST_CONTRADICTED * sum(int(use[:, device].sum()) for use in self._use):
                out += count * (own.stop - own.start)
                for use, one in zip(self._use, far, strict=True):
                    use[one, device] = False
        return out

    def state(self, x: FloatArray, segment: int) -> FloatArray:
        """The predictor's state at the start of a segment, without the biases' lines; (predictor's p,)."""
        at = self.constants + 3 * segment
        state = np.concatenate([x[at : at + 3], x[: self.constants]])
        if not self.segments[segment].held:
            state[PAYLOAD] = 0.0
        for bias_at, drift_at in self.predictor.biases:
            state[bias_at] = state[drift_at] = 0.0
        return np.asarray(state + self._other[segment] @ x[len(x) - self._other.shape[2] :], np.float64)

    def _along(self, x: FloatArray, segment: int, length_s: float) -> Iterator[Along]:
        """Block by block along a segment."""
        ticks, p = self.segments[segment].ticks, len(self.predictor.names)
        last = min(len(ticks.time_s), max(SHORTEST, round(min(length_s, 1e6) / self.predictor.period_s)))
        state, d_rate, first = self.state(x, segment), np.eye(3, p), 0
        while last - first >= _FEWEST_TICKS:
            end = last if last - first < 2 * _BLOCK_TICKS else first + _BLOCK_TICKS + 2
            some = ticks.part(slice(first, end))
            predicted = self.predictor.predict(some.q, some.dq, some.ddq, state, some.cyclic, some.thrust)
            here = slice(first + 1, end - 1)
            lines, values = self._lines(ticks.time_s[here]), predicted.values
            for at, (bias_at, _) in zip(self._of_lines, self.predictor.biases, strict=True):
                values = values + (lines @ x[at])[:, None] * predicted.jacobian[:, :, bias_at]
            yield Along(here, values, predicted, state, d_rate, lines)
            transition = predicted.transition[RATE].copy()
            transition[:, RATE] = 0.0
            d_rate = predicted.transition[RATE, RATE] @ d_rate + transition
            state = np.concatenate([predicted.state[RATE], state[RATE.stop :]])
            first = end - 2

    def _lines(self, time_s: FloatArray) -> FloatArray:
        """Offset, slope and kinks of a bias at some times, (n, 2 + kinks)."""
        t = time_s - self._begin_s
        return np.column_stack([np.ones_like(t), t, np.maximum(0.0, t[:, None] - self._kinks_s)])

    def _whitened(
        self, along: Along, segment: int, instrument: Instrument, use: BoolArray
    ) -> tuple[FloatArray, FloatArray, Callable[[FloatArray], FloatArray] | None]:
        """Residuals of the ticks to use, (u,), their sigmas, (t, lines), and what the delay's wander does to rows."""
        own, device, one = instrument.lines, instrument.device, self.segments[segment]
        sigma = self._sigma[segment][along.ticks, own][use]
        r = ((along.values[:, own] - one.ticks.measured[along.ticks, own])[use] / sigma).ravel()
        if device not in self._wander:
            return r, sigma, None
        delay_at, ticks = self._wander[device]
        effect = (along.predicted.jacobian[:, own, delay_at][use] / sigma).ravel() * self.predictor.sigma[delay_at]
        split = apart(effect, np.repeat(np.flatnonzero(use) // ticks, own.stop - own.start))
        return split(r[:, None])[:, 0], sigma, split

    def _rows(
        self, along: Along, segment: int, instrument: Instrument, use: BoolArray
    ) -> tuple[FloatArray, FloatArray, IndexArray]:
        """Whitened residuals of the ticks to use, (u,), their derivatives, (u, k), and by which parameters, (k,)."""
        r, sigma, split = self._whitened(along, segment, instrument, use)
        slopes = along.predicted.jacobian[:, instrument.lines]  # (n, lines, predictor's p)
        slopes = slopes if use.all() else slopes[use]
        seen = self._seen[instrument.device]
        seen = seen if self.segments[segment].held else seen[seen >= PAYLOAD.stop]
        by_constants = slopes.take(seen, axis=2)
        by_constants /= sigma[..., None]
        by_rate = (slopes[..., RATE] / sigma[..., None]).reshape(r.size, 3)
        J = by_constants.reshape(r.size, -1)
        J += by_rate @ along.d_rate[:, seen]
        first = self.constants + 3 * segment
        others = np.arange(len(self.names) - self._other.shape[2], len(self.names))
        parts = [J, by_rate @ along.d_rate[:, RATE], J @ self._other[segment, seen]]
        columns = [seen - RATE.stop, np.arange(first, first + 3), others]
        lines = along.lines[use]  # (t, 2 + kinks)
        begun = lines.any(axis=0)
        for at, (bias_at, _) in zip(self._of_lines, self.predictor.biases, strict=True):
            by_bias = slopes[..., bias_at] / sigma
            if by_bias.any():
                parts.append((by_bias[..., None] * lines[:, None, begun]).reshape(r.size, -1))
                columns.append(at[begun])
        J = np.concatenate(parts, axis=1)
        return r, J if split is None else split(J), np.concatenate(columns).astype(np.intp)
