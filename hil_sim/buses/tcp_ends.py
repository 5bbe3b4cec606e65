"""The flight computer's end of TCP: in this process (T0) or by a real socket (T1), for ``NetworkBus``.

In T0 ``socket.create_connection`` finds the simulated hosts by their names.
"""

import contextlib
import socket
from typing import Any, Final

_MOST: Final = 65_536
_real: Final = socket.create_connection


class VirtualConnection:
    """What of ``socket.socket`` a driver may use."""

    def __init__(self) -> None:
        self.incoming, self.outgoing = bytearray(), bytearray()
        self.is_open, self.is_broken = True, False

    def setblocking(self, flag: bool) -> None:
        """It never waits."""

    def setsockopt(self, *_: int) -> None:
        """There is nothing to set."""

    def recv(self, size: int) -> bytes:
        """Bytes that came; none where the other side has closed.

        Raises:
            BlockingIOError: there is nothing yet.
        """
        if not self.incoming and not self.is_broken:
            raise BlockingIOError
        data = bytes(self.incoming[:size])
        del self.incoming[:size]
        return data

    def send(self, data: bytes) -> int:
        """Send.

        Raises:
            BrokenPipeError: the other side has closed.
        """
        if self.is_broken:
            raise BrokenPipeError("the simulated connection is closed")
        self.outgoing += data
        return len(data)

    def close(self) -> None:
        """Close it."""
        self.is_open = False


class VirtualTcp:
    """A host in this process, as ``socket.create_connection`` finds it; a :class:`HostEnd`.

    Args:
        host: Its name.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        self._connection: VirtualConnection | None = None
        self._is_new = self._listens = False
        _hosts[host] = self
        socket.create_connection = _connect  # type: ignore[assignment]  # for the length of a simulated run

    def connect(self) -> VirtualConnection:
        """A new connection.

        Raises:
            ConnectionRefusedError: it does not listen.
        """
        if not self._listens:
            raise ConnectionRefusedError(f"[Errno 111] the simulated {self._host} refuses")
        self._break()
        self._connection, self._is_new = VirtualConnection(), True
        return self._connection

    def look(self) -> tuple[bool, bytes]:
        """See ``HostEnd``."""
        anew, self._is_new = self._is_new, False
        if self._connection is None:
            return anew, b""
        data = bytes(self._connection.outgoing)
        self._connection.outgoing.clear()
        return anew, data

    def give(self, data: bytes) -> bool:
        """See ``HostEnd``."""
        if self._connection is None or not self._connection.is_open:
            return False
        self._connection.incoming += data
        return True

    def listen(self, is_on: bool) -> None:
        """See ``HostEnd``."""
        self._listens = is_on
        if not is_on:
            self._break()

    def close(self) -> None:
        """Take the host away; with the last one ``socket.create_connection`` is Python's own again."""
        _hosts.pop(self._host, None)
        if not _hosts:
            socket.create_connection = _real

    def _break(self) -> None:
        if self._connection is not None:
            self._connection.is_broken = True
            self._connection = None


_hosts: Final[dict[str, VirtualTcp]] = {}


def _connect(address: tuple[str, int], *arguments: Any, **options: Any) -> Any:
    host = _hosts.get(address[0])
    return _real(address, *arguments, **options) if host is None else host.connect()


class ListeningTcp:
    """A port of this computer; a :class:`HostEnd`.

    Args:
        port: Its number; 0: any that is free.

    Attributes:
        address: Host and port.
    """

    def __init__(self, port: int = 0) -> None:
        self._listener: socket.socket | None = socket.create_server(("127.0.0.1", port))
        self._listener.setblocking(False)
        self.address: tuple[str, int] = self._listener.getsockname()
        self._client: socket.socket | None = None

    @property
    def files(self) -> list[int]:
        """Descriptors worth waiting for."""
        return [one.fileno() for one in (self._listener, self._client) if one is not None]

    def look(self) -> tuple[bool, bytes]:
        """See ``HostEnd``."""
        anew, data = False, b""
        if self._listener is not None:
            with contextlib.suppress(BlockingIOError):
                client, _ = self._listener.accept()
                self._hang_up()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._client, anew = client, True
        if self._client is not None:
            try:
                data = self._client.recv(_MOST)
                if not data:
                    self._hang_up()
            except BlockingIOError:
                pass
            except OSError:
                self._hang_up()
        return anew, data

    def give(self, data: bytes) -> bool:
        """See ``HostEnd``; a client that reads nothing until its buffers are full is cut off."""
        if self._client is None:
            return False
        try:
            self._client.sendall(data)
        except OSError:
            self._hang_up()
            return False
        return True

    def listen(self, is_on: bool) -> None:
        """See ``HostEnd``."""
        if is_on and self._listener is None:
            self._listener = socket.create_server(self.address)
            self._listener.setblocking(False)
        elif not is_on:
            self.close()

    def close(self) -> None:
        """Close everything."""
        self._hang_up()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
