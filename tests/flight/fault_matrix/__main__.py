"""Every fault of the vocabulary on every device, flown: what is said, who else suffers, how it ends.

``python -m tests.flight.fault_matrix docs/evidence/faults.md`` flies them all and writes the table, ``--check``
compares it. Exit code 1: it differs, or a promise of ``cells`` is not kept. A flight has room for two faults of
different devices, one in each sweep, far enough apart that what is said after one is not about the other.
"""

import argparse
import difflib
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy loads: results do not hang on the core count

from tests.flight.fault_matrix.flights import flights
from tests.flight.fault_matrix.report import document, flown


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("document", type=Path)
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="flights at a time")
    arguments = parser.parse_args()
    done = []
    with ProcessPoolExecutor(arguments.jobs, multiprocessing.get_context("spawn")) as pool:
        for flight in pool.map(flown, flights()):
            done.append(flight)
            sys.stdout.writelines(f"{text}\n" for text in flight.broken)
    made = document(done)
    is_broken = any(flight.broken for flight in done)
    if not arguments.check:
        arguments.document.write_text(made, encoding="utf-8")
        return int(is_broken)
    before = arguments.document.read_text(encoding="utf-8")
    sys.stdout.writelines(difflib.unified_diff(before.splitlines(True), made.splitlines(True), "committed", "flown"))
    return int(is_broken or made != before)


if __name__ == "__main__":
    sys.exit(main())
