"""Real-time loop: advances a mission with the clock and serves its bus ends."""

import select
from collections.abc import Callable
from typing import Final, Protocol

from hil_sim.buses.ports import Ports

_LONGEST_NAP_NS: Final = 5_000_000
_SHORTEST_NAP_S: Final = 50e-6  # events closer than this go out together


class Advancing(Protocol):
    """Object advanced by the loop: ``hil_sim.mission.Mission``, or a smaller one in a test."""

    @property
    def end_ns(self) -> int:
        """Its end, ``CLOCK_MONOTONIC`` ns."""

    @property
    def finished(self) -> bool:
        """Whether it has been advanced to its end."""

    def advance(self, now_ns: int) -> None:
        """Advance plant and twins to ``now_ns``."""


class MissionServer:
    """Serves a mission on open ports.

    Args:
        ports: Where its buses end.
        clock: ``CLOCK_MONOTONIC``, ns.

    Attributes:
        late_max_ns: Largest lateness of the loop.
        turns: Number of loop iterations.
    """

    def __init__(self, ports: Ports, clock: Callable[[], int]) -> None:
        self.late_max_ns = 0
        self.turns = 0
        self._ports = ports
        self._clock = clock

    def run(self, mission: Advancing, stop: Callable[[], bool] = lambda: False) -> None:
        """Keep ``mission``, attached to the buses of these ports, in step with the clock till it ends or ``stop()``."""
        clock, ports = self._clock, list(self._ports.ports.values())
        due_ns = clock()
        while not mission.finished and not stop():
            for port in ports:
                port.receive()
            now_ns = min(clock(), mission.end_ns)
            self.turns += 1
            self.late_max_ns = max(self.late_max_ns, now_ns - due_ns)
            mission.advance(now_ns)
            for port in ports:
                port.advance(now_ns)
            due_ns = min(now_ns + _LONGEST_NAP_NS, *(port.due_ns for port in ports))
            files = [file for port in ports for file in port.files]
            select.select(files, [], [], max((due_ns - clock()) * 1e-9, _SHORTEST_NAP_S))

    def summary(self) -> dict[str, float | dict[str, int]]:
        """What the loop did, and by bus what was done and lost there."""
        counts = {name: port.counts() for name, port in self._ports.ports.items()}
        return {"turns": self.turns, "late_max_ms": self.late_max_ns * 1e-6, **counts}
