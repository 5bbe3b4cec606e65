"""MARK record: the tick of a device's clock at which it saw an edge of the sync line.

The rules of ``drivers.records`` apply. An IMU flags the sample during which the edge fell (``IMU.sync``); a device that
latches a value on the edge, or stamps it with its own clock, writes MARK rows beside its samples. With the edge's time
on the sync line (PULSE), each mark is one point of that device's clock.
"""

import numpy as np

MARK = np.dtype(
    [
        ("sequence", "<u8"),
        ("host_ns", "<i8"),
        ("tick", "<u8"),  # same clock and unwrapping as the ticks of the device's samples
        ("pulse", "<u8"),  # the device's number of the edge, from 1; 0 where it does not count them
        ("value_raw", "<i8"),  # value latched on the edge, counts of its sample channel; 0 if none
    ],
    align=True,
)
