"""An ams AS5600 above a magnet on a joint's axis (data sheet 1-06), on I2C at 36h.

Registers: 00h ZMCO, 01h ZPOS, 03h MPOS, 05h MANG, 07h CONF (13 WD, 12..10 FTH, 9..8 SF, 7..6 PWMF, 5..4 OUTS, 3..2
HYST, 1..0 PM), 0Bh STATUS (5 MD, 4 ML, 3 MH), 0Ch RAW ANGLE, 0Eh ANGLE, 1Ah AGC, 1Bh MAGNITUDE, FFh BURN. The pointer
stays on RAW ANGLE, ANGLE and MAGNITUDE when it was set to their high byte. It samples every 150 us, from 10 ms after
power-up on; its slow filter settles in 2.2, 1.1, 0.55 or 0.286 ms with a noise of 0.015, 0.021, 0.030 or 0.043 degrees
rms.

Where the data sheet is silent: the slow filter is the mean of the samples in its settling time; a reading belongs to
its START. Left out: fast filter, hysteresis, low-power modes, watchdog and burning, whose bits are stored without
effect.
"""

from math import tau
from typing import Any, Final, Literal

import numpy as np

from hil_sim.devices.i2c.magnet import NONE, STRONG, WEAK, MagnetTable, MagnetTwin
from hil_sim.sensing.analog import ScalarAnalog

_SAMPLE_S: Final = 150e-6
_SETTLES: Final = (15, 7, 4, 2)  # samples of the slow filter, by SF
_NOISE_DEG: Final = (0.015, 0.021, 0.030, 0.043)
_HELD: Final = frozenset({0x0C, 0x0E, 0x1B})


class As5600Twin(MagnetTwin):
    """One chip; see ``MagnetTwin``."""

    registers = 0x20

    def __init__(self, analog: ScalarAnalog, start_ns: int, **options: Any) -> None:
        super().__init__(analog, start_ns, address=0x36, **options)

    def _power_up(self, now_ns: int) -> None:
        super()._power_up(now_ns)
        self._kept_on: int | None = None

    def _point(self, register: int) -> None:
        super()._point(register)
        self._kept_on = register if register in _HELD else None

    def _following(self, register: int) -> int:
        if self._kept_on is not None and register == self._kept_on + 1:
            return self._kept_on
        return super()._following(register)

    def _is_reading(self, write: bytes, read_count: int) -> bool:
        return read_count > 1 and write[:1] in (b"\x0b", b"\x0c", b"\x0e")

    def _sense(self, field: float, time_s: float) -> None:
        weak, strong = field < WEAK, field > STRONG
        self._reg[0x0B] = (0x20 if field > NONE else 0) | (0x10 if weak else 0) | (0x08 if strong else 0)
        self._reg[0x1A] = 128 if weak else 0 if strong else round(64.0 / field)
        self._reg[0x1B:0x1D] = round(min(max(1500.0 * field, 0.0), 4095.0)).to_bytes(2, "big")
        raw = self._raw(time_s) if field > NONE else 0
        self._reg[0x0C:0x0E] = raw.to_bytes(2, "big")
        self._reg[0x0E:0x10] = self._scaled(raw).to_bytes(2, "big")

    def _raw(self, time_s: float) -> int:
        code = self._reg[0x07] & 3
        tick = int(time_s / _SAMPLE_S)
        times_s = np.maximum(_SAMPLE_S * (tick - np.arange(_SETTLES[code] - 1, -1, -1)), 0.0)
        noise_deg = _NOISE_DEG[code] * np.random.default_rng([self._seed, 0x5600, tick]).standard_normal()
        counts = 4096.0 * (self._turns * float(self._joint.values(times_s).mean()) / tau + noise_deg / 360.0)
        return round(counts + self._zero) % 4096

    def _scaled(self, raw: int) -> int:
        """ANGLE: the raw one between ZPOS and MPOS, or over MANG."""
        start, stop, span = (int.from_bytes(self._reg[at : at + 2], "big") & 0xFFF for at in (1, 3, 5))
        span = span or (stop - start) % 4096
        beyond = (raw - start) % 4096
        return min(beyond * 4095 // span, 4095) if span else beyond

    def _read(self, register: int) -> int:
        return self._reg[register] if register < len(self._reg) else 0

    def _write(self, register: int, value: int, now_ns: int) -> None:
        if 1 <= register <= 8:
            self._reg[register] = value & (0x3F if register == 7 else 0xFF if register % 2 == 0 else 0x0F)


class As5600Table(MagnetTable):
    """An AS5600 on a joint."""

    full, finer, eccentricity_rad = 4096, 256, 0.006
    where = "address 0x36"

    kind: Literal["as5600"]

    def chip(self, analog: ScalarAnalog, start_ns: int, **options: Any) -> As5600Twin:
        """See ``MagnetTable``."""
        return As5600Twin(analog, start_ns, **options)
