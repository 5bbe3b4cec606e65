"""A network between a device and the flight computer, by TCP (``tcp_ends``) or UDP (``udp_ends``).

What is sent arrives whole and in order; by TCP, or the connection breaks.
"""

from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from hil_sim.faults import NEVER, NO_FAULTS, DeviceFaults, FaultKind


class NetworkDevice(Protocol):
    """A device that has a port."""

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
        """Whether there is a new client since the last call, and what came from it."""

    def give(self, data: bytes) -> bool:
        """Hand over bytes; False without a client."""

    def listen(self, is_on: bool) -> None:
        """Take clients from now on, or lose the one that there is and take no others."""


class NetworkBus:
    """A network with one device on it, which has one client at a time: a new one takes the place of the one before.

    Args:
        end: The flight computer's end.
    """

    def __init__(self, end: HostEnd) -> None:
        self.to_host = self.to_device = 0  # bytes
        self._end = end
        self._device: NetworkDevice | None = None
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

    def add(self, device: NetworkDevice) -> None:
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
