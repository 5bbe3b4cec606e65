"""An ams AS5048B on I2C, an AS5048A on SPI, above a magnet on a joint's axis (data sheet 1-06).

I2C registers: 03h programming, 15h address, 16h zero position bits 13..6, 17h 5..0, FAh AGC, FBh diagnostics (0 OCF, 1
COF, 2 COMP low, 3 COMP high), FCh magnitude 13..6, FDh 5..0, FEh angle 13..6, FFh 5..0. SPI, mode 1, 16-bit frames: a
command is bit 15 even parity, bit 14 read, then the register; the frame after it brings the answer: even parity, error
flag, 14 bits. Registers 0000h nothing, 0001h errors (0 framing, 1 command, 2 parity), cleared by reading it, 0003h,
0016h, 0017h as above, 3FFDh diagnostics (11 COMP high, 10 COMP low, 9 COF, 8 OCF) and AGC, 3FFEh magnitude, 3FFFh
angle. COMP high is a weak magnet, COMP low a strong one. It samples 11,250 times a second; a sample is there 100 us
later; its noise is 0.06 degrees rms.

Where the data sheet is silent: fields at which COMP high and low are set; AGC and magnitude between; with no magnet the
angle is noise. Left out: programming and burning, daisy chains.
"""

from math import tau
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from hil_sim.devices.i2c.magnet import NONE, STRONG, WEAK, MagnetTable, MagnetTwin
from hil_sim.devices.i2c.twin import POWER_KINDS
from hil_sim.faults import FaultKind, garbled
from hil_sim.sensing.analog import ScalarAnalog

_SAMPLES_S: Final = 11_250.0
_LATE_S: Final = 100e-6
_NOISE_DEG: Final = 0.06
_OVERFLOW: Final = 2.0  # of the nominal field: our choice
_COUNTS: Final = 16384
_FRAMING, _COMMAND, _PARITY = 1, 2, 4
_WRITABLE: Final = (0x03, 0x16, 0x17)


class As5048bTwin(MagnetTwin):
    """One chip on I2C; see ``MagnetTwin``."""

    registers = 0x100

    def __init__(self, analog: ScalarAnalog, start_ns: int, *, address: int = 0x40, **options: Any) -> None:
        super().__init__(analog, start_ns, address=address, **options)

    def _is_reading(self, write: bytes, read_count: int) -> bool:
        return bool(write) and write[0] + read_count > 0xFF

    def _sense(self, field: float, time_s: float) -> None:
        weak, strong = field < WEAK, field > STRONG
        self._reg[0xFA] = 255 if weak else 0 if strong else round(60.0 / field)
        self._reg[0xFB] = 0x01 | (0x02 if field > _OVERFLOW else 0) | (0x04 if strong else 0) | (0x08 if weak else 0)
        if field > _OVERFLOW:  # the last valid ones stay
            return
        self._put(0xFC, round(min(max(4700.0 * (field if weak or strong else 1.0), 0.0), _COUNTS - 1.0)))
        self._put(0xFE, self._angle(time_s, is_there=field > NONE))

    def _put(self, register: int, value: int) -> None:
        self._reg[register], self._reg[register + 1] = value >> 6, value & 0x3F

    def _angle(self, time_s: float, *, is_there: bool) -> int:
        tick = int((time_s - _LATE_S) * _SAMPLES_S)
        draws = np.random.default_rng([self._seed, 0x5048, max(tick, 0)])
        if not is_there:
            return int(draws.integers(_COUNTS))
        turned = self._turns * float(self._joint.value(max(tick / _SAMPLES_S, 0.0))) / tau
        turned += _NOISE_DEG * float(draws.standard_normal()) / 360.0
        own_zero = self._reg[0x16] << 6 | self._reg[0x17] & 0x3F
        return (round(_COUNTS * turned) + self._zero - own_zero) % _COUNTS

    def _read(self, register: int) -> int:
        return self._reg[register]

    def _write(self, register: int, value: int, now_ns: int) -> None:
        if register in (0x03, 0x15, 0x16, 0x17):
            self._reg[register] = value


class As5048aTwin(As5048bTwin):
    """One chip on SPI; see ``As5048bTwin``. Off, or silent, it drives no line: zeros."""

    mode = 1

    def __init__(self, analog: ScalarAnalog, start_ns: int, **options: Any) -> None:
        kinds = tuple(kind for kind in POWER_KINDS if kind not in (FaultKind.NACK, FaultKind.TIMEOUT))
        super().__init__(analog, start_ns, kinds=kinds, **options)

    def _power_up(self, now_ns: int) -> None:
        super()._power_up(now_ns)
        self._answer = self._errors = 0
        self._writes: int | None = None

    def exchange(self, frame: bytes, now_ns: int) -> bytes:
        """See ``SpiChip``."""
        self._settle(now_ns)
        if now_ns < self._off_until_ns or (self._is_faulty and self._faults.is_away(now_ns)):
            return bytes(len(frame))
        answer = self._answer | (0x4000 if self._errors else 0)
        answer |= (answer.bit_count() & 1) << 15
        self._answer = self._asked(int.from_bytes(frame, "big"), now_ns) if len(frame) == 2 else self._fault(_FRAMING)
        data = answer.to_bytes(2, "big").ljust(len(frame), b"\0")[: len(frame)]
        is_garbled = self._is_faulty and self._faults.active(FaultKind.GARBAGE, now_ns) is not None
        return garbled(data, self._rng) if is_garbled else data

    def _fault(self, error: int) -> int:
        self._errors |= error
        return 0

    def _asked(self, word: int, now_ns: int) -> int:
        """What the next frame brings."""
        content = word & 0x3FFF
        if word.bit_count() & 1:
            return self._fault(_PARITY)
        if self._writes is not None:  # the second frame of a write
            at, self._writes = self._writes, None
            self._write(at, content & 0xFF, now_ns)
            return content
        if word & 0x4000:
            self._look(now_ns)
            return self._word(content)
        self._writes = content if content in _WRITABLE else None
        return self._fault(_COMMAND) if content and self._writes is None else 0

    def _word(self, register: int) -> int:
        reg, errors = self._reg, self._errors
        words = {0x0000: 0, 0x0001: errors, **{at: reg[at] for at in _WRITABLE}}
        words |= {
            0x3FFD: reg[0xFB] << 8 | reg[0xFA],
            0x3FFE: reg[0xFC] << 6 | reg[0xFD],
            0x3FFF: reg[0xFE] << 6 | reg[0xFF],
        }
        self._errors = 0 if register == 0x0001 else errors
        self.answered += register == 0x3FFF
        return words[register] if register in words else self._fault(_COMMAND)


class As5048bTable(MagnetTable):
    """An AS5048B on a joint."""

    full, finer, eccentricity_rad = _COUNTS, 64, 9.9e-3
    where = "address {address}"

    kind: Literal["as5048b"]
    address: Annotated[int, Field(ge=0x40, le=0x43)] = 0x40

    def chip(self, analog: ScalarAnalog, start_ns: int, **options: Any) -> As5048bTwin:
        """See ``MagnetTable``."""
        return As5048bTwin(analog, start_ns, address=self.address, **options)


class As5048aTable(As5048bTable):
    """An AS5048A on a joint; see ``As5048bTable``."""

    needs = "spi"
    where = "the select line"

    kind: Literal["as5048a"]  # type: ignore[assignment]

    def chip(self, analog: ScalarAnalog, start_ns: int, **options: Any) -> As5048bTwin:
        """See ``MagnetTable``."""
        return As5048aTwin(analog, start_ns, **options)
