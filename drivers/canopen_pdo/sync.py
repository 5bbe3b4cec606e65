"""Unwraps the SYNC counter, which repeats after 240; host time resolves how many rounds were missed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from drivers.errors import ConfigurationError

ROUND = 240
SLACK = 12  # SYNC periods between arrival time and counter above which the producer is taken to have restarted
AT_PACE = 8  # SYNCs a period apart, after which the reader is in time
LATE = 3.0  # SYNC periods by which a SYNC is later than its number: the producer paused


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
    """A numbered SYNC. ``lost`` SYNCs before it did not arrive; ``restarted``: the producer's counter restarted."""

    tick: int
    lost: int
    restarted: bool


class SyncCounter:
    """SYNC numbers from SYNC counters.

    A SYNC with counter c has a number congruent to c - 1 modulo 240; the first one seen gets c - 1 (the offset in
    rounds is resolved later by the coded sync pulses). Counter 0 means that the SYNC carries none: losses are then
    counted by host time alone.

    Known limit: where a queue that was full has lost whole rounds, they are counted eight SYNCs later, and these eight
    are numbered as many too low.

    Attributes:
        period_ns: SYNC period.
        pause_ns: Length of a pause of the producer before the second to last SYNC; else 0. It is known one SYNC later:
            after a host that only read late, the next SYNC comes early.
    """

    WHAT: ClassVar[str] = "SYNC"

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.pause_ns = 0
        self._tick: int | None = None
        self._host_ns = 0
        self._late_ns = 0  # delay of the last SYNC against its number
        self._behind = 0.0  # SYNC periods by which all since the reader was last in time are late, at most
        self._at_pace = 0  # SYNCs in succession that came a period apart

    @property
    def tick(self) -> int | None:
        """Number of the last SYNC, None before the first."""
        return self._tick

    @property
    def host_ns(self) -> int:
        """CLOCK_MONOTONIC arrival of the last SYNC."""
        return self._host_ns

    @property
    def is_late(self) -> bool:
        """Whether the last SYNC came a period or more after its time: frames wait somewhere."""
        return self._behind >= 1.0

    def silence(self, host_ns: int) -> float:
        """SYNC periods from the last SYNC to ``host_ns``; 0 before the first."""
        return 0.0 if self._tick is None else (host_ns - self._host_ns) / self.period_ns

    def advance(self, counter: int, host_ns: int, sent_ns: int | None = None, stood: bool = False) -> SyncStep:
        """Number the next SYNC.

        A reader that was late finds a queue whose SYNCs have one stamp. They are numbered by their counters; how late
        the last of them is against its number bounds how many may be missing where the queue was full, behind it.

        Args:
            counter: Its counter, 1..240, or 0.
            host_ns: When it arrived.
            sent_ns: Latest time at which it was sent, if known to be well before its arrival.
            stood: The reader stood still shortly before: whole rounds that it is late by were lost, and are no pause.
        """
        if self._tick is None:
            self._tick, self._host_ns = max(counter - 1, 0), host_ns
            return SyncStep(self._tick, 0, False)
        elapsed = self.silence(host_ns)
        if counter == 0:
            ahead = max(1, round(elapsed if sent_ns is None else self.silence(sent_ns)))
            restarted = False
        else:
            queued = sent_ns is not None and host_ns - sent_ns > SLACK * self.period_ns
            ahead, restarted = self._ahead(counter, 0.0 if queued else elapsed, elapsed + self._behind)
        self.pause_ns = self._late_ns if elapsed > 0.5 * ahead else 0
        late = elapsed - ahead
        self._late_ns = round(late * self.period_ns) if late > LATE and not restarted else 0
        self._behind = 0.0 if restarted else max(0.0, self._behind + late)
        self._at_pace = self._at_pace + 1 if 0.5 * ahead < elapsed <= ahead + LATE else 0
        if self._at_pace >= AT_PACE:  # the queue is behind us
            rounds = round(self._behind / ROUND)
            if stood and abs(self._behind - ROUND * rounds) <= SLACK:
                ahead += ROUND * rounds
            self._behind = 0.0
        self._tick += ahead
        self._host_ns = host_ns
        return SyncStep(self._tick, 0 if restarted else ahead - 1, restarted)

    def advance_evenly(self, syncs: Sequence[tuple[int, bytes]], fewest: int) -> int:
        """Number SYNCs, arrival and data of each, as long as each is the next one and none comes after a pause.

        Returns:
            How many were numbered; 0, and no change, where fewer than ``fewest`` can be.
        """
        before = vars(self).copy()
        for count, (host_ns, data) in enumerate(syncs):
            step = self.advance(data[0], host_ns) if len(data) == 1 and 1 <= data[0] <= ROUND else None
            if step is None or step.lost or step.restarted or self.pause_ns:
                vars(self).update(before)
                return self.advance_evenly(syncs[:count], fewest) if count >= fewest else 0
        return len(syncs)

    def _ahead(self, counter: int, least_elapsed: float, most_elapsed: float) -> tuple[int, bool]:
        """Numbers from the last SYNC to this one, and whether the producer restarted.

        Args:
            counter: 1..240.
            least_elapsed: SYNC periods from the last SYNC's sending to this one's, at least.
            most_elapsed: At most.
        """
        assert self._tick is not None
        least = (counter - 1 - self._tick - 1) % ROUND + 1  # 1..240
        ahead = least + ROUND * max(0, math.ceil((least_elapsed - SLACK - least) / ROUND))
        if ahead == 1 or ahead <= most_elapsed + SLACK:
            return ahead, False
        if least == 1:  # the very next number, late: a pause. Of restarts 1 in 240 looks like it
            return 1, False
        return max(least, least + ROUND * round((most_elapsed - least) / ROUND)), True
