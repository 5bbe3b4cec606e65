"""Bodies without joints over seeds, by the commands of their pages: are the bars met, do 95 % intervals cover.

    python -m bench.bodies {planar,spherical} [--seeds 20] [--first 601]

``planar``: a body on an air-bearing table by its thrusters (docs/recordings.md), of ``bench/floating_bed.py``: valves
late by 0 to 0.5 s that stay shut below 20 to 70 ms, a tilted table. Each run is identified three times: by the file as
``heft init`` writes it, where inertia is as uncertain as the forces are alike; with one edit, the mass as weighed, to
0.5 %; and with noise and forces stated as they are.
``spherical``: ``heft hil spherical_bearing`` (docs/spherical_bearing.md). Exit code 1 where a bar is missed.
"""

import argparse
import contextlib
import io
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bench import floating_bed
from onboard import cli

COVERED: Final = (0.93, 0.98)
WEIGHED: Final = {"# mass_sigma": "mass_sigma"}
"""The one edit of the file that ``heft init --base planar`` writes: the URDF's mass is as weighed."""
AS_IT_IS: Final = WEIGHED | {
    "# common_force_sigma = 0.05 ": "common_force_sigma = 0.03 ",
    "scale_sigma = 0.05 ": "scale_sigma = 0.02 ",
    "position_noise_m = 5e-4": "position_noise_m = 3e-4",
    "yaw_noise_rad = 1e-3": "yaw_noise_rad = 6e-4",
}
EDITS: Final = {"as init writes it": {}, "mass weighed": WEIGHED, "all as it is": AS_IT_IS}


class ScoredAnswer(NamedTuple):
    """An answer beside the truth, SI."""

    name: str
    error: float
    sigma: float
    inside: bool
    scale: float  # what its bar is relative to


class Run(NamedTuple):
    """What one identification said."""

    seed: int
    verdict: str  # its level
    told: tuple[ScoredAnswer, ...]


class Bar(NamedTuple):
    """Largest error that an answer may have, over its scale."""

    said: str
    names: tuple[str, ...]
    most: float
    shown: str = "%"  # or a unit, "um"


INERTIA_1: Final = Bar("moments and products of inertia", ("I_xx", "I_yy", "I_zz", "I_xy", "I_xz", "I_yz"), 0.01)
OFFSET: Final = Bar("offset of the centre of mass", ("com_x", "com_y", "com_z"), 20e-6, "um")
INERTIA_3: Final = Bar("moment of inertia", ("I_zz",), 0.03)


def spherical(seed: int, directory: Path) -> Run:
    """One rehearsal; products of inertia are judged over the largest moment."""
    told = directory / f"{seed}.json"
    log = directory / f"{seed}.mcap"
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        cli.main(["hil", "spherical_bearing", "--seed", str(seed), "--json", str(told), "--log", str(log)])
    log.unlink()
    found = json.loads(told.read_text(encoding="utf-8"))
    rows = [row for row in (*found["centres"], *found["inertias"]) if not row["quantity"].startswith("move_")]
    largest = max(row["truth"] for row in found["inertias"])
    scale = {"com": 1.0, "I_x": largest, "I_y": largest, "I_z": largest}
    scales = {row["quantity"]: row["truth"] for row in rows if row["quantity"] in ("I_xx", "I_yy", "I_zz")}
    levels = [row["standing"] for row in rows]
    worst = next((level for name in ("do not use", "weak") for level in levels if level.startswith(name)), "good")
    return Run(
        seed,
        worst.split(":", maxsplit=1)[0],
        tuple(
            ScoredAnswer(
                name := row["quantity"],
                row["value"] - row["truth"],
                row["sigma"],
                row["covered"],
                scales.get(name, scale[name[:3]]),
            )
            for row in rows
            if row["supported"]
        ),
    )


def planar(bed: floating_bed.RecordedBed, seed: int, directory: Path, edits: dict[str, str]) -> Run:
    """One identification by the three commands of the page, the vehicle file edited by ``edits``."""
    floating_bed.write(bed, directory)
    lab, out = directory / "lab", directory / "told.json"
    names = ",".join(floating_bed.THRUSTERS)
    urdf = ["--urdf", str(directory / "body.urdf"), "--marker", "marker"]
    force = str(floating_bed.FORCE_N)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        assert cli.main(["init", str(lab), "--base", "planar", *urdf, "--thrusters", names, "--force", force]) == cli.OK
        vehicle = lab / "vehicle.toml"
        text = vehicle.read_text(encoding="utf-8")
        for old, new in edits.items():
            assert old in text, old
            text = text.replace(old, new)
        vehicle.write_text(text, encoding="utf-8")
        logs = directory / "logs"
        assert cli.main(["import", str(lab / "import.toml"), str(directory / "run.csv"), "-o", str(logs)]) == cli.OK
        cli.main(["identify", "--vehicle", str(vehicle), str(logs / "run.mcap"), "--json", str(out)])
    found = json.loads(out.read_text(encoding="utf-8"))["logs"][0]
    return Run(
        seed,
        found["verdict"]["level"],
        tuple(
            ScoredAnswer(
                one["name"],
                one["value"] - (true := bed.truth[one["name"]]),
                one["sigma"],
                one["low"] <= true <= one["high"],
                true if one["name"] in ("mass", "I_zz") else 1.0,
            )
            for one in found["quantities"]
            if one["supported"] and one["name"] in bed.truth
        ),
    )


def judged(runs: Sequence[Run], bars: Sequence[Bar], covered: tuple[float, float] | None) -> Iterator[tuple[str, bool]]:
    """Lines to print, each with whether its bar is met.

    Args:
        runs: of one kind, one at least.
        bars: on errors.
        covered: least and most share of all answers that are inside their 95 % intervals; printed only where None.
    """
    levels = [run.verdict for run in runs]
    counts = ", ".join(f"{levels.count(level)} {level}" for level in dict.fromkeys(sorted(levels)))
    yield f"{len(runs)} runs: {counts}", True
    for bar in bars:
        told = [(run.seed, one) for run in runs for one in run.told if one.name in bar.names]
        unit = {"%": 100.0, "um": 1e6}[bar.shown]
        missing = len(runs) * len(bar.names) - len(told)
        if not told:
            yield f"{bar.said}: not told", False
            continue
        seed, worst = max(told, key=lambda one: abs(one[1].error) / one[1].scale)
        most, inside = abs(worst.error) / worst.scale, sum(one.inside for _, one in told)
        limit, lost = f"{unit * bar.most:g}", f", {missing} not told" if missing else ""
        which = f"{worst.name}, seed {seed}; bar {limit}"
        said = (
            f"{bar.said}: largest error {unit * most:.3g} {bar.shown} ({which}), {inside} of {len(told)} inside{lost}"
        )
        yield said, most <= bar.most and not missing
    z = np.array([one.error / one.sigma for run in runs for one in run.told])
    share = float(np.mean([one.inside for run in runs for one in run.told]))
    band = f" (bar {covered[0]:.0%} to {covered[1]:.0%})" if covered else ""
    rms = np.sqrt((z**2).mean())
    said = f"all {len(z)} answers: {share:.1%} inside their 95 % intervals{band}, rms error {rms:.2f} of sigma"
    yield said, covered is None or covered[0] <= round(share, 3) <= covered[1]


def _show(lines: Iterable[tuple[str, bool]]) -> bool:
    met = True
    for said, fine in lines:
        print(f"  {said}{'' if fine else '  MISSED'}", flush=True)
        met = met and fine
    return met


def main() -> int:
    """Run the seeds, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("planar", "spherical"))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=601)
    parser.add_argument("--seconds", type=float, default=60.0, help="of a run on the table")
    asked = parser.parse_args()
    seeds, began = range(asked.first, asked.first + asked.seeds), time.process_time()
    runs: dict[str, list[Run]] = {}
    for seed in seeds:
        with tempfile.TemporaryDirectory() as where:
            if asked.kind == "spherical":
                runs.setdefault("spherical bearing", []).append(spherical(seed, Path(where)))
                continue
            bed = floating_bed.fly(seed, asked.seconds)
            for name, edits in EDITS.items():
                (own := Path(where) / name).mkdir()
                runs.setdefault(f"planar body, {name}", []).append(planar(bed, seed, own, edits))
    fine = []
    for name, every in runs.items():
        print(f"{name}, seeds {seeds[0]} to {seeds[-1]}")
        bars: tuple[tuple[Bar, ...], tuple[float, float] | None] = ((INERTIA_1, OFFSET), COVERED)
        if asked.kind == "planar":
            bars = (INERTIA_3,) * (name != "planar body, as init writes it"), None
        fine.append(_show(judged(every, *bars)))
    print(f"{(time.process_time() - began) / len(seeds):.1f} s of CPU time a seed")
    return 0 if all(fine) else 1


if __name__ == "__main__":
    sys.exit(main())
