"""What every twin at the end of a serial line has in common: its supply, its timers, its connector."""

from collections import deque
from collections.abc import Callable
from typing import ClassVar, Final

from hil_sim.devices.serial_wire import LineFormat, Transmit
from hil_sim.faults import INPUT_KINDS, NEVER, DeviceFaults, FaultKind, garbled

_SUPPLY = "supply"

POLLED_KINDS: Final = (FaultKind.SATURATED, FaultKind.SLOW, *INPUT_KINDS)
"""Faults of a load cell that speaks when it is spoken to."""


class SerialTwin:
    """Base of the serial twins; it is powered up at ``start_ns``.

    Args:
        line: Speed and format it comes up with.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        faults: What breaks; ``off``, ``reset``, ``silent``, ``intermittent``, ``garbage`` are applied here.
        extra_faults: Kinds that the subclass applies itself.

    Raises:
        FaultError: a fault that this device cannot have.
    """

    _outside: ClassVar[frozenset[str]] = frozenset()  # timers of what happens around the device, on or off

    def __init__(
        self, line: LineFormat, start_ns: int, faults: DeviceFaults, extra_faults: tuple[FaultKind, ...] = ()
    ) -> None:
        self.line = line
        self.powered = False
        self._faults = faults.require(
            FaultKind.OFF,
            FaultKind.RESET,
            FaultKind.SILENT,
            FaultKind.INTERMITTENT,
            FaultKind.GARBAGE,
            *extra_faults,
        )
        self._garbage = faults.rng()
        self._start_ns = start_ns
        self._transmit: Transmit | None = None
        self._timers: dict[str, tuple[int, Callable[[int], None]]] = {}
        self._due_ns = NEVER
        self._until_ns = start_ns
        self._supply = deque([(start_ns, self._supply_on)])
        for cycle in faults.power_cycles():
            self._supply += [(cycle.down_ns, self._supply_off), (cycle.up_ns, self._supply_on)]
        self._next_supply()

    @property
    def due_ns(self) -> int:
        """When it next does something of its own accord."""
        return self._due_ns

    def connect(self, transmit: Transmit) -> None:
        """Give it the line."""
        self._transmit = transmit

    def act(self, until_ns: int) -> None:
        """Do, in order, everything that is due at ``until_ns``."""
        self._until_ns = max(until_ns, self._until_ns)
        while self._due_ns <= until_ns:
            name = min(self._timers, key=lambda key: self._timers[key][0])
            due_ns, action = self._timers.pop(name)
            self._refresh()
            action(due_ns)

    def receive(self, byte: int, now_ns: int) -> None:
        """A character has ended."""
        if self.powered and not self._is_silent(now_ns):
            self._on_byte(byte, now_ns)

    def restart(self, now_ns: int) -> None:
        """Interrupt the supply for an instant."""
        self._lose_power(now_ns)
        self._gain_power(now_ns)

    # For subclasses

    def _power_up(self, now_ns: int) -> None:
        """Reset values; set the timers of what starts by itself. Subclasses override."""

    def _on_byte(self, byte: int, now_ns: int) -> None:
        """A character for a device that is on. Subclasses that listen override."""

    def _at(self, name: str, due_ns: int, action: Callable[[int], None]) -> None:
        """Set (or move) the timer ``name``."""
        before = self._timers.get(name)
        self._timers[name] = (due_ns, action)
        if due_ns <= self._due_ns:
            self._due_ns = due_ns
        elif before is not None and before[0] == self._due_ns:
            self._refresh()

    def _stop(self, name: str) -> None:
        if self._timers.pop(name, None) is not None:
            self._refresh()

    def _send(self, data: bytes, ready_ns: int) -> int:
        """Send; returns when the last bit ends. With an open connector nothing arrives."""
        if self._transmit is None or self._is_silent(ready_ns):
            return ready_ns + round(len(data) * self.line.character_ns)
        if self._faults.active(FaultKind.GARBAGE, ready_ns) is not None:
            data = garbled(data, self._garbage)
        return self._transmit(data, ready_ns)

    def _late(self, now_ns: int) -> int:
        """When an answer due at ``now_ns`` is given, by a device that is slow."""
        slow = self._faults.active(FaultKind.SLOW, now_ns)
        return now_ns if slow is None else now_ns + round(slow.value * 1e9)

    def _seconds(self, now_ns: int) -> float:
        """Mission time."""
        return (now_ns - self._start_ns) * 1e-9

    def _is_silent(self, now_ns: int) -> bool:
        return bool(self._faults) and self._faults.is_away(now_ns)

    # Supply

    def _next_supply(self) -> None:
        if self._supply:
            due_ns, action = self._supply.popleft()
            if due_ns < NEVER:
                self._at(_SUPPLY, due_ns, action)

    def _supply_on(self, now_ns: int) -> None:
        self._next_supply()
        self._gain_power(now_ns)

    def _supply_off(self, now_ns: int) -> None:
        self._lose_power(now_ns)
        self._next_supply()

    def _gain_power(self, now_ns: int) -> None:
        self.powered = True
        self._power_up(now_ns)

    def _lose_power(self, now_ns: int) -> None:
        del now_ns
        self.powered = False
        self._timers = {n: timer for n, timer in self._timers.items() if n == _SUPPLY or n in self._outside}
        self._refresh()

    def _refresh(self) -> None:
        self._due_ns = min([timer[0] for timer in self._timers.values()], default=NEVER)
