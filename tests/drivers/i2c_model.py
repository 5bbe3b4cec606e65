"""Chips on I2C as their data sheets tell them, for the drivers' tests: own register numbers, own times."""

import errno
import os
from collections.abc import Callable
from typing import ClassVar

from drivers.ports import I2cReply

MS = 1_000_000


class Chip:
    """A slave with registers and an address pointer, and a master on it (``drivers.ports.I2cPort``).

    Args:
        clock: Shows the time; has ``advance``.
        transfer_ns: Time of a transfer.
    """

    address = 0
    reset_values: ClassVar[dict[int, int]] = {}

    def __init__(self, clock, transfer_ns: int = 0) -> None:
        self.clock = clock
        self.transfer_ns = transfer_ns
        self.transfers: list[tuple] = []
        self.fail: Callable[[int], int] = lambda number: 0  # errno of the transfer with this number
        self.stuck: dict[int, int] = {}  # registers that read this whatever is written
        self.reset()

    def reset(self) -> None:
        """Power-on or brown-out."""
        self.registers = dict(self.reset_values)

    def run(self) -> None:
        """Do what is due."""

    def wrote(self, register: int, value: int) -> None:
        self.registers[register] = value

    def byte(self, register: int) -> int:
        return self.registers.get(register, 0)

    def write(self, address: int, data: bytes) -> None:
        self.begins(address, ("write", *data))
        for place, value in enumerate(data[1:]):
            self.wrote(data[0] + place, value)

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        self.begins(address, ("read", *data, count))
        (register,) = data
        got = bytes(self.stuck.get(register + place, self.byte(register + place)) for place in range(count))
        return I2cReply(got, self.clock())

    def close(self) -> None:
        raise AssertionError("the bus is not the driver's to close")

    def begins(self, address: int, transfer: tuple) -> None:
        number = len(self.transfers)
        self.transfers.append(transfer)
        self.clock.advance(self.transfer_ns)
        self.run()
        code = self.fail(number) or (errno.ENXIO if address != self.address else 0)
        if code:
            raise OSError(code, os.strerror(code))


class Nau7802Model(Chip):
    """NAU7802, data sheet 1.7. Conversion ``n`` since the first power-up reads ``values(n)``."""

    address = 0x2A
    reset_values: ClassVar = {0x07: 0x80, 0x0E: 0x80, 0x1F: 0x0F}
    rates: ClassVar = {0: 10, 1: 20, 2: 40, 3: 80, 7: 320}

    def __init__(self, clock, rate_error: float = 0.004, **options) -> None:
        self.rate_error = rate_error
        self.values: Callable[[int], int] = lambda number: 1000 + number
        self.conversions = 0  # in all
        self.calibration_ms = 60
        self.calibrates = True
        self.converts = True
        super().__init__(clock, **options)

    def reset(self) -> None:
        super().reset()
        self.next_ns = self.calibrated_ns = 0.0

    @property
    def period_ns(self) -> float:
        return 1e9 / self.rates[self.registers.get(2, 0) >> 4 & 7] * (1.0 + self.rate_error)

    def run(self) -> None:
        now_ns, power = self.clock(), self.registers.get(0, 0)
        if self.registers.get(2, 0) & 4 and now_ns >= self.calibrated_ns:
            self.registers[2] &= ~4
            if self.calibrates:
                self.registers |= {3: 0x80, 4: 0x01, 5: 0x23}
            else:
                self.registers[2] |= 8
            self.next_ns = now_ns + self.period_ns
        if power & 7 != 6 or self.registers.get(2, 0) & 4 or not self.converts:
            return
        while self.next_ns <= now_ns:
            data = (self.values(self.conversions) & 0xFFFFFF).to_bytes(3, "big")
            self.registers |= dict(zip((0x12, 0x13, 0x14), data, strict=True))
            self.registers[0] |= 0x20
            self.conversions += 1
            self.next_ns += self.period_ns

    def byte(self, register: int) -> int:
        if register == 0x14:
            self.registers[0] &= ~0x20
        return super().byte(register)

    def wrote(self, register: int, value: int) -> None:
        before = self.registers.get(register, 0)
        if register == 0 and value & 1:
            self.reset()
            value = 1
        elif register == 0:
            value = value & 0xD6 | (0x08 if value & 2 else 0)
            if (value & ~before) & 0x14:
                self.next_ns = self.clock() + self.period_ns
        elif register == 2 and value & 4:
            self.calibrated_ns = self.clock() + self.calibration_ms * MS
        super().wrote(register, value)


class As5600Model(Chip):
    """AS5600, data sheet 1-06; ``status`` and ``angle`` are what it shows."""

    address = 0x36

    def __init__(self, clock, **options) -> None:
        self.status = 0x20  # MD
        self.angle: Callable[[int], int] = lambda now_ns: 100
        super().__init__(clock, **options)

    def run(self) -> None:
        angle = self.angle(self.clock()) % 4096
        self.registers |= {0x0B: self.status, 0x0C: angle >> 8, 0x0D: angle & 0xFF, 0x1A: 90}
