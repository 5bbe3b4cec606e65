"""Rows of the SYNCs seen on a bus, and gaps of those that were not."""

from collections.abc import Sequence

import numpy as np

from drivers.canopen_pdo.sync import SyncConfig
from drivers.records import CAN_SYNC
from drivers.reporter import Reporter


class SyncRows:
    """CAN_SYNC rows, gathered between two pumps; ``sequence`` counts SYNCs seen and lost.

    Args:
        config: The SYNC producer.
        report: Where rows and gaps go.

    Attributes:
        count: SYNCs so far, lost ones included.
    """

    def __init__(self, config: SyncConfig, report: Reporter) -> None:
        self.count = 0
        self._config = config
        self._report = report
        self._rows: list[tuple[int, int, int, int]] = []

    def add_rounds(self, host_ns: Sequence[int], tick: int, counters: Sequence[int]) -> None:
        """SYNCs arrived, number ``tick`` and those that follow."""
        count, many = self.count, len(host_ns)
        self._rows += zip(range(count, count + many), host_ns, range(tick, tick + many), counters, strict=True)
        self.count += many

    def add(self, host_ns: int, tick: int, counter: int) -> None:
        """SYNC number ``tick`` arrived."""
        self._rows.append((self.count, host_ns, tick, counter))
        self.count += 1

    def lose(self, host_ns: int, lost: int, cause: str = "no_sync") -> None:
        """Record that ``lost`` SYNCs, if any, did not arrive until ``host_ns``."""
        if lost > 0:
            last, duration_ns = self.count + lost - 1, lost * self._config.period_ns
            self._report.gap(host_ns, self._config.name, self.count, last, duration_ns, cause)
            self.count += lost

    def hand_over(self) -> None:
        """Pass the collected rows to the reporter."""
        if self._rows:
            rows = np.zeros(len(self._rows), CAN_SYNC)
            rows[:] = self._rows
            self._rows.clear()
            self._report.rows(self._config.name, rows)
