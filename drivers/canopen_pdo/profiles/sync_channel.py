"""Synchronous TPDOs: each is assigned the SYNC it answers; a SYNC without an answer is a gap."""

from collections.abc import Sequence

import numpy as np

from drivers.canopen_pdo.profiles.channel import PdoChannel, ProcessData, Sample
from drivers.canopen_pdo.sync import ROUND, SyncCounter
from drivers.ports import CanFrame
from drivers.records import Severity
from drivers.reporter import Reporter

SILENT_AFTER = 20  # SYNCs without an answer before an event
FIRST_ANSWER = 4  # SYNCs after the start of a node until its first answer is late
LATEST = 400  # SYNCs after a gap during which late answers to it are discarded


class SyncChannel(PdoChannel):
    """One row for each SYNC answered.

    TPDOs are held until the next SYNC, because only then is it known whether a SYNC between was lost. A TPDO between
    SYNC n and n + 1 answers n; where SYNCs are missing, host time assigns it. ``sequence`` counts with the SYNC number
    from the first answer on. A surplus TPDO that is not a late answer to a SYNC in a gap takes one more sequence
    number, recorded as a gap.

    Args:
        data: The value.
        report: Where rows, gaps and events go.
        sync: Numbers the SYNCs of this bus.
    """

    def __init__(self, data: ProcessData, report: Reporter, sync: SyncCounter) -> None:
        super().__init__(data, report, sync)
        self._period_ns = sync.period_ns
        self._held: list[tuple[int, bytes]] = []
        self._last_tick = 0  # of the last row
        self._live_tick: int | None = None  # when the node was started, before any row
        self._before_sync = 0  # TPDOs that came before any SYNC
        self._unanswered = 0  # SYNCs seen since the last row without an answer
        self._silent = 0  # the same, since the node went live or answered
        self._owed = 0  # answers missing in the last gap
        self._owed_tick = 0
        self._reset_since_row = False

    @property
    def is_silent(self) -> bool:
        """Whether the SYNC before the last one seen was not answered, nor was the last one yet."""
        return self._unanswered > 0 and not self._held

    @property
    def is_awaited(self) -> bool:
        """Whether it answered the SYNC before the last one seen, and the last one not yet."""
        return self.live and self.started and self._unanswered == 0 and not self._held

    def go_live(self) -> None:
        """The node has been started."""
        super().go_live()
        self._silent = 0
        if not self.started:
            self._live_tick = self._sync.tick

    def node_reset(self) -> None:
        """See ``PdoChannel``. TPDOs held so far become rows first."""
        self.settle()
        super().node_reset()
        self._reset_since_row = self.started

    def accept(self, host_ns: int, data: bytes) -> None:
        """See ``PdoChannel``. TPDOs before the first SYNC answer none: they are a gap before the first row."""
        if self.live and self._sync.tick is not None:
            self._held.append((host_ns, data))
        elif self.live:
            self._before_sync += 1

    def close(self, tick: int, sync_ns: int, next_tick: int) -> None:
        """Assign the TPDOs held between SYNC ``tick`` (arrived at ``sync_ns``) and the next one seen, ``next_tick``."""
        answers = next_tick - tick
        held = self._held
        if not self.started and self._sync.is_late:  # so is the command to start
            self._live_tick = next_tick
        lowest = max(0, self._last_tick + 1 - tick) if self._next else 0
        if answers == 1 and len(held) == 1 and lowest == 0:
            self._answer(tick, *held.pop())
            return
        for place, (host_ns, data) in enumerate(held):
            if lowest >= answers:
                self._leave(host_ns, tick, len(held) - place)
                break
            by_time = (host_ns - sync_ns) // self._period_ns
            highest = max(answers - (len(held) - place), lowest)  # leave a SYNC for each that follows
            offset = min(max(by_time, lowest), highest)
            self._answer(tick + offset, host_ns, data)
            lowest = offset + 1
        if not held:
            self._unanswered += 1
            self._count_silence(sync_ns)
        held.clear()

    def awaits_sync(self, tick: int) -> bool:
        """Whether all is as it should be up to SYNC ``tick``, whose one answer is held until the next SYNC."""
        regular = self.live and self.started and not self._after_reset
        return regular and len(self._held) == 1 and self._last_tick == tick - 1

    def close_rounds(self, tick: int, syncs_ns: Sequence[int], answers: Sequence[CanFrame]) -> None:
        """Close SYNC ``tick``, whose answer is held, and those after it, which have one answer each.

        Args:
            tick: Number of the SYNC; ``awaits_sync`` is true of it.
            syncs_ns: When it arrived, and those after it, and that which closes the last of them.
            answers: To those after it.
        """
        held = [self._held.pop(), *((host_ns, data) for host_ns, _, data, _ in answers)]
        whole, size = b"".join([data for _, data in held]), len(held[0][1])
        samples = None
        if {len(data) for _, data in held} == {size}:
            samples = self.data.decode_many(np.frombuffer(whole, np.uint8).reshape(len(held), size))
        if samples is None:
            for at, answer in enumerate(held):
                self._held.append(answer)
                self.close(tick + at, syncs_ns[at], tick + at + 1)
            return
        counters = [1 + each % ROUND for each in range(tick, tick + len(held))]
        self._append_many([host_ns for host_ns, _ in held], tick, samples, counters)
        self._last_tick = tick + len(held) - 1
        self._unanswered = self._silent = 0
        self._reset_since_row = False

    def settle(self) -> None:
        """The next SYNC is overdue: assign the held TPDOs to the last SYNC and to unseen ones after it.

        One alone that is later than its period waits for the next SYNC, whose number tells a pause from losses.
        """
        tick = self._sync.tick
        if self._held and tick is not None:
            periods = (self._held[-1][0] - self._sync.host_ns) // self._period_ns
            if periods < 1 or len(self._held) > 1:
                self.close(tick, self._sync.host_ns, tick + 1 + max(periods, 0))

    def sync_restarted(self, host_ns: int, last: int, tick: int) -> None:
        """SYNC numbers jump from ``last`` to ``tick``: close the rows up to ``last``; the jump itself is no loss."""
        if self.started and last > self._last_tick:
            self._lose(host_ns, last)
        self._last_tick = tick - 1
        self._live_tick = tick - 1

    def finish(self, now_ns: int, last: int | None) -> None:
        """Last call: record the unanswered SYNCs up to ``last`` as a gap."""
        tick = self._sync.tick
        if tick is None or last is None:
            return
        self.close(tick, self._sync.host_ns, tick + 1)
        if not self.started:
            self._lose_first(now_ns, last)
        elif last > self._last_tick:
            self._lose(now_ns, last)

    def _lose_first(self, now_ns: int, up_to_tick: int) -> None:
        """No row yet: the SYNCs since the node was started are a gap, unless they are so few as it takes to start."""
        since = up_to_tick - self._live_tick if self.live and self._live_tick is not None else 0
        lost = self._before_sync + (since if since > FIRST_ANSWER else 0)
        if lost:
            self._last_tick = up_to_tick - lost
            self._lose(now_ns, up_to_tick)

    def _answer(self, tick: int, host_ns: int, data: bytes) -> None:
        sample: Sample | None = self._decoded(host_ns, data)
        if sample is None:
            self._unanswered += 1
            return
        if not self.started:
            self._lose_first(host_ns, tick - 1)
        elif tick > self._last_tick + 1:
            self._lose(host_ns, tick - 1)
        self._append(host_ns, tick, sample, 1 + tick % ROUND)
        self._last_tick = tick
        self._unanswered = self._silent = 0
        self._reset_since_row = False

    def _lose(self, now_ns: int, up_to_tick: int) -> None:
        """Record the missing answers to the SYNCs after the last row, up to ``up_to_tick``, as a gap."""
        lost = up_to_tick - self._last_tick
        cause = "node_reset" if self._reset_since_row else "no_pdo" if self._unanswered else "no_sync"
        first = self._next
        self._report.gap(now_ns, self.data.name, first, first + lost - 1, lost * self._period_ns, cause)
        self._next += lost
        self._last_tick = up_to_tick
        if cause == "no_pdo":
            self._owed, self._owed_tick = lost, up_to_tick

    def _leave(self, host_ns: int, tick: int, extra: int) -> None:
        """Surplus TPDOs: late answers to SYNCs in the last gap are discarded, others become a gap."""
        text = f"{extra} TPDOs more than SYNCs: the node is slow, or another node sends {self.data.cob_id:03X}h"
        self._report.event(host_ns, Severity.WARNING, "pdo_extra", text, self.data.name)
        late = min(extra, self._owed) if tick - self._owed_tick <= LATEST else 0
        self._owed -= late
        if extra > late:
            first = self._next
            self._report.gap(host_ns, self.data.name, first, first + extra - late - 1, 0, "pdo_extra")
            self._next += extra - late

    def _count_silence(self, now_ns: int) -> None:
        if self.live:
            self._silent += 1
            if self._silent == SILENT_AFTER:
                text = (
                    f"node {self.data.node} runs and does not answer SYNC with {self.data.cob_id:03X}h: check its TPDO"
                )
                self._report.event(now_ns, Severity.ERROR, "silent", text, self.data.name)
