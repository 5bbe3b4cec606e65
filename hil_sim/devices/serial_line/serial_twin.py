"""What every twin at the end of a serial line has in common: its faults and its connector."""

from typing import Final

from hil_sim.devices.powered import PoweredTwin
from hil_sim.devices.serial_wire import LineFormat, Transmit
from hil_sim.faults import INPUT_KINDS, DeviceFaults, FaultKind, garbled

POLLED_KINDS: Final = (FaultKind.SATURATED, FaultKind.SLOW, *INPUT_KINDS)
"""Faults of a load cell that speaks when it is spoken to."""


class SerialTwin(PoweredTwin):
    """Base of the serial twins; it is powered up at ``start_ns``.

    Args:
        line: Speed and format it comes up with.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        faults: What breaks; ``off``, ``reset``, ``silent``, ``intermittent``, ``garbage`` are applied here.
        extra_faults: Kinds that the subclass applies itself.

    Raises:
        FaultError: a fault that this device cannot have.
    """

    def __init__(
        self, line: LineFormat, start_ns: int, faults: DeviceFaults, extra_faults: tuple[FaultKind, ...] = ()
    ) -> None:
        self.line = line
        self.powered = False
        faults.require(
            FaultKind.OFF, FaultKind.RESET, FaultKind.SILENT, FaultKind.INTERMITTENT, FaultKind.GARBAGE, *extra_faults
        )
        self._garbage = faults.rng()
        self._transmit: Transmit | None = None
        self._until_ns = start_ns
        super().__init__(start_ns, faults)

    def connect(self, transmit: Transmit) -> None:
        """Give it the line."""
        self._transmit = transmit

    def act(self, until_ns: int) -> None:
        """Do, in order, everything that is due at ``until_ns``."""
        self._until_ns = max(until_ns, self._until_ns)
        super().act(until_ns)

    def receive(self, byte: int, now_ns: int) -> None:
        """A character has ended."""
        if self.powered and not (self._is_faulty and self._is_silent(now_ns)):
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

    def _send(self, data: bytes, ready_ns: int) -> int:
        """Send; returns when the last bit ends. With an open connector nothing arrives."""
        if self._transmit is None or self._is_silent(ready_ns):
            return ready_ns + round(len(data) * self.line.character_ns)
        if self._is_faulty and self._faults.active(FaultKind.GARBAGE, ready_ns) is not None:
            data = garbled(data, self._garbage)
        return self._transmit(data, ready_ns)

    def _late(self, now_ns: int) -> int:
        """When an answer due at ``now_ns`` is given, by a device that is slow."""
        slow = self._faults.active(FaultKind.SLOW, now_ns)
        return now_ns if slow is None else now_ns + round(slow.value * 1e9)

    def _gain_power(self, now_ns: int) -> None:
        self.powered = True
        self._power_up(now_ns)

    def _lose_power(self, now_ns: int) -> None:
        self.powered = False
        super()._lose_power(now_ns)
