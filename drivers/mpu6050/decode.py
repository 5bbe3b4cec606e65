"""Decodes MPU-6050 FIFO bytes into IMU rows, all packets of a transfer at once. No port, no clock.

A packet is seven big-endian int16 in register order (RM 4.32, FIFO_R_W): accel x, y, z, temperature, gyro x, y, z.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.errors import FrameError
from drivers.mpu6050.registers import Mpu6050Config
from drivers.records import IMU, Rows, SampleStatus

PACKET_BYTES = 14
TEMPERATURE_JUMP = 400  # counts, 1.2 degC: above any die's change in one sample period

_ACCEL, _TEMPERATURE, _GYRO = slice(0, 3), 3, slice(4, 7)
_HIGHEST, _LOWEST = b"\x7f\xff", b"\x80\x00"  # words, as they are sent


def decode_packets(data: bytes, config: Mpu6050Config) -> Rows:
    """Whole packets as IMU rows; ``sequence``, ``host_ns`` and ``tick`` are 0 and set by the device.

    Args:
        data: Bytes of the FIFO, beginning with a packet.
        config: Configuration they were sampled with.

    Returns:
        Rows of ``records.IMU``, one a packet. ``sync`` is bit 0 of the temperature (EXT_SYNC_SET = 1), which stays
        part of ``temperature_raw``; ``status`` is SATURATED where an inertial word is at either end of its range.

    Raises:
        FrameError: The length is not a whole number of packets.
    """
    if len(data) % PACKET_BYTES:
        raise FrameError(f"{len(data)} bytes are no whole number of 14-byte FIFO packets: resynchronise the FIFO")
    words = np.frombuffer(data, ">i2").astype("<i2").reshape(-1, 7)  # (n, 7)
    rows = np.zeros(len(words), IMU)
    rows["accel_scale_m_s2"] = config.accel_scale_m_s2
    rows["gyro_scale_rad_s"] = config.gyro_scale_rad_s
    rows["accel_raw"] = words[:, _ACCEL]
    rows["gyro_raw"] = words[:, _GYRO]
    rows["temperature_raw"] = words[:, _TEMPERATURE]
    rows["filter_code"] = config.filter_code
    rows["sync"] = words[:, _TEMPERATURE] & 1
    if _HIGHEST in data or _LOWEST in data:  # or halves of two words that look like it
        at_limit = (words == 32767) | (words == -32768)
        at_limit[:, _TEMPERATURE] = False
        rows["status"] = at_limit.any(axis=1) * np.uint8(SampleStatus.SATURATED)
    return rows


def first_misaligned(temperature_raw: NDArray[np.int16], before: int | None) -> int | None:
    """Index of the first sample with an impossible temperature step, a sign that the packet boundary slipped.

    Args:
        temperature_raw: Temperature words of successive samples, shape (n,).
        before: Temperature word of the sample before them; None if there is none.

    Returns:
        Index of the first sample that differs by more than ``TEMPERATURE_JUMP`` from the one before; None if none.
    """
    words = temperature_raw.tolist()  # they are few: faster than through arrays
    every = words if before is None else [before, *words]
    if every and max(every) - min(every) <= TEMPERATURE_JUMP:
        return None
    for place, word in enumerate(words):
        if before is not None and abs(word - before) > TEMPERATURE_JUMP:
            return place
        before = word
    return None
