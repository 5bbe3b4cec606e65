"""A six-axis force-torque sensor of Bota Systems on a serial line: SensONE, MegaONE, Rokubi with a serial interface.

Sources: Bota Systems' example for Python, ``bota_serial_example.py`` (in github.com/tud-phi/bota_ft_sensors), and the
status bits of its ROS driver ``rokubimini_serial``; tried against its package ``bota-driver``. Known limits: when
within the averaging of its samples a frame's time stamp is taken is not said there; filters other than the sinc
(chopping, FIR, fast settling) stay off, the offset is not touched, nothing is saved in the sensor.
"""

from drivers.bota_ft.device import BotaFt, BotaFtConfig
from drivers.bota_ft.frame import FRAME, decode_frame, wrench_stream

__all__ = ["FRAME", "BotaFt", "BotaFtConfig", "decode_frame", "wrench_stream"]
