"""Timers and supply of a twin that does things of its own accord."""

from collections import deque
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from hil_sim.faults import NEVER, DeviceFaults

_SUPPLY = "supply"


class Latency:
    """From a sample to the first bit of its message: a fixed part, and a random one of an exponential law.

    Args:
        fixed_ns: The fixed part.
        jitter_ns: Mean of the random one.
        seed: Of that, and of a device's other random numbers: ``rng``.
    """

    def __init__(self, fixed_ns: int, jitter_ns: int, *seed: int) -> None:
        self._fixed_ns, self._jitter_ns = fixed_ns, jitter_ns
        self.rng = np.random.default_rng(seed)

    def draw_ns(self) -> int:
        """That of the next message."""
        return self._fixed_ns + round(self._jitter_ns * float(self.rng.standard_exponential()))


class PoweredTwin:
    """It is powered up at ``start_ns``, and off while its faults say so.

    Args:
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        faults: What breaks.

    Attributes:
        due_ns: When it next does something of its own accord.
    """

    _outside: ClassVar[frozenset[str]] = frozenset()  # timers of what happens around the device, on or off

    def __init__(self, start_ns: int, faults: DeviceFaults) -> None:
        self._faults = faults
        self._is_faulty = bool(faults)  # at any time
        self._start_ns = start_ns
        self._timers: dict[str, tuple[int, Callable[[int], None]]] = {}
        self.due_ns = NEVER
        self._supply = deque([(start_ns, self._gain_power)])
        for cycle in faults.power_cycles():
            self._supply += [(cycle.down_ns, self._lose_power), (cycle.up_ns, self._gain_power)]
        self._next_supply()

    def act(self, until_ns: int) -> None:
        """Do, in order, everything that is due at ``until_ns``."""
        while self.due_ns <= until_ns:
            name = next(name for name, timer in self._timers.items() if timer[0] == self.due_ns)
            due_ns, action = self._timers.pop(name)
            self._refresh()
            self._acts(name)
            action(due_ns)

    # For subclasses

    def _take_over(self, other: "PoweredTwin") -> None:
        """Have the faults of another table of the same device, too."""
        kinds, windows = self._faults.possible, (*self._faults.windows, *other._faults.windows)
        self._faults = DeviceFaults(self._faults.device, windows).require(*kinds)
        self._is_faulty = bool(windows)
        for cycle in other._faults.power_cycles():
            self._supply += [(cycle.down_ns, self._lose_power), (cycle.up_ns, self._gain_power)]
        self._supply = deque(sorted(self._supply, key=lambda one: one[0]))

    def _gain_power(self, now_ns: int) -> None:
        """Begin with the reset values."""
        raise NotImplementedError

    def _lose_power(self, now_ns: int) -> None:
        """Stop: timers but those around the device are gone."""
        del now_ns
        self._timers = {n: timer for n, timer in self._timers.items() if n == _SUPPLY or n in self._outside}
        self._refresh()

    def _acts(self, name: str) -> None:
        """A timer's action follows."""

    def _at(self, name: str, due_ns: int, action: Callable[[int], None]) -> None:
        """Set (or move) the timer ``name``."""
        before = self._timers.get(name)
        self._timers[name] = (due_ns, action)
        if due_ns <= self.due_ns:
            self.due_ns = due_ns
        elif before is not None and before[0] == self.due_ns:
            self._refresh()

    def _stop(self, name: str) -> None:
        if self._timers.pop(name, None) is not None:
            self._refresh()

    def _seconds(self, now_ns: int) -> float:
        """Mission time."""
        return (now_ns - self._start_ns) * 1e-9

    def _is_silent(self, now_ns: int) -> bool:
        return self._is_faulty and self._faults.is_away(now_ns)

    def _next_supply(self) -> None:
        due_ns, action = self._supply.popleft() if self._supply else (NEVER, self._lose_power)
        if due_ns < NEVER:
            self._at(_SUPPLY, due_ns, lambda now_ns: self._switch(action, now_ns))

    def _switch(self, action: Callable[[int], None], now_ns: int) -> None:
        self._next_supply()
        action(now_ns)

    def _refresh(self) -> None:
        self.due_ns = min([timer[0] for timer in self._timers.values()], default=NEVER)
