"""ICM-20948 as its data sheet tells it (DS-000189 1.3), for the driver's tests: own register numbers, own times."""

from collections.abc import Callable
from typing import ClassVar

import numpy as np

from drivers.ports import I2cReply
from tests.drivers.i2c_model import Chip

SIZE = 512


class Icm20948Model(Chip):
    """Sample ``n`` since the first power-up holds the words ``values(n)``: accel, gyro, temperature."""

    address = 0x69
    reset_values: ClassVar = {0x000: 0xEA, 0x005: 0x40, 0x006: 0x41, 0x201: 0x01, 0x214: 0x01}  # bank, address

    def __init__(self, clock, rate_error: float = 0.004, **options) -> None:
        self.rate_error = rate_error
        self.values: Callable[[int], list[int]] = lambda number: [
            number % 30_000,
            1,
            2,
            3,
            4,
            5,
            100 | (number % 7 == 0),
        ]
        self.samples = 0  # in all
        self.runs = True
        super().__init__(clock, **options)

    def reset(self) -> None:
        super().reset()
        self.bank = 0
        self.fifo = bytearray()
        self.next_ns = 0.0

    @property
    def period_ns(self) -> float:
        return 1e9 / 1125.0 * (1 + self.registers.get(0x200, 0)) * (1.0 + self.rate_error)

    def run(self) -> None:
        now_ns = self.clock()
        if self.registers.get(0x006, 0) & 0x40 or not self.runs:
            self.next_ns = now_ns + self.period_ns
            return
        while self.next_ns <= now_ns:
            if self.registers.get(0x003, 0) & 0x40 and self.registers.get(0x067, 0) == 0x1F:
                self.fifo += np.array(self.values(self.samples), ">i2").tobytes()
                if len(self.fifo) > SIZE:
                    del self.fifo[: len(self.fifo) - SIZE]
                    self.registers[0x01B] = 1
            self.samples += 1
            self.next_ns += self.period_ns

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        if data == b"\x72" and not self.bank:
            self.begins(address, ("read", *data, count))
            got = bytes(self.fifo[:count])
            del self.fifo[:count]
            return I2cReply(got + bytes(count - len(got)), self.clock())
        return super().write_read(address, data, count)

    def byte(self, register: int) -> int:
        if register == 0x7F:
            return self.bank << 4
        if not self.bank and register in (0x70, 0x71):
            return len(self.fifo).to_bytes(2, "big")[register - 0x70]
        where = self.bank << 8 | register
        value = self.stuck.get(where, self.registers.get(where, 0))
        if where == 0x01B:
            self.registers[where] = 0
        return value

    def wrote(self, register: int, value: int) -> None:
        where = self.bank << 8 | register
        if register == 0x7F:
            self.bank = value >> 4
        elif where == 0x006 and value & 0x80:
            self.reset()
        elif where == 0x068 and value:
            self.fifo.clear()
        else:
            self.registers[where] = value
