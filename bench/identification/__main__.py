"""Identification against its bars, case by case; the truth is MuJoCo's or a real recording's.

Run ``python -m bench.identification CASE ...``:

- ``noise``: a payload of 1, 5, 20 kg on a free-flyer's arm, base IMU at its datasheet's noise and nothing else wrong;
- ``real``: the same with scale 0.3 %, axes 0.2 deg, bias and its drift, time, base mass 0.3 % and inertia 1 %, links
  1 %, the shapes of the workshop tools scaled to 1 to 20 kg (data sets in $HEFT_DATASETS or ../shared/datasets);
- ``recursive``: the flights of both through the recursive estimator, beside the maximum likelihood; time of a tick;
- ``capture``: a payload captured at an unknown time, and false alarms over hours without one;
- ``linear``: the flights of ``noise`` by rows: plain least squares, less the known noise, instrumental variables;
- ``planar``: 5 kg on an air-bearing table, wrong all that ``real`` has, the table's level, and a puck that drags.

Other cases are campaigns: ``python bench/mission_accuracy.py coverage|lies|tools``.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from collections.abc import Callable
from pathlib import Path

from bench.identification import capture, free_flyer, linear, planar, recursive

CASES: dict[str, Callable[[argparse.Namespace], None]] = {
    "noise": free_flyer.noise,
    "real": free_flyer.real,
    "recursive": recursive.run,
    "capture": capture.run,
    "linear": linear.linear,
    "planar": planar.run,
}


def main() -> None:
    """Print the tables of the cases asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="+", choices=CASES)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--datasets", type=Path, default=Path(os.environ.get("HEFT_DATASETS", "../shared/datasets")))
    arguments = parser.parse_args()
    for case in arguments.cases:
        CASES[case](arguments)


if __name__ == "__main__":
    main()
