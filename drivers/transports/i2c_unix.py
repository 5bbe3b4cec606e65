"""I2C over a Unix stream socket: the bus of a simulator in another process.

Little-endian, one request, one reply, in order. Request: u8 operation (0 write, 1 write and read), u8 address,
u16 length, u16 bytes to read, then the bytes. Reply: u16 errno (0: done), u16 count, then the bytes.
"""

import errno
import os
import socket
import struct
from collections.abc import Callable

from drivers.ports import I2cReply

_REQUEST = struct.Struct("<BBHH")
_REPLY = struct.Struct("<HH")
_WRITE, _WRITE_READ = 0, 1


class UnixI2cPort:
    """An ``I2cPort`` on a Unix stream socket.

    It connects at the first transfer and again after a broken connection, so the server may start late or restart;
    meanwhile a transfer raises OSError as an absent device does. A missing reply raises OSError(ETIMEDOUT) and closes
    the connection, because a late reply would be taken for the next one.
    """

    def __init__(self, path: str, clock: Callable[[], int], timeout_s: float = 1.0) -> None:
        self._path = path
        self._clock = clock
        self._timeout_s = timeout_s
        self._socket: socket.socket | None = None

    def write(self, address: int, data: bytes) -> None:
        """START, address+W, ``data``, STOP. Raises OSError."""
        self._transfer(_WRITE, address, data, 0)

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """Write ``data``, read ``count`` bytes after a repeated start. Raises OSError."""
        reply = self._transfer(_WRITE_READ, address, data, count)
        return I2cReply(reply, self._clock())

    def close(self) -> None:
        """Drop the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _transfer(self, operation: int, address: int, data: bytes, count: int) -> bytes:
        try:
            connection = self._connected()
            connection.sendall(_REQUEST.pack(operation, address, len(data), count) + data)
            reply = _receive(connection, count)
            code, size = _REPLY.unpack_from(reply)
        except TimeoutError as error:
            self.close()
            raise OSError(errno.ETIMEDOUT, f"no reply on {self._path}") from error
        except OSError:
            self.close()
            raise
        if code:
            raise OSError(code, os.strerror(code))
        if size != count:
            raise OSError(errno.EPROTO, f"{size} bytes where {count} were asked on {self._path}")
        return reply[_REPLY.size :]

    def _connected(self) -> socket.socket:
        if self._socket is None:
            connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            connection.settimeout(self._timeout_s)
            try:
                connection.connect(self._path)
            except OSError:
                connection.close()
                raise
            self._socket = connection
        return self._socket


def _receive(connection: socket.socket, asked: int) -> bytes:
    """One reply, mostly in one read; its head has the length of what follows, at most ``asked``."""
    data, size = b"", _REPLY.size
    while len(data) < size:
        piece = connection.recv(_REPLY.size + asked)
        if not piece:
            raise OSError(errno.ECONNRESET, "the other side closed the connection")
        data += piece
        if len(data) >= _REPLY.size:
            size = _REPLY.size + _REPLY.unpack_from(data)[1]
    return data
