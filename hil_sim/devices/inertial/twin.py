"""An inertial chip behind its I2C interface: when its samples are made, and how many were; its registers are its own.

Samples are made lazily, in one vectorised call to the physics, when the chip is addressed or 50 ms have gathered. A
transfer is an instant: all that it reads belongs to its START.

Samples that a simulated chip converts ahead: one conversion of many costs hardly more than one of ten.

They are good as long as no register that they depend on is written, and the input's future is known.

The FSYNC latch of a simulated chip (RM-MPU-6000A 4.3): a pulse on the pin marks one bit of the next sample.

The FIFO of a simulated chip: bytes that forget their oldest, and what ever went into it.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_sim.devices.i2c.twin import POWER_KINDS, I2cTwin
from hil_sim.faults import DeviceFaults, FaultError, FaultKind, FaultyClock, FaultyImu, PowerCycle
from hil_sim.sensing.analog import ChipClock, ImuAnalog, KnownAhead

Times = NDArray[np.float64]
Words = NDArray[np.int16]
_MOST = 1024
_SECOND_NS = 1_000_000_000
_FAULTS: Final = (
    *POWER_KINDS,
    *(FaultKind.STUCK, FaultKind.SATURATED, FaultKind.WRONG, FaultKind.DELAYED, FaultKind.SLOW, FaultKind.CLOCK_JUMP),
    *(FaultKind.WHO_AM_I, FaultKind.PULSE_DROP, FaultKind.PULSE_SPURIOUS),
)


class TwinFifo:
    """Bytes, and the accounts of the samples written.

    Args:
        size: How many.

    Attributes:
        produced: Samples written in each of the periods in which it was enabled, the current one last.
        between: Sample periods between two times in which it was filled.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self.produced = [0]
        self.between = 0
        self._bytes = bytearray()
        self._last = 0
        self._latch = 0
        self._filled_s: float | None = None  # mission time of the last sample in it
        self._period_s = 1.0  # true sample period then

    def __len__(self) -> int:
        return len(self._bytes)

    def power_up(self) -> None:
        """Reset values; the accounts go on."""
        self._bytes = bytearray()
        self._last = self._latch = 0

    def enable(self) -> None:
        """USER_CTRL switches it on."""
        self.produced.append(0)

    def clear(self) -> None:
        """FIFO_RESET."""
        self._bytes.clear()

    def fill(self, data: bytes, samples: int, first_s: float, last_s: float, period_s: float) -> bool:
        """Write samples; whether it ran over.

        Args:
            data: Their bytes.
            samples: How many they are.
            first_s: Mission time of the first, s.
            last_s: Mission time of the last, s.
            period_s: True sample period, s.
        """
        if self._filled_s is not None and not self.produced[-1]:
            self.between += max(round((first_s - self._filled_s) / self._period_s) - 1, 0)
        self.produced[-1] += samples
        self._period_s = period_s
        self._filled_s = last_s
        return self.write(data)

    def write(self, data: bytes) -> bool:
        """Append bytes; whether it ran over, and the oldest are lost."""
        self._bytes += data
        excess = len(self._bytes) - self._size
        if excess > 0:
            del self._bytes[:excess]
        return excess > 0

    def pop(self, count: int, is_enabled: bool) -> bytes:
        """Bytes read; when it is empty or disabled, the last byte read, again and again."""
        taken = b""
        if is_enabled:
            taken = bytes(self._bytes[:count])
            del self._bytes[:count]
        if taken:
            self._last = taken[-1]
        return taken + bytes([self._last]) * (count - len(taken))

    def count_high(self) -> int:
        """FIFO_COUNT_H; reading it latches both halves."""
        self._latch = len(self._bytes)
        return self._latch >> 8

    def count_low(self) -> int:
        """FIFO_COUNT_L, as latched."""
        return self._latch & 0xFF


class FsyncLatch:
    """Pulses on the pin, until the sample that they mark is made. Times are mission times [s]."""

    def __init__(self) -> None:
        self._pulses: list[tuple[float, float]] = []  # rise and fall

    def high(self, rise_s: float, fall_s: float) -> None:
        """The pin is high from ``rise_s`` to ``fall_s``."""
        self._pulses.append((rise_s, fall_s))

    def latch(self, counts: NDArray[np.int16], times_s: NDArray[np.float64], last_s: float, column: int | None) -> None:
        """Mark the samples in which the pin was high at any time since the sample before.

        Args:
            counts: samples (n, 7), changed in place.
            times_s: when they were made, (n,).
            last_s: when the sample before them was made.
            column: the word whose lowest bit is the mark; None: EXT_SYNC_SET is off.
        """
        if column is None:
            return
        if not self._pulses:
            counts[:, column] &= ~1
            return
        before_s = np.concatenate(([last_s], times_s[:-1]))  # (n,)
        marks = np.zeros(len(times_s), np.int16)
        for rise_s, fall_s in self._pulses:
            first = int(np.searchsorted(times_s, rise_s, "left"))
            last = int(np.searchsorted(before_s, fall_s, "left"))
            marks[first:last] = 1
        counts[:, column] = (counts[:, column] & ~1) | marks

    def forget(self, last_s: float) -> None:
        """Pulses over before ``last_s``, the time of the newest sample, mark nothing more."""
        if self._pulses:
            self._pulses = [pulse for pulse in self._pulses if pulse[1] > last_s]


class Grid(NamedTuple):
    """When samples are made.

    Attributes:
        first_ns: Chip time of the next one.
        period_ns: Chip time between them.
        clock: That of the chip.
        settings: What their words depend on; empty where they cannot be made ahead.
    """

    first_ns: int
    period_ns: int
    clock: ChipClock
    settings: tuple[object, ...]


class SamplesAhead:
    """The samples of one chip.

    Args:
        analog: The input.
        convert: Words at chip times and mission times, none later than a mission time.
    """

    def __init__(self, analog: KnownAhead, convert: Callable[[Times, Times, float], Words]) -> None:
        self._analog = analog
        self._convert = convert
        self._settings: tuple[object, ...] = ()
        self._first_ns = 0  # chip time of the first of those converted ahead
        self._times_s: Times = np.zeros(0)  # (m,)
        self._words: Words = np.zeros((0, 7), np.int16)

    def next(self, count: int, grid: Grid, latest_s: float) -> tuple[Times, Words]:
        """The next samples: mission times (n,), none after ``latest_s``, and words (n, 7) that are the caller's."""
        times_s, words = self._times_s[:count], self._words[:count]
        fits = grid.settings and grid.settings == self._settings and grid.first_ns == self._first_ns
        if fits and len(times_s) == count and times_s[-1] <= latest_s:
            self._first_ns += count * grid.period_ns
            self._times_s, self._words = self._times_s[count:], self._words[count:]
            return times_s, words.copy()
        ticks_ns = grid.first_ns + grid.period_ns * np.arange(count, dtype=np.float64)  # (n,)
        times_s = np.minimum(grid.clock.times_s(ticks_ns), latest_s)
        words = self._convert(ticks_ns, times_s, latest_s)
        if grid.settings:
            self._make(count, grid._replace(first_ns=grid.first_ns + count * grid.period_ns))
        return times_s, words

    def _make(self, fewest: int, grid: Grid) -> None:
        """Convert what the input knows; fewer than ``fewest`` samples would be for nothing."""
        self._first_ns, self._settings = grid.first_ns, grid.settings
        ticks_ns = grid.first_ns + grid.period_ns * np.arange(_MOST, dtype=np.float64)
        times_s = grid.clock.times_s(ticks_ns)
        known = int(np.searchsorted(times_s, self._analog.known_s))
        known = known if known >= fewest else 0
        self._times_s = times_s[:known]
        self._words = self._convert(ticks_ns[:known], self._times_s, math.inf) if known else self._words[:0]


class InertialTwin(I2cTwin):
    """One chip.

    Args:
        address: 7-bit address.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        faults: What breaks.
        analog: Its sensing elements.
        clock: Its oscillator.
        fifo_bytes: Size of its FIFO.

    Raises:
        FaultError: a fault that it cannot have.
    """

    _period_ns: int  # of its samples, by its own clock,
    _tick_ns: int  # and of what they are a multiple of
    _running: bool

    def __init__(
        self, address: int, start_ns: int, faults: DeviceFaults, analog: ImuAnalog, clock: ChipClock, fifo_bytes: int
    ) -> None:
        super().__init__(address, start_ns, faults, _FAULTS)
        if any(w.kind is FaultKind.CLOCK_JUMP and w.value > 0.0 for w in faults.windows):
            raise FaultError(
                f"{faults.device} counts samples and no time, its clock cannot be put forward; give a negative value."
            )
        self._analog = FaultyImu(analog, faults, start_ns)
        self._healthy = clock
        self._pll: ChipClock = FaultyClock(clock, faults)
        self._clock: ChipClock = self._pll
        self._now_ns = start_ns
        self._fsync = FsyncLatch()
        self._fifo = TwinFifo(fifo_bytes)
        self._made = 0  # samples
        self._ahead = SamplesAhead(self._analog, self._convert)
        self._grid = 0  # counts the restarts of the sample grid
        self._shown = 0  # samples from the first to the last read out of the data registers as new
        self._last_shown: tuple[int, int, float] | None = None  # its grid, its number, its mission time
        self._true_period = (0, 1.0)  # a sample period of its own clock, ns, and how long it is, s

    @abstractmethod
    def _convert(
        self, ticks_ns: NDArray[np.float64], times_s: NDArray[np.float64], latest_s: float
    ) -> NDArray[np.int16]:
        """Words (n, 7) at chip times and mission times (n,): accel x y z, temperature, gyro x y z."""

    @property
    @abstractmethod
    def _settings(self) -> tuple[object, ...]:
        """What words depend on; empty where they cannot be made ahead."""

    @property
    @abstractmethod
    def _sync_column(self) -> int | None:
        """The word whose lowest bit FSYNC marks; None: it marks none."""

    @abstractmethod
    def _store(self, counts: NDArray[np.int16], times_s: NDArray[np.float64]) -> None:
        """New samples, the last of which is ``_last``: into data registers, flags and FIFO."""

    @property
    def produced(self) -> int:
        """Samples written to the FIFO since it was last enabled."""
        self._settle(self._now_ns)
        return self._fifo.produced[-1]

    @property
    def sampled(self) -> int:
        """Sample periods from the first to the last sample written to the FIFO, those in which it was off included.

        While the chip is reset, asleep or without supply it makes none, or others: what counts is those it would have
        made at the rate at which the FIFO was filled before.
        """
        self._settle(self._now_ns)
        return sum(self._fifo.produced) + self._fifo.between

    @property
    def shown(self) -> int:
        """Samples from the first to the last read as new: their flag and the words in one transfer."""
        return self._shown

    @property
    def produced_by_enable(self) -> tuple[int, ...]:
        """Samples written to the FIFO in each of the periods in which it was enabled, the current one last."""
        self._settle(self._now_ns)
        return tuple(self._fifo.produced[1:])

    @property
    def fifo_fill(self) -> int:
        """Bytes waiting in the FIFO."""
        self._settle(self._now_ns)
        return len(self._fifo)

    def fsync(self, edge_ns: int, high_ns: int) -> None:
        """The FSYNC pin goes high at ``edge_ns`` for ``high_ns``.

        Raises:
            ValueError: the edge lies before a sample that is already made; advance the source of the pulses first.
        """
        if self._faults.active(FaultKind.PULSE_DROP, edge_ns) is None:
            self._mark(edge_ns, high_ns)

    def _mark(self, edge_ns: int, high_ns: int) -> None:
        rise_s = (edge_ns - self._start_ns) * 1e-9
        if rise_s < self._last_s:
            raise ValueError(
                f"FSYNC rose at {rise_s:.6f} s and the sample of {self._last_s:.6f} s is already made; "
                "advance the pulse source before the chip."
            )
        self._fsync.high(rise_s, rise_s + high_ns * 1e-9)

    def advance(self, now_ns: int) -> None:
        """Time goes on; samples are made in batches, on a read or after 50 ms."""
        self._now_ns = max(now_ns, self._now_ns)
        super().advance(now_ns)

    def _settle(self, now_ns: int) -> None:
        """Make every sample that is due."""
        if now_ns == self._settled_ns and not self._cycles:
            return
        for edge_ns in self._faults.spurious_edges(self._settled_ns, now_ns) if self._is_faulty else ():
            self._mark(edge_ns, 300_000)
        super()._settle(now_ns)

    def _lose_power(self, cycle: PowerCycle) -> None:
        self._power_up(cycle.down_ns)

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """See ``I2cTwin``."""
        self._now_ns = max(now_ns, self._now_ns)
        return super().transfer(address, write, read_count, self._now_ns)

    def _show(self) -> None:
        """The newest sample is read; those since the last one count as of the rate that the chip now has."""
        if self._last_shown is None:
            self._shown = 1
        elif self._last_shown[0] == self._grid:
            self._shown += self._made - self._last_shown[1]
        else:
            self._shown += max(round((self._last_s - self._last_shown[2]) / self._period_s()), 1)
        self._last_shown = self._grid, self._made, self._last_s

    def _period_s(self) -> float:
        """A sample period in true time."""
        if self._true_period[0] != self._period_ns:
            shown_ns = self._healthy.chip_ns(self._start_ns + _SECOND_NS) - self._healthy.chip_ns(self._start_ns)
            self._true_period = self._period_ns, self._period_ns / shown_ns
        return self._true_period[1]

    def _wake(self, now_ns: int) -> None:
        """After power-up: no sample yet."""
        self._last = np.zeros(7, np.int16)
        self._last_s = (now_ns - self._start_ns) * 1e-9
        self._restart_grid(now_ns)

    def _restart_grid(self, now_ns: int) -> None:
        """The next sample falls on the next tick of the internal rate."""
        self._grid += 1
        self._next_chip_ns = (self._clock.chip_ns(now_ns) // self._tick_ns + 1) * self._tick_ns

    def _run(self, until_ns: int) -> None:
        if not self._running:
            self._last_s = max(self._last_s, (until_ns - self._start_ns) * 1e-9)  # the FSYNC latch rests too
            self._fsync.forget(self._last_s)
            return
        chip_ns = self._clock.chip_ns(until_ns)
        if chip_ns < self._next_chip_ns:
            return
        n = (chip_ns - self._next_chip_ns) // self._period_ns + 1
        latest_s = (until_ns - self._start_ns) * 1e-9
        settings = self._settings
        can_be_ahead = settings and not self._faults
        grid = Grid(self._next_chip_ns, self._period_ns, self._clock, (self._grid, *settings) if can_be_ahead else ())
        times_s, counts = self._ahead.next(int(n), grid, latest_s)  # (n,), (n, 7)
        self._next_chip_ns += n * self._period_ns
        self._made += int(n)
        self._fsync.latch(counts, times_s, self._last_s, self._sync_column)
        self._last = counts[-1]
        self._last_s = float(times_s[-1])
        self._fsync.forget(self._last_s)
        self._store(counts, times_s)
