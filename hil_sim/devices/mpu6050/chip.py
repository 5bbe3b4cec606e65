"""Simulated InvenSense MPU-6050 behind its I2C interface (RM-MPU-6000A rev. 4.2, PS-MPU-6000A rev. 3.4).

All that a transfer reads belongs to its START: this is what the chip's shadow registers promise for a burst over
0x3B..0x48 (RM 4.18).

Where the documents are silent: the sample grid restarts at the next tick of the internal rate after a write that
changes the rate or wakes the chip; DEVICE_RESET keeps the chip busy for 1 ms, in which writes are lost; INT_STATUS bits
set whatever INT_ENABLE says, which gates the pin only; standby and disabled sensors hold their last word; CLKSEL 4 to 7
stop the chip, as nothing is wired to CLKIN; oscillator and gyro settling times are zero; offset registers are
stored without effect.
"""

import numpy as np
from numpy.typing import NDArray

from hil_sim.devices.inertial.twin import InertialTwin
from hil_sim.devices.mpu6050 import registers as reg
from hil_sim.faults import NO_FAULTS, DeviceFaults, FaultKind, FaultyClock
from hil_sim.sensing.analog import ChipClock, ImuAnalog

_RESET_NS = 1_000_000
_FAST_TICK_NS = 125_000  # 8 kHz: DLPF_CFG 0 and 7
_SLOW_TICK_NS = 1_000_000
_HIGHEST_REGISTER = 0x7F
_CONVERTING = slice(reg.CONFIG, reg.ACCEL_CONFIG + 1), slice(reg.PWR_MGMT_1, reg.PWR_MGMT_2 + 1)


class Mpu6050Twin(InertialTwin):
    """One chip.

    Args:
        analog: Its sensing elements.
        clock: Its gyro-referenced oscillator (CLKSEL 1 to 3).
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        address: 7-bit address, 0x68 or 0x69 by the AD0 pin.
        faults: What breaks.
        rc_clock: Its internal 8 MHz oscillator (CLKSEL 0); None: as good as ``clock``.
        trim: Factory self-test codes.
        self_test_error: Relative deviation of the self-test response from the factory's; beyond 0.14 is a failed chip.

    Raises:
        FaultError: a fault that this chip cannot have.
    """

    def __init__(
        self,
        analog: ImuAnalog,
        clock: ChipClock,
        start_ns: int,
        *,
        address: int = 0x68,
        faults: DeviceFaults = NO_FAULTS,
        rc_clock: ChipClock | None = None,
        trim: reg.FactoryTrim | None = None,
        self_test_error: float = 0.0,
    ) -> None:
        super().__init__(address, start_ns, faults, analog, clock, reg.FIFO_SIZE)
        self._rc: ChipClock = FaultyClock(rc_clock or clock, faults)
        self._trim = trim or reg.FactoryTrim()
        self._self_test_gain = 1.0 + self_test_error
        self._power_up(start_ns)

    def _mark(self, edge_ns: int, high_ns: int) -> None:
        super()._mark(edge_ns, high_ns)
        if self._reg[reg.INT_PIN_CFG] & 0x04:
            self._reg[reg.I2C_MST_STATUS] |= 0x80

    def _exchange(self, write: bytes, read_count: int, now_ns: int) -> bytes:
        if write:
            self._pointer = write[0] & _HIGHEST_REGISTER
            for byte in write[1:]:
                self._write(self._pointer, byte, now_ns)
                self._step_pointer()
        if read_count == 0:
            return b""
        if self._pointer == reg.FIFO_R_W:
            return self._pop(read_count)
        is_whole = self._pointer == reg.INT_STATUS and read_count > reg.GYRO_ZOUT_L - reg.INT_STATUS
        if is_whole and self._reg[reg.INT_STATUS] & reg.INT_DATA_RDY:
            self._show()
        answer = bytearray()
        for _ in range(read_count):
            answer.append(self._read(self._pointer))
            self._step_pointer()
        if self._reg[reg.INT_PIN_CFG] & 0x10:
            self._reg[reg.INT_STATUS] = 0
        return bytes(answer)

    def _step_pointer(self) -> None:
        if self._pointer != reg.FIFO_R_W:
            self._pointer = (self._pointer + 1) & _HIGHEST_REGISTER

    def _power_up(self, now_ns: int) -> None:
        self._reg = bytearray(_HIGHEST_REGISTER + 1)
        for address, value in reg.RESET_VALUES.items():
            self._reg[address] = value
        self._reg[reg.SELF_TEST_X : reg.SELF_TEST_A + 1] = self._trim.registers()
        self._fifo.power_up()
        self._pointer = 0
        self._busy_until_ns = 0
        self._wake(now_ns)

    # Sampling

    def _restart_grid(self, now_ns: int) -> None:
        power = self._reg[reg.PWR_MGMT_1]
        clksel = power & 0x07
        self._running = not power & 0x40 and clksel <= 3
        self._clock = self._pll if clksel else self._rc
        self._tick_ns = _FAST_TICK_NS if self._reg[reg.CONFIG] & 0x07 in (0, 7) else _SLOW_TICK_NS
        if power & 0x20:  # CYCLE
            self._tick_ns = _SLOW_TICK_NS
            self._period_ns = reg.LP_WAKE_PERIOD_NS[self._reg[reg.PWR_MGMT_2] >> 6]
        else:
            self._period_ns = self._tick_ns * (1 + self._reg[reg.SMPLRT_DIV])
        super()._restart_grid(now_ns)

    @property
    def _settings(self) -> tuple[object, ...]:
        if reg.held_columns(self._reg[reg.PWR_MGMT_1], self._reg[reg.PWR_MGMT_2]):
            return ()
        return tuple(bytes(self._reg[part]) for part in _CONVERTING)

    @property
    def _sync_column(self) -> int | None:
        return reg.SYNC_COLUMN[self._reg[reg.CONFIG] >> 3 & 7]

    def _store(self, counts: NDArray[np.int16], times_s: NDArray[np.float64]) -> None:
        self._reg[reg.ACCEL_XOUT_H : reg.GYRO_ZOUT_L + 1] = self._last.astype(">i2").tobytes()
        self._reg[reg.INT_STATUS] |= reg.INT_DATA_RDY
        self._fill_fifo(counts, times_s)

    def _convert(
        self, ticks_ns: NDArray[np.float64], times_s: NDArray[np.float64], latest_s: float
    ) -> NDArray[np.int16]:
        accel_lsb = reg.ACCEL_LSB_PER_G[self._reg[reg.ACCEL_CONFIG] >> 3 & 3]
        gyro_lsb = reg.GYRO_LSB_PER_DPS[self._reg[reg.GYRO_CONFIG] >> 3 & 3]
        dlpf = self._reg[reg.CONFIG] & 0x07
        counts = self._analog.counts(times_s, accel_lsb, gyro_lsb, dlpf).copy()
        if self._tick_ns == _FAST_TICK_NS:  # the accelerometer converts at 1 kHz and repeats
            slow_s = np.minimum(self._clock.times_s(ticks_ns // _SLOW_TICK_NS * _SLOW_TICK_NS), latest_s)
            counts[:, :3] = self._analog.counts(slow_s, accel_lsb, gyro_lsb, dlpf)[:, :3]
        self._add_self_test(counts, accel_lsb, gyro_lsb)
        held = reg.held_columns(self._reg[reg.PWR_MGMT_1], self._reg[reg.PWR_MGMT_2])
        if held:
            counts[:, held] = self._last[held]
        return counts

    def _add_self_test(self, counts: NDArray[np.int16], accel_lsb: float, gyro_lsb: float) -> None:
        accel_on, gyro_on = self._reg[reg.ACCEL_CONFIG], self._reg[reg.GYRO_CONFIG]
        if (accel_on | gyro_on) & 0xE0:
            response = self._trim.response_lsb(accel_on, gyro_on, accel_lsb, gyro_lsb)
            total = counts + np.rint(response * self._self_test_gain)
            counts[:] = np.clip(total, -32768, 32767).astype(np.int16)

    # FIFO

    def _fill_fifo(self, counts: NDArray[np.int16], times_s: NDArray[np.float64]) -> None:
        enabled = self._reg[reg.FIFO_EN]
        if not (self._reg[reg.USER_CTRL] & 0x40 and enabled & 0xF8):
            return
        columns = [0, 1, 2] * (enabled >> 3 & 1) + [3] * (enabled >> 7)
        columns += [4 + axis for axis in range(3) if enabled & 0x40 >> axis]
        data = (counts if len(columns) == 7 else counts[:, columns]).astype(">i2").tobytes()
        if self._fifo.fill(data, len(counts), float(times_s[0]), self._last_s, self._period_s()):
            self._reg[reg.INT_STATUS] |= reg.INT_FIFO_OFLOW

    def _pop(self, count: int) -> bytes:
        return self._fifo.pop(count, bool(self._reg[reg.USER_CTRL] & 0x40))

    # Registers

    def _read(self, address: int) -> int:
        now_ns = self._settled_ns
        if address == reg.FIFO_R_W:
            return self._pop(1)[0]
        if address == reg.FIFO_COUNT_H:
            return self._fifo.count_high()
        if address == reg.FIFO_COUNT_L:
            return self._fifo.count_low()
        value = self._reg[address]
        if address in (reg.INT_STATUS, reg.I2C_MST_STATUS):
            self._reg[address] = 0
        elif address == reg.PWR_MGMT_1 and now_ns < self._busy_until_ns:
            value |= 0x80
        elif address == reg.WHO_AM_I and self._faults:
            wrong = self._faults.active(FaultKind.WHO_AM_I, now_ns)
            value = value if wrong is None else int(wrong.value)
        return value

    def _write(self, address: int, value: int, now_ns: int) -> None:
        if now_ns < self._busy_until_ns:
            return
        if address == reg.PWR_MGMT_1:
            if value & 0x80:
                self._power_up(now_ns)
                self._pointer = address
                self._busy_until_ns = now_ns + _RESET_NS
                return
            self._set_and_regrid(address, value, now_ns)
        elif address == reg.USER_CTRL:
            self._write_user_ctrl(value)
        elif address == reg.FIFO_R_W:
            if self._reg[reg.USER_CTRL] & 0x40 and self._fifo.write(bytes([value])):
                self._reg[reg.INT_STATUS] |= reg.INT_FIFO_OFLOW
        elif address in (reg.SMPLRT_DIV, reg.CONFIG, reg.PWR_MGMT_2):
            self._set_and_regrid(address, value, now_ns)
        elif address in reg.WRITABLE:
            self._reg[address] = value

    def _set_and_regrid(self, address: int, value: int, now_ns: int) -> None:
        if self._reg[address] != value:
            self._reg[address] = value
            self._restart_grid(now_ns)

    def _write_user_ctrl(self, value: int) -> None:
        was_enabled = self._reg[reg.USER_CTRL] & 0x40
        if value & 0x04 and not value & 0x40:  # FIFO_RESET acts only while the FIFO is disabled
            self._fifo.clear()
        if value & 0x01:  # SIG_COND_RESET clears the sensor registers
            self._reg[reg.ACCEL_XOUT_H : reg.GYRO_ZOUT_L + 1] = bytes(14)
        if value & 0x40 and not was_enabled:
            self._fifo.enable()
        self._reg[reg.USER_CTRL] = value & ~0x07
