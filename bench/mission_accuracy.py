"""A mission over many seeds: how far off the answers are, and whether their intervals cover.

Run ``python bench/mission_accuracy.py [PLAN] [--seeds 100] [--first 1] [--jobs 2] [--out DIR]``: it flies
``bench/plans/PLAN.toml`` by ``heft campaign`` with these seeds, and prints what ``heft campaign report`` says, of each
level of the plan's factor if it has one.
``drawn`` is the part of sigma that the drawing's tolerances make, which no motion lowers: 1.96 of it bounds p95 from
below. Errors of inertias are those of the rows alone. With ``--out`` the data set and the page stay.
"""

import argparse
import os
import sys
import tempfile
import tomllib
from contextlib import ExitStack
from pathlib import Path

from onboard import cli

PLANS = Path(__file__).parent / "plans"
PLANNED = sorted(path.stem for path in PLANS.glob("*.toml"))


def main() -> int:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plan", nargs="?", default="rocksat", choices=PLANNED)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, help="directory of the campaign (default: none stays)")
    parser.add_argument("--json", type=Path, help="write the numbers of the report")
    arguments = parser.parse_args()
    with ExitStack() as stack:
        out = arguments.out or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        seeds = ["--first", str(arguments.first), "--seeds", str(arguments.seeds), "--jobs", str(arguments.jobs)]
        plan = PLANS / f"{arguments.plan}.toml"
        code = cli.main(["campaign", str(plan), "-o", str(out), *seeds])
        if code == cli.BAD_INPUT:
            return code
        more = ["--json", str(arguments.json)] if arguments.json else []
        factors = list(tomllib.loads(plan.read_text(encoding="utf-8")).get("factor", {}))
        more += ["--by", factors[0]] if len(factors) == 1 else []
        return max(code, cli.main(["campaign", "report", str(out), *more]))


if __name__ == "__main__":
    sys.exit(main())
