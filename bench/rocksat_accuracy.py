"""RockSat-X over many seeds: how far off the onboard answer is, and whether its intervals cover.

Run ``python bench/rocksat_accuracy.py [SCENARIO] [--seeds 100] [--first 1] [--jobs 2]``. Every seed is a whole mission
in virtual time; all that is random is drawn anew, at the full noise of the scenario. The bars are those of rocksat;
other scenarios carry other devices and are held to their coverage only.
"""

import argparse
import json
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from hil_sim.mission import open_in_process
from onboard import config
from onboard.flight import hil
from onboard.offline import table

BARS = {"m_arm": 3.0, "m_arm+m_tip_mass": 1.5, "m_tip_mass": 5.0}  # percent, 95th percentile of |error|
COVERAGE = (90.0, 99.0)


def fly(scenario: str, seed: int) -> dict[str, Any]:
    """One mission's result."""
    vehicle = config.load(config.packaged(scenario))
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process(scenario, seed)
        with world:
            return table.result(hil.fly_simulated(vehicle, world, urls, Path(directory) / "flight.mcap"))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", nargs="?", default="rocksat")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path, help="write every mission's result")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        flown = list(pool.map(partial(fly, arguments.scenario), seeds))
    if arguments.json:
        arguments.json.write_text(json.dumps(flown), encoding="utf-8")
    print(f"{len(flown)} seeds; bars: p95 of |error|, and {COVERAGE[0]:.0f}-{COVERAGE[1]:.0f} % of truths inside 95 %")
    print(f"{'':24}{'p95':>8}{'bar':>8}{'rms':>8}{'mean':>8}{'worst':>8}{'sigma':>8}{'covered':>9}")
    for index, mass in enumerate(flown[0]["masses"]):
        rows = [one["masses"][index] for one in flown]
        answered = [row for row in rows if row["supported"]]
        error = np.array([row["our_error_percent"] for row in answered])
        sigma = np.array([100 * row["sigma"] / row["truth"] for row in answered])
        covered = 100 * np.mean([row["covered"] for row in answered])
        print(
            f"{mass['label']:24}{np.percentile(abs(error), 95):7.2f}%{BARS[mass['quantity']]:7.1f}%"
            f"{np.sqrt(np.mean(error**2)):7.2f}%{np.mean(error):+7.2f}%{abs(error).max():7.2f}%{sigma.mean():7.2f}%"
            f"{covered:8.0f}%" + (f"  ({len(rows) - len(answered)} not answered)" if len(answered) < len(rows) else "")
        )
    for index, inertia in enumerate(flown[0]["inertias"]):
        rows = [one["inertias"][index] for one in flown]
        error = np.array([row["our_error_percent"] for row in rows if row["supported"]])
        spread = f"{np.sqrt(np.mean(error**2)):7.2f}%{np.mean(error):+7.2f}%"
        print(f"{inertia['label']:24}{np.percentile(abs(error), 95):7.2f}%{'':8}{spread}")
    print(f"every sample accounted for: {sum(one['accounted'] for one in flown)} of {len(flown)}")


if __name__ == "__main__":
    main()
