"""A six-axis force-torque sensor that streams RDT records over UDP: ATI Net F/T, Ethernet Axia and compatible ones.

Sources: ATI Industrial Automation, "Net F/T Installation and Operation Manual" (9620-05-NET FT), section 10, and
"Ethernet Axia Manual" (9610-05-Ethernet Axia), section 12. Known limits: the sensor serves one client at a time;
when within the internal sample period a record is taken is not said there; its software bias is not touched.
"""

from drivers.net_ft.device import NetFt, NetFtChannel, NetFtConfig
from drivers.net_ft.record import RecordStream, request

__all__ = ["NetFt", "NetFtChannel", "NetFtConfig", "RecordStream", "request"]
