"""nIMU device: packets in, IMU rows out, lost packets found by the packet timer."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.nimu.packet import STANDARD_GRAVITY_M_S2, NimuConfig, Packets, PacketStream
from drivers.nimu.timer import TURN_NS, PacketTicks, PacketTimer
from drivers.records import IMU, SCALAR, Rows, SampleStatus, Severity
from drivers.repeats import Repeats, longest_run
from drivers.serial_line.device import Channels, Clock, OpenPort, ReceivedBytes, SerialDevice

_GYRO, _ACCEL, _MAGNETOMETER, _TEMPERATURE = slice(0, 3), slice(3, 6), slice(6, 9), 9
_DEG = np.pi / 180.0
_TESLA_PER_GAUSS = 1e-4
ACCEL_NOISE_G, GYRO_NOISE_DEG_S = 0.3e-3, 0.28  # rms: half of PSD-0822
BANDWIDTH_HZ, HIGHEST_RATE_HZ = 50.0, 303.0  # PSD-0822; packets in a second at 115,200 baud


class Nimu(SerialDevice):
    """A Memsense nIMU: IMU rows on the channel of its name, magnetometer in SCALAR channels.

    ``tick`` is the packet timer (2.1701 us, at the start of the X gyro's conversion), unwrapped; ``temperature_raw`` is
    that of the X gyro (degC = 1.8165e-2 raw + 25). ``filter_code`` and ``sync`` are 0 (it has neither). ``status`` is
    SATURATED beyond the rated range, AFTER_RESET where the timer restarted or may have, NOT_VALID where the timer
    stands still or samples repeat exactly.

    Args:
        name: Channel of the IMU rows, first part of the magnetometer's channels, source of events.
        open_port: Opens its serial port.
        clock: CLOCK_MONOTONIC, ns.
        config: Which nIMU.
    """

    def __init__(self, name: str, open_port: OpenPort, clock: Clock, config: NimuConfig | None = None) -> None:
        self.config = NimuConfig() if config is None else config
        super().__init__(name, open_port, clock, self.config.poll_period_ms, self.config.silence_ms)
        self._stream = PacketStream(self.config.checksum_span)
        self._timer = PacketTimer()
        self._next = 0  # number of the next packet, if none is lost before it
        self._named = 0  # lost packets already recorded at a stop
        self._last_ns = 0
        self._told_stuck = False
        noise = [ACCEL_NOISE_G / self.config.accel_scale_g] * 3 + [GYRO_NOISE_DEG_S / self.config.gyro_scale_deg_s] * 3
        self._repeats = Repeats(longest_run(noise, BANDWIDTH_HZ, HIGHEST_RATE_HZ), self._report)
        gyro_limit = self.config.gyro_range_deg_s / self.config.gyro_scale_deg_s
        accel_limit = self.config.accel_range_g / self.config.accel_scale_g
        self._limits = np.minimum(np.repeat([gyro_limit, accel_limit], 3), 32767.0)  # counts

    @property
    def channels(self) -> Channels:
        """See ``SerialDevice``."""
        own: dict[str, np.dtype[Any]] = {self.name: IMU}
        return own | dict.fromkeys(self._magnetometer_channels(), SCALAR)

    def _magnetometer_channels(self) -> list[str]:
        return [f"{self.name}_mag_{axis}" for axis in "xyz"] if self.config.magnetometer else []

    def _opened(self, now_ns: int) -> None:
        self._stream.clear()

    def _receive(self, now_ns: int, chunk: ReceivedBytes) -> None:
        runs: list[Packets] = []
        broken: list[bool] = []
        for packets in self._frames_in(chunk, self._stream):
            runs.append(packets)
            broken += [self._broken, *[False] * (len(packets.timer) - 1)]
            self._broken = False
        if runs:
            self._heard(now_ns)
            words = np.concatenate([packets.words for packets in runs])
            timer = np.concatenate([packets.timer for packets in runs])
            placed = self._timer.place(timer, np.array(broken), chunk.host_ns, chunk.fresh)
            self._hand_over(chunk.host_ns, words, placed)

    def _hand_over(self, host_ns: int, words: NDArray[np.int16], placed: PacketTicks) -> None:
        numbers = self._next - 1 + np.cumsum(self._less_named(placed.steps))
        for place in np.flatnonzero(placed.steps > 1):
            before = int(numbers[place - 1]) if place else self._next - 1
            lost = int(numbers[place]) - before - 1
            if lost > 0:
                duration_ns = round(lost * (self._timer.period_ns or 0.0))
                counted = 0 < duration_ns < 0.5 * TURN_NS and not placed.restarted[place]
                for channel in (self.name, *self._magnetometer_channels()):
                    self._report.gap(
                        host_ns, channel, before + 1, before + lost, duration_ns, "packets_lost", counted=counted
                    )
        if placed.stuck.any() != self._told_stuck:
            self._told_stuck = not self._told_stuck
            if self._told_stuck:
                text = "timer stands still, these samples have no time: power-cycle it"
                self._report.event(host_ns, Severity.ERROR, "timer_stuck", text)
            else:
                self._report.event(host_ns, Severity.INFO, "timer_runs", "timer runs again")
        if self._last_ns == 0:
            self._report.event(host_ns, Severity.INFO, "started", "receiving packets")
        self._next = int(numbers[-1]) + 1
        self._last_ns = host_ns
        rows = self._imu_rows(host_ns, words, placed, numbers)
        self._repeats.watch(rows, host_ns)
        self._report.rows(self.name, rows)
        for axis, channel in enumerate(self._magnetometer_channels()):
            self._report.rows(channel, self._magnetometer_rows(rows, words[:, _MAGNETOMETER][:, axis]))

    def _imu_rows(
        self, host_ns: int, words: NDArray[np.int16], placed: PacketTicks, numbers: NDArray[np.int64]
    ) -> Rows:
        rows = np.zeros(len(words), IMU)
        rows["sequence"] = numbers
        rows["host_ns"] = host_ns
        rows["tick"] = placed.ticks
        rows["accel_scale_m_s2"] = self.config.accel_scale_g * STANDARD_GRAVITY_M_S2
        rows["gyro_scale_rad_s"] = self.config.gyro_scale_deg_s * _DEG
        rows["accel_raw"] = words[:, _ACCEL]
        rows["gyro_raw"] = words[:, _GYRO]
        rows["temperature_raw"] = words[:, _TEMPERATURE]
        saturated = (np.abs(words[:, :6].astype(np.int32)) >= self._limits).any(axis=1)
        rows["status"] = (
            saturated * np.uint8(SampleStatus.SATURATED)
            | placed.restarted * np.uint8(SampleStatus.AFTER_RESET)
            | placed.stuck * np.uint8(SampleStatus.NOT_VALID)
        )
        return rows

    def _magnetometer_rows(self, imu: Rows, raw: NDArray[np.int16]) -> Rows:
        rows = np.zeros(len(imu), SCALAR)
        for field in ("sequence", "host_ns", "tick"):
            rows[field] = imu[field]
        rows["value_raw"] = raw
        rows["scale"] = self.config.magnetometer_scale_gauss * _TESLA_PER_GAUSS
        rows["unit"] = b"T"
        rows["status"] = imu["status"] & ~np.uint8(SampleStatus.SATURATED)
        return rows

    def _less_named(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Steps minus the packets already recorded as lost at a stop, which are in ``_next``."""
        if not self._named:
            return steps
        steps = steps.copy()
        steps[0] = max(1, steps[0] - self._named)
        self._named = 0
        return steps

    def _finish(self, now_ns: int) -> None:
        period_ns = self._timer.period_ns
        if period_ns is None or not self._misses_its_end(now_ns - self._last_ns):
            return
        lost = int((now_ns - self._last_ns) / period_ns)
        if not lost:
            return
        first, last = self._next, self._next + lost - 1
        for channel in (self.name, *self._magnetometer_channels()):
            self._report.gap(now_ns, channel, first, last, now_ns - self._last_ns, "silent")
        self._next += lost
        self._named += lost
