"""Register access with a bounded number of retries, and messages for the errno of an I2C transfer."""

import errno
from collections.abc import Callable
from typing import TypeVar

from drivers.ports import I2cPort, I2cReply

TRIES = 3
NOT_ACKNOWLEDGED = frozenset({errno.ENXIO, errno.EREMOTEIO})  # at the address: no data were transferred
_REMEDY = {
    errno.ENXIO: "check its power, wiring and address",
    errno.EREMOTEIO: "check its power, wiring and address",
    errno.ETIMEDOUT: "SDA may be held low: power-cycle it",
    errno.ENODEV: "the adapter is gone: plug it in",
    errno.ENOENT: "the adapter is gone: plug it in",
    errno.EBADMSG: "invalid data, check wiring and pull-ups",
    errno.EAGAIN: "arbitration lost: look for another master",
}
_T = TypeVar("_T")


def explain(error: OSError) -> str:
    """Name of the errno and what to do about it."""
    code = error.errno or 0
    return f"({errno.errorcode.get(code, str(error))}): {_REMEDY.get(code, 'check the bus')}"


class RegisterBus:
    """Registers of one device on an I2C bus.

    A failed transfer is repeated at once, ``TRIES`` times in all, but not after a timeout (bus held low).

    Attributes:
        errors: Failed transfers, including those whose retry succeeded.
    """

    def __init__(self, port: I2cPort, address: int) -> None:
        self._port = port
        self._address = address
        self.errors = 0

    def read(self, register: int, count: int = 1) -> I2cReply:
        """``count`` bytes from ``register`` on. Raises OSError when the last try fails."""
        return self._tried(lambda: self._port.write_read(self._address, bytes((register,)), count), None)

    def byte(self, register: int) -> int:
        """One register. Raises OSError when the last try fails."""
        return self.read(register).data[0]

    def pop(self, register: int, count: int) -> I2cReply:
        """``count`` bytes of a FIFO; repeated only if the device transferred no data. Raises OSError."""
        transfer = self._port.write_read
        return self._tried(lambda: transfer(self._address, bytes((register,)), count), NOT_ACKNOWLEDGED)

    def write(self, register: int, value: int) -> None:
        """Write one register. Raises OSError when the last try fails."""
        self._tried(lambda: self._port.write(self._address, bytes((register, value))), None)

    def _tried(self, transfer: Callable[[], _T], only: frozenset[int] | None) -> _T:
        tried = 1
        while True:
            try:
                return transfer()
            except OSError as error:
                self.errors += 1
                barred = error.errno == errno.ETIMEDOUT or (only is not None and error.errno not in only)
                if tried == TRIES or barred:
                    raise
                tried += 1
