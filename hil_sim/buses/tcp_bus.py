"""TCP between a device that listens and the flight computer, in this process (T0) or by a real socket (T1).

``TcpBus`` is the medium: what is sent arrives whole and in order, or the connection breaks. In T0
``socket.create_connection`` finds the simulated hosts by their names. The device has one client at a time: a new one
takes the place of the one before.
"""

import contextlib
import socket
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol

from hil_sim.faults import NEVER, NO_FAULTS, DeviceFaults, FaultKind

_MOST: Final = 65_536
_real: Final = socket.create_connection


class TcpDevice(Protocol):
    """A device that listens on a port."""

    @property
    def due_ns(self) -> int:
        """When it next does something of its own accord."""

    @property
    def listens(self) -> bool:
        """Whether it takes connections: it is on."""

    def plug_in(self, transmit: Callable[[bytes, int], None]) -> None:
        """Give it the network: ``transmit`` sends bytes at a time, CLOCK_MONOTONIC ns."""

    def join(self, other: Any) -> None:
        """Another table of the same device."""

    def connected(self) -> None:
        """There is a new client."""

    def receive(self, data: bytes, now_ns: int) -> None:
        """Bytes of the client."""

    def delivered(self, data: bytes) -> None:
        """Bytes that it sent have reached the client."""

    def act(self, until_ns: int) -> None:
        """Do, in order, everything that is due at ``until_ns``."""


class HostEnd(Protocol):
    """The flight computer's end."""

    def look(self) -> tuple[bool, bytes]:
        """Whether there is a new connection since the last call, and what came on it."""

    def give(self, data: bytes) -> bool:
        """Hand over bytes; False without a connection."""

    def listen(self, is_on: bool) -> None:
        """Take connections from now on, or break the one that there is and refuse others."""


class TcpBus:
    """A network with one device on it.

    Args:
        end: The flight computer's end.
    """

    def __init__(self, end: HostEnd) -> None:
        self.to_host = self.to_device = 0  # bytes
        self._end = end
        self._device: TcpDevice | None = None
        self._under_way = deque[tuple[int, bytes]]()
        self._faults = NO_FAULTS
        self._listens = False
        self._now_ns = 0

    @property
    def due_ns(self) -> int:
        """When something next happens."""
        times = [t for w in self._faults.windows for t in (w.start_ns, w.end_ns) if t > self._now_ns]
        if self._under_way:
            times.append(self._under_way[0][0])
        return min([*times, NEVER if self._device is None else self._device.due_ns])

    def add(self, device: TcpDevice) -> None:
        """Connect the device, or one more table of it."""
        if self._device is not None:
            self._device.join(device)
            return
        self._device = device
        self._listens = device.listens
        self._end.listen(self._listens)
        device.plug_in(lambda data, ready_ns: self._under_way.append((ready_ns, data)))

    def inject(self, faults: DeviceFaults) -> None:
        """Set what breaks: the cable.

        Raises:
            FaultError: a fault that a network cannot have.
        """
        self._faults = faults.require(FaultKind.UNPLUG)

    def advance(self, now_ns: int) -> None:
        """Let the device go on, and deliver what has arrived."""
        self._now_ns = now_ns
        device = self._device
        if device is None:
            return
        device.act(now_ns)
        listens = device.listens and self._faults.active(FaultKind.UNPLUG, now_ns) is None
        if listens != self._listens:
            self._listens = listens
            self._end.listen(listens)
            self._under_way.clear()
        anew, data = self._end.look()
        if anew:
            self._under_way.clear()
            device.connected()
        if data:
            self.to_device += len(data)
            device.receive(data, now_ns)
        while self._under_way and self._under_way[0][0] <= now_ns:
            _, sent = self._under_way.popleft()
            if self._end.give(sent):
                self.to_host += len(sent)
                device.delivered(sent)


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

    Attributes:
        address: Host and port.
    """

    def __init__(self) -> None:
        self._listener: socket.socket | None = socket.create_server(("127.0.0.1", 0))
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
