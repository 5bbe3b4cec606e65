"""heft for notebooks and scripts: logs as arrays and data frames, and the estimators on them.

    import heft

    log = heft.open("flight.mcap")
    log["imu_base"].to_pandas()      # SI, vectors in the URDF's frame, indexed by sample time
    log.estimates.to_pandas()        # onboard estimates
    heft.identify("flight.mcap")     # the onboard estimator, offline
    heft.subscribe("quantity")       # answers of the flight that is running

Re-exports of ``onboard.ground.api``; nothing is defined here.
"""

from onboard.ground.api.flight_log import ChannelTable, FlightLog, LogChannel, open_log
from onboard.ground.api.identify import identify
from onboard.ground.api.subscribe import subscribe
from onboard.ground.identify.identify import Identification
from onboard.ground.identify.replay.replay import Reestimate, Replay, replay

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
