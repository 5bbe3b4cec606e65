"""Registers in banks: a register's number is 256 times its bank, and its address in that."""

from drivers.i2c.bus import RegisterBus
from drivers.ports import I2cPort, I2cReply


class BankedBus(RegisterBus):
    """Registers of a device whose bank is the register ``select``, bits 5 and 4, in every bank.

    Bank 0 is selected after each access to another one: it is what a device has that was reset.
    """

    def __init__(self, port: I2cPort, address: int, select: int) -> None:
        super().__init__(port, address)
        self._at = select
        self._bank: int | None = 0  # None: not known, since a write of it failed

    def read(self, register: int, count: int = 1) -> I2cReply:
        """See ``RegisterBus``."""
        self.select(register >> 8)
        try:
            return super().read(register & 0xFF, count)
        finally:
            self.select(0)

    def write(self, register: int, value: int) -> None:
        """See ``RegisterBus``."""
        self.select(register >> 8)
        try:
            super().write(register & 0xFF, value)
        finally:
            self.select(0)

    def select(self, bank: int | None) -> None:
        """Have this bank selected; None: it is not known which one is. Raises OSError when the last try fails."""
        if bank is not None and bank != self._bank:
            self._bank = None
            super().write(self._at, bank << 4)
        self._bank = bank
