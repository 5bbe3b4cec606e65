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

from collections.abc import Mapping
from math import tau
from typing import Any, Final, Literal

import numpy as np
from pydantic import PositiveFloat

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.i2c.twin import POWER_KINDS, I2cTwin
from hil_sim.faults import INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyScalar
from hil_sim.scenario.sheets import Sheets
from hil_sim.scenario.tables import ScenarioError
from hil_sim.sensing.analog import ScalarAnalog
from hil_sim.sensing.sensors import EncoderSensor

_SAMPLE_S: Final = 150e-6
_POWER_UP_NS: Final = 10_000_000
_SETTLES: Final = (15, 7, 4, 2)  # samples of the slow filter, by SF
_NOISE_DEG: Final = (0.015, 0.021, 0.030, 0.043)
_WEAK, _STRONG, _NONE = 0.5, 1.5, 0.1  # of the nominal field: our choice
_HELD: Final = frozenset({0x0C, 0x0E, 0x1B})
_FINER: Final = 256  # steps of the sensor in a count: the chip rounds, after its noise


class As5600Twin(I2cTwin):
    """One chip.

    Args:
        analog: Angle of the joint, rad.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        turns: Of the magnet in one of the joint; negative: the other way.
        zero_count: What it reads at joint angle zero.
        seed: Of its noise.
        faults: What breaks.

    Raises:
        FaultError: a fault that it cannot have.
    """

    def __init__(
        self,
        analog: ScalarAnalog,
        start_ns: int,
        *,
        turns: float = 1.0,
        zero_count: int = 0,
        seed: int = 0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(0x36, start_ns, faults, (*POWER_KINDS, *INPUT_KINDS, FaultKind.FIELD))
        self._joint = FaultyScalar(analog, faults, start_ns)
        self._turns, self._zero, self._seed = turns, zero_count, seed
        self.answered = 0  # readings of STATUS or an angle, from their first byte
        self._power_up(start_ns)

    def _power_up(self, now_ns: int) -> None:
        self._reg = bytearray(0x20)
        self._ready_ns = now_ns + _POWER_UP_NS
        self._kept_on: int | None = None

    def _run(self, until_ns: int) -> None:
        """It is asked."""

    def _point(self, register: int) -> None:
        super()._point(register)
        self._kept_on = register if register in _HELD else None

    def _following(self, register: int) -> int:
        if self._kept_on is not None and register == self._kept_on + 1:
            return self._kept_on
        return super()._following(register)

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """See ``I2cTwin``."""
        self._settle(now_ns)
        if read_count and now_ns >= self._ready_ns:
            self._sense(now_ns)
        answer = super().transfer(address, write, read_count, now_ns)
        self.answered += bool(read_count > 1 and write[:1] in (b"\x0b", b"\x0c", b"\x0e"))
        return answer

    def _sense(self, now_ns: int) -> None:
        """What its output registers hold now."""
        window = self._faults.active(FaultKind.FIELD, now_ns)
        field = 1.0 + (window.value if window is not None else 0.0)
        weak, strong = field < _WEAK, field > _STRONG
        self._reg[0x0B] = (0x20 if field > _NONE else 0) | (0x10 if weak else 0) | (0x08 if strong else 0)
        self._reg[0x1A] = 128 if weak else 0 if strong else round(64.0 / field)
        self._reg[0x1B:0x1D] = round(min(max(1500.0 * field, 0.0), 4095.0)).to_bytes(2, "big")
        raw = self._raw((now_ns - self._start_ns) * 1e-9) if field > _NONE else 0
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


class As5600Table(MeasuringEmulator):
    """An AS5600 on a joint; ``turns``: of its magnet in one of the joint, ``zero_count``: at joint angle zero."""

    needs = "i2c"
    has_clock = False
    quantities = ("joint_angle",)
    where = "address 0x36"

    kind: Literal["as5600"]
    turns: PositiveFloat = 1.0
    zero_count: int = 0

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: a magnet a little beside the axis, by what the file says of its eccentricity."""
        counts = said.get("counts_per_revolution", 4096)
        if counts <= 0:
            raise ScenarioError(f"device.{name}: {counts} counts a revolution; rehearse it with the count's size")
        table = {"measures": name, "at": said["joint"], "turns": counts / 4096, "zero_count": said.get("zero_count", 0)}
        own = {"eccentricity_rad": 0.006, **said, "counts_per_revolution": counts * _FINER}
        return Equivalent(table, {name: sheets.encoder(name, own)}, {})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        encoder = bench.sensor(EncoderSensor)
        twin = As5600Twin(
            encoder,
            bench.start_ns,
            turns=self.turns,
            zero_count=self.zero_count,
            seed=bench.seed,
            faults=bench.faults,
        )
        return Twin(twin, lambda: twin.answered, (bench.name,))
