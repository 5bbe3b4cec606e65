"""Simulated serial line: twin, line faults, and the flight computer's end in this process or on a pty.

``SerialBus`` is the medium; a mission plugs its twin in and advances it, as with the other buses. Tier T0 is
``VirtualSerial``: a port object on the virtual clock that has what ``drivers.ports.SerialPort`` asks for, and
``install_serial`` lets ``serial.Serial`` open it by path. Tier T1 is ``PtySerial``: the same twin on a pseudo-terminal
for any program. A pty has no parity, no modem lines and no speed of its own; the speed set by its user is read here and
applied.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from hil_sim.devices.serial_wire import Arrived, Heard, LineFormat, SerialStation, SerialWire
from hil_sim.faults import NEVER, NO_FAULTS, DeviceFaults, FaultKind

_LAZY_NS: Final = 50_000_000
_USB_PACKET: Final = 62  # characters in a full packet of an FTDI adapter, after two status bytes
_KEPT: Final = 65_536  # newest characters handed over, and samples ended, whose times are known


class HostLink(Protocol):
    """The flight computer's serial port, seen from the line."""

    asks: Callable[[bytes], int]
    """How many samples a message of the flight computer asks for."""

    messages: int
    """Times that the flight computer asked for one."""

    discarded: int
    """Times that it threw away what had come, as far as one can tell from here."""

    is_live: bool
    """Whether what is taken was sent a moment ago; else when the line was last looked at."""

    @property
    def line(self) -> LineFormat | None:
        """Speed and format of the open port; None when no process has it open."""

    def take(self) -> bytes:
        """Characters the flight computer sent since the last call."""

    def give(self, data: bytes) -> None:
        """Characters it received."""

    def unread(self) -> int:
        """Characters that it had received and not read when it closed its port."""

    def unplug(self) -> None:
        """The adapter is pulled out."""

    def plug(self) -> None:
        """The adapter is back."""


@runtime_checkable
class Listens(Protocol):
    """A station that hears what the others on its line send."""

    def overhear(self, data: bytes, end_ns: int) -> None:
        """Another station sends ``data``, which will have ended at ``end_ns``."""


@runtime_checkable
class Joins(Protocol):
    """A station that has the line for itself, made of several tables."""

    def join(self, other: Any) -> None:
        """Another table of the same device."""


class _Wire(SerialWire):
    """One that knows which of the device's messages are samples, and tells other stations of all of them."""

    def __init__(
        self, device: SerialStation, sample_length: Callable[[bytes], int], said: "deque[tuple[_Wire, bytes, int]]"
    ) -> None:
        self._sample_length, self._said = sample_length, said
        self._listens = device if isinstance(device, Listens) else None
        self._ends_ns: deque[int] = deque()  # of samples that may still be under way
        self._ended_ns = deque[int](maxlen=_KEPT)  # of those that are not
        super().__init__(device)

    @property
    def device(self) -> SerialStation:
        """Who hangs on it."""
        return self._device

    @property
    def agrees(self) -> bool:
        """Whether the two ends understand each other."""
        return self.host is not None and self.host.agrees_with(self._device.line)

    def under_way(self, now_ns: int) -> int:
        """Samples of which the end was not there yet at ``now_ns``."""
        while self._ends_ns and self._ends_ns[0] <= now_ns:
            self._ended_ns.append(self._ends_ns.popleft())
        return len(self._ends_ns)

    def ended_after(self, read_ns: int) -> int:
        """Samples that are not under way any more, of which the end came after ``read_ns``."""
        return sum(1 for end_ns in self._ended_ns if end_ns > read_ns)

    def _transmit(self, data: bytes, ready_ns: int) -> int:
        end_ns = super()._transmit(data, ready_ns)
        length = self._sample_length(data)
        if length == len(data):
            self._ends_ns.append(end_ns)
        elif length:
            character_ns = self._device.line.character_ns
            self._ends_ns.append(end_ns - round(len(data) * character_ns) + round(length * character_ns))
        self._said.append((self, data, end_ns))
        return end_ns

    def overhear(self, data: bytes, end_ns: int) -> None:
        """Another station sends."""
        if self._listens is not None:
            self._listens.overhear(data, end_ns)


class SerialBus:
    """A line with the flight computer at one end and a device at the other, or several stations on an RS-485 line.

    Stations hear each other if they are such that :class:`Listens`, whole messages without faults. When two talk at
    once the flight computer gets both, character by character.

    Args:
        link: The flight computer's end.
        seed: Of what the faults hit.
        latency_ns: Latency timer of a USB adapter: what arrived is handed over when it expires, or by whole packets of
            62 characters before that. FTDI's is 16 ms, and 1 ms in low-latency mode. 0: no such adapter.
    """

    def __init__(self, link: HostLink, seed: int = 0, *, latency_ns: int = 0) -> None:
        self._samples = 0
        self.to_host = 0  # characters delivered
        self.to_device = 0  # characters sent
        self.lost = 0
        self.garbled = 0
        self._link = link
        self._wires: list[_Wire] = []
        self._said = deque[tuple[_Wire, bytes, int]]()  # by stations, not passed to the others yet
        self._made: Callable[[], int] = lambda: 0
        self._made_before: int | None = None  # the port was first open
        self._discarded = False
        self._is_heard = False  # by the flight computer, when this was last looked at
        self._given_ns = deque[int](maxlen=_KEPT)  # when the newest characters handed over had been received
        self._latency_ns = latency_ns
        self._held = Arrived([], b"")  # in the USB adapter
        self._rng = np.random.default_rng([seed, 0x5E])
        self._faults = NO_FAULTS
        self._plugged = True
        self._now_ns = self._reached_ns = 0
        self._waits = False

    @property
    def samples(self) -> int:
        """That devices had to say while the flight computer had its port open; see ``add``."""
        self.look()
        self._leave_out_unread()
        return self._samples

    @property
    def questions(self) -> int:
        """Times that the flight computer asked for a sample."""
        return self._link.messages

    @property
    def due_ns(self) -> int:
        """When something next happens on the line, in a device or in the adapter."""
        times = [t for w in self._faults.windows for t in (w.start_ns, w.end_ns) if t > self._now_ns]
        if self._held.data:
            times.append((self._now_ns // self._latency_ns + 1) * self._latency_ns)
        return min([*times, *(wire.due_ns for wire in self._wires)], default=NEVER)

    def add(
        self,
        device: SerialStation,
        made: Callable[[], int] = lambda: 0,
        sample_length: Callable[[bytes], int] = lambda message: 0,
        asks: Callable[[bytes], int] | None = None,
    ) -> None:
        """Connect a device, or one more table of it.

        Args:
            device: It.
            made: Of a device that talks unasked: samples it has made. ``samples`` counts them from when the flight
                computer first had its port open at the device's speed, and had thrown away what was in it, to when it
                last had it open; those that it could not hear because something broke included, but not those of
                which the end is still under way, or was not read when it closed the port.
            sample_length: How many characters of a message make a sample; 0: it is none.
            asks: Of a device that is asked: how many samples a message of the flight computer asks for; None: each for
                one.
        """
        for wire in self._wires:
            if isinstance(wire.device, Joins):
                wire.device.join(device)
                return
        self._wires.append(_Wire(device, sample_length, self._said))
        self._made = made
        if asks is not None:
            self._link.asks = asks

    def inject(self, faults: DeviceFaults) -> None:
        """Set what breaks on the line; what can break in the twin is the twin's.

        Raises:
            FaultError: a fault that a serial line cannot have.
        """
        self._faults = faults.require(
            FaultKind.BYTE_LOSS, FaultKind.BYTE_GARBLE, FaultKind.UNPLUG, FaultKind.INTERMITTENT
        )

    def wait_for_looks(self) -> None:
        """Go on where the flight computer looks, by ``look``, or 50 ms have gathered: what comes is the same."""
        self._waits = True

    def advance(self, now_ns: int) -> None:
        """Send what the flight computer sent since the last call, let devices and line go on, deliver what arrived."""
        self._reached_ns = now_ns
        if not self._waits or now_ns - self._now_ns >= _LAZY_NS:
            self._advance(now_ns)

    def look(self) -> None:
        """The flight computer does something with its port: all is to be as it is now."""
        if self._now_ns < self._reached_ns:
            self._advance(self._reached_ns)

    def _advance(self, now_ns: int) -> None:
        if not self._now_ns:
            self._now_ns = now_ns
        self._leave_out_unread()
        if self._link.is_live:
            self._go_to(now_ns)
        sent = self._link.take()
        host = self._link.line if self._plugged else None  # asked afterwards: the port may just have been opened
        if self._faults:
            sent = self._through_faults([Heard(self._now_ns, byte) for byte in sent]).data
        for wire in self._wires:
            wire.host = host or (wire.host if sent else None)  # closing a port sends what is still in it
            wire.send(sent, self._now_ns)
            wire.host = host
        self.to_device += len(sent)
        hears = host is not None and any(wire.agrees for wire in self._wires)
        discards = bool(self._link.discarded) and not self._discarded  # pyserial does on opening
        if hears and (self._made_before is None or discards):
            self._made_before = self._made()
            self._discarded = discards
        self._go_to(now_ns)
        self._is_heard |= hears
        if hears and self._plugged and self._made_before is not None:
            there_ns = self._held.ends_ns[0] - 1 if self._held.data else now_ns
            self._samples = self._made() - self._made_before - sum(wire.under_way(there_ns) for wire in self._wires)

    def _leave_out_unread(self) -> None:
        """Where the port was closed: samples that end in characters not read came after the last read."""
        if not self._is_heard or self._link.line is not None:
            return
        self._is_heard = False
        if known := min(self._link.unread(), len(self._given_ns)):
            read_ns = self._given_ns[-known] - 1
            self._samples -= sum(wire.ended_after(read_ns) for wire in self._wires)

    def _go_to(self, now_ns: int) -> None:
        while (stop_ns := self._next_plugging(now_ns)) is not None:
            self._go_on(stop_ns)
            self._set_plugged(self._faults.active(FaultKind.UNPLUG, stop_ns) is None)
        self._go_on(now_ns)

    def _go_on(self, now_ns: int) -> None:
        each: list[Arrived] = []
        for until_ns in self._steps(now_ns):
            each += [arrived for wire in self._wires if (arrived := wire.advance(until_ns)).data]
            self._overhear()
        arrived = each[0] if len(each) == 1 else _joined(sorted(one for other in each for one in other.characters()))
        self._now_ns = now_ns
        if self._faults:
            arrived = self._through_faults(arrived.characters())
        ends_ns, data = self._through_adapter(arrived, now_ns) if self._latency_ns else arrived
        if data:
            self.to_host += len(data)
            self._given_ns.extend(ends_ns)
            self._link.give(data)

    def _through_adapter(self, arrived: Arrived, now_ns: int) -> Arrived:
        ends_ns, data = self._held.ends_ns + arrived.ends_ns, self._held.data + arrived.data
        if not data:
            return arrived
        expiry_ns = now_ns // self._latency_ns * self._latency_ns
        ready = bisect_right(ends_ns, expiry_ns)
        ready += (len(data) - ready) // _USB_PACKET * _USB_PACKET
        self._held = Arrived(ends_ns[ready:], data[ready:])
        return Arrived(ends_ns[:ready], data[:ready])

    def _steps(self, now_ns: int) -> Iterator[int]:
        """``now_ns``, and before it when one of several stations acts: what it sends may concern the others."""
        while len(self._wires) > 1 and (due_ns := min(wire.acts_ns for wire in self._wires)) < now_ns:
            yield due_ns
        yield now_ns

    def _overhear(self) -> None:
        """Tell each station what the others began to send; all of them have heard what came before it."""
        while self._said:
            sender, data, end_ns = self._said.popleft()
            for wire in self._wires:
                if wire is not sender:
                    wire.overhear(data, end_ns)

    def _next_plugging(self, until_ns: int) -> int | None:
        if not self._faults:
            return None
        windows = (w for w in self._faults.windows if w.kind is FaultKind.UNPLUG)
        times = (t for w in windows for t in (w.start_ns, w.end_ns))
        return min((t for t in times if self._now_ns < t <= until_ns), default=None)

    def _set_plugged(self, plugged: bool) -> None:
        if plugged == self._plugged:
            return
        self._plugged = plugged
        if plugged:
            self._link.plug()
        else:
            self._link.unplug()
            self._held = Arrived([], b"")
            for wire in self._wires:
                wire.cut()
                wire.host = None

    def _through_faults(self, characters: list[Heard]) -> Arrived:
        kept = []
        for character in characters:
            loss = self._faults.active(FaultKind.BYTE_LOSS, character.end_ns)
            if self._faults.is_away(character.end_ns) or (loss is not None and self._rng.random() < loss.value):
                self.lost += 1
                continue
            garble = self._faults.active(FaultKind.BYTE_GARBLE, character.end_ns)
            if garble is not None and self._rng.random() < garble.value:
                self.garbled += 1
                character = Heard(character.end_ns, character.byte ^ 1 << int(self._rng.integers(8)))  # noqa: PLW2901
            kept.append(character)
        return _joined(kept)


def _joined(characters: list[Heard]) -> Arrived:
    return Arrived([one.end_ns for one in characters], bytes([one.byte for one in characters]))
