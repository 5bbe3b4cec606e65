"""Node guarding (CiA 301, 7.2.8.3.2.1): for a node that makes no heartbeat, the master asks whether it lives.

Every guard time a remote frame goes to 700h + node, and the node answers with its state and a bit that toggles from one
answer to the next. An answer whose bit did not toggle is no sign of life: some controllers answer remote frames out of
a buffer while the program behind them is dead. Only after a question without an answer either bit is right, for the
question may have been lost, or the answer.
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
        guard_time_ms: Time between two questions (100Ch).
        life_time_factor: Questions without a sign of life after which the node is lost (100Dh).
    """

    node: int
    guard_time_ms: int = 100
    life_time_factor: int = 3

    def __post_init__(self) -> None:
        if not 1 <= self.guard_time_ms <= 0xFFFF:
            raise ConfigurationError(f"node {self.node}: guard_time_ms = {self.guard_time_ms}: use 1..65535")
        if not 2 <= self.life_time_factor <= 0xFF:
            raise ConfigurationError(
                f"node {self.node}: life_time_factor = {self.life_time_factor}: use 2..255, so that one may be lost"
            )


class Guard:
    """Questions to one node, and what its answers are worth.

    Args:
        config: When to ask, when to give up.
        ask: Sends the remote frame.

    Attributes:
        config: The same.
        unanswered: Questions since the last sign of life.
    """

    def __init__(self, config: GuardConfig, ask: Callable[[], None]) -> None:
        self.config = config
        self.unanswered = 0
        self._ask = ask
        self._due_ns = 0
        self._waiting = False
        self._expected: int | None = None  # the bit of the next answer; None: either

    def begin(self, now_ns: int) -> None:
        """The node was set up: ask from now on. Whether it has been guarded before is not known."""
        self.unanswered = 0
        self._due_ns = now_ns
        self._waiting = False
        self._expected = None

    def poll(self, now_ns: int) -> bool:
        """Ask, when it is time. False: enough questions have had no answer, the node is lost.

        Questions are counted and not time, so that a host that did not ask for a while accuses nobody.
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
        """An answer; whether it is a sign of life."""
        toggle = data[0] & TOGGLE
        alive = self._expected is None or toggle == self._expected
        self._expected = toggle ^ TOGGLE
        self._waiting = False
        if alive:
            self.unanswered = 0
        return alive
