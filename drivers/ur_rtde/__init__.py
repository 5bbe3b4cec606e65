"""A Universal Robots controller by RTDE over TCP: angles, rates, currents and wrench are read, nothing is commanded.

Sources: Universal Robots, "Real-Time Data Exchange (RTDE) Guide", protocol version 2. Known limits: when within a
control cycle the joints are sampled is not said there; ``actual_TCP_force`` has what the controller believes to be the
payload and the tool taken off, ``ft_raw_wrench`` (e-Series) has not.
"""

from drivers.ur_rtde.device import RtdeConfig, UrRtde
from drivers.ur_rtde.packet import PackageStream, RtdeChannel, decode_recipe, decode_text

__all__ = ["PackageStream", "RtdeChannel", "RtdeConfig", "UrRtde", "decode_recipe", "decode_text"]
