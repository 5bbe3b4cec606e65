"""Decodes the FIFO bytes of an inertial chip into IMU rows, all packets of a transfer at once. No port, no clock.

A packet is seven big-endian int16 in the order of the chip's registers; a pulse on its FSYNC pin marks bit 0 of the
temperature (EXT_SYNC_SET = 1).
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.errors import FrameError
from drivers.records import IMU, Rows, SampleStatus

PACKET_BYTES = 14
TEMPERATURE_JUMP = 400  # counts, 1.2 degC at 330 counts/K: above any die's change in one sample period

_HIGHEST, _LOWEST = b"\x7f\xff", b"\x80\x00"  # words, as they are sent


class WordOrder(NamedTuple):
    """Words of a packet."""

    accel: slice
    temperature: int
    gyro: slice


class Sampling(Protocol):
    """How samples are made and fetched: a chip's configuration."""

    @property
    def accel_scale_m_s2(self) -> float:
        """Specific force per count, m/s^2."""

    @property
    def gyro_scale_rad_s(self) -> float:
        """Angular rate per count, rad/s."""

    @property
    def sample_period_ns(self) -> int:
        """Nominal sample period, ns."""

    @property
    def filter_code(self) -> int:
        """The chip's code of its low-pass filter."""

    @property
    def poll_period_ms(self) -> float:
        """Time between two drains of the FIFO."""

    @property
    def max_transfer_bytes(self) -> int:
        """Longest single read."""


def decode_words(data: bytes, order: WordOrder, config: Sampling) -> Rows:
    """Whole packets as IMU rows; ``sequence``, ``host_ns`` and ``tick`` are 0 and set by the device.

    Args:
        data: Bytes of the FIFO, beginning with a packet.
        order: Of the words of a packet.
        config: Configuration they were sampled with.

    Returns:
        Rows of ``records.IMU``, one a packet. ``sync`` is bit 0 of the temperature, which stays part of
        ``temperature_raw``; ``status`` is SATURATED where an inertial word is at either end of its range.

    Raises:
        FrameError: The length is not a whole number of packets.
    """
    if len(data) % PACKET_BYTES:
        raise FrameError(f"{len(data)} bytes are no whole number of 14-byte FIFO packets: resynchronise the FIFO")
    words = np.frombuffer(data, ">i2").astype("<i2").reshape(-1, 7)  # (n, 7)
    rows = np.zeros(len(words), IMU)
    rows["accel_scale_m_s2"] = config.accel_scale_m_s2
    rows["gyro_scale_rad_s"] = config.gyro_scale_rad_s
    rows["accel_raw"] = words[:, order.accel]
    rows["gyro_raw"] = words[:, order.gyro]
    rows["temperature_raw"] = words[:, order.temperature]
    rows["filter_code"] = config.filter_code
    rows["sync"] = words[:, order.temperature] & 1
    if _HIGHEST in data or _LOWEST in data:  # or halves of two words that look like it
        at_limit = (words == 32767) | (words == -32768)
        at_limit[:, order.temperature] = False
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
