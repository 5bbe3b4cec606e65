"""What the campaign of ``bench/plans/honesty.toml`` shows: does a wrong answer ever look like a right one?

Run ``heft campaign bench/plans/honesty.toml -o DIR``, then ``python bench/honesty.py DIR...`` (of a campaign flown in
parts: each part's). Each seed is a short mission of its own; vehicle, faults and model errors are drawn from it
(``bench/honest_flights/drawn.py``). Counted are

- *confident nonsense*: a quantity that the flight supports while its truth lies outside its 99.9 % interval,
- the same under a fault that no instrument on board can see (``Drawn.invisible``): there the answer leans on a
  calibration, which it names,
- flights with a harmless fault (samples are missing, none is false) that still answer,
- healthy flights of which some answer is not to be used,
- faults on an instrument that another one stands beside, and whether an event names it,
- all numbers told: how many lie outside their 95 % and 99.9 % intervals, and the rms of their errors in sigmas.

Exit code 1: confident nonsense.
"""

import sys
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.honest_flights.drawn import HARMLESS, REDUNDANT
from onboard.identification.verdict import Level
from onboard.offline.campaign.results import WIDER, Outcome
from onboard.offline.campaign.statistics import share_of
from onboard.offline.campaign.store import Store

_SIGMAS = 1.9600  # of the half width of a 95 % interval


class Flight(NamedTuple):
    """A flight's rows."""

    rows: list[dict[str, Any]]

    @property
    def faults(self) -> list[list[str]]:
        """Kind, device, start, end, value."""
        return [text.split(":") for text in self.rows[0]["faults"] if ":" in text]

    @property
    def model_errors(self) -> list[str]:
        """By name."""
        return [text for text in self.rows[0]["faults"] if ":" not in text]

    @property
    def answered(self) -> bool:
        """Whether every mass is."""
        return all(row["supported"] for row in self.rows if row["unit"] == "kg")

    @property
    def harmless(self) -> bool:
        """Whether every fault loses samples, and makes none false."""
        return {kind for kind, *_ in self.faults} <= HARMLESS

    @property
    def has_one_beside(self) -> bool:
        """Whether one instrument alone is false and another one measures the same."""
        if len(self.faults) != 1 or self.model_errors:
            return False
        ((kind, device, *_),) = self.faults
        return kind in ("stuck", "wrong") and device in REDUNDANT.get(self.rows[0]["what"], set())

    def has(self, outcome: Outcome) -> bool:
        """Whether an answer is of this outcome."""
        return any(row["outcome"] == outcome for row in self.rows)

    def names(self, where: str) -> bool:
        """Whether every faulty instrument is named."""
        return all(device in where for _, device, *_ in self.faults)


def counts(flights: list[Flight]) -> list[str]:
    """The campaign's numbers, a line each."""
    unseen = [one for one in flights if one.rows[0]["unseen"]]
    nonsense = [one for one in flights if one.has(Outcome.NONSENSE)]
    leaning = [one for one in unseen if one.has(Outcome.LEANS)]
    harmless = [one for one in flights if one.faults and not one.model_errors and one.harmless]
    model_only = [one for one in flights if one.model_errors and not one.faults]
    healthy = [one for one in flights if not one.faults and not one.model_errors]
    beside = [one for one in flights if one.has_one_beside]
    shown = [row for one in healthy for row in one.rows if row["supported"]]
    refused = sum(any(row["level"] == Level.DO_NOT_USE for row in one.rows) for one in healthy)
    calibrated = sum(one.names(" ".join(row["leans"] + row["why"] for row in one.rows)) for one in leaning)
    unseen_told = f"{len(unseen)}, wrong in {len(leaning)}, which name the calibration: {calibrated}"
    vehicles = ", ".join(f"{name} {count}" for name, count in Counter(one.rows[0]["what"] for one in flights).items())
    return [
        f"flights: {len(flights)} ({vehicles})",
        f"confident nonsense: {_share(len(nonsense), len(flights) - len(unseen))}",
        f"invisible to every instrument: {unseen_told}",
        f"harmless faults answered: {_share(sum(one.answered for one in harmless), len(harmless))}",
        f"model errors alone answered: {_share(sum(one.answered for one in model_only), len(model_only))}",
        f"healthy flights that say do not use: {_share(refused, len(healthy))}",
        f"healthy flights answered: {_share(sum(one.answered for one in healthy), len(healthy))}",
        f"truths inside the 95 % interval of healthy flights: "
        f"{_share(sum(row['low'] <= row['truth'] <= row['high'] for row in shown), len(shown))}",
        f"faulty redundant instrument named: "
        f"{_share(sum(one.names(' '.join(one.rows[0]['events'])) for one in beside), len(beside))}",
        _told([row for one in flights if not one.rows[0]["unseen"] for row in one.rows if row["supported"]]),
    ]


def _told(rows: list[dict[str, Any]]) -> str:
    """Numbers told, and their errors beside their intervals: of exact ones 0.1 % lie beyond that of 99.9 %."""
    off = np.array([(row["value"] - row["truth"]) / (row["high"] - row["value"]) for row in rows])
    off = np.abs(off[np.isfinite(off)])
    if not off.size:
        return "numbers told: none"
    inside, beyond = f"{100.0 * (off <= 1.0).mean():.1f} %", int((off > WIDER).sum())
    return (
        f"numbers told: {off.size}; inside 95 %: {inside}; beyond 99.9 %: {beyond}, "
        f"worst {off.max() / WIDER:.2f} of its half width; rms {_SIGMAS * np.sqrt(np.mean(off * off)):.2f} sigmas"
    )


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole}, {share_of(part, whole).text}"


def main() -> int:
    """Print the counts."""
    flights: dict[str, Flight] = {}
    failures = 0
    for directory in sys.argv[1:]:
        store = Store(Path(directory))
        items = store.content().items
        failures += len(store.failures(items))
        for row in store.rows(items):
            flights.setdefault(row["flight"], Flight([])).rows.append(row)
    print("\n".join(counts(list(flights.values()))))
    print(f"failed programs: {failures}")
    return int(any(one.has(Outcome.NONSENSE) for one in flights.values()))


if __name__ == "__main__":
    sys.exit(main())
