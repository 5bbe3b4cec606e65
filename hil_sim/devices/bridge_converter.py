"""Load cell converters: their digital filter, the count of their conversions, the cell in their table.

Data sheets say that the filter settles in four conversions and not what it is: here, four running means over one
conversion each (delay of two).
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from pydantic import PositiveFloat

from hil_sim.devices.emulator import FORCES, Equivalent, MeasuringEmulator
from hil_sim.faults import DeviceFaults, FaultyClock, FaultyScalar
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ScalarAnalog

_TAPS: Final = 4  # samples of the input in a conversion
_BOX: Final = np.full(_TAPS, 1.0 / _TAPS)
FILTER: Final = np.convolve(np.convolve(_BOX, _BOX), np.convolve(_BOX, _BOX))
"""Weights of input samples a quarter of a conversion apart, (13,)."""
NOISE_GAIN: Final = float(np.sqrt(np.sum(FILTER**2)))
"""Of white noise, rms."""


class Conversions:
    """Conversions of a chip's input, one after the other by its oscillator.

    Args:
        analog: Force on the cell, N.
        clock: The oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        faults: What breaks.

    Attributes:
        shown: From the first to the last that was read as new, by the rate that the chip had.
        last_s: Mission time at which the last one ended.
    """

    def __init__(self, analog: ScalarAnalog, clock: ChipClock, start_ns: int, faults: DeviceFaults) -> None:
        self._cell = FaultyScalar(analog, faults, start_ns)
        self._healthy, self._clock = clock, FaultyClock(clock, faults)
        self._start_ns = start_ns
        self._made = 0
        self.shown = 0
        self.last_s = 0.0
        self._last_shown: tuple[int, int, float] | None = None  # grid, number, mission time
        self._grid = 0
        self.period_ns = 0
        self._next_ns = 0

    def chip_ns(self, now_ns: int) -> int:
        """Time of its oscillator."""
        return self._clock.chip_ns(now_ns)

    def begin(self, chip_ns: int, period_ns: int) -> None:
        """A conversion begins, of another phase than those before."""
        self._grid += 1
        self.period_ns = period_ns
        self._next_ns = chip_ns + period_ns

    def run(self, until_ns: int) -> int:
        """How many have ended until then, since the last call or beginning."""
        due = int((self._clock.chip_ns(until_ns) - self._next_ns) // self.period_ns) + 1
        if due > 0:
            self._next_ns += due * self.period_ns
            self._made += due
        return max(due, 0)

    def force(self, until_ns: int) -> float:
        """Filtered force of the last one that had ended until then, N."""
        ended_ns, latest_s = self._next_ns - self.period_ns, (until_ns - self._start_ns) * 1e-9
        back = np.arange(len(FILTER) - 1, -1, -1, dtype=np.float64) + 2.0  # of the middles of four means' samples
        times_s = np.clip(self._clock.times_s(ended_ns - self.period_ns / _TAPS * back), 0.0, latest_s)  # (13,)
        self.last_s = min(float(self._clock.times_s(np.array([float(ended_ns)]))[0]), latest_s)
        return float(self._cell.values(times_s) @ FILTER)

    def show(self) -> None:
        """The last one is read as new."""
        if self._last_shown is None:
            self.shown = 1
        elif self._last_shown[0] == self._grid:
            self.shown += self._made - self._last_shown[1]
        else:
            second = self._healthy.chip_ns(self._start_ns + 1_000_000_000) - self._healthy.chip_ns(self._start_ns)
            self.shown += max(round((self.last_s - self._last_shown[2]) * second / self.period_ns), 1)
        self._last_shown = self._grid, self._made, self.last_s


class BridgeEmulator(MeasuringEmulator):
    """A converter with a cell that gives ``rated_output_mV_V`` at ``rated_load_N``."""

    quantities = FORCES

    rated_output_mV_V: PositiveFloat = 2.0  # noqa: N815  (the volt's letter)
    rated_load_N: PositiveFloat = 50.0  # noqa: N815

    @property
    def volt_per_volt_N(self) -> float:  # noqa: N802
        """What the bridge gives for a newton, V per V of its supply."""
        return 1e-3 * self.rated_output_mV_V / self.rated_load_N

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: the cell and its cable delay by half a millisecond, the rest is the chip's filter."""
        table = {"measures": name, "at": said["frame"], "rated_output_mV_V": said.get("rated_output_mV_V", 2.0)}
        table["rated_load_N"] = said.get("rated_load_N") or said["capacity_N"]
        cell = sheets.load_cell(said) | {"delay_ms": 0.5, "delay_sigma_ms": 0.0}
        cell["noise_rms_N"] /= NOISE_GAIN
        return Equivalent(table, {name: cell}, {name: "converter"})
