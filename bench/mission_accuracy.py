"""A mission over many seeds: how far off the onboard answer is, and whether its intervals cover.

Run ``python bench/mission_accuracy.py [SCENARIO] [--seeds 100] [--first 1] [--jobs 2]``. Every seed is a whole mission
in virtual time; all that is random is drawn anew, at the full noise of the scenario. Errors of masses are in percent,
others in the unit that ``heft hil`` shows. RockSat-X has bars; every mission is held to its coverage. Every seed builds
its own vehicle within the tolerances of the drawing; ``drawn`` is the part of sigma that they make, which no motion
lowers: 1.96 of it bounds p95 from below. Errors of inertias are those of the rows alone.
"""

import argparse
import json
import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from hil_sim.mission import open_in_process
from onboard import config
from onboard.flight import hil
from onboard.offline.views import mission_table as table

BARS = {"rocksat": {"m_arm": 2.0, "m_arm+m_tip_mass": 1.0, "m_tip_mass": 3.0}}  # percent, 95th percentile of |error|
WIDTHS = (9, 8, 9, 9, 9, 9, 10, 9, 9)
COVERAGE = (92.0, 98.0)


def fly(scenario: str, seed: int) -> dict[str, Any]:
    """One mission's result."""
    vehicle = config.load(config.packaged(scenario))
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process(scenario, seed)
        with world:
            return table.result(hil.fly_simulated(vehicle, world, urls, Path(directory) / "flight.mcap"))


def line(rows: Sequence[dict[str, Any]], percent: bool, bar: float | None) -> str:
    """One quantity over all missions; ``percent`` of the truth, or else in the unit that it is shown in."""
    answered = [row for row in rows if row["supported"]]
    name = f"{rows[0]['label']}, {'%' if percent else rows[0]['shown_in']}"
    if not answered:
        return f"{name:24}not answered by any"
    scale = np.array([100.0 / row["truth"] if percent else row["factor"] for row in answered])
    error = scale * np.array([row["value"] - row["truth"] for row in answered])
    sigma = np.array([row["sigma"] for row in answered]) * scale
    drawn = scale * np.array([row["drawn"] for row in answered])
    inside = np.abs(error) <= scale * np.array([row["high"] - row["value"] for row in answered])
    held = "" if bar is None else f"{bar:.1f}"
    told = f"  ({len(rows) - len(answered)} not answered)" if len(answered) < len(rows) else ""
    return (
        f"{name:24}{np.percentile(abs(error), 95):9.3f}{held:>8}{np.sqrt(np.mean(error**2)):9.3f}{np.mean(error):+9.3f}"
        f"{abs(error).max():9.3f}{sigma.mean():9.3f}{np.sqrt(np.mean((error / sigma) ** 2)):10.2f}"
        f"{100 * np.mean(inside):8.0f}%{drawn.mean():9.3f}{told}"
    )


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
    bars = BARS.get(arguments.scenario, {})
    print(f"{len(flown)} seeds; bars: p95 of |error|, and {COVERAGE[0]:.0f}-{COVERAGE[1]:.0f} % of truths inside 95 %")
    headings = ("p95", "bar", "rms", "mean", "worst", "sigma", "in sigma", "covered", "drawn")
    print(" " * 24 + "".join(f"{heading:>{width}}" for heading, width in zip(headings, WIDTHS, strict=True)))
    for group in ("masses", "centres", "inertias"):
        for index, first in enumerate(flown[0][group]):
            rows = [one[group][index] for one in flown]
            percent = group == "masses" or (group == "inertias" and bool(bars))
            print(line(rows, percent, bars.get(first["quantity"])))
    if flown[0]["capture"]:
        captures = [one["capture"] for one in flown]
        late_s = [one["said_s"][0] - one["true_s"] for one in captures if len(one["said_s"]) == 1]
        after = f"after {np.median(late_s):.2f} s, {max(late_s):.2f} s at worst" if late_s else ""
        print(f"capture told, once: {len(late_s)} of {len(flown)} {after}")
    print(f"every sample accounted for: {sum(one['accounted'] for one in flown)} of {len(flown)}")


if __name__ == "__main__":
    main()
