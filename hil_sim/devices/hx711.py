"""An Avia Semiconductor HX711 with a load cell on its channel A (its data sheet), on PD_SCK and DOUT.

DOUT is low when a conversion is ready. Each rising edge of PD_SCK shifts a bit out, the highest first; the 25th one
takes DOUT high. 25, 26 or 27 pulses choose input and gain of the next conversion: A 128, B 32, A 64. PD_SCK high for
longer than 60 us is power-down, with DOUT high; low again: reset, and A 128. Two's complement; full scale is half of
AVDD over the gain, either way, 7FFFFFh and 800000h at its ends; AVDD feeds the bridge. RATE chooses 10 or 80 a second
of its own oscillator. After power-up, a reset and a change of input or gain it settles: 400 ms at 10 and 100 at 80.

Where the data sheet is silent: the filter is that of ``bridge_converter``; DOUT stays high while it settles; a reset
begins a conversion; a conversion that ends while another is read waits for that one's 25th pulse; pulses after the 27th
change nothing; channel B is shorted. Without supply its DOUT is held low by its protection diodes.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from hil_sim.devices.bridge_converter import BridgeEmulator, Conversions
from hil_sim.devices.emulator import Bench, Equivalent, Twin
from hil_sim.faults import CLOCK_KINDS, INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ScalarAnalog
from hil_sim.sensing.sensors import LoadCellSensor

_SELECTED: Final = {25: ("A", 128), 26: ("B", 32), 27: ("A", 64)}
_BITS, _READ, _MOST = 24, 25, 27
_POWER_DOWN_NS: Final = 60_000
_FULL: Final = 1 << 23
_LAZY_NS: Final = 50_000_000
_OFFSET: Final = 0.2e-3 / 5.0  # 1 sigma of its input's, V per V of AVDD: 0.2 mV at 5 V and a gain of 128
_SETTLING: Final = {10: 4, 80: 8}  # conversions
_KINDS: Final = (
    *(FaultKind.OFF, FaultKind.RESET, FaultKind.SILENT, FaultKind.INTERMITTENT, FaultKind.GARBAGE),
    *(*INPUT_KINDS, FaultKind.SATURATED, *CLOCK_KINDS),
)


class Hx711Twin:
    """One chip, a ``ClockedChip``.

    Args:
        analog: Force on the cell, N.
        clock: Its oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        rate_hz: By its pin RATE, 10 or 80.
        volt_per_volt_N: What the bridge gives for a newton, V per V of its supply.
        offset: Of its input, V per V of its supply.
        faults: What breaks.

    Raises:
        FaultError: a fault that it cannot have.
    """

    def __init__(
        self,
        analog: ScalarAnalog,
        clock: ChipClock,
        start_ns: int,
        *,
        rate_hz: int = 80,
        volt_per_volt_N: float = 2e-3 / 50.0,
        offset: float = 0.0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        self._faults, self._is_faulty = faults.require(*_KINDS), bool(faults)
        self.conversions = Conversions(analog, clock, start_ns, faults)
        self._rng = faults.rng()
        self._cycles = deque(faults.power_cycles())
        self._off_until_ns = self._settled_ns = start_ns
        self._period_ns = 1_000_000_000 // rate_hz
        self._per_N = volt_per_volt_N
        self._offset = offset
        self._settling = _SETTLING[rate_hz]
        self._high = False
        self._rose_ns = start_ns
        self._reset(start_ns)

    def _reset(self, now_ns: int) -> None:
        self._selected = _SELECTED[_READ]
        self._hidden = self._settling - 1  # conversions that are not shown
        self._word: int | None = None  # a conversion that is ready, or being read
        self._pulses = 0  # since the last one was ready
        self.conversions.begin(self.conversions.chip_ns(now_ns), self._period_ns)

    def advance(self, now_ns: int) -> None:
        """Time goes on."""
        if now_ns - self._settled_ns >= _LAZY_NS:
            self._settle(now_ns)

    def _settle(self, now_ns: int) -> None:
        while self._cycles and self._cycles[0].down_ns <= now_ns:
            cycle = self._cycles.popleft()
            self._run(cycle.down_ns)
            self._off_until_ns = cycle.up_ns
            self._reset(cycle.up_ns)
        if now_ns >= self._off_until_ns:
            self._run(now_ns)
        self._settled_ns = max(now_ns, self._settled_ns)

    def _run(self, until_ns: int) -> None:
        if self._is_down(until_ns) or 0 < self._pulses < _READ:
            return
        made = self.conversions.run(until_ns)
        if not made:
            return
        if self._pulses:
            selected = _SELECTED[min(self._pulses, _MOST)]
            self._hidden = self._settling if selected != self._selected else self._hidden
            self._selected, self._pulses = selected, 0
        self._hidden, shown = max(self._hidden - made, 0), made > self._hidden
        self._word = self._convert(until_ns) if shown else None

    def _convert(self, until_ns: int) -> int:
        channel, gain = self._selected
        force_N = self.conversions.force(until_ns)
        ratio = (self._per_N * force_N if channel == "A" else 0.0) + self._offset
        return round(min(max(2.0 * gain * ratio * _FULL, -_FULL), _FULL - 1)) % (2 * _FULL)

    def _is_down(self, now_ns: int) -> bool:
        return self._high and now_ns - self._rose_ns > _POWER_DOWN_NS

    def _is_away(self, now_ns: int) -> bool:
        return self._is_faulty and self._faults.is_away(now_ns)

    def clock_line(self, high: bool, now_ns: int) -> None:
        """See ``ClockedChip``."""
        self._settle(now_ns)
        if self._is_away(now_ns):
            return
        if self._is_down(now_ns) and not high:
            self._reset(now_ns)
        elif high and not self._high:
            self._rose_ns = now_ns
            if self._word is not None or self._pulses:
                self._pulse(now_ns)
        self._high = high

    def _pulse(self, now_ns: int) -> None:
        self._pulses = min(self._pulses + 1, _MOST)
        if self._pulses == _BITS:
            self.conversions.show()
        if self._pulses == _READ:
            self._word = None
        garbled = self._is_faulty and self._faults.active(FaultKind.GARBAGE, now_ns) is not None
        if garbled and self._pulses == 1 and self._word is not None:
            self._word = int(self._rng.integers(2 * _FULL))

    def data_line(self, now_ns: int) -> bool:
        """See ``ClockedChip``."""
        self._settle(now_ns)
        if self._is_away(now_ns):
            return True
        if now_ns < self._off_until_ns:
            return False
        if self._word is None or self._is_down(now_ns):
            return True
        return bool(self._word >> (_BITS - self._pulses) & 1) if self._pulses else False


class Hx711Table(BridgeEmulator):
    """An HX711 with a cell."""

    needs = "pair"
    where = "the two lines"

    kind: Literal["hx711"]
    rate_hz: Literal[10, 80] = 80

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``BridgeEmulator``."""
        equivalent = super().from_vehicle(name, said, sheets)
        equivalent.device["rate_hz"] = said.get("sample_rate_hz", 80)
        return equivalent

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        twin = Hx711Twin(
            bench.sensor(LoadCellSensor),
            bench.clock,
            bench.start_ns,
            rate_hz=self.rate_hz,
            volt_per_volt_N=self.volt_per_volt_N,
            offset=_OFFSET * float(np.random.default_rng([bench.seed, 0x711]).standard_normal()),
            faults=bench.faults,
        )
        return Twin(twin, lambda: twin.conversions.shown, (bench.name,))
