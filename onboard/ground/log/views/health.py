"""What the HEALTH records of a flight say, for ``heft info``, ``report`` and ``watch``."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.flight.health.status import standing, words

PROCESSES = ("acquisition", "estimation", "recording", "supervisor", "others")
_NEEDED = {"status_word", "status_latched", "rows_hz", "estimator_lag_s", "computer_idle_percent"}


def is_health(dtype: np.dtype[np.void]) -> bool:
    """Whether rows are HEALTH, of this version or a later one."""
    return set(dtype.names or ()) >= _NEEDED | {f"{name}_cpu_percent" for name in PROCESSES}


class HealthSummary:
    """Mean, least and largest value of every field, and both status words. Unknown values do not count.

    Attributes:
        rows: records taken in.
        status: the last status word.
        latched: all bits ever set.
    """

    def __init__(self) -> None:
        self.rows = self.status = self.latched = 0
        self._low: dict[str, float] = {}
        self._high: dict[str, float] = {}
        self._sum: dict[str, tuple[float, int]] = {}

    def add(self, rows: Rows) -> None:
        """Take in HEALTH rows (n,)."""
        if not len(rows):
            return
        self.rows += len(rows)
        self.status = int(rows["status_word"][-1])
        self.latched |= int(np.bitwise_or.reduce(rows["status_latched"] | rows["status_word"]))
        for name in rows.dtype.names or ():
            values = known(rows, name)
            if len(values):
                self._low[name] = min(self._low.get(name, math.inf), float(values.min()))
                self._high[name] = max(self._high.get(name, -math.inf), float(values.max()))
                total, count = self._sum.get(name, (0.0, 0))
                self._sum[name] = total + float(values.sum()), count + len(values)

    def least(self, name: str) -> float | None:
        """Of a field; None where it was never known."""
        return self._low.get(name)

    def most(self, name: str) -> float | None:
        """Of a field; None where it was never known."""
        return self._high.get(name)

    def mean(self, name: str) -> float | None:
        """Of a field; None where it was never known."""
        total, count = self._sum.get(name, (0.0, 0))
        return total / count if count else None

    def as_json(self) -> dict[str, Any] | None:
        """Plain values; None for a flight that has no such records."""
        if not self.rows:
            return None
        fields = sorted(self._low.keys() - {"sequence", "host_ns", "status_word", "status_latched"})
        spans = {name: {"least": self.least(name), "mean": self.mean(name), "most": self.most(name)} for name in fields}
        told = {"status": words(self.status), "latched": words(self.latched), "status_word": self.status}
        return {**told, "status_latched": self.latched, "records": self.rows, "fields": spans}

    def lines(self) -> list[str]:
        """In words: status, streams and estimator, computer."""
        if not self.rows:
            return []
        cpu = [(name, self.mean(f"{name}_cpu_percent")) for name in PROCESSES]
        pss = [self.most(f"{name}_pss_mb") or 0.0 for name in PROCESSES]
        used = ", ".join(f"{name} {value:.1f}" for name, value in cpu if value is not None)
        worst = (
            ("slowest stream", self.least("slowest_percent"), "%"),
            ("estimator behind", self.most("estimator_lag_s"), "s"),
            ("fullest ring", self.most("recorder_backlog_percent"), "%"),
            ("idle", self.least("computer_idle_percent"), "%"),
            ("temperature", self.most("temperature_deg_c"), "deg C"),
        )
        told = ", ".join(f"{what} {value:.3g} {unit}" for what, value, unit in worst if value is not None)
        unknown = "" if self.most("temperature_deg_c") is not None else "; temperature unknown"
        return [
            f"health: {standing(self.status, self.latched)}",
            f"CPU in % of a core: {used}; PSS at most {sum(pss):.0f} MB; worst second: {told}{unknown}",
        ]


def known(rows: Rows, name: str) -> NDArray[np.float64]:
    """The values of a field that are known; none of a field of text or several columns."""
    values = rows[name]
    if values.ndim != 1 or values.dtype.kind not in "iuf":
        return np.empty(0)
    numbers = values.astype(np.float64)
    told = np.isfinite(numbers)
    if name == "throttled":
        told &= numbers >= 0
    return numbers[told]
