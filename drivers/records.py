"""One NumPy dtype per kind of channel, used by the ring, the log (row bytes) and the dump (column names).

Rules: little-endian, ``align=True`` (a row's bytes are its CDR body), field name = quantity (+ frame) + unit, raw
counts beside the scale they were taken with, no converted value in place of a raw one.

Every dtype begins with ``sequence`` and ``host_ns``:

``sequence``
    Number of this sample in its channel, from 0. Lost samples are counted too: a jump in ``sequence`` is a gap,
        described by a ``GAP`` record.
``host_ns``
    ``CLOCK_MONOTONIC`` of the arrival of the bytes at the host (for a frame the kernel's stamp, if there is one). It is
    not the time of the sample.
``tick``
    The device's clock: sample number since its start, SYNC number, timer count unwrapped. ``onboard.timebase``
    turns it into vehicle time.
"""

from enum import IntEnum, IntFlag
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.void]

_HEAD = [("sequence", "<u8"), ("host_ns", "<i8")]

IMU = np.dtype(
    [
        *_HEAD,
        ("tick", "<u8"),
        ("accel_scale_m_s2", "<f4"),  # specific force (a - g) per count: not an acceleration
        ("gyro_scale_rad_s", "<f4"),
        ("accel_raw", "<i2", (3,)),  # sensor axes x, y, z
        ("gyro_raw", "<i2", (3,)),
        ("temperature_raw", "<i2"),
        ("filter_code", "u1"),  # the device's code of its low-pass filter (MPU-6050: DLPF_CFG)
        ("sync", "u1"),  # 1: the sync pulse fell into this sample's period
        ("status", "u1"),  # SampleStatus
    ],
    align=True,
)

SCALAR = np.dtype(
    [
        *_HEAD,
        ("tick", "<u8"),
        ("value_raw", "<i8"),  # counts, unwrapped where the device's counter wraps
        ("scale", "<f8"),  # `unit` per count
        ("unit", "S8"),  # "rad", "rad/s", "N", "N m", "A", "1"
        ("sync_counter", "u1"),  # counter of the SYNC the sample answers; 0 where there is none
        ("device_status", "u1"),  # the device's status byte (CiA 404 6150h), 0 where there is none
        ("status", "u1"),  # SampleStatus
    ],
    align=True,
)

POSE = np.dtype(  # of a frame M of the vehicle in the tracker's frame L; numbers as they were sent
    [
        *_HEAD,
        ("tick", "<u8"),  # us of the tracker's clock
        ("position_m", "<f4", (3,)),  # of M's origin in L
        ("quaternion", "<f4", (4,)),  # w, x, y, z: v_L = q v_M q*
        ("covariance", "<f4", (21,)),  # the tracker's own, m^2, m rad, rad^2: upper triangle by rows; NaN: not given
        ("link_sequence", "u1"),  # the message's number
        ("status", "u1"),  # SampleStatus
    ],
    align=True,
)

CAN_SYNC = np.dtype([*_HEAD, ("tick", "<u8"), ("sync_counter", "u1")], align=True)

CAN_FRAME = np.dtype(  # sent by us; `host_ns`: when it was handed to the port
    [*_HEAD, ("cob_id", "<u2"), ("length", "u1"), ("data", "u1", (8,))], align=True
)

REGISTER_WRITE = np.dtype(  # likewise, to registers of a device
    [*_HEAD, ("address", "<u2"), ("length", "u1"), ("data", "u1", (12,))], align=True
)
SENT = CAN_FRAME, REGISTER_WRITE  # what we send has no rate

PULSE = np.dtype([*_HEAD, ("edge_ns", "<i8"), ("line_sequence", "<u4")], align=True)

GAP = np.dtype(
    [
        *_HEAD,
        ("first_missing", "<u8"),  # sequence numbers in `channel`, both ends included
        ("last_missing", "<u8"),
        ("duration_ns", "<i8"),
        ("channel", "S32"),
        ("cause", "S23"),
        ("counted", "u1"),  # 1: by a counter of the device or of a queue; 0: estimated, about as many are missing
    ],
    align=True,
)

EVENT = np.dtype([*_HEAD, ("severity", "u1"), ("code", "S31"), ("source", "S32"), ("text", "S160")], align=True)


class SampleStatus(IntFlag):
    """Why a sample may not be used; 0 is a good sample."""

    OK = 0
    SATURATED = 1
    NOT_VALID = 2  # reported by the device, or impossible: an event gives the reason
    AFTER_RESET = 4  # first sample after a restart of the device: its tick restarted


class Severity(IntEnum):
    """Severity of an event."""

    INFO = 0
    WARNING = 1
    ERROR = 2


class Batch(NamedTuple):
    """Rows of one channel, in the order the device made them."""

    channel: str
    rows: Rows


def event(now_ns: int, severity: Severity, code: str, source: str, text: str) -> Batch:
    """An EVENT row as a batch of the channel ``event``; its sequence number is set by the writer of the channel."""
    row = np.zeros(1, EVENT)
    row[0] = (0, now_ns, severity, code.encode(), source.encode(), text.encode()[:160])
    return Batch("event", row)


CHANGES_UNHEARD: Final = "changes_unheard"  # cause of a gap: at least so many, for nobody heard the device meanwhile


def gap(
    now_ns: int,
    channel: str,
    first_missing: int,
    last_missing: int,
    duration_ns: int,
    cause: str,
    *,
    counted: bool = False,
) -> Batch:
    """A GAP row as a batch of the channel ``gap``: samples ``first_missing..last_missing`` of ``channel`` are lost.

    ``counted``: the number is from a counter of the device or of a queue; else it is estimated.
    """
    row = np.zeros(1, GAP)
    row[0] = (0, now_ns, first_missing, last_missing, duration_ns, channel.encode(), cause.encode(), counted)
    return Batch("gap", row)
