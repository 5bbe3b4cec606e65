"""Serves an I2C bus on a Unix stream socket: one request, one reply, in order (little-endian).

Request: u8 operation (0 write, 1 write_read), u8 address, u16 length, u16 read count, the bytes to write. Reply: u16
errno (0: done), u16 count, the bytes read. A reply is delayed by the transfer's time on real wires; transfers are
serialised.
"""

import contextlib
import errno
import select
import socket
import struct
from collections import deque
from pathlib import Path
from typing import Final

from hil_sim.buses.i2c_dev import I2cTarget
from hil_sim.buses.media import I2cBus
from hil_sim.faults import NEVER

_REQUEST: Final = struct.Struct("<BBHH")
_REPLY: Final = struct.Struct("<HH")
_WRITE, _WRITE_READ = 0, 1


class _Client:
    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.input = bytearray()
        self.replies: deque[tuple[int, bytes]] = deque()


class I2cSocket:
    """The listening socket and its clients; ``advance`` performs the work.

    Args:
        path: Where to listen.
        bus: What answers.
        bit_rate: Of the wires, bit/s.
    """

    def __init__(self, path: Path, bus: I2cTarget, bit_rate: int = 400_000) -> None:
        self._bus = bus
        self._bit_rate = bit_rate
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        self._listener.bind(str(path))
        self._listener.listen()
        self._readable = select.epoll()  # a turn of the loop asks it, and not each socket
        self._readable.register(self._listener, select.EPOLLIN)
        self._clients: dict[int, _Client] = {}
        self._free_ns = 0

    def fileno(self) -> int:
        """Readable when any of its sockets is."""
        return self._readable.fileno()

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._clients)

    @property
    def due_ns(self) -> int:
        """When the next reply is to be sent."""
        return min((client.replies[0][0] for client in self._clients.values() if client.replies), default=NEVER)

    def advance(self, now_ns: int) -> None:
        """Process requests and send the replies that are due."""
        ready = dict(self._readable.poll(0))
        if self._listener.fileno() in ready:
            self._accept()
            ready = dict(self._readable.poll(0))
        for file, client in tuple(self._clients.items()):
            try:
                if file in ready:
                    self._receive(client, now_ns)
                while client.replies and client.replies[0][0] <= now_ns:
                    client.connection.sendall(client.replies.popleft()[1])
            except (ConnectionError, BlockingIOError):  # closed, or does not read its replies
                client.connection.close()
                del self._clients[file]

    def close(self) -> None:
        """Close everything."""
        self._readable.close()
        for file in (self._listener, *(client.connection for client in self._clients.values())):
            file.close()
        self._clients.clear()

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                connection, _ = self._listener.accept()
                connection.setblocking(False)
                self._readable.register(connection, select.EPOLLIN)
                self._clients[connection.fileno()] = _Client(connection)

    def _receive(self, client: _Client, now_ns: int) -> None:
        data = client.connection.recv(65536)
        if not data:
            raise ConnectionResetError
        client.input += data
        while len(client.input) >= _REQUEST.size:
            operation, address, length, read_count = _REQUEST.unpack_from(client.input)
            end = _REQUEST.size + length
            if len(client.input) < end:
                return
            write = bytes(client.input[_REQUEST.size : end])
            del client.input[:end]
            client.replies.append(self._transfer(operation, address, write, read_count, now_ns))

    def _transfer(self, operation: int, address: int, write: bytes, read_count: int, now_ns: int) -> tuple[int, bytes]:
        if operation not in (_WRITE, _WRITE_READ):
            return now_ns, _REPLY.pack(errno.EINVAL, 0)
        read_count = read_count if operation == _WRITE_READ else 0
        start_ns = max(now_ns, self._free_ns)
        try:
            answer = self._bus.transfer(address, write, read_count, now_ns)
        except OSError as error:
            self._free_ns = start_ns + I2cBus.transfer_ns(0, 0, self._bit_rate)  # address byte, NACK, STOP
            return self._free_ns, _REPLY.pack(error.errno or errno.EIO, 0)
        self._free_ns = start_ns + I2cBus.transfer_ns(len(write), read_count, self._bit_rate)
        return self._free_ns, _REPLY.pack(0, len(answer)) + answer
