"""Converts records to smoothed SI signals at the estimator's ticks, all channels with the same kernel, delays removed.

Samples are stored with their device ticks; their times are computed from the timebase at every step, so that a new
clock solution shifts all samples of a window consistently.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, Severity
from onboard import config
from onboard.devices import si
from onboard.devices.roles import SmoothedChannel, TrackerRole
from onboard.estimation.arrays import TINY, FloatArray
from onboard.estimation.gates import GateReason, reasons, window_contains
from onboard.estimation.smoothing import SPLINE, Kernel, Response, SmoothingWindow
from onboard.flight.estimate.readings.at_ticks import ChannelAtTicks, nothing, side_by_side, tick_means
from onboard.flight.estimate.readings.cyclic import Cyclic, cyclic_functions, cyclic_of
from onboard.flight.estimate.readings.history import History, RecentSamples, SampleTimes
from onboard.flight.estimate.readings.jumps import JumpWatch, StuckEvent, StuckWatch, jumped_text
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.scatter import SampleScatter
from onboard.regressor.signals import EncoderJump
from onboard.timebase.timebase import Timebase

HISTORY_S = 2.0
TimesOf = Callable[[str, Rows], NDArray[np.int64] | None]
CYCLIC_LEFT = 0.1  # of cyclic errors, where an estimator fits them: other harmonics, and what depends on the load


def kernel_of(vehicle: config.Vehicle) -> Kernel:
    """The smoothing kernel that the vehicle file selects."""
    if vehicle.file.estimation.smoothing == "spline":
        return SPLINE
    from onboard.estimation import kinematics  # noqa: PLC0415 - filterpy takes most of a second to import

    return kinematics.smoother_kernel()


class SignalSmoother:
    """The smoothed channels of one vehicle.

    Args:
        vehicle: its file.
        trackers: whose poses are wanted.
        follows_jumps: the estimator goes on after an encoder has jumped.
    """

    def __init__(
        self,
        vehicle: config.Vehicle,
        *,
        trackers: Sequence[TrackerRole] = (),
        follows_jumps: bool = False,
    ) -> None:
        self._follows = follows_jumps
        self.width_s = vehicle.file.estimation.smoothing_ms * 1e-3
        self._kernel = kernel_of(vehicle)
        self._response = Response(self.width_s, self._kernel)
        self._signals = {**roles_of(vehicle).signals, **{one.channel: one.signal for one in trackers}}
        self._histories = {
            name: History(int(HISTORY_S / signal.period_s), len(signal.noise)) for name, signal in self._signals.items()
        }
        self._noises: dict[tuple[str, ...], tuple[FloatArray, list[tuple[float, slice | NDArray[np.bool_]]]]] = {}
        self._reach_ns = round(1.5e9 * self.width_s)
        self._zero_lost: set[str] = set()
        self._told: set[tuple[str, str]] = set()
        self._watches = {name: StuckWatch(signal) for name, signal in self._signals.items() if not signal.is_pose}
        moving = {name: signal for name, signal in self._signals.items() if signal.travels}
        self._scatter = SampleScatter({name: bool(signal.ripple) for name, signal in moving.items() if follows_jumps})
        self._jumps = {name: JumpWatch(signal, follows=follows_jumps) for name, signal in moving.items()}
        self._attitudes = {one.channel: np.zeros(4) for one in trackers}  # the last, of which the next has the sign

    @property
    def jumped(self) -> str:
        """Why answers are weak; empty where no angle has jumped since rows were used."""
        names = ", ".join(name for name, watch in self._jumps.items() if watch.jumped)
        return names and jumped_text(names, follows=self._follows)

    def jumps(self, channel: str, until_ns: int) -> Iterator[EncoderJump]:
        """Those of a channel up to some time, that were not taken before."""
        new = self._jumps[channel].new if channel in self._jumps else []
        while new and new[0].vehicle_ns <= until_ns:
            yield new.pop(0)

    def append(
        self, batches: Mapping[str, Rows], times_ns: TimesOf | None = None, *, in_use: bool = True
    ) -> list[tuple[str, StuckEvent]]:
        """Take in what a step consumed; returns channels with what there is to say of them.

        Args:
            batches: rows by channel.
            times_ns: vehicle time of a channel's rows, (n,), None while it is not known: jumps are not looked for.
            in_use: rows of the estimator were made of what came before.
        """
        said = list[tuple[str, StuckEvent]]()
        for name, arrived in batches.items():
            if name not in self._signals or not len(arrived):
                continue
            signal, history = self._signals[name], self._histories[name]
            restarts = (arrived["status"] & si.AFTER_RESET).nonzero()[0]
            if len(restarts):
                history.clear()
                if not signal.absolute:
                    self._zero_lost.add(name)
            rows = arrived[restarts[-1] :] if len(restarts) else arrived
            values, usable = values_of(signal, rows)
            if signal.is_pose:  # one that repeats is not usable already
                history.append(rows, self._continued(name, values, usable), reasons(~usable, GateReason.SATURATED))
                continue
            why = ""
            if name in self._zero_lost:
                usable[:] = False
                why = "its counter restarted and its zero is lost: rows that need it are refused; set its zero again"
            elif not np.isfinite(values).all():
                unit = rows["unit"][~np.isfinite(values[:, 0])][0].decode("ascii", "replace")
                known = ", ".join(u.decode() for u in signal.si)
                why = f"unit {unit!r} is none of {known}: not used, correct its device"
                values = np.nan_to_num(values)
            if why and (name, why) not in self._told:
                self._told.add((name, why))
                said.append((name, StuckEvent(Severity.ERROR, "not_usable", why)))
            stuck, before, told = self._watches[name].watch(rows, usable)
            said += [] if told is None else [(name, told)]
            history.mark(before, GateReason.STUCK)
            wrong = reasons(~usable, GateReason.SATURATED)
            if stuck.any():
                wrong |= reasons(stuck, GateReason.STUCK)
            if name in self._jumps and times_ns is not None:
                angle = np.where(wrong, np.nan, values[:, 0])
                seen = self._jumps[name].watch(rows, angle, times_ns(name, rows), in_use)
                said += [(name, told) for told in seen.said]
                history.mark(seen.before, 0 if seen.before_off else GateReason.JUMPED, seen.before_off)
                wrong |= reasons(seen.wrong, GateReason.JUMPED) if seen.wrong.any() else 0
                values[:, 0] -= seen.off
            history.append(rows, values, wrong)
        return said

    def _continued(self, name: str, values: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
        """Poses, (n, 7), with the sign of each quaternion next to that of the one before."""
        values = np.where(usable[:, None], values, 0.0)
        last = self._attitudes[name]
        for row in np.flatnonzero(usable):
            values[row, :4] *= -1.0 if values[row, :4] @ last < 0.0 else 1.0
            last = values[row, :4]
        self._attitudes[name] = last.copy()
        return values

    def at(self, name: str, timebase: Timebase, at_ns: NDArray[np.int64], derivatives: int) -> ChannelAtTicks:
        """Channel ``name`` and its first ``derivatives`` derivatives at vehicle times ``at_ns`` (n,), evenly spaced."""
        [smoothed] = self.each([name], timebase, at_ns, derivatives)
        return smoothed

    def each(
        self, names: Sequence[str], timebase: Timebase, at_ns: NDArray[np.int64], derivatives: int
    ) -> list[ChannelAtTicks]:
        """As :meth:`at`, for several channels: those that were sampled together are smoothed together."""
        found: dict[str, ChannelAtTicks] = {}
        groups: list[dict[str, RecentSamples]] = []
        seen: dict[str, SampleTimes] = {}
        for name in names:
            recent = self._recent(name, timebase, at_ns, seen)
            if isinstance(recent, GateReason):
                found[name] = nothing(len(self._signals[name].noise), len(at_ns), derivatives, recent)
                continue
            for group in groups:
                other = next(iter(group))
                if self._signals[other].delays_s == self._signals[name].delays_s and group[other].is_with(recent):
                    group[name] = recent
                    break
            else:
                groups.append({name: recent})
        for group in groups:
            found |= self._smooth(group, at_ns, derivatives)
        return [found[name] for name in names]

    def means(
        self, names: Sequence[str], timebase: Timebase, at_ns: NDArray[np.int64], period_ns: int
    ) -> ChannelAtTicks:
        """Channels as means over the tick of ``period_ns`` about each of ``at_ns``, their columns side by side.

        A tick with half of its samples or fewer has a gap; one with a sample that may not be used is refused. Samples
        are hardly ever even about a tick's middle, so the mean is that of a straight line through them.
        """
        if not names:
            return nothing(0, len(at_ns), 0, GateReason.OK)
        recent = ((self._signals[name], self._recent(name, timebase, at_ns)) for name in names)
        return side_by_side([tick_means(signal, samples, at_ns, period_ns) for signal, samples in recent])

    def _recent(
        self, name: str, timebase: Timebase, at_ns: NDArray[np.int64], seen: dict[str, SampleTimes] | None = None
    ) -> RecentSamples | GateReason:
        """What of a channel can be under the kernel at any of ``at_ns``; ``seen``: of channels before, by clock."""
        history = self._histories[name]
        # a sample is taken before it arrives: what arrived long before the window is not under it
        recent = slice(int(history.stamps["host_ns"].searchsorted(at_ns[0] - self._reach_ns)), None)
        stamps = history.stamps[recent]
        if len(stamps) < 2:
            return GateReason.GAP
        clock = timebase.clock_of(name)
        timed = None if seen is None else seen.get(clock)
        if timed is None or not np.array_equal(timed.ticks, stamps["tick"]):
            found = self._timed(name, timebase, stamps, at_ns)
            if isinstance(found, GateReason):
                return found
            timed = found
            if seen is not None:
                seen[clock] = timed
        values, wrong = history.values[recent], history.wrong[recent]
        if timed.kept is not None:
            values, wrong = values[timed.kept], wrong[timed.kept]
        gap_s = (4.5 if timed.late else 3.5) * self._signals[name].period_s
        return RecentSamples(timed.times_s, values[timed.near], wrong[timed.near], gap_s, timed.timing_s)

    def _timed(self, name: str, timebase: Timebase, stamps: Rows, at_ns: NDArray[np.int64]) -> SampleTimes | GateReason:
        times_ns = timebase.time_ns(name, stamps)
        if times_ns is None:
            return GateReason.NOT_SYNCHRONISED
        times_s, kept = (times_ns - at_ns[0]) * 1e-9, None
        waited = timebase.waited(name, stamps)
        late = waited is not None and bool(waited.any())
        if late or not (times_s[1:] > times_s[:-1]).all():
            later = times_s[1:] > np.maximum.accumulate(times_s)[:-1]  # not so where a timer stood still
            kept = np.append(True, later) & (True if waited is None else ~waited)
            times_s = times_s[kept]
        last_s = (at_ns[-1] - at_ns[0]) * 1e-9
        near = slice(*times_s.searchsorted((-self.width_s, last_s + self.width_s)).tolist())
        if near.stop - near.start < 2:
            return GateReason.GAP
        timing_s = timebase.sigma_ns(name, int(at_ns[len(at_ns) // 2])) * 1e-9
        return SampleTimes(stamps["tick"], times_s[near], kept, near, late, timing_s)

    def _smooth(
        self, group: Mapping[str, RecentSamples], at_ns: NDArray[np.int64], derivatives: int
    ) -> dict[str, ChannelAtTicks]:
        """Channels sampled together, with the same delays."""
        one = next(iter(group.values()))
        at_s = (at_ns - at_ns[0]) * 1e-9
        alone = len(group) == 1
        values = one.values if alone else np.hstack([recent.values for recent in group.values()])
        noise, delays = self._noise_of(tuple(group))
        out = np.full((derivatives + 1, len(at_ns), len(noise)), np.nan)
        sigma = np.full_like(out, np.nan)
        gaps = np.zeros(len(at_ns), np.int64)
        for delay_s, where in delays:
            window = SmoothingWindow(
                one.times_s - delay_s, at_s, self.width_s, max_gap_s=one.gap_s, kernel=self._kernel
            )
            smoothed, gain = window.stacked(values[:, where], range(derivatives + 1))
            out[..., where], sigma[..., where] = smoothed, gain[..., None] * noise[where]
            if derivatives == 2 and len(delays) == 1 and len(noise) == len(group):
                self._scatter.take([*group], window, values, noise)
            if not window.valid.all():
                gaps |= reasons(~window.valid, GateReason.GAP)
        power = self._scatter.power([*group]) if len(noise) == len(group) else np.ones(len(noise))
        of_samples = sigma * sigma * power
        sigma *= np.sqrt(np.maximum(power, 1.0))
        # a time error dt is an error of dt times the next derivative, without the noise of that derivative
        change, of_change = np.empty_like(out), np.empty_like(sigma)
        change[:-1], change[-1] = out[1:], _rate_of_change(out[-1], at_s)
        of_change[:-1], of_change[-1] = sigma[1:], sigma[-1] * (np.pi / self.width_s)
        moved = one.timing_s * np.sqrt(np.maximum(change * change - of_change * of_change, 0.0))
        sigma = np.hypot(sigma, moved)
        if derivatives:
            self._ripple(group, out[1], sigma)
        of_samples /= np.maximum(sigma * sigma, TINY)
        found, column, cyclic = {}, 0, self._cyclic(group, values, window, derivatives)
        for name, recent in group.items():
            part = slice(column, column + recent.values.shape[1])
            refused, column = gaps, part.stop
            for reason in GateReason(int(np.bitwise_or.reduce(recent.wrong))):
                held = window_contains(recent.times_s, recent.wrong & int(reason) != 0, at_s, self.width_s)
                refused = refused | reasons(held, reason)
            signal = tuple(out[:, :, part]), tuple(sigma[:, :, part])
            found[name] = ChannelAtTicks(*signal, refused, cyclic.get(name), tuple(of_samples[:, :, part]))
        return found

    def _noise_of(self, names: tuple[str, ...]) -> tuple[FloatArray, list[tuple[float, slice | NDArray[np.bool_]]]]:
        """Noise of the columns of channels with the same delays, and which columns have each delay."""
        if names not in self._noises:
            delays_s = np.array(self._signals[names[0]].delays_s * len(names))
            which = [(delay_s, _contiguous(delays_s == delay_s)) for delay_s in dict.fromkeys(delays_s.tolist())]
            self._noises[names] = np.hstack([self._signals[name].noise for name in names]), which
        return self._noises[names]

    def _ripple(self, group: Mapping[str, RecentSamples], rate: FloatArray, sigma: FloatArray) -> None:
        """Add what the kernel passes of the encoders' cyclic errors to the noise.

        Args:
            group: the channels.
            rate: of each, (n, columns) rad/s.
            sigma: (orders, n, columns), which changes.
        """
        columns, periods, rms, ends, rounds = self._errors(group)
        if not columns.size:
            return
        # those of an encoder that has jumped begin elsewhere, or turn at another rate, under all hypotheses
        lost = [name in self._jumps and self._jumps[name].jumped for name in group]
        left = rms * np.where(np.repeat(lost, np.diff([0, *ends])), 1.0, CYCLIC_LEFT)
        turning = periods * rate[:, columns]
        passed = np.stack([left * self._response.gain(turning, order) for order in range(len(sigma))])
        for each in rounds:
            own = columns[each]
            sigma[:, :, own] = np.hypot(sigma[:, :, own], passed[:, :, each])

    def _errors(self, group: Mapping[str, RecentSamples]) -> Cyclic:
        """Cyclic errors of a group's channels."""
        ripples = tuple(self._signals[name].ripple for name in group)
        return cyclic_of(ripples, tuple(recent.values.shape[1] for recent in group.values()))

    def _cyclic(
        self, group: Mapping[str, RecentSamples], values: FloatArray, window: SmoothingWindow, derivatives: int
    ) -> dict[str, FloatArray]:
        """Functions of the cyclic errors of the channels that have some, see :class:`ChannelAtTicks`.

        Args:
            group: the channels.
            values: of each, beside each other, (k, columns).
            window: of their samples.
            derivatives: that are wanted.
        """
        columns, periods, _, ends, _ = self._errors(group)
        if not (derivatives and columns.size):
            return {}
        smoothed, _ = window.stacked(cyclic_functions(values[:, columns] * periods), range(derivatives + 1))
        functions = smoothed.swapaxes(0, 1)
        parts = zip(group, [0, *ends], ends, strict=False)
        return {name: functions[:, :, 2 * first : 2 * last] for name, first, last in parts if last > first}


def _contiguous(which: NDArray[np.bool_]) -> slice | NDArray[np.bool_]:
    """Columns as a slice, where they lie beside each other."""
    at = np.flatnonzero(which)
    together = slice(int(at[0]), int(at[-1]) + 1)
    return together if together.stop - together.start == len(at) else which


def _rate_of_change(values: FloatArray, at_s: FloatArray) -> FloatArray:
    """Of ``values`` (n, columns) from tick to tick; 0 where there is no neighbour to tell it."""
    rate = np.zeros_like(values)
    if len(at_s) > 1:
        steps = (values[1:] - values[:-1]) / (at_s[1] - at_s[0])
        rate[0], rate[-1] = steps[0], steps[-1]
        rate[1:-1] = 0.5 * (steps[1:] + steps[:-1])
    return rate if np.isfinite(rate).all() else np.nan_to_num(rate)


def values_of(signal: SmoothedChannel, rows: Rows) -> tuple[FloatArray, NDArray[np.bool_]]:
    """SI values, (n, columns), gyro and accelerometer in sensor axes or one scalar; and which may be used, (n,)."""
    usable = si.usable(rows)
    if signal.is_pose:
        return si.pose(rows), usable
    if not signal.si:
        return si.imu(rows, signal), usable
    readings: FloatArray = (rows["value_raw"] - signal.zero_count) * rows["scale"] * si.factors(rows, signal)
    return signal.corrected(readings[:, None]), usable & (np.abs(readings) < signal.limit)
