"""A six-axis force-torque sensor that streams RDT records over UDP: ATI Net F/T, Ethernet Axia, OnRobot HEX.

Sources: ATI Industrial Automation, "Net F/T Installation and Operation Manual" (9620-05-NET FT), section 10, and
"Ethernet Axia Manual" (9610-05-Ethernet Axia), section 12. OnRobot's Compute Box: the maker's example
``highspeed_udp.c`` (github.com/jsbyysheng/onrobot_hex_ft_sensor, example/) and the BSD-licensed driver of 2016 by
OptoForce, since then OnRobot (etherdaq_ros): the same requests and records, set up by three further requests. Known
limits: the sensor serves one client at a time; when within the internal sample period a record is taken is not said;
ATI's software bias is not touched, OnRobot's is switched off; RDT carries no temperature; the bits of OnRobot's status
are not published, nor whether its sample counter begins anew with power alone.
"""

from drivers.net_ft.device import NetFt, NetFtChannel, NetFtConfig
from drivers.net_ft.record import RecordStream, request

__all__ = ["NetFt", "NetFtChannel", "NetFtConfig", "RecordStream", "request"]
