"""I2C through the kernel's i2c-dev node, by smbus2."""

import contextlib
import errno
import os
from collections.abc import Callable

from smbus2 import SMBus, i2c_msg

from drivers.ports import I2cReply

MOST_KEPT = 256  # kinds of transfers whose buffers are used again
ADAPTER_GONE = frozenset({errno.ENODEV, errno.ESHUTDOWN, errno.EBADF})


class SmbusPort:
    """An ``I2cPort`` on ``/dev/i2c-N``.

    Every transfer is one I2C_RDWR call, so a write and its read are joined by a repeated start and no other process can
    interleave; SMBus block reads are limited to 32 bytes. Errors carry the kernel's errno.

    An unplugged adapter removes its node and returns as another one of that name. After a transfer whose errno shows
    this, or after which the node is missing or replaced, the old node is closed and the next transfer reopens it.
    (ENXIO alone is not enough: some controllers return it for an address without acknowledge.)

    Attributes:
        reopened: Number of times the node was reopened.
    """

    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        self._path = path
        self._clock = clock
        self._messages: dict[tuple[int, bytes, int], tuple[i2c_msg, i2c_msg]] = {}  # a driver asks the same each time
        self.reopened = 0
        self._bus: SMBus | None = _opened(path)
        self._node = _status(path)

    def write(self, address: int, data: bytes) -> None:
        """START, address+W, ``data``, STOP. Raises OSError."""
        self._transfer(i2c_msg.write(address, data))

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """Write ``data``, read ``count`` bytes after a repeated start. Raises OSError."""
        messages = self._messages.get((address, data, count))
        if messages is None:
            if len(self._messages) >= MOST_KEPT:
                self._messages.clear()
            messages = i2c_msg.write(address, data), i2c_msg.read(address, count)
            self._messages[address, data, count] = messages
        self._transfer(*messages)
        host_ns = self._clock()
        return I2cReply(bytes(messages[1]), host_ns)

    def close(self) -> None:
        """Close the node."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _transfer(self, *messages: i2c_msg) -> None:
        bus = self._bus
        if bus is None:
            bus = self._bus = _opened(self._path)
            self._node = _status(self._path)
            self.reopened += 1
        try:
            bus.i2c_rdwr(*messages)
        except OSError as error:
            if error.errno == errno.EBADF:  # its descriptor may belong to another file by now
                bus.fd = None
            if error.errno in ADAPTER_GONE or self._is_another_node():
                self.close()
            raise

    def _is_another_node(self) -> bool:
        """Whether the opened node's name is gone or names another node."""
        now = _status(self._path)
        return self._node is not None and (now is None or not os.path.samestat(now, self._node))


def _status(path: str) -> os.stat_result | None:
    try:
        return os.stat(path)
    except OSError:
        return None


def _opened(path: str) -> SMBus:
    """Open the node; no descriptor stays open on failure. Raises OSError."""
    bus = SMBus()
    try:
        bus.open(path)
    except OSError:
        with contextlib.suppress(OSError):
            bus.close()
        raise
    return bus
