"""DYNAMIXEL X servos (protocol 2.0) on one TTL or RS-485 line, read, and sent goals where the vehicle file says so.

Sources: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0" and the control tables of the X series. Known limits: when a servo
samples what it answers is not said there, and lies anywhere between the request and its own answer; Present Current
is the motor's, of which the gear's friction is a part; over a loss of power whole turns of the horn are lost.
"""

from drivers.dynamixel.device import DynamixelBus
from drivers.dynamixel.packet import Block, Reply, answer_bytes, crc16, read_request, sync_read_request
from drivers.dynamixel.registers import DynamixelConfig, DynamixelTiming, Present, decode_identity, decode_present

__all__ = [
    "Block",
    "DynamixelBus",
    "DynamixelConfig",
    "DynamixelTiming",
    "Present",
    "Reply",
    "answer_bytes",
    "crc16",
    "decode_identity",
    "decode_present",
    "read_request",
    "sync_read_request",
]
