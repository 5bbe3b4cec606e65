"""Serial buses: one twin at the end of a line, its faults, and the flight computer's end in this process or on a pty.

``SerialBus`` is the medium; a mission plugs its twin in and advances it, as with the other buses. Tier T0 is
``VirtualSerial``: a port object on the virtual clock that has what ``drivers.ports.SerialPort`` asks for, and
``install_serial`` lets ``serial.Serial`` open it by path. Tier T1 is ``PtySerial``: the same twin on a pseudo-terminal
for any program. A pty has no parity, no modem lines and no speed of its own, but the speed that its user sets is seen
here and honoured.

What can break on the line, between ``start_s`` and ``end_s`` (what can break in the twin is in ``hil_sim.faults``):

===============  =====================================================================================================
kind             effect
===============  =====================================================================================================
``byte_loss``    each character, either way, is lost with probability ``value``
``byte_garble``  each character, either way, has one bit inverted with probability ``value``
``unplug``       the adapter is pulled out of the flight computer: its port dies and must be opened again afterwards
===============  =====================================================================================================
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple, Protocol

import numpy as np

from hil_sim.devices.serial_wire import Heard, LineFormat, SerialDevice, SerialWire
from hil_sim.faults import NEVER, FaultError

_USB_PACKET: Final = 62  # characters in a full packet of an FTDI adapter, after two status bytes


class LineFaultKind(StrEnum):
    """What can break on a serial line. The module's table says what each does."""

    BYTE_LOSS = "byte_loss"
    BYTE_GARBLE = "byte_garble"
    UNPLUG = "unplug"


@dataclass(frozen=True, slots=True)
class LineFault:
    """One fault of a serial line; fields as of ``hil_sim.faults.Fault``.

    Args:
        kind: What happens.
        device: Name of the bus it happens to.
        start_s: Mission time of its beginning, s.
        end_s: Mission time of its end, s.
        value: Probability for one character.

    Raises:
        FaultError: an unknown kind, or times or a value that make no sense for it.
    """

    kind: LineFaultKind
    device: str
    start_s: float
    end_s: float = math.inf
    value: float = 0.0

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "kind", LineFaultKind(self.kind))
        except ValueError:
            known = ", ".join(LineFaultKind)
            raise FaultError(f"No fault of a serial line is called {self.kind!r}; name one of: {known}.") from None
        if not (math.isfinite(self.start_s) and 0.0 <= self.start_s < self.end_s):
            raise FaultError(
                f"Fault {self.kind} of {self.device} lasts from {self.start_s} s to {self.end_s} s; "
                "give 0 <= start_s < end_s."
            )
        if self.kind is not LineFaultKind.UNPLUG and not 0.0 < self.value <= 1.0:
            raise FaultError(f"Fault {self.kind} of {self.device} needs `value`, a probability above 0 and up to 1.")


class _Window(NamedTuple):
    kind: LineFaultKind
    start_ns: int
    end_ns: int
    value: float


class SerialLink(Protocol):
    """The flight computer's serial port, seen from the line."""

    @property
    def line(self) -> LineFormat | None:
        """Speed and format of the open port; None when nobody has it open."""

    def take(self) -> bytes:
        """Characters the flight computer sent since the last call."""

    def give(self, data: bytes) -> None:
        """Characters it received."""

    def unplug(self) -> None:
        """The adapter is pulled out."""

    def plug(self) -> None:
        """The adapter is back."""


class SerialBus:
    """A line with the flight computer at one end and a device at the other, or several stations on an RS-485 line.

    Stations do not hear each other, and when two talk at once the flight computer gets both, character by character.

    Args:
        link: The flight computer's end.
        seed: Of what the faults hit.
        latency_ns: Latency timer of a USB adapter: what arrived is handed over when it expires, or by whole packets of
            62 characters before that. FTDI's is 16 ms, and 1 ms in low-latency mode. 0: no such adapter.
    """

    def __init__(self, link: SerialLink, seed: int = 0, *, latency_ns: int = 0) -> None:
        self.to_host = 0  # characters delivered
        self.to_device = 0  # characters sent
        self.lost = 0
        self.garbled = 0
        self._link = link
        self._wires: list[SerialWire] = []
        self._latency_ns = latency_ns
        self._held: list[Heard] = []  # in the USB adapter
        self._rng = np.random.default_rng([seed, 0x5E])
        self._faults: tuple[_Window, ...] = ()
        self._plugged = True
        self._now_ns = 0

    @property
    def due_ns(self) -> int:
        """When something next happens on the line, in a device or in the adapter."""
        times = [t for w in self._faults for t in (w.start_ns, w.end_ns) if t > self._now_ns]
        if self._held:
            times.append((self._now_ns // self._latency_ns + 1) * self._latency_ns)
        return min([*times, *(wire.due_ns for wire in self._wires)], default=NEVER)

    def add(self, device: SerialDevice) -> None:
        """Connect a device."""
        self._wires.append(SerialWire(device))

    def inject(self, faults: Iterable[LineFault], start_ns: int) -> None:
        """Set what breaks; mission time 0 is ``start_ns``."""
        self._faults = tuple(
            _Window(
                fault.kind,
                start_ns + round(fault.start_s * 1e9),
                NEVER if math.isinf(fault.end_s) else start_ns + round(fault.end_s * 1e9),
                fault.value,
            )
            for fault in faults
        )

    def advance(self, now_ns: int) -> None:
        """Send what the flight computer sent since the last call, let devices and line go on, deliver what arrived."""
        if not self._now_ns:
            self._now_ns = now_ns
        sent = self._link.take()
        host = self._link.line if self._plugged else None  # asked afterwards: the port may just have been opened
        if self._faults:
            sent = bytes(c.byte for c in self._through_faults([Heard(self._now_ns, byte) for byte in sent]))
        for wire in self._wires:
            wire.host = host
            wire.send(sent, self._now_ns)
        self.to_device += len(sent)
        while (stop_ns := self._next_plugging(now_ns)) is not None:
            self._go_on(stop_ns)
            self._set_plugged(self._active(LineFaultKind.UNPLUG, stop_ns) is None)
        self._go_on(now_ns)

    def _go_on(self, now_ns: int) -> None:
        arrived = sorted(character for wire in self._wires for character in wire.advance(now_ns))
        self._now_ns = now_ns
        if self._faults:
            arrived = self._through_faults(arrived)
        if self._latency_ns:
            arrived = self._through_adapter(arrived, now_ns)
        if arrived:
            self.to_host += len(arrived)
            self._link.give(bytes(character.byte for character in arrived))

    def _through_adapter(self, arrived: list[Heard], now_ns: int) -> list[Heard]:
        self._held += arrived
        expiry_ns = now_ns // self._latency_ns * self._latency_ns
        ready = sum(character.end_ns <= expiry_ns for character in self._held)
        ready += (len(self._held) - ready) // _USB_PACKET * _USB_PACKET
        handed_over, self._held = self._held[:ready], self._held[ready:]
        return handed_over

    def _next_plugging(self, until_ns: int) -> int | None:
        times = (t for w in self._faults if w.kind is LineFaultKind.UNPLUG for t in (w.start_ns, w.end_ns))
        return min((t for t in times if self._now_ns < t <= until_ns), default=None)

    def _set_plugged(self, plugged: bool) -> None:
        if plugged == self._plugged:
            return
        self._plugged = plugged
        if plugged:
            self._link.plug()
        else:
            self._link.unplug()
            self._held.clear()
            for wire in self._wires:
                wire.cut()
                wire.host = None

    def _through_faults(self, characters: list[Heard]) -> list[Heard]:
        kept = []
        for character in characters:
            loss = self._active(LineFaultKind.BYTE_LOSS, character.end_ns)
            if loss is not None and self._rng.random() < loss.value:
                self.lost += 1
                continue
            garble = self._active(LineFaultKind.BYTE_GARBLE, character.end_ns)
            if garble is not None and self._rng.random() < garble.value:
                self.garbled += 1
                character = Heard(character.end_ns, character.byte ^ 1 << int(self._rng.integers(8)))  # noqa: PLW2901
            kept.append(character)
        return kept

    def _active(self, kind: LineFaultKind, now_ns: int) -> _Window | None:
        for window in self._faults:
            if window.kind is kind and window.start_ns <= now_ns < window.end_ns:
                return window
        return None
