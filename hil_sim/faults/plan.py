"""The faults of a mission on the true clock, distributed to their devices."""

import zlib
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from hil_sim.faults.vocabulary import Fault, FaultError, FaultKind, meant

NEVER = 1 << 62  # ns; later than any clock here


class FaultWindow(NamedTuple):
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
    """The faults of one device, on the true clock.

    Attributes:
        possible: Kinds that the device says it can have.
    """

    def __init__(self, device: str, windows: Iterable[FaultWindow] = ()) -> None:
        self.device = device
        self.possible: tuple[FaultKind, ...] = ()
        self.windows = tuple(sorted(windows, key=lambda w: w.start_ns))

    def __bool__(self) -> bool:
        return bool(self.windows)

    def require(self, *kinds: FaultKind) -> "DeviceFaults":
        """Check that every fault here is of one of ``kinds``, and return self.

        Raises:
            FaultError: a fault that the device cannot have.
        """
        self.possible = kinds
        for window in self.windows:
            if window.kind not in kinds:
                possible = ", ".join(kinds)
                raise FaultError(f"{self.device} cannot have the fault {window.kind}; it can have: {possible}.")
        return self

    def active(self, kind: FaultKind, now_ns: int) -> FaultWindow | None:
        """The fault of this kind in force at ``now_ns``, or None."""
        for window in self.windows:
            if window.kind is kind and window.start_ns <= now_ns < window.end_ns:
                return window
        return None

    def over(self, now_ns: int) -> bool:
        """Whether none is in force from ``now_ns`` on."""
        return all(window.end_ns <= now_ns for window in self.windows)

    def quiet_until(self, now_ns: int, *besides: FaultKind) -> int:
        """Before when none is in force but of kinds ``besides``: ``now_ns`` where one is."""
        others = [w for w in self.windows if w.kind not in besides and w.end_ns > now_ns]
        return max(now_ns, others[0].start_ns) if others else NEVER

    def within(self, now_ns: int, *kinds: FaultKind) -> FaultWindow | None:
        """The first fault of one of these kinds in force at ``now_ns``, or None."""
        for window in self.windows:
            if window.kind in kinds and window.start_ns <= now_ns < window.end_ns:
                return window
        return None

    def absences(self) -> list[tuple[int, int]]:
        """Times [from, to) in which the connector is open, in order: ``silent``, and the halves of ``intermittent``."""
        away: list[tuple[int, int]] = []
        for window in self.windows:
            if window.kind is FaultKind.SILENT:
                away.append((window.start_ns, window.end_ns))
            elif window.kind is FaultKind.INTERMITTENT:
                period_ns = max(2, round(window.value * 1e9))
                for start_ns in range(window.start_ns, window.end_ns, period_ns):
                    away.append((start_ns, min(start_ns + period_ns // 2, window.end_ns)))
        return sorted(away)

    def is_away(self, now_ns: int) -> bool:
        """Whether the connector is open at ``now_ns``."""
        for window in self.windows:
            if window.start_ns <= now_ns < window.end_ns:
                if window.kind is FaultKind.SILENT:
                    return True
                if window.kind is FaultKind.INTERMITTENT:
                    period_ns = max(2, round(window.value * 1e9))
                    if (now_ns - window.start_ns) % period_ns < period_ns // 2:
                        return True
        return False

    def rng(self) -> np.random.Generator:
        """The device's random numbers."""
        return np.random.default_rng([zlib.crc32(self.device.encode()), 0xFA])

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
        return self.repeats(FaultKind.PULSE_SPURIOUS, after_ns, until_ns)

    def repeats(self, kind: FaultKind, after_ns: int, until_ns: int) -> list[int]:
        """True times in (``after_ns``, ``until_ns``] at which a fault of ``kind`` acts, every ``value`` s, in order."""
        edges: list[int] = []
        for window in self.windows:
            if window.kind is not kind:
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
        self._windows: dict[str, list[FaultWindow]] = {}
        self._asked: dict[str, DeviceFaults] = {}
        for fault in faults:
            end_ns = NEVER if fault.end_s * 1e9 >= NEVER - start_ns else start_ns + round(fault.end_s * 1e9)
            window = FaultWindow(fault.kind, start_ns + round(fault.start_s * 1e9), end_ns, fault.value)
            self._windows.setdefault(fault.device, []).append(window)

    def of(self, device: str) -> DeviceFaults:
        """The faults of one device."""
        self._asked[device] = DeviceFaults(device, self._windows.get(device, ()))
        return self._asked[device]

    def possible(self) -> dict[str, tuple[FaultKind, ...]]:
        """Kinds of faults that each device and bus can have, which asked for theirs."""
        return {name: faults.possible for name, faults in self._asked.items()}

    def check_all_taken(self) -> None:
        """Check that every fault was asked for by a device.

        Raises:
            FaultError: a fault names a device that does not exist.
        """
        left = sorted(self._windows.keys() - self._asked)
        if left:
            there = ", ".join(sorted(self._asked))
            named = ", ".join(f"{name}{meant(name, self._asked)}" for name in left)
            raise FaultError(f"No device is called {named}; devices here are: {there}.")


def garbled(data: bytes, rng: np.random.Generator) -> bytes:
    """As many random bytes."""
    return rng.bytes(len(data))
