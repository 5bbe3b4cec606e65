"""A Bosch BMI088 (data sheet BST-BMI088-DS001) behind I2C or SPI: two dies with an address or select line, and a clock.

Accelerometer: 00h chip ID (1Eh), 02h errors, 03h status (7 new data, which a read of it clears), 12h to 17h force, low
bytes first, 18h to 1Ah sensor time (39.0625 us a count), 22h and 23h temperature (11 bits, 8 counts a kelvin, 0 at 23
degC), 40h ACC_CONF (7..4 filter: 8 OSR4, 9 OSR2, Ah normal; 3..0 rate: 5 12.5 Hz to Ch 1600 Hz; A8h), 41h range (0 3 g
to 3 24 g; 01h), 7Ch PWR_CONF (3 suspended, 0 active; 03h), 7Dh PWR_CTRL (4 on; 00h), 7Eh soft reset (B6h). It is off
after power-up, takes a write each millisecond while it is suspended, and measures 50 ms after it was switched on.
Gyroscope: 00h chip ID (0Fh), 02h to 07h rates, 0Ah status (7 new data), 0Fh range (0 2000 deg/s to 4 125), 10h
bandwidth (0 2000/532 Hz, 1 2000/230, 2 1000/116, 3 400/47, 4 200/23, 5 100/12, 6 200/64, 7 100/32; bit 7 reads 1), 11h
LPM1 (00h on, 80h suspended), 14h soft reset (B6h), after which it is away for 30 ms.
SPI: the first byte is the register, its bit 7 reads; the gyroscope answers from the next byte on, the accelerometer a
byte later. That is on I2C from power-up or soft reset until its select line first rises: that frame is lost.

FIFOs. Accelerometer: 24h, 25h its bytes, 26h data, 49h bit 6 lets samples in; 1024 bytes, the oldest give way. A frame
is 84h and six bytes of force; who reads on gets, where samples were lost, before them 40h and their number (255 at
most); behind them 44h and the sensor time, then 80h. A frame that a reading cuts comes again. Gyroscope: 0Eh its
samples (bits 6..0) and overrun (bit 7), 3Eh mode (80h stream; a write of it empties, and clears overrun), 3Fh data: 100
samples of six bytes, the oldest give way. Reading stays at 26h and 3Fh. A sample falls on a multiple of its period.

Where the data sheet is silent: sensor time and data stand still while the accelerometer is off; a word is that of the
die's last period, and its filter's delay is that of one pole. Left out: interrupts, self tests, tags and other modes of
the FIFOs, rates and filters but those of the table of ``_FILTERS``, whose bits are stored and give the slowest of them.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.i2c.twin import POWER_KINDS, I2cTwin
from hil_sim.faults import NO_FAULTS, DeviceFaults, FaultKind, FaultyClock, FaultyImu
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ImuAnalog
from hil_sim.sensing.sensors import ImuSensor

_ACCEL, _GYRO = 0, 1
_RESET_VALUES: Final = (
    {0x00: 0x1E, 0x40: 0xA8, 0x41: 0x01, 0x45: 0x80, 0x48: 0x02, 0x49: 0x10, 0x7C: 0x03},
    {0x00: 0x0F, 0x10: 0x80},
)
_WRITABLE: Final = ({0x40, 0x41, 0x45, 0x48, 0x49, 0x7C, 0x7D}, {0x0F, 0x10, 0x11, 0x3D, 0x3E})
_FIFO_DATA: Final = (0x26, 0x3F)
_FIFO_SAMPLES: Final = (1024 // 7, 100)
_SOFT_RESET: Final = (0x7E, 0x14)
_FILTERS: Final = ({0xAC: 0, 0x9C: 1, 0x8C: 2, 0x8A: 3}, {0x80: 0, 0x81: 1, 0x82: 2, 0x83: 3})  # rows of its data sheet
_PERIOD_NS: Final = ((625_000, 625_000, 625_000, 2_500_000), (500_000, 500_000, 1_000_000, 2_500_000))
_TICK_NS: Final = 39_062.5
_STARTS_NS: Final = (50_000_000, 30_000_000)
_SUSPENDED_NS: Final = 1_000_000  # after a write
_FAULTS: Final = (
    *POWER_KINDS,
    *(FaultKind.STUCK, FaultKind.SATURATED, FaultKind.WRONG, FaultKind.DELAYED, FaultKind.SLOW, FaultKind.CLOCK_JUMP),
    FaultKind.WHO_AM_I,
)


class Bmi088Twin(I2cTwin):
    """One chip.

    Args:
        analog: Its sensing elements.
        clocks: Oscillators of the accelerometer and of the gyroscope.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        addresses: 7-bit addresses of both, by the SDO pins.
        faults: What breaks.

    Raises:
        FaultError: a fault that this chip cannot have.
    """

    def __init__(
        self,
        analog: ImuAnalog,
        clocks: tuple[ChipClock, ChipClock],
        start_ns: int,
        *,
        addresses: tuple[int, int] = (0x18, 0x68),
        faults: DeviceFaults = NO_FAULTS,
        kinds: tuple[FaultKind, ...] = _FAULTS,
    ) -> None:
        super().__init__(addresses[_ACCEL], start_ns, faults, kinds)
        self.addresses = addresses
        self._imu = FaultyImu(analog, faults, start_ns)
        self._clocks = tuple(FaultyClock(clock, faults) for clock in clocks)
        self.answered = 0  # readings of the gyroscope
        self._taken: list[int] = []  # numbers of the first and the last sample out of the accelerometer's FIFO
        self._power_up(start_ns)

    def _power_up(self, now_ns: int) -> None:
        self._reg = [bytearray(0x80), bytearray(0x80)]
        self._fifo: list[list[tuple[int, bytes]]] = [[], []]  # numbers of samples, and their bytes
        self._made: list[int | None] = [None, None]  # number of the newest sample
        self._lost, self._shown, self._at = [0, 0], b"", 0
        self._starts_ns, self._pointers, self._blocked_ns = [0, 0], [0, 0], now_ns
        for die in (_ACCEL, _GYRO):
            self._reset(die, now_ns)
        self._die = _ACCEL

    def _reset(self, die: int, now_ns: int) -> None:
        self._reg[die][:] = bytes(0x80)
        for register, value in _RESET_VALUES[die].items():
            self._reg[die][register] = value
        self._starts_ns[die] = now_ns + _STARTS_NS[die]
        self._empty(die)
        self._blocked_ns = self._blocked_ns if die == _GYRO else now_ns

    @property
    def produced(self) -> int:
        """Readings of the gyroscope's registers, and samples of the accelerometer from the first taken to the last."""
        return self.answered + (self._taken[-1] - self._taken[0] + 1 if self._taken else 0)

    def _empty(self, die: int) -> None:
        self._fifo[die].clear()
        self._made[die] = None
        self._lost[die] = 0

    def _run(self, until_ns: int) -> None:
        """Samples go into the FIFOs."""
        for die in (_ACCEL, _GYRO):
            takes = self._reg[die][0x49] & 0x40 if die == _ACCEL else self._reg[die][0x3E] == 0x80
            if not takes or not self._measures(die, until_ns):
                self._made[die] = None
                continue
            code = self._code(die)
            number = self._clocks[die].chip_ns(until_ns) // _PERIOD_NS[die][code]
            before = self._made[die]
            self._made[die] = number
            if before is None or number <= before:
                continue
            numbers = np.arange(max(before + 1, number - 2 * _FIFO_SAMPLES[die]), number + 1)
            times_s = self._clocks[die].times_s(numbers.astype(float) * _PERIOD_NS[die][code])
            words = self._words(code, np.maximum(times_s, 0.0))
            kept = (words[:, :3] if die == _ACCEL else words[:, 4:]).astype("<i2")
            self._fifo[die] += [(int(n), sample.tobytes()) for n, sample in zip(numbers, kept, strict=True)]
            over = len(self._fifo[die]) - _FIFO_SAMPLES[die]
            if over > 0:
                del self._fifo[die][:over]
                self._lost[die] += over

    def _code(self, die: int) -> int:
        return _FILTERS[die].get(self._reg[die][0x40 if die == _ACCEL else 0x10], 3)

    def _show_fifo(self, now_ns: int) -> None:
        """Counts, and what a reading of the data gives, from now on."""
        if self._die == _ACCEL:
            skip = bytes([0x40, min(self._lost[_ACCEL], 255)]) if self._lost[_ACCEL] else b""
            self._shown = skip + b"".join(b"\x84" + sample for _, sample in self._fifo[_ACCEL])
            self._reg[_ACCEL][0x24:0x26] = len(self._shown).to_bytes(2, "little")
            ticks = int(self._clocks[_ACCEL].chip_ns(now_ns) / _TICK_NS) & 0xFFFFFF
            self._shown += b"\x44" + ticks.to_bytes(3, "little")
        else:
            self._shown = b"".join(sample for _, sample in self._fifo[_GYRO])
            self._reg[_GYRO][0x0E] = len(self._fifo[_GYRO]) | (0x80 if self._lost[_GYRO] else 0)
        self._at = 0

    def _take_out(self) -> None:
        """What was read is gone: whole frames only."""
        if self._die == _GYRO:
            whole = min(self._at // 6, len(self._fifo[_GYRO]))
        else:
            skip = 2 if self._lost[_ACCEL] else 0
            if skip and self._at >= skip:
                self._lost[_ACCEL] = 0
            whole = min(max(self._at - skip, 0) // 7, len(self._fifo[_ACCEL]))
        if self._die == _ACCEL and whole:
            first, last = (self._fifo[_ACCEL][at][0] for at in (0, whole - 1))
            self._taken = [self._taken[0] if self._taken else first, last]
        del self._fifo[self._die][:whole]
        self._at = 0

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """See ``I2cTwin``."""
        self._settle(now_ns)
        self._die = self.addresses.index(address)
        self._pointer = self._pointers[self._die]
        if read_count:
            self._sense(now_ns)
            self._show_fifo(now_ns)
        answer = super().transfer(self.address, write, read_count, now_ns)
        if self._at:
            self._take_out()
        self._pointers[self._die] = self._pointer
        self.answered += self._die == _GYRO and read_count > 0 and write[:1] == b"\x02"
        return answer

    def _measures(self, die: int, now_ns: int) -> bool:
        own = self._reg[die]
        is_on = own[0x7D] == 4 and not own[0x7C] & 3 if die == _ACCEL else not own[0x11]
        return is_on and now_ns >= self._starts_ns[die]

    def _sense(self, now_ns: int) -> None:
        """What the output registers of the die that is addressed hold now."""
        die, own = self._die, self._reg[self._die]
        if not self._measures(die, now_ns):
            return
        code = self._code(die)
        period_ns, chip_ns = _PERIOD_NS[die][code], self._clocks[die].chip_ns(now_ns)
        made_ns = self._clocks[die].time_ns(chip_ns // period_ns * period_ns)
        words = self._words(code, np.array([max(made_ns - self._start_ns, 0) * 1e-9]))[0]
        if die == _ACCEL:
            own[0x12:0x18] = words[:3].astype("<i2").tobytes()
            own[0x18:0x1B] = (int(chip_ns / _TICK_NS) & 0xFFFFFF).to_bytes(3, "little")
            kelvin = float(words[3]) / 340.0 + 36.53 - 23.0  # the sensing element shows an MPU-6050's word
            warm = round(8.0 * kelvin) & 0x7FF
            own[0x22:0x24] = bytes([warm >> 3, (warm & 7) << 5])
        else:
            own[0x02:0x08] = words[4:].astype("<i2").tobytes()
        own[0x03 if die == _ACCEL else 0x0A] = 0x80

    def _words(self, code: int, times_s: NDArray[np.float64]) -> NDArray[np.int16]:
        accel_g, gyro_deg_s = 3 << (self._reg[_ACCEL][0x41] & 3), 2000.0 / (1 << (self._reg[_GYRO][0x0F] & 7))
        return self._imu.counts(times_s, 32768.0 / accel_g, 32768.0 / gyro_deg_s, code)

    def _following(self, register: int) -> int:
        return register if register == _FIFO_DATA[self._die] else super()._following(register)

    def _read(self, register: int) -> int:
        if register == _FIFO_DATA[self._die]:
            self._at += 1
            beyond = 0x80 if self._die == _ACCEL else 0
            return self._shown[self._at - 1] if self._at <= len(self._shown) else beyond
        own, value = self._reg[self._die], self._reg[self._die][register & 0x7F]
        if register in (0x03, 0x0A):
            own[register] &= 0x7F
        wrong = self._faults.active(FaultKind.WHO_AM_I, self._settled_ns) if self._faults else None
        return int(wrong.value) if wrong is not None and register == 0 else value

    def _write(self, register: int, value: int, now_ns: int) -> None:
        die, own = self._die, self._reg[self._die]
        if now_ns < (self._starts_ns[_GYRO] if die == _GYRO else self._blocked_ns):
            return
        if die == _ACCEL and own[0x7C] & 3:
            self._blocked_ns = now_ns + _SUSPENDED_NS
        if register == _SOFT_RESET[die] and value == 0xB6:
            self._reset(die, now_ns)
        elif register in _WRITABLE[die]:
            if die == _ACCEL and register == 0x7D and value == 4 and own[register] != 4:
                self._starts_ns[_ACCEL] = now_ns + _STARTS_NS[_ACCEL]
            own[register] = value & 0x0F | 0x80 if die == _GYRO and register == 0x10 else value
            if (die, register) == (_GYRO, 0x3E):
                self._empty(_GYRO)
            self._run(now_ns)


class _Select:
    """The select line of a die."""

    mode = 0

    def __init__(self, chip: "Bmi088SpiTwin", die: int) -> None:
        self._chip, self._die = chip, die

    def advance(self, now_ns: int) -> None:
        """See ``SpiChip``."""
        self._chip.advance(now_ns)

    def exchange(self, frame: bytes, now_ns: int) -> bytes:
        """See ``SpiChip``."""
        return self._chip.exchange(self._die, frame, now_ns)


class Bmi088SpiTwin(Bmi088Twin):
    """One chip on SPI; see ``Bmi088Twin``. Off, or silent, it drives no line: zeros."""

    _on_i2c = True  # its accelerometer

    def __init__(self, analog: ImuAnalog, clocks: tuple[ChipClock, ChipClock], start_ns: int, **options: Any) -> None:
        kinds = tuple(kind for kind in _FAULTS if kind not in (FaultKind.NACK, FaultKind.TIMEOUT))
        super().__init__(analog, clocks, start_ns, kinds=kinds, **options)
        self.dies = _Select(self, _ACCEL), _Select(self, _GYRO)

    def _reset(self, die: int, now_ns: int) -> None:
        super()._reset(die, now_ns)
        self._on_i2c = die == _ACCEL or self._on_i2c

    def exchange(self, die: int, frame: bytes, now_ns: int) -> bytes:
        """A frame of a die's select line."""
        self._settle(now_ns)
        nothing = bytes(len(frame))
        if now_ns < self._off_until_ns or (self._is_faulty and self._faults.is_away(now_ns)):
            return nothing
        if die == _ACCEL and self._on_i2c:
            self._on_i2c = False
            return nothing
        address, begin = self.addresses[die], 2 if die == _ACCEL else 1
        if not frame[0] & 0x80:
            self.transfer(address, frame, 0, now_ns)
            return nothing
        count = max(len(frame) - begin, 0)
        answer = self.transfer(address, bytes([frame[0] & 0x7F]), count, now_ns)
        return (bytes(begin) + answer)[: len(frame)]


class Bmi088Table(MeasuringEmulator):
    """A BMI088."""

    needs = "i2c"
    quantities = ("inertial",)
    where = "address {address:#04x}"

    kind: Literal["bmi088"]
    address: Annotated[int, Field(ge=0x18, le=0x19)] = 0x18
    gyro_address: Annotated[int, Field(ge=0x68, le=0x69)] = 0x68

    def clocks(self, name: str) -> tuple[str, ...]:
        """See ``Emulator``: an oscillator a die."""
        return name, f"{name}_gyro"

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {key: said[key] for key in ("address", "gyro_address") if key in said}
        table |= {"measures": name, "at": said["frame"]}
        return Equivalent(table, {name: sheets.imu("bmi088", said)}, {name: "gyro", f"{name}_gyro": "gyro"})

    def chip(self, *parts: Any, **options: Any) -> Bmi088Twin:
        """The chip."""
        return Bmi088Twin(*parts, addresses=(self.address, self.gyro_address), **options)

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        clocks = bench.clock, bench.clocks[f"{bench.name}_gyro"]
        imu = self.chip(bench.sensor(ImuSensor), clocks, bench.start_ns, faults=bench.faults)
        return Twin(imu, lambda: imu.produced, (bench.name,))


class Bmi088SpiTable(Bmi088Table):
    """A BMI088 on SPI."""

    needs = "spi"
    where = "the select lines"

    kind: Literal["bmi088_spi"]  # type: ignore[assignment]

    def chip(self, *parts: Any, **options: Any) -> Bmi088Twin:
        """See ``Bmi088Table``."""
        return Bmi088SpiTwin(*parts, **options)
