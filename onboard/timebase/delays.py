"""Known delays: filters of sensors and transmitters, and frames on the wire; each kind of device gives its own.

The flight removes them when samples are put on vehicle time; ``heft info`` lists them.
"""

from typing import NamedTuple


class Delay(NamedTuple):
    """What is taken off the samples of ``channel``, and why; sigma 0: as good as the data sheet.

    ``clock``: whose arrivals it is of, and so the error of all that arrives there; empty: it is of no arrival.
    """

    channel: str
    part: str  # "gyro", "accel" or "" for all of it
    delay_s: float
    sigma_s: float
    cause: str
    clock: str = ""


def on_wire_s(count: int, baud: float) -> float:
    """Time that ``count`` bytes take on a serial line, 8N1."""
    return 10.0 * count / baud
