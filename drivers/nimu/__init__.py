"""Memsense nIMU inertial measurement unit on RS-422: it streams packets from power-up and takes no commands.

Sources: DOC00290 rev J (packet, table 3; scale factors, table 1; conversion, section 4.3) and, for what it leaves open,
two public drivers (Gastd/memsense_nano_imu, srv/memsense_imu). Known limits: the 16-bit timer wraps every 0.142 s, so
the number of wraps during a loss comes from host time; there is no sync input, so its clock has no marks.
"""

from drivers.nimu.device import Nimu
from drivers.nimu.packet import NimuConfig, PacketStream
from drivers.nimu.timer import PacketTimer

__all__ = ["Nimu", "NimuConfig", "PacketStream", "PacketTimer"]
