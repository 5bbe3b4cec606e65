"""A Nuvoton NAU7802 with a load cell on its channel 1 (data sheet revision 1.7), on I2C at 2Ah.

Registers: 00h PU_CTRL (7 AVDDS, 6 OSCS, 5 CR, 4 CS, 3 PUR, 2 PUA, 1 PUD, 0 RR), 01h CTRL1 (7 CRP, 6 DRDY_SEL, 5..3
VLDO, 2..0 GAINS), 02h CTRL2 (7 CHS, 6..4 CRS, 3 CAL_ERR, 2 CALS, 1..0 CALMOD), 03h OCAL1 (sign and magnitude), 06h
GCAL1 (800000h is 1), 0Ah and 0Dh the same of channel 2, 11h I2C control, 12h ADCO, 15h ADC or OTP, 1Bh PGA, 1Ch power
control, 1Fh revision (0Fh). Full scale is half the reference over the gain, either way; AVDD is the reference and feeds
the bridge. Output = GCAL x (conversion - OCAL).

Where the data sheet is silent, or was not at hand: the filter is that of ``bridge_converter``; CR is cleared when the
first byte of ADCO is read; CS, a new rate, gain or channel begin a conversion; a calibration takes eight conversions;
channel 2 is shorted; PUR follows PUD after 200 us; everything but PU_CTRL can be written while it is off.
"""

from typing import Final, Literal

import numpy as np

from hil_sim.devices.bridge_converter import BridgeEmulator, Conversions
from hil_sim.devices.emulator import Bench, Twin
from hil_sim.devices.i2c.twin import POWER_KINDS, I2cTwin
from hil_sim.faults import CLOCK_KINDS, INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind
from hil_sim.sensing.analog import ChipClock, ScalarAnalog
from hil_sim.sensing.sensors import LoadCellSensor

_RATES: Final = {0: 10, 1: 20, 2: 40, 3: 80, 7: 320}
_RESET: Final = {0x07: 0x80, 0x0E: 0x80, 0x1F: 0x0F}
_WRITABLE: Final = frozenset({*range(0x01, 0x12), 0x15, 0x1B, 0x1C})
_FULL: Final = 1 << 23
_READY_NS: Final = 200_000
_CALIBRATION: Final = 8  # conversions
_OFFSET_V: Final = 20e-6  # our choice: 1 sigma of the amplifier's offset, at its input


class Nau7802Twin(I2cTwin):
    """One chip.

    Args:
        analog: Force on the cell, N.
        clock: Its RC oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        volt_per_volt_N: What the bridge gives for a newton, V per V of its supply.
        seed: Of its offset.
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
        volt_per_volt_N: float = 2e-3 / 50.0,
        seed: int = 0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        kinds = (*POWER_KINDS, *INPUT_KINDS, FaultKind.SATURATED, *CLOCK_KINDS, FaultKind.WHO_AM_I)
        super().__init__(0x2A, start_ns, faults, kinds)
        self.conversions = Conversions(analog, clock, start_ns, faults)
        self._per_N = volt_per_volt_N
        self._offset_V = _OFFSET_V * float(np.random.default_rng([seed, 0x7802]).standard_normal())
        self._power_up(start_ns)

    def _power_up(self, now_ns: int) -> None:
        self._reg = bytearray(0x20)
        for register, value in _RESET.items():
            self._reg[register] = value
        self._ready_ns = self._calibrated_ns = now_ns
        self._data = bytes(3)
        self._begin(now_ns)

    @property
    def _period_ns(self) -> int:
        return 1_000_000_000 // _RATES.get(self._reg[2] >> 4 & 7, 10)

    def _begin(self, now_ns: int) -> None:
        """A conversion begins."""
        self._reg[0] &= ~0x20
        self.conversions.begin(self.conversions.chip_ns(now_ns), self._period_ns)

    @property
    def _gain(self) -> int:
        return 1 << (self._reg[1] & 7)

    def _run(self, until_ns: int) -> None:
        power = self._reg[0]
        if power & 0x02 and until_ns - self._ready_ns >= _READY_NS:
            self._reg[0] |= 0x08
        if power & 0x07 != 0x06:
            return
        if self._reg[2] & 0x04:
            if self.conversions.chip_ns(until_ns) < self._calibrated_ns:
                return
            self._calibrate()
            self.conversions.begin(self._calibrated_ns, self._period_ns)
        if self.conversions.run(until_ns):
            self._convert(self._per_N * self.conversions.force(until_ns))
            self._reg[0] |= 0x20

    def _convert(self, ratio: float) -> None:
        channel_2 = bool(self._reg[2] & 0x80)
        ratio = 0.0 if channel_2 else ratio
        at = 0x0A if channel_2 else 0x03
        offset = int.from_bytes(self._reg[at : at + 3], "big")
        offset = -(offset & 0x7FFFFF) if offset & 0x800000 else offset
        gain = int.from_bytes(self._reg[at + 3 : at + 7], "big") / _FULL
        counts = gain * (self._counts(ratio + self._offset_V / self._supply_V) - offset)
        self._data = round(min(max(counts, -_FULL), _FULL - 1)).to_bytes(3, "big", signed=True)

    @property
    def _supply_V(self) -> float:  # noqa: N802
        return 4.5 - 0.3 * (self._reg[1] >> 3 & 7) if self._reg[0] & 0x80 else 3.3

    def _counts(self, ratio: float) -> float:
        """Of an input, V per V of the reference; clipped where the converter is."""
        return min(max(ratio * 2.0 * self._gain, -1.0), 1.0) * _FULL

    def _calibrate(self) -> None:
        """CALMOD 0: the input is shorted. The others need a load that is not simulated: CAL_ERR."""
        self._reg[2] &= ~0x04
        if self._reg[2] & 0x03:
            self._reg[2] |= 0x08
            return
        offset = round(self._counts(self._offset_V / self._supply_V))
        at = 0x0A if self._reg[2] & 0x80 else 0x03
        self._reg[at : at + 3] = (abs(offset) | (0x800000 if offset < 0 else 0)).to_bytes(3, "big")

    def _read(self, register: int) -> int:
        if register == 0x1F and (wrong := self._faults.active(FaultKind.WHO_AM_I, self._settled_ns)) is not None:
            return int(wrong.value)
        if 0x12 <= register <= 0x14:
            if register == 0x12:
                if self._reg[0] & 0x20:
                    self.conversions.show()
                self._reg[0] &= ~0x20
            return self._data[register - 0x12]
        return self._reg[register] if register < len(self._reg) else 0

    def _write(self, register: int, value: int, now_ns: int) -> None:
        if register == 0:
            self._write_power(value, now_ns)
        elif self._reg[0] & 0x01:
            return  # held in reset
        elif register == 2:
            before, self._reg[2] = self._reg[2], value & 0xF7 | self._reg[2] & 0x08
            if value & 0x04:
                self._reg[2] &= ~0x08
                self._calibrated_ns = self.conversions.chip_ns(now_ns) + _CALIBRATION * self._period_ns
            if (before ^ value) & 0xF0:
                self._begin(now_ns)
        elif register in _WRITABLE:
            changed = register == 1 and (self._reg[1] ^ value) & 0x3F
            self._reg[register] = value
            if changed:
                self._begin(now_ns)

    def _write_power(self, value: int, now_ns: int) -> None:
        before = self._reg[0]
        if value & 0x01:
            self._power_up(now_ns)
            self._reg[0] = 0x01
            return
        self._reg[0] = value & 0xD6 | before & 0x28
        if value & 0x02 and not before & 0x02:
            self._ready_ns = now_ns
        if not value & 0x02:
            self._reg[0] &= ~0x28
        if (value & ~before) & 0x14:  # PUA, CS
            self._begin(now_ns)


class Nau7802Table(BridgeEmulator):
    """An NAU7802 with a cell."""

    needs = "i2c"
    where = "address 0x2a"

    kind: Literal["nau7802"]

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        twin = Nau7802Twin(
            bench.sensor(LoadCellSensor),
            bench.clock,
            bench.start_ns,
            volt_per_volt_N=self.volt_per_volt_N,
            seed=bench.seed,
            faults=bench.faults,
        )
        return Twin(twin, lambda: twin.conversions.shown, (bench.name,))
