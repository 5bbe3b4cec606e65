"""Messages of an axis. No port, no clock.

An identifier is the node (0 to 63) times 32, and the command; all numbers are little-endian.
"""

import struct
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from drivers.errors import FrameError
from drivers.ports import Station

HEARTBEAT, ENCODER_ESTIMATES, TORQUES = 0x01, 0x09, 0x1C
NODES, COMMANDS = 64, 32
COUNTS = 1 << 20  # of our rows in a revolution of the motor: an axis tells a float
CLOSED_LOOP = 8
INITIALIZING, MISSING_ESTIMATE = 0x1, 0x8
STATES = ("undefined", "idle", "startup", "calibration", "motor calibration", "sensorless", "index search")
ERRORS = {
    0x1: "initializing",
    0x2: "system level",
    0x4: "timing error",
    0x8: "missing estimate",
    0x10: "bad configuration",
    0x20: "driver fault",
    0x40: "missing input",
    0x100: "over-voltage",
    0x200: "under-voltage",
    0x400: "over-current of the supply",
    0x800: "too much current regenerated",
    0x1000: "current limit",
    0x2000: "motor too hot",
    0x4000: "inverter too hot",
    0x8000: "velocity limit",
    0x10000: "position limit",
    0x1000000: "watchdog",
    0x2000000: "emergency stop",
    0x4000000: "spinout",
    0x8000000: "brake resistor disarmed",
    0x10000000: "thermistor disconnected",
    0x40000000: "calibration",
}
_HEARTBEAT, _PAIR = struct.Struct("<IBBB"), struct.Struct("<ff")


class Heartbeat(NamedTuple):
    """Errors of an axis, by bits, and its state."""

    errors: int
    state: int


def split(identifier: int) -> tuple[int, int]:
    """Node and command."""
    return divmod(identifier, COMMANDS)


def decode_heartbeat(data: bytes) -> Heartbeat:
    """A heartbeat.

    Raises:
        FrameError: It has another length.
    """
    if len(data) not in (7, 8):
        raise FrameError(f"a heartbeat of {len(data)} bytes: is it an ODrive with firmware 0.6?")
    errors, state, _, _ = _HEARTBEAT.unpack_from(data)
    return Heartbeat(errors, state)


def decode_pair(data: bytes) -> tuple[float, float]:
    """Position [rev] and velocity [rev/s], or target and estimate of the torque [N m].

    Raises:
        FrameError: It has another length.
    """
    if len(data) != _PAIR.size:
        raise FrameError(f"estimates of {len(data)} bytes in place of 8: is it an ODrive?")
    first, second = _PAIR.unpack(data)
    return first, second


def heard(frames: Mapping[int, bytes]) -> Iterator[Station]:
    """Axes on a bus, by the last frame of each identifier: those that send heartbeats and estimates."""
    for node in range(NODES):
        beat, pair = (frames.get(node * COMMANDS + command, b"") for command in (HEARTBEAT, ENCODER_ESTIMATES))
        if len(beat) == len(pair) == _PAIR.size:
            torques = node * COMMANDS + TORQUES in frames
            yield Station(node, f"ODrive, {'position and torque' if torques else 'position; it sends no torques'}")
