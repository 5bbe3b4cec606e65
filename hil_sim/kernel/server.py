"""The three buses of one flight computer behind kernel interfaces, kept in step with a clock that the runner gives."""

import select
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol, Self

from hil_sim.buses import CanBus, EdgeDatagrams, I2cBus, PulseLine
from hil_sim.kernel.cuse import CuseNode
from hil_sim.kernel.i2c_node import I2cNode
from hil_sim.kernel.socketcan import SocketCan

_LONGEST_NAP_NS: Final = 5_000_000
_SHORTEST_NAP_S: Final = 50e-6
_BURST_GAP_NS: Final = 1_000_000  # CAN frames nearer than this to the next go out with it
_BURST_NS: Final = 3_000_000  # but none waits longer


class Mission(Protocol):
    """What is served: ``hil_sim.mission.Mission``, or a smaller one in a test."""

    @property
    def end_ns(self) -> int:
        """Its end, ``CLOCK_MONOTONIC`` ns."""

    @property
    def finished(self) -> bool:
        """Whether it has been advanced to its end."""

    def advance(self, now_ns: int) -> None:
        """Let world and twins go on to ``now_ns``."""


class KernelServer:
    """I2C on a CUSE node, CAN on a network interface, pulse edges as datagrams: this kernel has no GPIO lines.

    Args:
        directory: Where the flight computer binds its pulse socket, as ``sync_line.sock``.
        i2c_node: Name of the device node under ``/dev``.
        can_interface: A CAN interface that is up.
        seed: Of the stamp jitter of the pulse line.
        i2c_bit_rate: bit/s; a transfer returns when it would have left real wires.
        can_bit_rate: bit/s; frames leave one after the other as on a real bus.

    Attributes:
        late_max_ns: How late the loop ever was.
        turns: How often it went round.

    Raises:
        OSError: The kernel has no CUSE, no CAN or no such interface.
    """

    def __init__(
        self,
        directory: Path,
        *,
        i2c_node: str = "i2c-9",
        can_interface: str = "vcan0",
        seed: int = 0,
        i2c_bit_rate: int = 400_000,
        can_bit_rate: int = 500_000,
    ) -> None:
        edge_path = directory / "sync_line.sock"
        self.late_max_ns = 0
        self.turns = 0
        self.i2c = I2cBus()
        self._can_link = SocketCan(can_interface)
        self.can = CanBus(self._can_link, can_bit_rate, seed)
        self._edges = EdgeDatagrams(edge_path)
        self.pulse = PulseLine(self._edges, seed)
        self._node = CuseNode(i2c_node, I2cNode(self.i2c, i2c_bit_rate))
        self.urls = {
            "i2c_1": f"i2c:///dev/{i2c_node}",
            "can_0": f"can+socketcan://{can_interface}?bitrate={can_bit_rate}",
            "sync_line": f"gpio+unix://{edge_path}",
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Unplug everything; open files of the I2C node get ENOTCONN from here on."""
        self._node.close()
        self._can_link.close()
        self._edges.close()

    def run(self, mission: Mission, clock: Callable[[], int], stop: Callable[[], bool] = lambda: False) -> None:
        """Keep a mission, attached to these buses, in step with ``clock`` until it ends or ``stop()``."""
        files: list[Any] = [self._can_link, *self._node.files]
        due_ns = clock()
        while not mission.finished and not stop():
            self._node.receive()
            now_ns = min(clock(), mission.end_ns)
            self.turns += 1
            self.late_max_ns = max(self.late_max_ns, now_ns - due_ns)
            mission.advance(now_ns)
            self._node.advance(now_ns)
            if self.can.due_ns - now_ns > _BURST_GAP_NS or now_ns - self._can_link.oldest_ns > _BURST_NS:
                self._can_link.flush()
            due_ns = min(self.can.due_ns, self._node.due_ns, now_ns + _LONGEST_NAP_NS)
            select.select(files, [], [], max((due_ns - clock()) * 1e-9, _SHORTEST_NAP_S))

    def summary(self) -> dict[str, float]:
        """What the server itself did and lost."""
        return {
            "turns": self.turns,
            "late_max_ms": self.late_max_ns * 1e-6,
            "can_frames_dropped": self.can.dropped,
            "can_frames_not_taken": self._can_link.lost,
            "edges_without_receiver": self._edges.lost,
            "edges_seen": self.pulse.seen,
            "i2c_transfers": self.i2c.transfers,
            "i2c_refused": self.i2c.refused,
            "i2c_abandoned": self._node.abandoned,
        }
