"""UTC of a log's instants, from the one wall-clock reading in its header."""

from collections.abc import Mapping

import numpy as np

FLIGHT_METADATA = "flight"
_EARLIEST_NS = int(np.datetime64("2020-01-01", "ns").astype(np.int64))
_LATEST_NS = 1 << 62


def utc_offset_ns(metadata: Mapping[str, Mapping[str, str]]) -> int | None:
    """What is added to vehicle time for UTC in ns since 1970.

    None for a log without a wall clock (a simulated flight), and where the reading is from before 2020: a computer
    without a battery begins at 1970 and had not been set.
    """
    facts = metadata.get(FLIGHT_METADATA, {})
    try:
        wall_ns, monotonic_ns = int(facts["wall_clock_ns"]), int(facts["monotonic_ns"])
    except (KeyError, ValueError):
        return None
    return wall_ns - monotonic_ns if _EARLIEST_NS <= wall_ns < _LATEST_NS and abs(monotonic_ns) < _LATEST_NS else None
