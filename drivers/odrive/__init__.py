"""Axes of ODrive motor controllers on CAN, by the messages that they send unasked (CANSimple); read, never commanded.

Source: ODrive's published table of messages, ``odrive-cansimple.dbc`` for firmware 0.6.10. Known limits: when within
its control cycle an estimate is taken is not said there; messages carry no number and no time.
"""

from drivers.odrive.device import OdriveAxis, Odrives
from drivers.odrive.message import COUNTS, decode_heartbeat, decode_pair

__all__ = ["COUNTS", "OdriveAxis", "Odrives", "decode_heartbeat", "decode_pair"]
