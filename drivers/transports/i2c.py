"""I2C through the kernel's i2c-dev node, by smbus2."""

from collections.abc import Callable

from smbus2 import SMBus, i2c_msg

from drivers.ports import I2cReply


class SmbusPort:
    """An ``I2cPort`` on ``/dev/i2c-N``.

    Every transfer is one I2C_RDWR call, so a write and its read are joined by a repeated start and no other process
    comes between; SMBus block reads would end at 32 bytes. Errors are the kernel's, with its errno.
    """

    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        self._bus = SMBus(path)
        self._clock = clock

    def write(self, address: int, data: bytes) -> None:
        """START, address+W, ``data``, STOP. Raises OSError."""
        self._bus.i2c_rdwr(i2c_msg.write(address, data))

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """Write ``data``, read ``count`` bytes after a repeated start. Raises OSError."""
        reading = i2c_msg.read(address, count)
        self._bus.i2c_rdwr(i2c_msg.write(address, data), reading)
        host_ns = self._clock()
        return I2cReply(bytes(reading), host_ns)

    def close(self) -> None:
        """Close the node."""
        self._bus.close()
