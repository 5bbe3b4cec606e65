"""Rehearsals of vehicles that are not packaged, from ``heft init`` and a URDF, over seeds.

    python -m bench.rehearsals [--seeds 10] [--first 1] [--only NAME ...] [--directory DIR] [--planned SECONDS]

By vehicle: flights that answered, and of all answers how many are given, inside their 95 % interval, and beyond four of
their sigmas; what is not answered must be said to be weak. Then the promise made before the flight: errors in sigmas
that were expected (rms 1 where the promise is kept; a payload lighter than the one assumed gives more), and reported
over expected sigmas (median). With ``--directory`` results stay there, and flights whose result is there are read.
``--planned``: the longest swing is replaced by the motion of so many seconds that ``heft plan`` finds.
"""

import argparse
import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from onboard.cli import main

OWN = Path(__file__).resolve().parents[1] / "tests" / "flight" / "own"
SECTIONS = ("masses", "centres", "inertias", "parameters")
FAR = 4.0  # sigmas


class Setup(NamedTuple):
    """A vehicle by the options of ``heft init``, and what its scenario file says."""

    init: tuple[str, ...]
    scenario: str = ""


CASES = {
    "planar_arm": Setup(("--base", "free", "--urdf", str(OWN / "planar_arm.urdf"))),
    "six_joints": Setup(("--base", "fixed", "--encoder", "cia402", "--urdf", str(OWN / "bench_arm.urdf"))),
    "spinner": Setup(("--base", "free", "--urdf", str(OWN / "spinner.urdf")), "release.spin_rad_s = [0.1, -0.05, 1.2]"),
    "free": Setup(("--base", "free", "--joints", "3")),
    "free_1_kg": Setup(("--base", "free", "--joints", "3"), "payload.mass_kg = [1.0, 1.0]"),
    "planar": Setup(("--base", "planar", "--joints", "2")),
    "prescribed": Setup(("--base", "prescribed", "--joints", "2", "--load-cell", "cia404")),
    "fixed": Setup(("--base", "fixed", "--joints", "2", "--load-cell", "cia404")),
    "from_rocksat": Setup(("--from", "rocksat")),
}


class Tally(NamedTuple):
    """Answers of one flight: 1 sigma errors of those given, and what else there is."""

    told: list[float]  # errors in reported sigmas
    inside: int
    silent: list[str]  # neither answered nor said to be weak
    promised: list[float]  # errors in expected sigmas
    wider: list[float]  # reported over expected sigmas
    answered: bool
    accounted: bool


def fly(directory: Path, name: str, seed: int, planned_s: float | None = None) -> dict[str, Any]:
    """The result of one flight."""
    case, result = CASES[name], directory / f"{name}_{seed}.json"
    if result.exists():
        return dict(json.loads(result.read_text()))
    vehicle, scenario, log = directory / name, directory / f"{name}.toml", directory / f"{name}_{seed}.mcap"
    with contextlib.redirect_stdout(io.StringIO()):
        if not vehicle.exists() and main(["init", str(vehicle), *case.init]) != 0:
            raise SystemExit(f"heft init of {name} failed")
        scenario.write_text(case.scenario)
        if planned_s is not None:
            made = directory / f"{name}_plan"
            asked = ["plan", str(vehicle / "vehicle.toml"), "--scenario", str(scenario), "--seconds", str(planned_s)]
            if not made.exists() and main([*asked, "-o", str(made)]) != 0:
                raise SystemExit(f"heft plan of {name} failed")
            scenario = made / "scenario.toml"
        asked = ["hil", str(vehicle / "vehicle.toml"), "--seed", str(seed), "--scenario", str(scenario)]
        main([*asked, "--json", str(result), "--log", str(log)])
    log.unlink(missing_ok=True)
    return dict(json.loads(result.read_text()))


def tally(result: dict[str, Any]) -> Tally:
    """What a flight's answers came to."""
    expected = {one["name"]: one for one in result["expected"]}
    found = Tally([], 0, [], [], [], result["identified"], result["accounted"])
    inside = 0
    for row in (row for section in SECTIONS for row in result[section]):
        if not row["supported"]:
            if not row["standing"].startswith("weak"):
                found.silent.append(row["quantity"])
            continue
        error = row["value"] - row["truth"]
        found.told.append(error / row["sigma"])
        inside += row["covered"]
        before = expected.get(row["quantity"])
        if before is not None and before["why"] != "not determined" and before["sigma"]:
            found.promised.append(error / before["sigma"])
            found.wider.append(row["sigma"] / before["sigma"])
    return found._replace(inside=inside)


def campaign() -> None:
    """Fly, and print a line a vehicle."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seeds", type=int, default=10)
    arguments.add_argument("--first", type=int, default=1)
    arguments.add_argument("--only", nargs="+", choices=CASES, default=["planar_arm", "six_joints", "spinner"])
    arguments.add_argument("--directory", type=Path)
    arguments.add_argument("--planned", type=float, metavar="SECONDS")
    asked = arguments.parse_args()
    with contextlib.ExitStack() as stack:
        where = asked.directory or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        where.mkdir(parents=True, exist_ok=True)
        for name in asked.only:
            seeds = range(asked.first, asked.first + asked.seeds)
            flights = [tally(fly(where, name, seed, asked.planned)) for seed in seeds]
            told = np.array([z for one in flights for z in one.told])
            promised = np.array([z for one in flights for z in one.promised])
            wider = np.array([ratio for one in flights for ratio in one.wider])
            silent = sorted({quantity for one in flights for quantity in one.silent})
            print(
                f"{name:12s} {len(flights)} flights, {sum(one.answered for one in flights)} answered, "
                f"{sum(one.accounted for one in flights)} accounted; {len(told)} told, "
                f"{sum(one.inside for one in flights)} inside 95 %, {int((np.abs(told) > FAR).sum())} beyond 4 sigma; "
                f"neither told nor weak: {', '.join(silent) or 'none'}"
            )
            if promised.size:
                print(
                    f"{'':12s} promise: error over expected sigma {np.sqrt(np.mean(promised**2)):.2f} rms, "
                    f"{np.median(np.abs(promised)) / 0.6745:.2f} by the median; reported over expected sigma "
                    f"{np.median(wider):.2f} ({np.quantile(wider, 0.1):.2f} to {np.quantile(wider, 0.9):.2f})"
                )
            sys.stdout.flush()


if __name__ == "__main__":
    campaign()
