"""SPI through the kernel's spidev node, by its ioctls; or of a simulator, over a socket."""

import ctypes
import fcntl
import os
from collections.abc import Callable

from drivers.ports import I2cReply, SpiPort
from drivers.transports.i2c_unix import UnixI2cPort
from drivers.transports.reopening import Reopening

WRITE_MODE, WRITE_SPEED = 0x4001_6B01, 0x4004_6B04  # linux/spi/spidev.h: _IOW('k', 1, u8), _IOW('k', 4, u32)
MESSAGE = 0x4000_6B00  # _IOW('k', 0, char[32 x transfers]): their bytes from bit 16 on


class _Transfer(ctypes.Structure):
    """struct spi_ioc_transfer of linux/spi/spidev.h."""

    _fields_ = (
        ("tx_buf", ctypes.c_uint64),
        ("rx_buf", ctypes.c_uint64),
        ("len", ctypes.c_uint32),
        ("speed_hz", ctypes.c_uint32),
        ("delay_usecs", ctypes.c_uint16),
        ("bits_per_word", ctypes.c_uint8),
        ("cs_change", ctypes.c_uint8),
        ("tx_nbits", ctypes.c_uint8),
        ("rx_nbits", ctypes.c_uint8),
        ("word_delay_usecs", ctypes.c_uint8),
        ("pad", ctypes.c_uint8),
    )


class SpidevPort:
    """An ``SpiPort`` on ``/dev/spidevB.C``; all frames of a transfer are one ioctl.

    Args:
        path: Of the node.
        clock: CLOCK_MONOTONIC, ns.
        mode: CPOL x 2 + CPHA.
        speed_hz: Of the clock line, at most.

    Raises:
        OSError: There is no such node, or it has not this mode.
    """

    def __init__(self, path: str, clock: Callable[[], int], mode: int, speed_hz: int) -> None:
        self._clock = clock
        self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.ioctl(self._fd, WRITE_MODE, bytes([mode]))
            fcntl.ioctl(self._fd, WRITE_SPEED, speed_hz.to_bytes(4, "little"))
        except OSError:
            self.close()
            raise

    def transfer(self, data: bytes, size: int) -> I2cReply:
        """See ``SpiPort``."""
        sent = ctypes.create_string_buffer(data, len(data))
        got = ctypes.create_string_buffer(len(data))
        frames = (_Transfer * (len(data) // size))()
        for number, frame in enumerate(frames):
            frame.tx_buf = ctypes.addressof(sent) + number * size
            frame.rx_buf = ctypes.addressof(got) + number * size
            frame.len, frame.cs_change = size, number < len(frames) - 1  # on the last one it would stay selected
        fcntl.ioctl(self._fd, MESSAGE | ctypes.sizeof(frames) << 16, frames)
        return I2cReply(got.raw, self._clock())

    def close(self) -> None:
        """Close the node."""
        os.close(self._fd)


class ReopeningSpi(Reopening[SpiPort]):
    """An ``SpiPort`` over ports that ``open_port`` opens, one after the other; see :class:`Reopening`."""

    def __init__(self, open_port: Callable[[], SpiPort], clock: Callable[[], int]) -> None:
        super().__init__(open_port, clock, "the SPI adapter")

    def transfer(self, data: bytes, size: int) -> I2cReply:
        """See ``SpiPort``."""
        return self._tried(lambda port: port.transfer(data, size))


class UnixSpi:
    """An ``SpiPort`` of a simulator: requests of ``i2c_unix``, the bytes of a frame in place of the address."""

    def __init__(self, path: str, clock: Callable[[], int]) -> None:
        self._socket = UnixI2cPort(path, clock)

    def transfer(self, data: bytes, size: int) -> I2cReply:
        """See ``SpiPort``."""
        return self._socket.write_read(size, data, len(data))

    def close(self) -> None:
        """Drop the connection."""
        self._socket.close()
