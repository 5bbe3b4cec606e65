"""An MPU-6050 as the data sheet tells it, for the driver's tests: own register numbers, own FIFO, own clock.

RM-MPU-6000A 4.2: section 3 (register map and reset values), 4.1 (self test), 4.18 (INT_STATUS, shadow registers), 4.29
(FIFO_COUNT), 4.30 (FIFO_R_W).
"""

import errno
import os
from collections.abc import Callable

from drivers.ports import I2cReply

MS = 1_000_000
RESET_VALUES = {0x6B: 0x40, 0x75: 0x68}  # all others 0
FIFO_BYTES = 1024


def sample_words(number: int) -> tuple[int, ...]:
    """The seven words of sample ``number``: it is written into accel x and y, so that every row can be recognised."""
    return (number & 0x3FFF, number >> 14 & 0x3FFF, 100, -3920, -200, 300, 5)


class Mpu6050Model:
    """Answers ``write`` and ``write_read`` as the chip does, at the time its clock shows.

    Args:
        clock: Shows the time; has ``advance``.
        period_ns: True sample period, ns; not a whole number, as in life.
        phase_ns: Of the sampling, against time 0.
        byte_ns: Time one byte takes on the bus; 0: transfers take no time.
    """

    def __init__(self, clock, period_ns: float = 1_003_217.3, phase_ns: float = 123_456.0, byte_ns: int = 0) -> None:
        self.clock = clock
        self.period_ns = period_ns
        self.phase_ns = phase_ns
        self.byte_ns = byte_ns
        self.identity = 0x68
        self.broken = False  # powered, and its sampling stands still
        self.fail: Callable[[int], int] = lambda place: 0  # errno of the transfer with this number
        self.pops_before_failure = 0  # bytes a failing FIFO read takes with it
        self.late: Callable[[], int] = lambda: 0  # ns that pass between the end of a read and its stamp
        self.self_test_response = [0.0] * 6  # gyro, accel: counts at 250 deg/s and 8 g
        self.factory_codes = bytes(4)
        self.offsets = (12, -30, 7, 100, -60, 3900)  # gyro, accel: what it says at rest in its self test
        self.transfers: list[tuple] = []
        self.sync_samples: set[int] = set()
        self.words = sample_words
        self.first: int | None = None  # grid number of the first sample ever written
        self.written = 0
        self.reset()

    def reset(self) -> None:
        """Power-on or brown-out."""
        self.registers = {**RESET_VALUES, 0x75: self.identity}
        self.fifo = bytearray()
        self.last_byte = 0
        self.grid = self._grid_now()

    def _grid_now(self) -> int:
        """Number of sample instants that have passed."""
        return int((self.clock() - self.phase_ns) // self.period_ns)

    def sample(self) -> None:
        now = self._grid_now()
        running = self.registers.get(0x23) == 0xF8 and self.registers.get(0x6A, 0) & 0x40
        if running and not self.registers[0x6B] & 0x40 and not self.broken:
            for grid in range(self.grid, now):
                if self.first is None:
                    self.first = grid
                self._write_fifo(grid - self.first)
        if now > self.grid and self.registers.get(0x38, 0) & 1 and not self.registers[0x6B] & 0x40 and not self.broken:
            if self.first is None:
                self.first = self.grid
            self._show(now - 1 - self.first)
        self.grid = now

    def _show(self, number: int) -> None:
        """Sample ``number`` in the data registers."""
        words = list(self.words(number))
        words[3] = words[3] & ~1 | (number in self.sync_samples)
        data = b"".join((word & 0xFFFF).to_bytes(2, "big") for word in words)
        self.registers.update(zip(range(0x3B, 0x49), data, strict=True))
        self.registers[0x3A] = self.registers.get(0x3A, 0) | 1
        self.written = number + 1

    def _show_self_test(self) -> None:
        """The data registers of a chip at rest, with the actuators of 1Bh and 1Ch on or off."""
        gyro, accel = self.registers.get(0x1B, 0), self.registers.get(0x1C, 0)
        on = [gyro >> bit & 1 for bit in (7, 6, 5)] + [accel >> bit & 1 for bit in (7, 6, 5)]
        if self.registers[0x6B] & 0x40:
            values = [0] * 6
        elif any(on) and (gyro & 0x18, accel & 0x18) != (0x00, 0x10):
            raise AssertionError("self test at ranges for which there is no factory trim")
        else:
            parts = zip(self.offsets, on, self.self_test_response, strict=True)
            values = [round(offset + bit * response) for offset, bit, response in parts]
        words = [*values[3:], -3920, *values[:3]]
        data = b"".join((word & 0xFFFF).to_bytes(2, "big") for word in words)
        self.registers.update(zip(range(0x3B, 0x49), data, strict=True))

    def _write_fifo(self, number: int) -> None:
        words = list(self.words(number))
        words[3] = words[3] & ~1 | (number in self.sync_samples)
        self.fifo += b"".join((word & 0xFFFF).to_bytes(2, "big") for word in words)
        self.written += 1
        if len(self.fifo) > FIFO_BYTES:
            del self.fifo[: len(self.fifo) - FIFO_BYTES]
            self.registers[0x3A] = self.registers.get(0x3A, 0) | 0x10

    def _begin(self, size: int) -> None:
        self.clock.advance(self.byte_ns * size)
        self.sample()

    def write(self, address: int, data: bytes) -> None:
        self.transfers.append(("write", *data))
        self._begin(1 + len(data))
        self._fail(address)
        register, value = data
        if register == 0x6B and value & 0x80:
            self.reset()
        elif register == 0x6A:
            if value & 0x04 and not value & 0x40:
                self.fifo.clear()
            self.registers[register] = value & ~0x04
        else:
            self.registers[register] = value

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        (register,) = data
        self.transfers.append(("read", register, count))
        self._begin(3)
        try:
            self._fail(address)
        except OSError as error:
            if register == 0x74 and error.errno not in {errno.EREMOTEIO, errno.ENXIO}:
                del self.fifo[: self.pops_before_failure]
            raise
        if register == 0x74:
            reply = bytes(self._pop() for _ in range(count))
        else:
            if (register, count) == (0x3B, 14):
                self._show_self_test()
            self.registers.update(zip(range(0x0D, 0x11), self.factory_codes, strict=True))
            size = len(self.fifo).to_bytes(2, "big")
            self.registers[0x72], self.registers[0x73] = size
            reply = bytes(self.registers.get(register + place, 0) for place in range(count))
            if register <= 0x3A < register + count:
                self.registers[0x3A] = 0
        self.clock.advance(self.byte_ns * count)
        self.clock.advance(self.late())
        return I2cReply(reply, self.clock())

    def close(self) -> None:
        pass

    def _pop(self) -> int:
        if self.fifo:
            self.last_byte = self.fifo.pop(0)
        return self.last_byte

    def _fail(self, address: int) -> None:
        code = self.fail(len(self.transfers) - 1)
        if address != 0x68:
            code = errno.EREMOTEIO
        if code:
            raise OSError(code, os.strerror(code))


class ScriptedI2c:
    """A bus that expects these transactions, in this order: ``done`` says that all have been made.

    Each is ``(bytes written, bytes read | errno)``; a write has b"" to be read.
    """

    def __init__(self, clock, script: list[tuple[bytes, bytes | int]]) -> None:
        self.clock = clock
        self.script = list(script)

    def write(self, address: int, data: bytes) -> None:
        self._next(address, data, 0)

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        return I2cReply(self._next(address, data, count), self.clock())

    def close(self) -> None:
        pass

    def _next(self, address: int, data: bytes, count: int) -> bytes:
        assert self.script, f"transaction beyond the script: {data.hex(' ')}"
        expected, answer = self.script.pop(0)
        assert (address, data) == (0x68, expected)
        if isinstance(answer, int):
            raise OSError(answer, os.strerror(answer))
        assert len(answer) == count
        return answer

    def done(self) -> None:
        assert not self.script, f"{len(self.script)} transactions not made, next {self.script[0]}"
