"""``python -m onboard.telemetry.span LOG BEGIN_NS END_NS PERIOD_NS``: rows of a log that are sent once more.

Events all, of each answer one in ``PERIOD_NS``, in the order of the log, as ``.npy`` arrays one after the other on the
standard output. A process of its own: reading a log takes memory, and longer than the sender may wait. The log is being
written meanwhile: what was written is read.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.records import EVENT
from onboard import channels
from onboard.recording.reader import LogReader

MOST_ROWS = 10_000
TOO_MANY = 4  # exit code
_NICENESS = 10  # more than that of the sender


def main(arguments: Sequence[str]) -> int:
    """Body of the process."""
    os.nice(_NICENESS)
    log, (begin_ns, end_ns, period_ns) = LogReader(Path(arguments[0])), map(int, arguments[1:])
    told: dict[bytes, int] = {}
    rows = 0
    for batch in log.batches(start_ns=begin_ns, end_ns=end_ns):
        if batch.rows.dtype == EVENT:
            found = batch.rows
        elif channels.is_quantity(batch.rows.dtype):
            found = batch.rows[[_is_due(row, told, period_ns) for row in batch.rows]]
        else:
            continue
        rows += len(found)
        if rows > MOST_ROWS:
            return TOO_MANY
        np.save(sys.stdout.buffer, found, allow_pickle=False)
    return 0


def _is_due(row: np.void, told: dict[bytes, int], period_ns: int) -> bool:
    name, at_ns = bytes(row["name"]), int(row["host_ns"])
    if not row["unit"] or at_ns - told.get(name, at_ns - period_ns) < period_ns:
        return False
    told[name] = at_ns
    return True


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
