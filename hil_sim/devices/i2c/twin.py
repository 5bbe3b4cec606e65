"""A slave of registers on I2C: address pointer, power, and what a fault does to a transfer.

A transfer is an instant. A read or write steps the pointer by one, unless a device says otherwise.
"""

import errno
import os
from abc import ABC, abstractmethod
from collections import deque
from typing import Final

from hil_sim.faults import DeviceFaults, FaultKind, PowerCycle, garbled

LAZY_NS: Final = 50_000_000
POWER_KINDS: Final = (
    *(FaultKind.OFF, FaultKind.RESET, FaultKind.SILENT, FaultKind.INTERMITTENT),
    *(FaultKind.GARBAGE, FaultKind.NACK, FaultKind.TIMEOUT),
)
"""Faults that any of them can have."""


class I2cTwin(ABC):
    """One slave.

    Args:
        address: 7-bit address.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        faults: What breaks.
        kinds: Faults that it can have.

    Raises:
        FaultError: a fault that it cannot have.
    """

    def __init__(self, address: int, start_ns: int, faults: DeviceFaults, kinds: tuple[FaultKind, ...]) -> None:
        self.address = address
        self._faults, self._is_faulty = faults.require(*kinds), bool(faults)
        self._rng = faults.rng()
        self._start_ns = self._settled_ns = start_ns
        self._cycles = deque(faults.power_cycles())
        self._off_until_ns = start_ns
        self._pointer = 0

    @abstractmethod
    def _power_up(self, now_ns: int) -> None:
        """Registers have their reset values."""

    def _lose_power(self, cycle: PowerCycle) -> None:
        self._power_up(cycle.up_ns)

    @abstractmethod
    def _run(self, until_ns: int) -> None:
        """Do what is due until then."""

    @abstractmethod
    def _read(self, register: int) -> int:
        """A byte."""

    @abstractmethod
    def _write(self, register: int, value: int, now_ns: int) -> None:
        """A byte written."""

    def _following(self, register: int) -> int:
        """The pointer after a byte read."""
        return (register + 1) & 0xFF

    def _point(self, register: int) -> None:
        self._pointer = register

    def advance(self, now_ns: int) -> None:
        """Time goes on."""
        if now_ns - self._settled_ns >= LAZY_NS:
            self._settle(now_ns)

    def _settle(self, now_ns: int) -> None:
        while self._cycles and self._cycles[0].down_ns <= now_ns:
            cycle = self._cycles.popleft()
            self._run(cycle.down_ns)
            self._off_until_ns = cycle.up_ns
            self._pointer = 0
            self._lose_power(cycle)
        if now_ns >= self._off_until_ns:
            self._run(now_ns)
        self._settled_ns = max(now_ns, self._settled_ns)

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """One transaction: START, ``write``, repeated START when ``read_count`` > 0, that many bytes, STOP.

        Raises:
            OSError: EREMOTEIO when nothing acknowledges; the errno of a ``nack`` fault; ETIMEDOUT.
        """
        self._settle(now_ns)
        nack = self._faults.active(FaultKind.NACK, now_ns) if self._is_faulty else None
        away = self._is_faulty and self._faults.is_away(now_ns)
        if nack is not None or away or address != self.address or now_ns < self._off_until_ns:
            code = int(nack.value) if nack is not None and nack.value else errno.EREMOTEIO
            raise OSError(code, os.strerror(code))
        answer = self._exchange(write, read_count, now_ns)
        if not self._is_faulty:
            return answer
        if self._faults.active(FaultKind.TIMEOUT, now_ns) is not None:
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
        return answer if self._faults.active(FaultKind.GARBAGE, now_ns) is None else garbled(answer, self._rng)

    def _exchange(self, write: bytes, read_count: int, now_ns: int) -> bytes:
        if write:
            self._point(write[0])
            for byte in write[1:]:
                self._write(self._pointer, byte, now_ns)
                self._pointer = (self._pointer + 1) & 0xFF
        answer = bytearray()
        for _ in range(read_count):
            answer.append(self._read(self._pointer))
            self._pointer = self._following(self._pointer)
        return bytes(answer)
