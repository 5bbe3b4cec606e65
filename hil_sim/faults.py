"""Faults as data: what breaks, where, from when to when. The twins and the buses apply them.

One vocabulary for every twin and every wire. In the twins:

==================  =======================  ==========================================================================
kind                devices                  effect between ``start_s`` and ``end_s``
==================  =======================  ==========================================================================
``off``             any twin                 no supply; it starts again, from its reset values, at ``end_s``
``reset``           any twin                 brown-out at ``start_s``: starts again at once (``end_s`` is not used)
``silent``          all but the IMU          open connector: neither hears nor is heard, keeps its state
``intermittent``    any twin, any bus        loose connector: open for the first half of every ``value`` seconds
``stuck``           analogue inputs, phase   the input holds its last value
``saturated``       imu, load cell           the input is at full scale; the sign of ``value`` says which end
``wrong``           analogue inputs          plausible and false: the reading is ``1 + value`` times what it should be
``wrong``           phase, SYNC counter      ``value`` is added to the number
``delayed``         analogue inputs, phase   the input shows what was ``value`` seconds ago
``garbage``         any twin                 what it says is random bits, in transfers and frames of the right form
``slow``            CAN nodes                it answers SYNC and SDO ``value`` seconds late
``slow``            imu, sync box            its oscillator runs slow by the share ``value`` (0.02: 2 %)
``clock_jump``      imu, sync box            its clock stands still for ``-value`` s at ``start_s`` (``end_s`` is not
                                             used); the sync box's may also be put forward, by a positive ``value``
``nack``            imu                      every transfer fails with errno ``value`` (0: EREMOTEIO)
``timeout``         imu                      it stretches the clock for ever: a transfer is made, and ends in ETIMEDOUT
``who_am_i``        imu                      WHO_AM_I reads ``value``
``pulse_drop``      recorders of the pulse   the edge never reaches this pin
``pulse_spurious``  recorders of the pulse   one more edge every ``value`` seconds, beginning at ``start_s``
==================  =======================  ==========================================================================

On the wires:

==================  =======================  ==========================================================================
kind                bus                      effect between ``start_s`` and ``end_s``
==================  =======================  ==========================================================================
``nack``            I2C                      nobody acknowledges; errno as above
``timeout``         I2C                      transfers are made, and end in ETIMEDOUT
``stuck_bus``       I2C                      SDA is held low: no transfer begins, EBUSY
``bus_off``         CAN                      the flight computer's controller is off the bus; error frames say when
``error_frames``    CAN                      a bus error every ``value`` seconds; what it hit is sent again
``flood``           CAN                      a babbling node sends ``value`` (a COB-ID) without pause
``frame_drop``      CAN                      the flight computer loses frames with COB-ID ``value`` (0: every frame)
``delayed``         CAN, sync line           frames, or edges, are stamped and delivered ``value`` seconds late
``pulse_drop``      sync line                edges are not seen
``pulse_spurious``  sync line                one more edge every ``value`` seconds, beginning at ``start_s``
``garbage``         sync line                chatter: ``value`` more edges a second, at random times
``byte_loss``       serial                   each character is lost with probability ``value``
``byte_garble``     serial                   each character has one bit inverted with probability ``value``
``unplug``          serial                   the adapter is pulled out of the flight computer
==================  =======================  ==========================================================================

Everything random is drawn from the device's name, so a fault does the same in every run.
A fault that its device cannot apply is refused when the device is built: a fault that silently does nothing would
make a fault test pass for the wrong reason.
"""

import math
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_sim.analog import ChipClock, ImuAnalog, ScalarAnalog

NEVER = 1 << 62  # ns; later than any clock here
_INERTIAL = np.array([0, 1, 2, 4, 5, 6])  # columns of ImuAnalog.counts without the temperature


class FaultError(ValueError):
    """A fault that cannot be applied as written."""


class FaultKind(StrEnum):
    """The vocabulary. The module's table says what each does."""

    OFF = "off"
    RESET = "reset"
    SILENT = "silent"
    INTERMITTENT = "intermittent"
    STUCK = "stuck"
    SATURATED = "saturated"
    WRONG = "wrong"
    DELAYED = "delayed"
    GARBAGE = "garbage"
    SLOW = "slow"
    CLOCK_JUMP = "clock_jump"
    NACK = "nack"
    TIMEOUT = "timeout"
    STUCK_BUS = "stuck_bus"
    WHO_AM_I = "who_am_i"
    PULSE_DROP = "pulse_drop"
    PULSE_SPURIOUS = "pulse_spurious"
    BUS_OFF = "bus_off"
    ERROR_FRAMES = "error_frames"
    FLOOD = "flood"
    FRAME_DROP = "frame_drop"
    BYTE_LOSS = "byte_loss"
    BYTE_GARBLE = "byte_garble"
    UNPLUG = "unplug"


INPUT_KINDS: Final = (FaultKind.STUCK, FaultKind.WRONG, FaultKind.DELAYED)
"""What ``FaultyScalar`` and ``FaultyImu`` apply to any analogue input; ``SATURATED`` is for inputs that have an end."""

_ABOVE_ZERO: Final = {
    FaultKind.INTERMITTENT: "the seconds from one interruption to the next",
    FaultKind.DELAYED: "the delay in seconds",
    FaultKind.SLOW: "the seconds it answers late, or the share by which its oscillator is slow",
    FaultKind.PULSE_SPURIOUS: "the seconds between two edges",
    FaultKind.ERROR_FRAMES: "the seconds between two error frames",
}
_NOT_ZERO: Final = {
    FaultKind.WRONG: "how wrong it is",
    FaultKind.CLOCK_JUMP: "the jump in seconds",
}
_WITHIN: Final = {
    FaultKind.WHO_AM_I: (0, 0xFF, "the byte to read (0 to 255)"),
    FaultKind.FLOOD: (0, 0x7FF, "the COB-ID to send (0 to 7FFh)"),
    FaultKind.BYTE_LOSS: (1e-9, 1.0, "a probability above 0 and up to 1"),
    FaultKind.BYTE_GARBLE: (1e-9, 1.0, "a probability above 0 and up to 1"),
}


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
        why = self._nonsense()
        if why is not None:
            raise FaultError(f"Fault {self.kind} of {self.device} needs {why}.")

    def _nonsense(self) -> str | None:
        if self.kind in _ABOVE_ZERO and not self.value > 0.0:
            return f"`value`, {_ABOVE_ZERO[self.kind]}, above 0"
        if self.kind in _NOT_ZERO and not (math.isfinite(self.value) and self.value):
            return f"`value`, {_NOT_ZERO[self.kind]}, other than 0"
        low, high, what = _WITHIN.get(self.kind, (-math.inf, math.inf, ""))
        if not low <= self.value <= high:
            return f"`value`, {what}"
        if self.kind is FaultKind.INTERMITTENT and math.isinf(self.end_s):
            return "`end_s`: a connector is not loose for ever"
        return None


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

    def within(self, now_ns: int, *kinds: FaultKind) -> Window | None:
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
        """The device's own random numbers."""
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
        """True times in (``after_ns``, ``until_ns``] of what a fault of ``kind`` does every ``value`` s, in order."""
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
    """A ``ScalarAnalog`` with the faults ``stuck``, ``saturated``, ``wrong`` and ``delayed``.

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
        if not self._faults:
            return self._analog.value(time_s)
        now_ns = self._start_ns + round(time_s * 1e9)
        saturated = self._faults.active(FaultKind.SATURATED, now_ns)
        if saturated is not None:
            return math.copysign(math.inf, saturated.value)
        if self._faults.active(FaultKind.STUCK, now_ns) is not None and not math.isnan(self._last):
            return self._last
        delayed = self._faults.active(FaultKind.DELAYED, now_ns)
        reading = self._analog.value(time_s if delayed is None else max(time_s - delayed.value, 0.0))
        wrong = self._faults.active(FaultKind.WRONG, now_ns)
        self._last = reading if wrong is None else reading * (1.0 + wrong.value)
        return self._last


class FaultyImu:
    """An ``ImuAnalog`` with the same faults. Arguments as of ``FaultyScalar``."""

    def __init__(self, analog: ImuAnalog, faults: DeviceFaults, start_ns: int) -> None:
        self._analog = analog
        self._start_ns = start_ns
        kinds = (FaultKind.SATURATED, *INPUT_KINDS)
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
            if window.kind is FaultKind.DELAYED:
                before_s = np.maximum(times_s[inside] - window.value, 0.0)
                counts[inside] = self._analog.counts(before_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg)
            elif window.kind is FaultKind.WRONG:
                cells = inside[:, np.newaxis], _INERTIAL
                readings = np.rint(counts[cells] * (1.0 + window.value))
                counts[cells] = np.clip(readings, -32768, 32767).astype(np.int16)
            elif window.kind is FaultKind.SATURATED:
                counts[inside[:, np.newaxis], _INERTIAL] = -32768 if window.value < 0 else 32767
            elif inside[0] > 0:
                counts[inside] = counts[inside[0] - 1]
            else:
                counts[inside] = counts[inside[0]] if self._last is None else self._last
        self._last = counts[-1]
        return counts


class _Segment(NamedTuple):
    """From ``healthy_ns`` of the healthy clock on, the faulty one goes on from ``shown_ns`` at ``rate``."""

    healthy_ns: float
    shown_ns: float
    rate: float

    def shown_at(self, healthy_ns: float) -> float:
        return self.shown_ns + self.rate * (healthy_ns - self.healthy_ns)


class FaultyClock:
    """A ``ChipClock`` with the faults ``slow`` and ``clock_jump``.

    A time that it never shows, because it was put forward over it, is the instant of the jump.

    Args:
        clock: The healthy oscillator.
        faults: Faults of its device.

    Raises:
        FaultError: two of them overlap, or one that makes it run backwards.
    """

    def __init__(self, clock: ChipClock, faults: DeviceFaults) -> None:
        self._clock = clock
        self._segments: list[_Segment] = []
        for window in faults.windows:
            if window.kind not in (FaultKind.SLOW, FaultKind.CLOCK_JUMP):
                continue
            start_ns, end_ns, rate, ahead_ns = window.start_ns, window.end_ns, 1.0 - window.value, 0.0
            if window.kind is FaultKind.CLOCK_JUMP:
                ahead_ns = max(window.value, 0.0) * 1e9
                rate, end_ns = 0.0, start_ns + max(-round(window.value * 1e9), 0)
            if rate < 0.0:
                raise FaultError(f"{faults.device} is slow by {window.value}: a clock stands still at 1; give less.")
            begins = float(clock.chip_ns(start_ns))
            if not self._segments:
                self._segments.append(_Segment(-math.inf, -math.inf, 1.0))
                shown = begins
            elif begins < self._segments[-1].healthy_ns:
                raise FaultError(f"The clock faults of {faults.device} overlap; set them apart.")
            else:
                shown = self._segments[-1].shown_at(begins)
            if end_ns > start_ns:
                self._segments.append(_Segment(begins, shown + ahead_ns, rate))
                begins, shown = float(clock.chip_ns(end_ns)), self._segments[-1].shown_at(float(clock.chip_ns(end_ns)))
                self._segments.append(_Segment(begins, shown, 1.0))
            else:
                self._segments.append(_Segment(begins, shown + ahead_ns, 1.0))

    def time_ns(self, chip_ns: int) -> int:
        """See ``ChipClock``."""
        return self._clock.time_ns(round(self._healthy(chip_ns)) if self._segments else chip_ns)

    def chip_ns(self, time_ns: int) -> int:
        """See ``ChipClock``."""
        healthy_ns = self._clock.chip_ns(time_ns)
        for segment in reversed(self._segments[1:]):
            if healthy_ns >= segment.healthy_ns:
                return round(segment.shown_at(healthy_ns))
        return healthy_ns

    def times_s(self, chip_ns: NDArray[np.float64]) -> NDArray[np.float64]:
        """See ``ChipClock``."""
        if not self._segments:
            return self._clock.times_s(chip_ns)
        return self._clock.times_s(np.array([self._healthy(value) for value in chip_ns.tolist()], np.float64))

    def _healthy(self, shown_ns: float) -> float:
        """The healthy clock's time when this one first shows ``shown_ns``."""
        for segment, following in zip(self._segments, [*self._segments[1:], None], strict=True):
            if following is None or shown_ns < following.shown_ns:
                if segment.shown_ns == -math.inf:
                    return min(shown_ns, math.inf if following is None else following.healthy_ns)
                healthy = segment.healthy_ns
                if segment.rate > 0.0:
                    healthy += (shown_ns - segment.shown_ns) / segment.rate
                return healthy if following is None else min(max(healthy, segment.healthy_ns), following.healthy_ns)
        raise AssertionError("the last segment has no end")


def garbled(data: bytes, rng: np.random.Generator) -> bytes:
    """As many random bytes."""
    return rng.bytes(len(data))


def told_phases(
    changes: list[tuple[int, int]], faults: DeviceFaults, wrap: Callable[[int], int] = lambda code: code & 0xFF
) -> list[tuple[int, int]]:
    """(time in ns, code) of the changes that are told, of those that there are, with the faults of an input.

    Args:
        changes: What changes, in order.
        faults: Faults of the device: ``stuck``, ``wrong``, ``delayed``.
        wrap: What a sum becomes in the code's type.
    """
    windows = [w for w in faults.windows if w.kind in INPUT_KINDS]
    if not windows:
        return changes
    late: list[tuple[int, int]] = []
    for time_ns, code in changes:
        delayed = faults.active(FaultKind.DELAYED, time_ns)
        late.append((time_ns + (0 if delayed is None else round(delayed.value * 1e9)), code))
    late.sort(key=lambda change: change[0])
    told: list[tuple[int, int]] = []
    bounds = {t for w in windows for t in (w.start_ns, w.end_ns) if t < NEVER and w.kind is not FaultKind.DELAYED}
    for now_ns in sorted(bounds | {time_ns for time_ns, _ in late}):
        code = next((c for t, c in reversed(late) if t <= now_ns), 0)
        if faults.active(FaultKind.STUCK, now_ns) is not None:
            continue
        wrong = faults.active(FaultKind.WRONG, now_ns)
        code = code if wrong is None else wrap(code + int(wrong.value))
        if code != (told[-1][1] if told else 0):
            told.append((now_ns, code))
    return told
