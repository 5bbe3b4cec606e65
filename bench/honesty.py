"""Does a wrong answer ever look like a right one, and how often is there none?

Run ``heft campaign PLAN -o DIR``, then ``python -m bench.honesty DIR...`` (of a campaign flown in parts: each part's).
Of ``bench/plans/scoreboard.toml`` (what was said on board) and ``scoreboard_identified.toml`` (what ``heft identify``
says of the same logs) it prints the scoreboard, a row a class (``bench/honest_flights/scores.py``); ``--before DIR...``
gives flights of another revision, shown in brackets, and ``--page FILE`` writes it.

Of ``bench/plans/honesty.toml`` each seed is a short mission of its own; vehicle, faults and model errors are drawn from
it (``bench/honest_flights/drawn.py``). Counted are

- *confident nonsense*: a quantity that the flight supports while its truth lies outside its 99.9 % interval,
- the same under a fault that no instrument on board can see (``Drawn.invisible``): there the answer leans on a
  calibration, which it names,
- flights with a harmless fault (samples are missing, none is false) that still answer,
- healthy flights of which some answer is not to be used,
- faults on an instrument that another one stands beside, and whether an event names it,
- all numbers reported: how many lie outside their 95 % and 99.9 % intervals, and the rms of their errors in sigmas.

Exit code 1: confident nonsense.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench import given
from bench.honest_flights import scores
from bench.honest_flights.drawn import HARMLESS, REDUNDANT
from onboard.ground.campaign.instants import off_by
from onboard.ground.campaign.results import Outcome
from onboard.ground.campaign.statistics import share_of
from onboard.ground.campaign.store import Store
from onboard.identification.standing import Level


class FlightRows(NamedTuple):
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

    @property
    def lied(self) -> bool:
        """Whether a number was confident nonsense at any time of the flight, and an instrument could show it."""
        return not self.rows[0]["unseen"] and any(row["instants_beyond"] for row in self.rows)

    def names(self, where: str) -> bool:
        """Whether every faulty instrument is named."""
        return all(device in where for _, device, *_ in self.faults)


def counts(flights: list[FlightRows]) -> list[str]:
    """The numbers of random flights, a line each."""
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
        f"the same at any time of the flight: {_share(sum(one.lied for one in flights), len(flights) - len(unseen))}",
        f"invisible to every instrument: {unseen_told}",
        f"harmless faults answered: {_share(sum(one.answered for one in harmless), len(harmless))}",
        f"model errors alone answered: {_share(sum(one.answered for one in model_only), len(model_only))}",
        f"healthy flights that say do not use: {_share(refused, len(healthy))}",
        f"healthy flights answered: {_share(sum(one.answered for one in healthy), len(healthy))}",
        f"truths inside the 95 % interval of healthy flights: "
        f"{_share(sum(row['low'] <= row['truth'] <= row['high'] for row in shown), len(shown))}",
        f"faulty redundant instrument named: "
        f"{_share(sum(one.names(' '.join(one.rows[0]['events'])) for one in beside), len(beside))}",
        _reported([row for one in flights if not one.rows[0]["unseen"] for row in one.rows if row["supported"]]),
    ]


def _reported(rows: list[dict[str, Any]]) -> str:
    """Numbers reported, and their errors beside their intervals: of exact ones 0.1 % lie beyond that of 99.9 %."""
    known = [row for row in rows if row["truth"] is not None and row["value"] is not None]
    if not known:
        return "numbers told: none"
    inside = np.mean([row["low"] <= row["truth"] <= row["high"] for row in known])
    far = off_by(*([row[key] for row in known] for key in ("value", "low_999", "high_999", "truth")))
    rms = np.sqrt(np.mean([((row["value"] - row["truth"]) / row["sigma"]) ** 2 for row in known]))
    return (
        f"numbers told: {len(known)}; inside 95 %: {100.0 * inside:.1f} %; beyond 99.9 %: {(far > 1.0).sum()}, "
        f"worst {far.max():.2f} of its half width; rms {rms:.2f} sigmas"
    )


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole}, {share_of(part, whole).text}"


class CampaignRows(NamedTuple):
    """What lies in the directories of one."""

    rows: list[dict[str, Any]]
    failures: int
    revisions: tuple[str, ...]
    name: str = "scoreboard"  # of the plan


def read(directories: list[Path]) -> CampaignRows:
    """The rows of all flights that are done."""
    rows, failures, names = list[dict[str, Any]](), 0, list[str]()
    for directory in directories:
        store = Store(directory)
        content = store.content()
        names.append(content.name)
        failures += len(store.failures(content.items))
        rows += store.rows(content.items)
    return CampaignRows(rows, failures, tuple(sorted({row["revision"] for row in rows})), *names[:1])


def _at_all_instants(rows: list[dict[str, Any]]) -> str:
    told, beyond = (sum(row[one] or 0 for row in rows) for one in ("instants", "instants_beyond"))
    if not told:
        return "By what is said of each log as a whole."
    farthest = max((row["instants_farthest"] or 0.0 for row in rows), default=0.0)
    share = f"{100.0 * beyond / told:.3f} %"
    return (
        f"At all instants of all flights together {beyond} of {told:,} numbers lay beyond their 99.9 % interval\n"
        f"({share}; exact intervals leave 0.1 %), the farthest {farthest:.2g} times half of it."
    )


def main() -> int:
    """Print the counts, or the scoreboard."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("directories", type=given.campaign, nargs="+", metavar="DIR", help="of the campaign")
    parser.add_argument(
        "--before", type=given.campaign, nargs="+", metavar="DIR", default=[], help="of another revision's flights"
    )
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the scoreboard as Markdown")
    arguments = parser.parse_args()
    own, before = read(arguments.directories), read(arguments.before)
    after = scores.board(own.rows)
    if not after:
        return _random(own)
    text = scores.page(after, scores.board(before.rows))
    print(text)
    print(f"\nfailed programs: {own.failures}")
    if arguments.page:
        plan = f"bench/plans/{own.name.replace(' ', '_')}.toml"
        command = f"heft campaign {plan}, python -m bench.honesty; code {', '.join(own.revisions)}"
        beside = f"; in brackets that of {', '.join(before.revisions)}" if before.rows else ""
        seeds = sorted({int(row["seed"]) for row in own.rows})
        made = f"Made by {command}{beside}; seeds {seeds[0]} to {seeds[-1]}.\n{_at_all_instants(own.rows)}"
        title = f"# {own.name.capitalize()}"
        arguments.page.write_text(f"{title}\n\n{_HEAD}\n{made}\n{text}\n", encoding="utf-8")
    return int(any(score.lied for score in after.values()))


_HEAD = """\
Each row is a class of flights (`bench/honest_flights/classes.py`). *Answered*: every mass is supported and known to
20 %. *Lies*: a number was supported while its truth lay beyond its 99.9 % interval, at any time of the flight or in its
last estimate. *Good, beyond*: such a number was called good. *rms*: of errors in sigmas; 1 is exact, less is too wide.
*Half width*: of the 95 % intervals of masses, median. *Score*: mean interval score of masses and principal moments
(Gneiting and Raftery 2007), of their truth; a number that is not told counts 200 %. *Named*: flights that name what is
wrong; *another blamed*: flights that say of something else that it contradicts.
"""


def _random(own: CampaignRows) -> int:
    flights: dict[str, FlightRows] = {}
    for row in own.rows:
        flights.setdefault(row["flight"], FlightRows([])).rows.append(row)
    print("\n".join(counts(list(flights.values()))))
    print(f"failed programs: {own.failures}")
    return int(any(one.has(Outcome.NONSENSE) for one in flights.values()))


if __name__ == "__main__":
    sys.exit(main())
