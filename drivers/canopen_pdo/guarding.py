"""Node guarding (CiA 301, 7.2.8.3.2.1): the master polls a node that has no heartbeat.

Every guard time a remote frame goes to 700h + node, and the node answers with its state and a toggle bit that
alternates between answers. An answer whose bit did not toggle does not count: some controllers answer remote frames
from a buffer while their program has stopped. After a request without an answer either bit is accepted, because the
request or the answer may have been lost.
"""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import ConfigurationError

TOGGLE = 0x80


@dataclass(frozen=True)
class GuardConfig:
    """How a node without heartbeat is guarded.

    Attributes:
        node: Node number.
        guard_time_ms: Time between two requests (100Ch).
        life_time_factor: Requests without a valid answer after which the node is lost (100Dh).
    """

    node: int
    guard_time_ms: int = 100
    life_time_factor: int = 3

    def __post_init__(self) -> None:
        if not 1 <= self.guard_time_ms <= 0xFFFF:
            raise ConfigurationError(f"node {self.node}: guard_time_ms = {self.guard_time_ms}: use 1..65535")
        if not 2 <= self.life_time_factor <= 0xFF:
            raise ConfigurationError(
                f"node {self.node}: life_time_factor = {self.life_time_factor}: use 2..255, an answer may be lost"
            )


class Guard:
    """Sends guarding requests to one node and checks its answers.

    Args:
        config: Guard time and life time factor.
        ask: Sends the remote frame.

    Attributes:
        config: The same.
        unanswered: Requests since the last valid answer.
    """

    def __init__(self, config: GuardConfig, ask: Callable[[], None]) -> None:
        self.config = config
        self.unanswered = 0
        self._ask = ask
        self._due_ns = 0
        self._waiting = False
        self._expected: int | None = None  # the bit of the next answer; None: either

    def begin(self, now_ns: int) -> None:
        """The node was set up: start sending requests. The first toggle bit may have either value."""
        self.unanswered = 0
        self._due_ns = now_ns
        self._waiting = False
        self._expected = None

    @property
    def due_ns(self) -> int:
        """When the next request is sent."""
        return self._due_ns

    def poll(self, now_ns: int) -> bool:
        """Send a request when it is due. False: ``life_time_factor`` requests had no valid answer, the node is lost.

        Requests are counted instead of time, so that a pause of the host does not count as a loss of the node.
        """
        if now_ns < self._due_ns:
            return True
        if self.unanswered >= self.config.life_time_factor:
            return False
        period_ns = self.config.guard_time_ms * 1_000_000
        self._due_ns = max(self._due_ns + period_ns, now_ns + period_ns // 2)
        if self._waiting:
            self._expected = None
        self._waiting = True
        self.unanswered += 1
        self._ask()
        return True

    def answered(self, data: bytes) -> bool:
        """Take an answer; True if its toggle bit is right."""
        toggle = data[0] & TOGGLE
        alive = self._expected is None or toggle == self._expected
        self._expected = toggle ^ TOGGLE
        self._waiting = False
        if alive:
            self.unanswered = 0
        return alive
