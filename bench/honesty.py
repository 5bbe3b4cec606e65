"""Random flights with faults and model errors, alone and in pairs: does a wrong answer ever look like a right one?

Run ``python bench/honesty.py [--flights 20] [--first 1] [--vehicle rocksat] [--healthy] [--out FILE] [--jobs 1]``.
Each seed is a short mission of its own; vehicle, faults and model errors are drawn from it
(``bench/honest_flights/drawn.py``). With ``--out`` each flight is one line of JSON, written when it is flown; seeds
that the file has already are not flown again, so that a campaign that was stopped goes on. Counted are

- *confident nonsense*: a quantity that the flight supports while its truth lies outside its 99.9 % interval,
- the same under a fault that no instrument on board can see (``Drawn.invisible``): there the answer leans on a
  calibration, which it names,
- flights with a harmless fault (samples are missing, none is false) that still answer,
- healthy flights of which some answer is not to be used,
- faults on an instrument that another one stands beside, and whether an event names it.

Exit code 1: confident nonsense.
"""

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from bench.honest_flights.drawn import FAULTS, HARMLESS, MISSION, REDUNDANT, Drawn, draw
from bench.honest_flights.flown import fly as fly_drawn

__all__ = ["MISSION", "counts", "draw", "fly"]

Flight = dict[str, Any]


def fly(seed: int, vehicle: str | None = None, healthy: bool = False) -> Flight:
    """Fly a seed's flight; a program that fails is an outcome too."""
    drawn = draw(seed, vehicle, healthy)
    try:
        return fly_drawn(drawn)
    except Exception as error:  # noqa: BLE001 - counted, printed, and the campaign goes on
        return drawn._asdict() | {"failed": f"{type(error).__name__}: {error}"}


def text_of(flight: Flight) -> str:
    """What was flown."""
    return Drawn(*(flight[field] for field in Drawn._fields)).text


def told(flight: Flight) -> Iterator[str]:
    """What is remarkable about a flight."""
    if "failed" in flight:
        yield f"FAILED: {text_of(flight)}: {flight['failed']}"
    elif flight["nonsense"]:
        kind = "leans on calibration" if flight["invisible"] else "NONSENSE"
        yield f"{kind}: {text_of(flight)}: {'; '.join(flight['nonsense'])}"
    elif not flight["answered"] and not _visible_lies(flight):
        yield f"no answer: {text_of(flight)}: {next(iter(flight['standings'].values()), '')}"


def counts(flights: list[Flight]) -> list[str]:
    """The campaign's numbers, a line each."""
    flown = [one for one in flights if "failed" not in one]
    invisible = [one for one in flown if one["invisible"]]
    others = [one for one in flown if not one["invisible"]]
    nonsense = [one for one in others if one["nonsense"]]
    harmless = [one for one in flown if one["faults"] and not one["model_errors"] and not _visible_lies(one)]
    model_only = [one for one in flown if one["model_errors"] and not one["faults"]]
    healthy = [one for one in flown if not one["faults"] and not one["model_errors"]]
    beside = [one for one in flown if _has_one_beside(one)]
    inside, shown = (sum(one["covered"][k] for one in healthy) for k in (0, 1))
    vehicles = ", ".join(f"{name} {count}" for name, count in Counter(one["vehicle"] for one in flown).items())
    return [
        f"flights: {len(flown)} ({vehicles}); failed programs: {len(flights) - len(flown)}",
        f"confident nonsense: {_share(len(nonsense), len(others))}",
        f"invisible to every instrument: {len(invisible)}, wrong in {sum(bool(one['nonsense']) for one in invisible)}, "
        f"which name the calibration: {sum(_names_calibration(one) for one in invisible if one['nonsense'])}",
        f"harmless faults answered: {_share(sum(one['answered'] for one in harmless), len(harmless))}",
        f"model errors alone answered: {_share(sum(one['answered'] for one in model_only), len(model_only))}",
        f"healthy flights that say do not use: {_share(sum(one['refused'] for one in healthy), len(healthy))}",
        f"healthy flights answered: {_share(sum(one['answered'] for one in healthy), len(healthy))}",
        f"truths inside the 95 % interval of healthy flights: {_share(inside, shown)}",
        f"faulty redundant instrument named: {_share(sum(one['named'] for one in beside), len(beside))}",
    ]


def _visible_lies(flight: Flight) -> bool:
    """Whether some fault makes false readings, and not only missing ones."""
    return not {fault["kind"] for fault in flight["faults"]} <= HARMLESS


def _has_one_beside(flight: Flight) -> bool:
    """Whether one instrument alone is false and another one measures the same."""
    if len(flight["faults"]) != 1 or flight["model_errors"]:
        return False
    (fault,) = flight["faults"]
    return fault["kind"] in ("stuck", "wrong") and fault["device"] in REDUNDANT.get(flight["vehicle"], set())


def _names_calibration(flight: Flight) -> bool:
    """Whether what is said of an answer names the instrument whose scale is wrong."""
    said = " ".join(flight["leans"]) + " ".join(flight["standings"].values())
    return any(fault["device"] in said for fault in flight["faults"] if fault["kind"] == "wrong")


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole}" + (f" ({100.0 * part / whole:.1f} %)" if whole else "")


def _flown_before(path: Path | None) -> list[Flight]:
    """Whole lines of a campaign's file; one cut short by a kill is taken out and flown again."""
    if path is None or not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines.pop()
        path.write_text("".join(lines), encoding="utf-8")
    return [json.loads(line) for line in lines]


def main() -> int:
    """Print what is remarkable as it comes, then the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--vehicle", choices=list(FAULTS))
    parser.add_argument("--healthy", action="store_true", help="no fault and no model error")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, help="a line of JSON a flight; what it has already is not flown again")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.flights)
    done = _flown_before(arguments.out)
    left = [seed for seed in seeds if seed not in {one["seed"] for one in done}]
    for one in done:
        for line in told(one):
            print(line)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        job = partial(fly, vehicle=arguments.vehicle, healthy=arguments.healthy)
        for one in pool.map(job, left):
            done.append(one)
            if arguments.out is not None:
                with arguments.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(one) + "\n")
            for line in told(one):
                print(line, flush=True)
    print("\n".join(counts(done)))
    return int(any(one.get("nonsense") and not one["invisible"] for one in done))


if __name__ == "__main__":
    sys.exit(main())
