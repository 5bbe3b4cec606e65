"""A TDK ICM-20948 (data sheet DS-000189 1.3) behind its I2C interface, without the compass.

Bank 0: 00h WHO_AM_I (EAh), 03h USER_CTRL (6 FIFO_EN, 5 I2C_MST_EN, 3..1 resets that clear themselves), 05h LP_CONFIG,
06h PWR_MGMT_1 (7 DEVICE_RESET, 6 SLEEP, 3 TEMP_DIS, 2..0 CLKSEL, 7 stops), 07h PWR_MGMT_2 (5..3 accel off, 2..0 gyro
off), 0Fh to 13h interrupts, 17h I2C_MST_STATUS, 19h to 1Ch their states, which clear as they are read (1Ah 0 new data,
1Bh 4..0 FIFO overflow), 2Dh to 3Ah accel, gyro and temperature, 66h and 67h what goes into the FIFO (67h: 4 accel, 3 to
1 gyro z y x, 0 temperature), 68h FIFO_RST, 69h FIFO_MODE, 70h count (70h latches 71h), 72h FIFO, 7Fh bank (5..4), which
is in all of them. Bank 2: 00h gyro divider, 01h GYRO_CONFIG_1 (5..3 DLPF, 2..1 range, 0 FCHOICE), 10h and 11h accel
divider, 14h ACCEL_CONFIG likewise, 52h FSYNC_CONFIG (3..0 the word that FSYNC marks). 512 bytes of FIFO, each sample in
the order of the registers. Temperature: 333.87 counts a kelvin from 21 degC.

Where the data sheet is silent: both sensors' rates are fractions of 1125 Hz, the FIFO is filled at the gyroscope's, and
an accelerometer that is slower repeats; a new rate begins at the next tick of that; DEVICE_RESET takes 1 ms, in which
writes are lost; nothing answers at the I2C master. Left out: FCHOICE 0, low-power cycles, averaging, the FIFO's
snapshot mode, self test, offsets and DMP, whose bits are stored without effect; times of settling.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.inertial.twin import InertialTwin
from hil_sim.faults import NO_FAULTS, DeviceFaults, FaultKind
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ImuAnalog
from hil_sim.sensing.sensors import ImuSensor

_TICK_NS: Final = 888_889
_RESET_NS: Final = 1_000_000
_FIFO: Final = 0x72
_RESET_VALUES: Final[tuple[dict[int, int], ...]] = (
    {0x00: 0xEA, 0x05: 0x40, 0x06: 0x41},
    {},
    {0x01: 0x01, 0x14: 0x01},
    {},
)
_WRITABLE: Final = (
    frozenset({0x05, *range(0x0F, 0x14), 0x66, 0x69, 0x76}),
    frozenset({*range(0x02, 0x05), *range(0x0E, 0x11), *range(0x14, 0x1C), 0x28}),
    frozenset({*range(0x01, 0x0A), 0x12, 0x13, 0x14, 0x15, 0x52, 0x53, 0x54}),
    frozenset({*range(0x17)}),
)
_RATES: Final = frozenset({0x00, 0x10, 0x11})  # of bank 2
_ACCEL_LSB: Final = (16384.0, 8192.0, 4096.0, 2048.0)
_GYRO_LSB: Final = (131.0, 65.5, 32.8, 16.4)
_MARKED: Final = {1: 3, 2: 4, 3: 5, 4: 6, 5: 0, 6: 1, 7: 2}  # EXT_SYNC_SET: column of accel, temperature, gyro
_OUT: Final = [0, 1, 2, 4, 5, 6, 3]  # columns in the order of the registers


class Icm20948Twin(InertialTwin):
    """One chip.

    Args:
        analog: Its sensing elements.
        clock: Its oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        address: 7-bit address, 0x68 or 0x69 by the AD0 pin.
        faults: What breaks.

    Raises:
        FaultError: a fault that this chip cannot have.
    """

    def __init__(
        self,
        analog: ImuAnalog,
        clock: ChipClock,
        start_ns: int,
        *,
        address: int = 0x69,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(address, start_ns, faults, analog, clock, 512)
        self._power_up(start_ns)

    def _power_up(self, now_ns: int) -> None:
        self._banks = tuple(bytearray(128) for _ in _RESET_VALUES)
        for registers, values in zip(self._banks, _RESET_VALUES, strict=True):
            for register, value in values.items():
                registers[register] = value
        self._bank = self._pointer = 0
        self._fifo.power_up()
        self._busy_until_ns = 0
        self._wake(now_ns)

    def _restart_grid(self, now_ns: int) -> None:
        power = self._banks[0][0x06]
        self._running = not power & 0x40 and power & 7 != 7
        self._tick_ns = _TICK_NS
        self._period_ns = _TICK_NS * (1 + self._banks[2][0x00])
        super()._restart_grid(now_ns)

    # Samples

    @property
    def _held(self) -> list[int]:
        """Columns of sensors that are off."""
        first, second = self._banks[0][0x06], self._banks[0][0x07]
        off = [0, 1, 2] * (second & 0x38 == 0x38) + [3] * bool(first & 0x08)
        return off + [4, 5, 6] * (second & 0x07 == 0x07)

    @property
    def _settings(self) -> tuple[object, ...]:
        return () if self._held else (bytes(self._banks[2][:0x15]),)

    @property
    def _sync_column(self) -> int | None:
        return _MARKED.get(self._banks[2][0x52] & 0x0F)

    def _convert(
        self, ticks_ns: NDArray[np.float64], times_s: NDArray[np.float64], latest_s: float
    ) -> NDArray[np.int16]:
        own = self._banks[2]
        accel, gyro = own[0x14], own[0x01]
        lsb = _ACCEL_LSB[accel >> 1 & 3], _GYRO_LSB[gyro >> 1 & 3]
        counts = self._analog.counts(times_s, *lsb, gyro >> 3 & 7).copy()
        divider = (own[0x10] & 0x0F) << 8 | own[0x11]
        if divider > own[0x00] or (accel ^ gyro) & 0x38:
            period_ns = _TICK_NS * (1 + max(divider, own[0x00]))
            slow_s = np.minimum(self._clock.times_s(ticks_ns // period_ns * period_ns), latest_s)
            at_s = slow_s if divider > own[0x00] else times_s
            counts[:, :3] = self._analog.counts(np.maximum(at_s, 0.0), *lsb, accel >> 3 & 7)[:, :3]
        kelvin = counts[:, 3] / 340.0 + (36.53 - 21.0)  # the sensing element shows an MPU-6050's word
        counts[:, 3] = np.rint(333.87 * kelvin)
        if held := self._held:
            counts[:, held] = self._last[held]
        return counts

    def _store(self, counts: NDArray[np.int16], times_s: NDArray[np.float64]) -> None:
        own = self._banks[0]
        own[0x2D:0x3B] = self._last[_OUT].astype(">i2").tobytes()
        own[0x1A] |= 0x01
        chosen = own[0x67] & 0x1F
        if not own[0x03] & 0x40 or not chosen or own[0x68] & 0x1F:
            return
        columns = [0, 1, 2] * (chosen >> 4) + [4 + axis for axis in range(3) if chosen >> axis & 2] + [3] * (chosen & 1)
        data = counts[:, columns].astype(">i2").tobytes()
        if self._fifo.fill(data, len(counts), float(times_s[0]), self._last_s, self._period_s()):
            own[0x1B] |= 0x01

    # Registers

    def _exchange(self, write: bytes, read_count: int, now_ns: int) -> bytes:
        if read_count and not self._bank and write == bytes([_FIFO]):
            self._pointer = _FIFO
            return self._fifo.pop(read_count, bool(self._banks[0][0x03] & 0x40))
        return super()._exchange(write, read_count, now_ns)

    def _following(self, register: int) -> int:
        return register if register == _FIFO and not self._bank else (register + 1) & 0x7F

    def _read(self, register: int) -> int:
        if register == 0x7F:
            return self._bank << 4
        if self._bank:
            return self._banks[self._bank][register & 0x7F]
        if register == _FIFO:
            return self._fifo.pop(1, bool(self._banks[0][0x03] & 0x40))[0]
        if register in (0x70, 0x71):
            return self._fifo.count_low() if register & 1 else self._fifo.count_high()
        value = self._banks[0][register & 0x7F]
        if register == 0x17 or 0x19 <= register <= 0x1C:
            self._banks[0][register] = 0
        elif register == 0x06 and self._settled_ns < self._busy_until_ns:
            value |= 0x80
        elif register == 0x00 and self._faults:
            wrong = self._faults.active(FaultKind.WHO_AM_I, self._settled_ns)
            value = value if wrong is None else int(wrong.value)
        return value

    def _write(self, register: int, value: int, now_ns: int) -> None:
        own = self._banks[self._bank]
        if now_ns < self._busy_until_ns:
            return
        if register == 0x7F:
            self._bank = value >> 4 & 3
        elif self._bank == 0 and register in (0x03, 0x06, 0x07, 0x67, 0x68):
            self._control(register, value, now_ns)
        elif self._bank == 2 and register in _RATES:
            if own[register] != value:
                own[register] = value
                self._restart_grid(now_ns)
        elif register in _WRITABLE[self._bank]:
            own[register] = value
            if self._bank == 3 and register == 0x15 and value & 0x80 and self._banks[0][0x03] & 0x20:
                own[register] &= 0x7F
                self._banks[0][0x17] |= 0x50  # slave 4: done, not acknowledged

    def _control(self, register: int, value: int, now_ns: int) -> None:
        own = self._banks[0]
        before = own[register]
        if register == 0x06 and value & 0x80:
            self._power_up(now_ns)
            self._busy_until_ns = now_ns + _RESET_NS
            return
        own[register] = value & ~0x0E if register == 0x03 else value
        if register in (0x06, 0x07):
            if before != value:
                self._restart_grid(now_ns)
        elif register == 0x68 and before & ~value & 0x1F:
            self._fifo.clear()
        elif register == 0x67 and value & 0x1F and not before & 0x1F:
            self._fifo.enable()


class Icm20948Table(MeasuringEmulator):
    """An ICM-20948; ``sync_input``: the sync line reaches its FSYNC pin."""

    needs = "i2c"
    quantities = ("inertial",)
    where = "address {address:#04x}"

    kind: Literal["icm20948"]
    address: Annotated[int, Field(ge=0x68, le=0x69)] = 0x69
    sync_input: bool = True

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {"address": said.get("address", 0x69), "measures": name, "at": said["frame"]}
        table["sync_input"] = sheets.pulse and said.get("sync_input", True)
        return Equivalent(table, {name: sheets.imu("icm20948", said)}, {name: "gyro"})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        imu = Icm20948Twin(
            bench.sensor(ImuSensor), bench.clock, bench.start_ns, address=self.address, faults=bench.faults
        )
        return Twin(imu, lambda: imu.sampled, (bench.name,), pin=imu.fsync if self.sync_input else None)
