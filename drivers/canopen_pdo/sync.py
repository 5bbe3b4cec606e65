"""Numbers SYNC messages: their counter repeats after 240, so host time decides how often it went round unseen."""

from dataclasses import dataclass
from typing import NamedTuple

from drivers.errors import ConfigurationError

ROUND = 240
SLACK = 12  # SYNC periods by which arrival time and counter may differ before we say that the producer began anew
LATE = 3.0  # SYNC periods by which a SYNC is later than its number says: the producer stood still


@dataclass(frozen=True)
class SyncConfig:
    """The SYNC producer.

    Attributes:
        name: Channel of the CAN_SYNC rows.
        period_ms: SYNC period, ms.
    """

    name: str = "can_sync"
    period_ms: float = 5.0

    def __post_init__(self) -> None:
        if not self.period_ms > 0.0:
            raise ConfigurationError(f"{self.name}: period_ms = {self.period_ms}: give the SYNC period, above 0")

    @property
    def period_ns(self) -> int:
        """SYNC period, ns."""
        return round(self.period_ms * 1e6)


class SyncStep(NamedTuple):
    """A SYNC numbered. ``lost`` SYNCs before it did not arrive; ``restarted``: the producer's count began anew."""

    tick: int
    lost: int
    restarted: bool


class SyncCounter:
    """SYNC numbers from SYNC counters.

    A SYNC with counter c has a number congruent to c - 1 modulo 240; the first one seen is given c - 1. (Which round of
    the producer's own count that was, the coded pulses tell.) A counter of 0 means that the SYNC carries none: then
    host time alone says how many were lost.

    Attributes:
        period_ns: SYNC period.
        pause_ns: How long the producer stood still before the SYNC before the last one, where it did; else 0. Only the
            next one tells: after a host that read late, it comes early.
    """

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.pause_ns = 0
        self._tick: int | None = None
        self._host_ns = 0
        self._late_ns = 0  # by which the last SYNC came later than its number says

    @property
    def tick(self) -> int | None:
        """Number of the last SYNC, None before the first."""
        return self._tick

    @property
    def host_ns(self) -> int:
        """When the last SYNC arrived."""
        return self._host_ns

    def silence(self, host_ns: int) -> float:
        """SYNC periods from the last SYNC to ``host_ns``; 0 before the first."""
        return 0.0 if self._tick is None else (host_ns - self._host_ns) / self.period_ns

    def advance(self, counter: int, host_ns: int, sent_ns: int | None = None) -> SyncStep:
        """Number the next SYNC.

        Args:
            counter: Its counter, 1..240, or 0.
            host_ns: When it arrived.
            sent_ns: When it must have been sent, where that is known to be well before it arrived.
        """
        if self._tick is None:
            self._tick, self._host_ns = max(counter - 1, 0), host_ns
            return SyncStep(self._tick, 0, False)
        elapsed = self.silence(host_ns if sent_ns is None else sent_ns)
        if counter == 0:
            ahead = max(1, round(elapsed))
            restarted = False
        else:
            least = (counter - 1 - self._tick - 1) % ROUND + 1  # 1..240
            ahead = least + ROUND * round((elapsed - least) / ROUND)
            restarted = ahead < 1 or (ahead > 1 and abs(elapsed - ahead) > SLACK)
            ahead = max(ahead, least)
        self.pause_ns = self._late_ns if elapsed > 0.5 * ahead else 0
        late = elapsed - ahead
        self._late_ns = round(late * self.period_ns) if late > LATE and not restarted else 0
        self._tick += ahead
        self._host_ns = host_ns
        return SyncStep(self._tick, 0 if restarted else ahead - 1, restarted)
