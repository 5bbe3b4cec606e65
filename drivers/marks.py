"""MARK: a device saw an edge of the sync line, and says at which tick of its own clock.

The rules of ``drivers.records`` hold. An IMU flags the sample that the edge fell into (``IMU.sync``); a device that
latches something on the edge, or stamps it with its own clock, says so in a channel of MARK rows beside its samples.
With the edge's time on the sync line (PULSE) each mark is one point of that device's clock.
"""

import numpy as np

MARK = np.dtype(
    [
        ("sequence", "<u8"),
        ("host_ns", "<i8"),
        ("tick", "<u8"),  # the same clock, unwrapped the same way, as the ticks of the device's samples
        ("pulse", "<u8"),  # the device's own number of the edge, from 1; 0 where it does not count them
        (
            "value_raw",
            "<i8",
        ),  # what it latched on the edge, in counts of its sample channel; 0 where it latches nothing
    ],
    align=True,
)
