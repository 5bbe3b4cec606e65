"""Known delays, all in one place: filters of sensors and transmitters, and frames on the wire.

The flight removes them when samples are put on vehicle time; ``heft info`` lists them.
"""

from typing import NamedTuple

# DLPF_CFG 0..6: delay of the accelerometer's and of the gyroscope's low-pass filter, s (register map, register 26)
MPU6050_FILTER_DELAY_S = (
    (0.0, 0.98e-3),
    (2.0e-3, 1.9e-3),
    (3.0e-3, 2.8e-3),
    (4.9e-3, 4.8e-3),
    (8.5e-3, 8.3e-3),
    (13.8e-3, 13.4e-3),
    (19.0e-3, 18.6e-3),
)

NIMU_PACKET_BYTES = 38
QSB_LINE_BYTES = 26  # with spaces, stamp, CR and LF
QSB_MEASUREMENT_S = 100e-6
MODBUS_QUESTION_BYTES, MODBUS_ANSWER_BYTES = 8, 21  # eight registers, 40007 to 40014
DSC_ANSWER_BYTES = 8  # at the least: a sign, six characters and CR


class Delay(NamedTuple):
    """What is taken off the samples of ``channel``, and why; sigma 0: as good as the data sheet."""

    channel: str
    part: str  # "gyro", "accel" or "" for all of it
    delay_s: float
    sigma_s: float
    cause: str


def on_wire_s(count: int, baud: float) -> float:
    """Time that ``count`` bytes take on a serial line, 8N1."""
    return 10.0 * count / baud
