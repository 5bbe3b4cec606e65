"""Faults as data: what breaks, where, from when to when. The twins and the buses apply them.

=================  ==========================  ========================================================================
kind               devices                     effect between ``start_s`` and ``end_s``
=================  ==========================  ========================================================================
``off``            any twin                    no supply; it starts again, from its reset values, at ``end_s``
``reset``          any twin                    brown-out at ``start_s``: starts again at once (``end_s`` is not used)
``stuck``          imu, encoder, load cell     the analogue input holds its last value
``saturated``      imu, load cell              the analogue input is at full scale; the sign of ``value`` says which end
``silent``         CAN nodes, sync box         open connector: neither hears nor is heard, keeps its state
``nack``           imu, I2C bus                every transfer fails with errno ``value`` (0: EREMOTEIO)
``who_am_i``       imu                         WHO_AM_I reads ``value``
``pulse_drop``     imu, sync line              the edge never reaches this pin
``pulse_spurious`` imu, sync line              one more edge every ``value`` seconds, beginning at ``start_s``
``frame_drop``     CAN bus                     the flight computer loses frames with COB-ID ``value`` (0: every frame)
=================  ==========================  ========================================================================

A fault that its device cannot apply is refused when the device is built: a fault that silently does nothing would
make a fault test pass for the wrong reason.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_sim.analog import ImuAnalog, ScalarAnalog

NEVER = 1 << 62  # ns; later than any clock here
_INERTIAL = np.array([0, 1, 2, 4, 5, 6])  # columns of ImuAnalog.counts without the temperature


class FaultError(ValueError):
    """A fault that cannot be applied as written."""


class FaultKind(StrEnum):
    """The vocabulary. The module's table says what each does."""

    OFF = "off"
    RESET = "reset"
    STUCK = "stuck"
    SATURATED = "saturated"
    SILENT = "silent"
    NACK = "nack"
    WHO_AM_I = "who_am_i"
    PULSE_DROP = "pulse_drop"
    PULSE_SPURIOUS = "pulse_spurious"
    FRAME_DROP = "frame_drop"


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Args:
        kind: What happens.
        device: Name of the twin or bus it happens to.
        start_s: Mission time of its beginning, s.
        end_s: Mission time of its end, s.
        value: Meaning by ``kind``, see the module's table.

    Raises:
        FaultError: an unknown kind, or times or a value that make no sense for it.
    """

    kind: FaultKind
    device: str
    start_s: float
    end_s: float = math.inf
    value: float = 0.0

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "kind", FaultKind(self.kind))
        except ValueError:
            known = ", ".join(FaultKind)
            raise FaultError(f"No fault is called {self.kind!r}; name one of: {known}.") from None
        if not (math.isfinite(self.start_s) and self.start_s >= 0.0 and self.end_s > self.start_s):
            raise FaultError(
                f"Fault {self.kind} of {self.device} lasts from {self.start_s} s to {self.end_s} s; "
                "give 0 <= start_s < end_s."
            )
        if self.kind is FaultKind.PULSE_SPURIOUS and not self.value > 0.0:
            raise FaultError(f"Fault pulse_spurious of {self.device} needs `value`, the seconds between two edges.")
        if self.kind is FaultKind.WHO_AM_I and not 0 <= self.value <= 0xFF:
            raise FaultError(f"Fault who_am_i of {self.device} needs `value`, the byte to read (0 to 255).")


class Window(NamedTuple):
    """A fault on the true clock."""

    kind: FaultKind
    start_ns: int
    end_ns: int
    value: float


class PowerCycle(NamedTuple):
    """Supply gone at ``down_ns`` and back at ``up_ns`` (the same instant for a brown-out)."""

    down_ns: int
    up_ns: int


class DeviceFaults:
    """The faults of one device, on the true clock."""

    def __init__(self, device: str, windows: Iterable[Window] = ()) -> None:
        self.device = device
        self.windows = tuple(sorted(windows, key=lambda w: w.start_ns))

    def __bool__(self) -> bool:
        return bool(self.windows)

    def require(self, *kinds: FaultKind) -> "DeviceFaults":
        """Check that every fault here is of one of ``kinds``, and return self.

        Raises:
            FaultError: a fault that the device cannot have.
        """
        for window in self.windows:
            if window.kind not in kinds:
                possible = ", ".join(kinds)
                raise FaultError(f"{self.device} cannot have the fault {window.kind}; it can have: {possible}.")
        return self

    def active(self, kind: FaultKind, now_ns: int) -> Window | None:
        """The fault of this kind in force at ``now_ns``, or None."""
        for window in self.windows:
            if window.kind is kind and window.start_ns <= now_ns < window.end_ns:
                return window
        return None

    def power_cycles(self) -> list[PowerCycle]:
        """Interruptions of the supply, in order.

        Raises:
            FaultError: two of them overlap.
        """
        cycles: list[PowerCycle] = []
        for window in self.windows:
            if window.kind is FaultKind.OFF:
                cycle = PowerCycle(window.start_ns, window.end_ns)
            elif window.kind is FaultKind.RESET:
                cycle = PowerCycle(window.start_ns, window.start_ns)
            else:
                continue
            if cycles and cycle.down_ns < cycles[-1].up_ns:
                raise FaultError(f"{self.device} loses its supply while it has none; make its faults not overlap.")
            cycles.append(cycle)
        return cycles

    def spurious_edges(self, after_ns: int, until_ns: int) -> list[int]:
        """True times of the extra edges in (``after_ns``, ``until_ns``], in order."""
        edges: list[int] = []
        for window in self.windows:
            if window.kind is not FaultKind.PULSE_SPURIOUS:
                continue
            step_ns = round(window.value * 1e9)
            first = max(0, (after_ns - window.start_ns) // step_ns + 1)
            last = (min(until_ns, window.end_ns - 1) - window.start_ns) // step_ns
            edges.extend(window.start_ns + k * step_ns for k in range(first, last + 1))
        return sorted(edges)


NO_FAULTS = DeviceFaults("a healthy device")


class FaultPlan:
    """The faults of a mission, handed out by device name.

    Args:
        faults: All of them.
        start_ns: ``CLOCK_MONOTONIC`` ns of mission time 0.
    """

    def __init__(self, faults: Iterable[Fault], start_ns: int) -> None:
        self._windows: dict[str, list[Window]] = {}
        self._asked: set[str] = set()
        for fault in faults:
            end_ns = NEVER if math.isinf(fault.end_s) else start_ns + round(fault.end_s * 1e9)
            window = Window(fault.kind, start_ns + round(fault.start_s * 1e9), end_ns, fault.value)
            self._windows.setdefault(fault.device, []).append(window)

    def of(self, device: str) -> DeviceFaults:
        """The faults of one device."""
        self._asked.add(device)
        return DeviceFaults(device, self._windows.get(device, ()))

    def check_all_taken(self) -> None:
        """Check that every fault was asked for by a device.

        Raises:
            FaultError: a fault names a device that nobody built.
        """
        left = sorted(self._windows.keys() - self._asked)
        if left:
            there = ", ".join(sorted(self._asked))
            raise FaultError(f"No device is called {', '.join(left)}; devices here are: {there}.")


class FaultyScalar:
    """A ``ScalarAnalog`` with the faults ``stuck`` and ``saturated``.

    Args:
        analog: The healthy input.
        faults: Faults of its device.
        start_ns: ``CLOCK_MONOTONIC`` ns of mission time 0.
    """

    def __init__(self, analog: ScalarAnalog, faults: DeviceFaults, start_ns: int) -> None:
        self._analog = analog
        self._faults = faults
        self._start_ns = start_ns
        self._last = math.nan

    def value(self, time_s: float) -> float:
        """As ``ScalarAnalog.value``; saturation is an infinite value for the converter to clip."""
        if self._faults:
            now_ns = self._start_ns + round(time_s * 1e9)
            saturated = self._faults.active(FaultKind.SATURATED, now_ns)
            if saturated is not None:
                return math.copysign(math.inf, saturated.value)
            if self._faults.active(FaultKind.STUCK, now_ns) is not None and not math.isnan(self._last):
                return self._last
        self._last = self._analog.value(time_s)
        return self._last


class FaultyImu:
    """An ``ImuAnalog`` with the faults ``stuck`` and ``saturated``. Arguments as of ``FaultyScalar``."""

    def __init__(self, analog: ImuAnalog, faults: DeviceFaults, start_ns: int) -> None:
        self._analog = analog
        self._start_ns = start_ns
        kinds = (FaultKind.STUCK, FaultKind.SATURATED)
        self._windows = [w for w in faults.windows if w.kind in kinds]
        self._last: NDArray[np.int16] | None = None

    def counts(
        self, times_s: NDArray[np.float64], accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int
    ) -> NDArray[np.int16]:
        """As ``ImuAnalog.counts``."""
        counts = self._analog.counts(times_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg)
        if not self._windows:
            return counts
        counts = counts.copy()
        times_ns = self._start_ns + times_s * 1e9
        for window in self._windows:
            inside = np.flatnonzero((times_ns >= window.start_ns) & (times_ns < window.end_ns))
            if inside.size == 0:
                continue
            if window.kind is FaultKind.SATURATED:
                counts[inside[:, np.newaxis], _INERTIAL] = -32768 if window.value < 0 else 32767
            elif inside[0] > 0:
                counts[inside] = counts[inside[0] - 1]
            else:
                counts[inside] = counts[inside[0]] if self._last is None else self._last
        self._last = counts[-1]
        return counts
