"""Longest step of the onboard estimator over a recorded flight, with the flight's URDF and with a wrong one.

    heft hil dymaflex --seed 3 --log LOG
    python -m bench.longest_step LOG [--mass 1.6]

Every step of the flight (its TICK records) is done again. ``--mass`` multiplies the masses and moments of inertia of
all links but the base: the windows are then not explained, so every hypothesis and every guess is tried. Times are of
the thread's CPU.
"""

import argparse
import re
import tempfile
import time
from pathlib import Path

import numpy as np

from bench import given
from onboard import config
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.identify.replay.replay import Pass, steps
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.recording.reader import LogReader


def wrong_urdf(text: str, factor: float) -> str:
    """The URDF with masses and moments of inertia of all links after the first multiplied."""
    head, *links = re.split(r"(?=<link\b)", text)

    def scaled(match: re.Match[str]) -> str:
        return f'{match[1]}"{float(match[2]) * factor:.9g}"'

    wrong = [re.sub(r'((?:mass value|i[xyz]{2})=)"([^"]+)"', scaled, link) for link in links[1:]]
    return "".join([head, *links[:1], *wrong])


def step_times_s(log: LogReader, vehicle: config.Vehicle) -> tuple[np.ndarray, Estimator]:
    """CPU time of each step of a flight."""
    estimator = Estimator(vehicle)
    rows = Pass(log, [*estimator.inputs, "tick"])
    times = []
    for step in steps(rows, estimator.inputs):
        began_s = time.thread_time()
        estimator.process(step.now_ns, step.batches, step.lag_ns, step.skipped_ns)
        times.append(time.thread_time() - began_s)
    return np.array(times), estimator


def main() -> None:
    """Print a line per URDF."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", type=given.log)
    parser.add_argument("--mass", type=float, default=1.6, help="factor on the links of the wrong URDF (default 1.6)")
    asked = parser.parse_args()
    log = LogReader(asked.log)
    for name, factor in (("as flown", 1.0), (f"links x {asked.mass:g}", asked.mass)):
        with tempfile.TemporaryDirectory() as directory:
            vehicle = vehicle_of(log, Path(directory))
            if factor != 1.0:
                urdf = Path(directory) / "wrong.urdf"
                urdf.write_text(wrong_urdf(vehicle.urdf_text, factor), encoding="utf-8")
                vehicle = config.load(vehicle.path, urdf)
            times, estimator = step_times_s(log, vehicle)
        worst = np.sort(times)[::-1]
        print(
            f"{name}: {len(times)} steps, longest {', '.join(f'{1e3 * t:.0f}' for t in worst[:4])} ms, "
            f"median {1e3 * np.median(times):.1f} ms, {times.sum():.1f} s in all; "
            f"quantities {sum(one.supported for one in estimator.online.estimate().quantities)} supported"
        )


if __name__ == "__main__":
    main()
