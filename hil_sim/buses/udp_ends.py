"""The flight computer's end of UDP, for ``NetworkBus``: a real socket in every tier, for nothing of it waits.

In T0 ``socket.getaddrinfo`` finds the simulated hosts by their names. A client is who sends; one whose datagrams come
from another address is a new one.
"""

import contextlib
import socket
from typing import Any, Final

_MOST: Final = 65_536
_real: Final = socket.getaddrinfo
_hosts: Final[dict[str, tuple[str, int]]] = {}


def _found(host: Any, *arguments: Any, **options: Any) -> Any:
    if host in _hosts:
        return [(socket.AF_INET, socket.SOCK_DGRAM, 0, "", _hosts[host])]
    return _real(host, *arguments, **options)


class UdpEnd:
    """A port of this computer; a ``HostEnd``.

    Args:
        host: The name by which this process finds it; "": by its address alone.

    Attributes:
        address: Host and port.
    """

    def __init__(self, host: str = "") -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.address: tuple[str, int] = self._socket.getsockname()
        self._client: tuple[str, int] | None = None
        self._is_on = True
        self._host = host
        if host:
            _hosts[host] = self.address
            socket.getaddrinfo = _found

    @property
    def files(self) -> list[int]:
        """Descriptors worth waiting for."""
        return [self._socket.fileno()]

    def look(self) -> tuple[bool, bytes]:
        """See ``HostEnd``: a datagram."""
        try:
            data, client = self._socket.recvfrom(_MOST)
        except OSError:  # none is there; or an earlier one found nobody
            return False, b""
        if not self._is_on:
            return False, b""
        anew, self._client = client != self._client, client
        return anew, data

    def give(self, data: bytes) -> bool:
        """See ``HostEnd``: a datagram; one for which the client's buffer has no room is lost without notice."""
        if self._client is None or not self._is_on:
            return False
        with contextlib.suppress(OSError):
            self._socket.sendto(data, self._client)
        return True

    def listen(self, is_on: bool) -> None:
        """See ``HostEnd``: the client stays, its datagrams are lost."""
        self._is_on = is_on

    def close(self) -> None:
        """Close it; with the last named one ``socket.getaddrinfo`` is Python's own again."""
        self._socket.close()
        _hosts.pop(self._host, None)
        if not _hosts:
            socket.getaddrinfo = _real
