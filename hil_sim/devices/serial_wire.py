"""The asynchronous serial line: characters take their true time, one after the other, each way on its own.

A character is a start bit, eight data bits, the lowest first, an optional parity bit and the stop bits. It is received
when its last stop bit is over. Two ends that disagree by more than 2 % in speed, or in the format, hear what a
receiver hears that samples the other's waveform in the middle of its own bits; characters with a framing or parity
error are passed on as they are, which is what a Linux tty in raw mode does.
"""

from bisect import bisect_right
from collections import deque
from functools import lru_cache
from typing import Final, NamedTuple, Protocol, runtime_checkable

from hil_sim.faults import NEVER

_SPEED_TOLERANCE: Final = 0.02  # half a bit in ten, shared between two ends and the rise times
_DATA_BITS: Final = 8


class LineFormat(NamedTuple):
    """Speed and character format of one end. ``parity`` is ``N``, ``E`` or ``O``."""

    baud_rate: int
    parity: str = "N"
    stop_bits: int = 1

    @property
    def bits(self) -> int:
        """Bit times of one character, start and stop bits included."""
        return 1 + _DATA_BITS + (self.parity != "N") + self.stop_bits

    @property
    def character_ns(self) -> float:
        """Duration of one character."""
        return self.bits * 1e9 / self.baud_rate

    def agrees_with(self, other: "LineFormat") -> bool:
        """Whether the two ends understand each other; one stop bit more or less goes unnoticed."""
        return abs(self.baud_rate / other.baud_rate - 1.0) <= _SPEED_TOLERANCE and self.parity == other.parity


class Transmit(Protocol):
    """What a device is given to send with."""

    def __call__(self, data: bytes, ready_ns: int) -> int:
        """Send ``data``, not before ``ready_ns`` nor before what was sent earlier; returns when the last bit ends."""


class SerialStation(Protocol):
    """A device at the end of a serial line."""

    @property
    def line(self) -> LineFormat:
        """Its speed and format now."""

    @property
    def due_ns(self) -> int:
        """When it next does something of its own accord; ``NEVER`` when it does not."""

    def connect(self, transmit: Transmit) -> None:
        """Give it the line."""

    def act(self, until_ns: int) -> None:
        """Do, in order, everything that is due at ``until_ns``."""

    def receive(self, byte: int, now_ns: int) -> None:
        """A character has ended."""


@runtime_checkable
class HearsPackets(Protocol):
    """A station to which single characters are nothing, but whole messages."""

    @property
    def lacks(self) -> int:
        """Characters, at least, that it has to receive before it does anything for them; one or more."""

    def gather(self, characters: "list[Heard]") -> None:
        """Receive characters, fewer than it lacks, before anything else is due."""


class Heard(NamedTuple):
    """A character, and when it was received."""

    end_ns: int
    byte: int


class Arrived(NamedTuple):
    """Characters that came one after the other: when each was received, and what they are."""

    ends_ns: list[int]
    data: bytes

    def characters(self) -> list[Heard]:
        """One by one."""
        return list(map(Heard, self.ends_ns, self.data))


NOTHING: Final = Arrived([], b"")


def waveform(data: bytes, line: LineFormat) -> list[int]:
    """Levels of the line, one entry a bit time, while ``data`` is sent without pause."""
    levels: list[int] = []
    for byte in data:
        bits = [byte >> k & 1 for k in range(_DATA_BITS)]
        if line.parity != "N":
            bits.append(sum(bits) & 1 ^ (line.parity == "O"))
        levels += [0, *bits, *([1] * line.stop_bits)]
    return levels


def hear(data: bytes, start_ns: int, sender: LineFormat, receiver: LineFormat) -> Arrived:
    """What a receiver makes of characters sent without pause.

    Args:
        data: The characters.
        start_ns: When the first start bit began.
        sender: Format they are sent with.
        receiver: Format they are read with.
    """
    if sender.agrees_with(receiver):
        return Arrived([start_ns + after_ns for after_ns in _ends_ns(len(data), sender.character_ns)], data)
    return _sampled(waveform(data, sender), start_ns, sender, receiver)


@lru_cache(maxsize=1024)
def _ends_ns(characters: int, character_ns: float) -> tuple[int, ...]:
    """When each of some characters ends, after the start of the first."""
    return tuple(round(k * character_ns) for k in range(1, characters + 1))


def _sampled(levels: list[int], start_ns: int, sender: LineFormat, receiver: LineFormat) -> Arrived:
    """Find start bits as falling edges and sample each bit in its middle; times in bits of the sender."""
    step = sender.baud_rate / receiver.baud_rate
    before_stop = _DATA_BITS + (receiver.parity != "N")
    heard = Arrived([], b"")
    edge = 0
    while True:
        while edge < len(levels) and (levels[edge] or (edge and not levels[edge - 1])):
            edge += 1
        if edge >= len(levels):
            return heard
        byte = 0
        for k in range(_DATA_BITS):
            at = int(edge + (k + 1.5) * step)
            byte |= (levels[at] if at < len(levels) else 1) << k
        stop = edge + (before_stop + 1.5) * step  # the middle of the stop bit: from here on an edge is a new start
        end = edge + (before_stop + 2) * step
        ends_ns = [*heard.ends_ns, start_ns + round(end * 1e9 / sender.baud_rate)]
        heard = Arrived(ends_ns, heard.data + bytes([byte]))
        edge = int(stop) + 1


class SerialWire:
    """The line between the host's UART and one device.

    Args:
        device: What hangs on it.
    """

    def __init__(self, device: SerialStation) -> None:
        self.host: LineFormat | None = None  # the host's port while it is open
        self._device = device
        self._hears = device if isinstance(device, HearsPackets) else None
        self._to_device: deque[Heard] = deque()
        self._to_host_ns: list[int] = []  # when each character under way to the host is received
        self._to_host = bytearray()
        self._host_idle_ns = 0
        self._device_idle_ns = 0
        device.connect(self._transmit)

    @property
    def due_ns(self) -> int:
        """When something next happens on the line or in the device."""
        return min(self.acts_ns, self._to_host_ns[0] if self._to_host_ns else NEVER)

    @property
    def acts_ns(self) -> int:
        """When something next happens in the device, or reaches it for which it may do something."""
        last = 1 if self._hears is None or not self._to_device else self._hears.lacks
        return min(self._device.due_ns, self._to_device[last - 1].end_ns if len(self._to_device) >= last else NEVER)

    def send(self, data: bytes, ready_ns: int) -> None:
        """Send characters of the host, not before ``ready_ns``; a closed port sends nothing."""
        if self.host is None or not data:
            return
        start_ns = max(ready_ns, self._host_idle_ns)
        self._host_idle_ns = start_ns + round(len(data) * self.host.character_ns)
        self._to_device += hear(data, start_ns, self.host, self._device.line).characters()

    def cut(self) -> None:
        """Lose what is under way."""
        self._to_device.clear()
        self._to_host.clear()
        self._to_host_ns.clear()

    def advance(self, now_ns: int) -> Arrived:
        """Let everything happen that is due at ``now_ns``; returns what the host's UART received."""
        inbox, device, hears = self._to_device, self._device, self._hears
        while True:
            next_ns = inbox[0].end_ns if inbox else NEVER
            until_ns = min(next_ns, now_ns)
            if device.due_ns <= until_ns:
                device.act(until_ns)
            if next_ns > now_ns:
                break
            few = 0 if hears is None else min(hears.lacks, len(inbox)) - 1
            if hears is not None and few > 0 and inbox[few - 1].end_ns < min(device.due_ns, now_ns):
                hears.gather([inbox.popleft() for _ in range(few)])
                continue
            character = inbox.popleft()
            device.receive(character.byte, character.end_ns)
        arrived = bisect_right(self._to_host_ns, now_ns)
        if not arrived:
            return NOTHING
        received = Arrived(self._to_host_ns[:arrived], bytes(self._to_host[:arrived]))
        del self._to_host_ns[:arrived], self._to_host[:arrived]
        return received

    def _transmit(self, data: bytes, ready_ns: int) -> int:
        line = self._device.line
        start_ns = max(ready_ns, self._device_idle_ns)
        self._device_idle_ns = start_ns + round(len(data) * line.character_ns)
        if self.host is not None:
            ends_ns, heard = hear(data, start_ns, line, self.host)
            self._to_host_ns += ends_ns
            self._to_host += heard
        return self._device_idle_ns
