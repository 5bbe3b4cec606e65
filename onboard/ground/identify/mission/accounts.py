"""Samples of a rehearsal: those the simulated devices made, those in the log, those in gap records, and the rest.

A gap record says whether its samples were ``counted`` or are about as many: a node that is off makes none, and a master
that asks for them cannot know. A channel is accounted for where

- without an estimate: produced = recorded + missing, exactly;
- with one: recorded + missing is at most the estimate above what was produced, and at most ``SHORT_PART`` of the
  estimate and ``SHORT_EACH`` samples per estimated gap below it;
- with surplus answers (``pdo_extra``: another node sends the same identifier): one more may be recorded for each gap;
- with a gap of changes that nobody heard (``changes_unheard``): however many more were produced.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers import records
from onboard.estimation.arrays import PAUSE

SHORT_PART, SHORT_EACH = 0.02, 2
_MOST_PLACES = 20  # of a channel


class MissionSpan(NamedTuple):
    """Mission time [s] from one row to another."""

    from_s: float
    to_s: float


class Account(NamedTuple):
    """Samples of one channel.

    Attributes:
        produced: by the devices.
        recorded: in the log.
        missing: in gap records.
        about: of these, in gap records that are estimates.
        gaps: each gap record.
        silent: pauses without a gap record, longest first, where samples are unaccounted for.
    """

    produced: int
    recorded: int
    missing: int
    about: int
    gaps: list[dict[str, Any]]
    silent: list[MissionSpan]

    @property
    def left(self) -> int:
        """Samples neither recorded nor in a gap record; negative: gap records name more than were made."""
        return self.produced - self.recorded - self.missing

    @property
    def is_least(self) -> bool:
        """Whether ``missing`` is a lower bound: nobody heard how many changes there were."""
        return any(gap["cause"] == records.CHANGES_UNHEARD for gap in self.gaps)

    @property
    def is_whole(self) -> bool:
        """Whether all samples are accounted for, see the module."""
        estimates = sum(1 for gap in self.gaps if gap["about"])
        if self.is_least:
            return self.left >= -self.about
        others = sum(1 for gap in self.gaps if gap["cause"] == "pdo_extra")
        return -self.about - others <= self.left <= SHORT_PART * self.about + SHORT_EACH * estimates

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        silent = [span._asdict() for span in self.silent]
        whole = {"accounted": self.is_whole, "unaccounted": 0 if self.is_whole else self.left}
        return {**self._asdict(), "silent": silent, **whole}


class Seen:
    """Rows of a log as they are read, to be accounted for.

    Args:
        produced: samples made, by channel.
        start_ns: CLOCK_MONOTONIC of mission time 0.
    """

    def __init__(self, produced: dict[str, int], start_ns: int) -> None:
        self._produced, self._start_ns = produced, start_ns
        self._stamps: dict[str, list[NDArray[np.int64]]] = {name: [] for name in produced}
        self._gaps: dict[str, list[dict[str, Any]]] = {name: [] for name in produced}

    def see(self, batch: records.Batch) -> None:
        """Take the next rows of the log."""
        channel, rows = batch
        if channel in self._stamps:
            self._stamps[channel].append(rows["host_ns"].astype(np.int64))
        elif rows.dtype == records.GAP:
            for row in rows:
                name = row["channel"].decode(errors="replace")
                if name in self._gaps:
                    self._gaps[name].append(_gap(row, self._start_ns))

    def accounts(self) -> dict[str, Account]:
        """Of every channel, when all of the log was seen."""
        made = {}
        for name, count in self._produced.items():
            times_ns = np.concatenate([np.zeros(0, np.int64), *self._stamps[name]])
            named = self._gaps[name]
            missing, about = (sum(gap["missing"] for gap in some) for some in (named, [g for g in named if g["about"]]))
            account = Account(count, len(times_ns), missing, about, named, [])
            places = [] if account.is_whole else _silent(1e-9 * (np.sort(times_ns) - self._start_ns), named)
            made[name] = account._replace(silent=places)
        return made


def _gap(row: np.void, start_ns: int) -> dict[str, Any]:
    to_s = 1e-9 * (int(row["host_ns"]) - start_ns)
    return {
        "missing": int(row["last_missing"]) - int(row["first_missing"]) + 1,
        "about": not row["counted"],
        "cause": row["cause"].decode(errors="replace"),
        "from_s": round(to_s - 1e-9 * int(row["duration_ns"]), 4),
        "to_s": round(to_s, 4),
    }


def _silent(times_s: NDArray[np.float64], gaps: list[dict[str, Any]]) -> list[MissionSpan]:
    """Pauses between rows (n,) that no gap record overlaps, longest first; the start, if there is no row."""
    if not len(times_s):
        return [MissionSpan(0.0, 0.0)]
    since = np.diff(times_s)
    usual_s = float(np.median(since[since > 0])) if (since > 0).any() else 0.0
    spans = [
        MissionSpan(round(float(times_s[place]), 4), round(float(times_s[place + 1]), 4))
        for place in np.flatnonzero(since > PAUSE * usual_s)
    ]
    spans = [s for s in spans if not any(g["from_s"] < s.to_s and g["to_s"] > s.from_s for g in gaps)]
    return sorted(spans, key=lambda span: span.from_s - span.to_s)[:_MOST_PLACES]


def render(made: dict[str, Account]) -> list[str]:
    """A line for all that is well, and one for each channel that is not."""
    lines = []
    for name, account in made.items():
        if account.is_whole:
            continue
        counts = f"{account.produced} made, {account.recorded} recorded, {account.missing} in gap records"
        excess = "in no gap record" if account.left > 0 else "named and never made"
        lines.append(f"SAMPLES UNACCOUNTED FOR: {name}: {counts}: {abs(account.left)} {excess}{_where(account)}")
    whole = ", ".join(f"{name} {_counted(account)}" for name, account in made.items() if account.is_whole)
    verdict = "accounted for" if lines else "every sample accounted for"
    return [*lines, f"{verdict}: {whole}"] if whole else lines


def _counted(account: Account) -> str:
    if not account.missing:
        return str(account.recorded)
    about = "at least " if account.is_least else "about " if account.about else ""
    from_s, to_s = min(gap["from_s"] for gap in account.gaps), max(gap["to_s"] for gap in account.gaps)
    return f"{account.recorded} (and {about}{account.missing} missing, {from_s:.2f} to {to_s:.2f} s)"


def _where(account: Account) -> str:
    if account.left < 0:
        return ""
    if not account.recorded:
        return ", no row"
    spans = ", ".join(f"{span.from_s:.3f} to {span.to_s:.3f} s" for span in account.silent[:3])
    return f", rows pause from {spans}" if spans else ", at the start, at the end or beside its gaps"
