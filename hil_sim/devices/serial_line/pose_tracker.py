"""The bridge of a motion capture system on a serial line: MAVLink 2, message ATT_POS_MOCAP, at the tracker's rate.

====  ==========================================================================================
byte  content
====  ==========================================================================================
0     FDh
1     length of the content, zeros at its end not counted (one byte at least is sent)
2, 3  flags of what the receiver must, and may, know: 0
4     number of the message, modulo 256
5, 6  system, component
7..9  identifier, low byte first: 138
10    time, us, u64; attitude w, x, y, z; position x, y, z; 21 numbers of the covariance, f32; little-endian
end   CRC-16/MCRF4XX of all after the first byte and of 109, low byte first
====  ==========================================================================================

Content and CRC by the common dialect of the MAVLink project. The tracker stamps a pose when its cameras expose, on its
own clock; the message leaves ``latency_ns`` later, and a random time more. While markers are hidden nothing is sent.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

import math
import struct
from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.powered import Latency
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import CLOCK_KINDS, INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyClock
from hil_sim.scenario.sensor_tables import NonNegative
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock
from hil_sim.sensing.pose_sensor import PoseSensor

_MESSAGE: Final = 138
_CRC_EXTRA: Final = 109
_EPOCH_US: Final = 1_790_000_000_000_000  # of the tracker's clock at power-up
_LONGEST: Final = 132  # bytes of a message


class PoseTrackerTwin(SerialTwin):
    """One tracker.

    Args:
        analog: Its cameras.
        clock: Its computer's oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        rate_hz: Poses a second on its own clock.
        line: Speed and format.
        latency_ns: From exposure to the first bit of the message.
        jitter_ns: Mean of a random time more.
        hidden: How often a second the markers are hidden, and for how long, s, on average.
        swapped: Two axes of the position that are sent for each other; none where they are the same.
        seed: Of jitter and of when the markers are hidden.
        faults: What breaks.

    Raises:
        FaultError: a fault that it cannot have.
        ValueError: the line is too slow for the rate.
    """

    def __init__(
        self,
        analog: PoseSensor,
        clock: ChipClock,
        start_ns: int,
        *,
        rate_hz: float = 100.0,
        line: LineFormat = LineFormat(230_400),  # noqa: B008  (a constant)
        latency_ns: int = 8_000_000,
        jitter_ns: int = 300_000,
        hidden: tuple[float, float] = (0.0, 0.0),
        swapped: tuple[int, int] = (0, 0),
        seed: int = 0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(line, start_ns, faults, (*INPUT_KINDS, *CLOCK_KINDS))
        if _LONGEST * line.character_ns * rate_hz > 1e9:
            raise ValueError(
                f"{rate_hz:g} messages of {_LONGEST} bytes a second do not fit into {line.baud_rate} baud; "
                "lower rate_Hz or raise the baud rate."
            )
        self.produced = 0
        self._analog, self._clock = analog, FaultyClock(clock, faults)
        self._windows = [w for w in faults.windows if w.kind in INPUT_KINDS]
        self._period_ns = 1e9 / rate_hz
        self._latency, self._hidden = Latency(latency_ns, jitter_ns, seed), hidden
        self._swapped = swapped
        self._rng = self._latency.rng
        self._powered_chip_ns = 0
        self._next = self._number = 0
        self._unseen_until = 0  # number of the pose from which the markers are seen again
        self._last: NDArray[np.float64] | None = None

    def _power_up(self, now_ns: int) -> None:
        self._powered_chip_ns = self._clock.chip_ns(now_ns)
        self._next = self._number = self._unseen_until = 0
        self._arm(now_ns)

    def _arm(self, not_before_ns: int) -> None:
        own_ns = self._powered_chip_ns + int(self._next * self._period_ns)
        self._at("pose", max(self._clock.time_ns(own_ns), not_before_ns), self._expose)

    def _expose(self, now_ns: int) -> None:
        """Take this pose and all that follow until the next event of another device."""
        until_ns = max(now_ns, min(self._until_ns, self.due_ns - 1))
        own_until_ns = self._clock.chip_ns(until_ns) - self._powered_chip_ns
        n = max(1, math.floor(own_until_ns / self._period_ns) + 1 - self._next)
        numbers = self._next + np.arange(n, dtype=np.float64)
        own_ns = np.floor(numbers * self._period_ns)
        times_s = np.minimum(self._clock.times_s(self._powered_chip_ns + own_ns), self._seconds(until_ns))
        poses = self._seen(times_s)
        for number, stamp_ns, time_s, pose in zip(numbers, own_ns, times_s, poses, strict=True):
            if self._is_hidden(int(number)):
                continue
            late_ns = self._latency.draw_ns()
            self._send(self._message(int(stamp_ns) // 1000, pose), self._start_ns + round(time_s * 1e9) + late_ns)
            self.produced += 1
        self._next += n
        self._arm(until_ns)

    def _is_hidden(self, number: int) -> bool:
        often, mean_s = self._hidden
        if number >= self._unseen_until and self._rng.random() < often * self._period_ns * 1e-9:
            self._unseen_until = number + 1 + int(self._rng.exponential(mean_s) * 1e9 / self._period_ns)
        return number < self._unseen_until

    def _seen(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses (n, 7) with the faults of the input."""
        times_ns = self._start_ns + times_s * 1e9
        poses = self._analog.poses(times_s)
        for window in self._windows:
            inside = (times_ns >= window.start_ns) & (times_ns < window.end_ns)
            if window.kind is FaultKind.DELAYED and inside.any():
                poses[inside] = self._analog.poses(np.maximum(times_s[inside] - window.value, 0.0))
            elif window.kind is FaultKind.WRONG:
                poses[inside, :3] *= 1.0 + window.value
        poses = self._analog.noisy(poses)
        a, b = self._swapped
        poses[:, [a, b]] = poses[:, [b, a]]
        for window in self._windows:
            held = np.flatnonzero((times_ns >= window.start_ns) & (times_ns < window.end_ns))
            if window.kind is FaultKind.STUCK and held.size:
                before = poses[held[0] - 1] if held[0] else self._last
                poses[held] = poses[held[0]] if before is None else before
        self._last = poses[-1]
        return poses

    def _message(self, stamp_us: int, pose: NDArray[np.float64]) -> bytes:
        unknown = (math.nan, *[0.0] * 20)
        content = struct.pack("<Q28f", _EPOCH_US + stamp_us, *pose[3:], *pose[:3], *unknown).rstrip(b"\0")
        content = content or b"\0"
        head = struct.pack("<BBBBBB", len(content), 0, 0, self._number, 1, 196) + _MESSAGE.to_bytes(3, "little")
        self._number = (self._number + 1) % 256
        return b"\xfd" + head + content + struct.pack("<H", _crc(head + content + bytes([_CRC_EXTRA])))


def _crc(data: bytes) -> int:
    """Nibble by nibble as in the MAVLink project's description of X.25."""
    crc = 0xFFFF
    for byte in data:
        mixed = (byte ^ crc) & 0xFF
        mixed = (mixed ^ (mixed << 4)) & 0xFF
        crc = (crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4)
    return crc & 0xFFFF


class PoseTrackerTable(MeasuringEmulator):
    """A motion capture bridge.

    ``latency_sigma_ms``: the latency is drawn about ``latency_ms``. ``hidden_per_s``, ``hidden_s``: how often and for
    how long the markers are hidden. ``swapped``: two axes of the position that are sent for each other.
    """

    quantities = ("pose",)

    kind: Literal["pose_tracker"]
    rate_Hz: PositiveFloat = 100.0
    latency_ms: NonNegative = 8.0
    latency_sigma_ms: NonNegative = 0.0
    jitter_ms: NonNegative = 0.3
    hidden_per_s: NonNegative = 0.05
    hidden_s: NonNegative = 0.2
    swapped: tuple[int, int] = (0, 0)

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {
            "rate_Hz": said["rate_hz"],
            "latency_ms": said["latency_ms"],
            "latency_sigma_ms": said["latency_sigma_ms"],
            "measures": name,
            "at": said["frame"],
        }
        return Equivalent(table, {name: sheets.pose(said)}, {name: "crystal"})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        rng = np.random.default_rng(bench.seed)
        latency_ms = max(0.0, self.latency_ms + self.latency_sigma_ms * float(rng.standard_normal()))
        tracker = PoseTrackerTwin(
            bench.sensor(PoseSensor),
            bench.clock,
            bench.start_ns,
            rate_hz=self.rate_Hz,
            line=bench.line,
            latency_ns=round(1e6 * latency_ms),
            jitter_ns=round(1e6 * self.jitter_ms),
            hidden=(self.hidden_per_s, self.hidden_s),
            swapped=self.swapped,
            seed=int(rng.integers(2**32)),
            faults=bench.faults,
        )
        return Twin(tracker, lambda: tracker.produced, (bench.name,), len)
