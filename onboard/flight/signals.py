"""Records to smoothed SI signals at the estimator's ticks, every channel through the same kernel, delays removed.

Samples keep their device ticks until the last moment: their times are taken from the timebase anew at every step, so a
better clock solution moves all of them together and no seam is left in a window.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows, SampleStatus
from onboard import config
from onboard.estimation.gates import GateReason, reasons, window_contains
from onboard.estimation.smoothing import Window
from onboard.flight.history import History
from onboard.timebase.delays import MPU6050_FILTER_DELAY_S
from onboard.timebase.timebase import Timebase

Floats = NDArray[np.float64]

UNUSABLE = int(SampleStatus.SATURATED | SampleStatus.NOT_VALID)
HISTORY_S = 2.0


class Channel(NamedTuple):
    """One channel's samples and what smoothing needs to know of them."""

    history: History
    delays_s: tuple[float, ...]  # of each column's filter
    noise: tuple[float, ...]  # of each column, standard deviation of a sample
    period_s: float  # nominal


class Smoothed(NamedTuple):
    """A channel at n ticks."""

    derivatives: tuple[Floats, ...]  # each (n, columns): the signal, its rate of change, ...
    sigma: tuple[Floats, ...]  # each (n, columns): noise of the above
    refused: NDArray[np.int64]  # (n,) GateReason


class Signals:
    """The smoothed channels of one vehicle."""

    def __init__(self, vehicle: config.Vehicle) -> None:
        self.width_s = vehicle.file.estimation.smoothing_ms * 1e-3
        self._zero: dict[str, int] = {}
        self._channels: dict[str, Channel] = {}
        self._recorded: set[str] = set()
        for name, device in vehicle.file.device.items():
            channel = self._channel(device, vehicle)
            if channel is not None:
                self._channels[name] = channel
            if isinstance(device, config.Cia406Device):
                self._zero[name] = device.zero_count
            if isinstance(device, config.RecordedDevice):
                self._recorded.add(name)

    @staticmethod
    def _channel(device: config.Device, vehicle: config.Vehicle) -> Channel | None:
        sync = next((d for d in vehicle.file.device.values() if isinstance(d, config.CanopenSyncDevice)), None)
        sync_s = sync.period_ms * 1e-3 if sync else 0.0

        def scalar(delay_s: float, noise: float, period_s: float) -> Channel:
            return Channel(History(int(HISTORY_S / period_s), 1), (delay_s,), (noise,), period_s)

        def imu(period_s: float, gyro_delay_s: float, accel_delay_s: float, gyro: float, accel: float) -> Channel:
            delays, noise = (gyro_delay_s,) * 3 + (accel_delay_s,) * 3, (gyro,) * 3 + (accel,) * 3
            return Channel(History(int(HISTORY_S / period_s), 6), delays, noise, period_s)

        match device:
            case config.Mpu6050Device():
                accel_delay_s, gyro_delay_s = MPU6050_FILTER_DELAY_S[device.filter_code]
                period_s = 1.0 / device.sample_rate_hz
                return imu(period_s, gyro_delay_s, accel_delay_s, device.gyro_noise_rad_s, device.accel_noise_m_s2)
            case config.RecordedImu():
                return imu(device.period_ms * 1e-3, 0.0, 0.0, device.gyro_noise_rad_s, device.accel_noise_m_s2)
            case config.Cia406Device():
                return scalar(0.0, device.noise_rad, sync_s)
            case config.Cia404Device():
                return scalar(device.delay_ms * 1e-3, device.noise_N, sync_s)
            case config.RecordedRate():
                return scalar(0.0, device.noise_rad_s, device.period_ms * 1e-3)
            case _:
                return None

    def append(self, batches: Mapping[str, Rows]) -> None:
        """Take in what a step consumed."""
        for name, arrived in batches.items():
            if name not in self._channels or not len(arrived):
                continue
            restarts = np.flatnonzero(arrived["status"] & SampleStatus.AFTER_RESET)
            if len(restarts):
                self._channels[name].history.clear()
            rows = arrived[restarts[-1] :] if len(restarts) else arrived
            ticks = rows["host_ns"] if name in self._recorded else rows["tick"].astype(np.int64)
            valid = (rows["status"] & UNUSABLE) == 0
            self._channels[name].history.append(ticks, self._values(name, rows), valid)

    def _values(self, name: str, rows: Rows) -> Floats:
        """SI values, (n, columns): gyro and accelerometer in sensor axes, or one scalar."""
        if "gyro_raw" in (rows.dtype.names or ()):
            gyro = rows["gyro_raw"] * rows["gyro_scale_rad_s"].astype(np.float64)[:, None]
            accel = rows["accel_raw"] * rows["accel_scale_m_s2"].astype(np.float64)[:, None]
            return np.hstack([gyro, accel])
        values: Floats = (rows["value_raw"] - self._zero.get(name, 0)) * rows["scale"]
        return values[:, None]

    def at(self, name: str, timebase: Timebase, at_ns: NDArray[np.int64], derivatives: int) -> Smoothed:
        """Channel ``name`` and its first ``derivatives`` derivatives at vehicle times ``at_ns`` (n,)."""
        channel = self._channels[name]
        n, columns = len(at_ns), len(channel.noise)
        history = channel.history
        times_ns = timebase.time_ns(name, history.ticks) if len(history.ticks) > 1 else None
        if times_ns is None:
            nothing = np.full((n, columns), np.nan)
            reason = GateReason.GAP if len(history.ticks) < 2 else GateReason.NOT_SYNCHRONISED
            return Smoothed((nothing,) * (derivatives + 1), (nothing,) * (derivatives + 1), np.full(n, int(reason)))
        epoch_ns = int(at_ns[0])
        at_s = (at_ns - epoch_ns) * 1e-9
        times_s = (times_ns - epoch_ns) * 1e-9
        near = slice(*np.searchsorted(times_s, [at_s[0] - self.width_s, at_s[-1] + self.width_s]).tolist())
        times_s, values, valid = times_s[near], history.values[near], history.valid[near]
        refused = reasons(window_contains(times_s, ~valid, at_s, self.width_s), GateReason.SATURATED)
        values_out = [np.full((n, columns), np.nan) for _ in range(derivatives + 1)]
        sigma_out = [np.full((n, columns), np.nan) for _ in range(derivatives + 1)]
        for delay_s in dict.fromkeys(channel.delays_s):
            mine = [i for i, d in enumerate(channel.delays_s) if d == delay_s]
            window = Window(times_s - delay_s, at_s, self.width_s, max_gap_s=3.5 * channel.period_s)
            for order in range(derivatives + 1):
                smoothed = window.apply(values[:, mine], order)
                values_out[order][:, mine] = smoothed.values
                sigma_out[order][:, mine] = smoothed.noise_gain[:, None] * np.array(channel.noise)[mine]
            refused |= reasons(~smoothed.valid, GateReason.GAP)
        return Smoothed(tuple(values_out), tuple(sigma_out), refused)
