"""heft for notebooks and scripts: logs as arrays and data frames, and the estimators on them.

    import heft

    log = heft.open("flight.mcap")
    log["imu_base"].to_pandas()      # SI, vectors in the URDF's frame, indexed by sample time
    log.estimates.to_pandas()        # onboard estimates
    heft.identify("flight.mcap")     # the onboard estimator, offline
    heft.subscribe("quantity")       # answers of the flight that is running

Re-exports of ``onboard.offline.api``; nothing is defined here.
"""

from onboard.offline.api.flight_log import FlightLog, LogChannel, open_log
from onboard.offline.api.identify import identify
from onboard.offline.api.subscribe import subscribe
from onboard.offline.api.table import ChannelTable
from onboard.offline.estimate_again.identify import Identification
from onboard.offline.estimate_again.reestimate import Reestimate
from onboard.offline.estimate_again.replay import Replay, replay

open = open_log  # noqa: A001  # heft.open reads as what it does

__all__ = [
    "ChannelTable",
    "FlightLog",
    "Identification",
    "LogChannel",
    "Reestimate",
    "Replay",
    "identify",
    "open",
    "replay",
    "subscribe",
]
