"""Control table of DYNAMIXEL X (addresses, models, units) and the configuration of servos on a line.

Source: ROBOTIS e-manual, pages of XM430-W350, XH430-V350, XL430-W250, XL330-M288, XW540-T260. The unit of Present
Velocity is 0.229 rev/min on all of them. Models that are not listed here need ``ampere_per_count``, and are read by
Sync Read.
"""

import struct
from dataclasses import dataclass
from math import tau
from typing import NamedTuple

from drivers.dynamixel.packet import LARGEST_ID
from drivers.errors import ConfigurationError, FrameError
from drivers.position import Position

IDENTITY, IDENTITY_BYTES = 0, 10  # Model Number, Model Information, Firmware Version, ID, Baud Rate, Return Delay Time
TEMPERATURE_LIMIT = 31
HARDWARE_ERROR = 70
PRESENT_POSITION = 132
PRESENT, PRESENT_BYTES = 126, 10  # Present Current (or Load), Velocity, Position: one block
HEALTH, HEALTH_BYTES = 144, 3  # Present Input Voltage, Present Temperature
DRIVEN_HEALTH, DRIVEN_HEALTH_BYTES = 64, 83  # from Torque Enable to them
SETTINGS, SETTINGS_BYTES = 10, 61  # Drive Mode to Hardware Error Status
DRIVE_MODE, OPERATING_MODE, HOMING_OFFSET, VELOCITY_LIMIT = 10, 11, 20, 44
MAX_POSITION, MIN_POSITION, SHUTDOWN, TORQUE_ENABLE, STATUS_LEVEL = 48, 52, 63, 64, 68
BUS_WATCHDOG, PROFILE_ACCELERATION, PROFILE_VELOCITY, GOAL_POSITION = 98, 108, 112, 116
DRIVEN, DRIVEN_BYTES = 98, 38  # Bus Watchdog to Present Position: what a servo that is driven is asked in every round
LARGEST_STEP = 1024  # between two samples, counts of the horn
COUNTS = 4096  # in a revolution of the horn
VELOCITY_RAD_S = 0.229 * tau / 60.0  # of a count
VELOCITY_COUNTS_S = 0.229 / 60.0 * COUNTS  # of a count of a velocity: positions a second
ACCELERATION_COUNTS_S2 = 214.577 / 3600.0 * COUNTS  # of a count of Profile Acceleration
ENCODER_ERROR = 0x08
FAULTS = {
    0x01: "input voltage out of its limits: check the supply",
    0x04: "overheated: let it cool down, load it less",
    ENCODER_ERROR: "its encoder fails: replace it",
    0x10: "electrical shock to its circuit, or too little power: check the supply",
    0x20: "overloaded: it holds more than it can for long",
}


class Model(NamedTuple):
    """What differs between models.

    Attributes:
        ampere: Of a count of Present Current; 0: it has Present Load there, or is not known.
        fast_from: Oldest firmware with Fast Sync Read; 256: none has it.
    """

    ampere: float
    fast_from: int


UNKNOWN = Model(0.0, 256)
_XM, _XH24, _X330, _X430_LOAD, _2X = Model(2.69e-3, 45), Model(1.34e-3, 45), Model(1e-3, 46), Model(0.0, 45), UNKNOWN
MODELS = {
    **dict.fromkeys((1000, 1010, 1020, 1030, 1100, 1110, 1120, 1130, 1170, 1180), _XM),  # XH430-W, XM430, X540, XW540
    **dict.fromkeys((1040, 1050), _XH24),  # XH430-V
    **dict.fromkeys((1190, 1200, 1210, 1220, 1230, 1240), _X330),  # XL330, XC330
    **dict.fromkeys((1060, 1070, 1080), _X430_LOAD),  # XL430, XC430
    **dict.fromkeys((1090, 1160), _2X),  # 2XL430, 2XC430
}


class DrivenState(NamedTuple):
    """What a servo that is driven says of itself in every round.

    Attributes:
        watchdog: Bus Watchdog: 0 off, FFh tripped, else as set.
        goal: Goal Position, counts.
        moving: Moving Status: bit 0 in position, bit 1 on a profile.
        velocity: Present Velocity, its counts.
        position: Present Position, counts.
    """

    watchdog: int
    goal: int
    moving: int
    velocity: int
    position: int


class Identity(NamedTuple):
    """Who a servo is, and how long it waits before it answers."""

    model: int
    firmware: int
    return_delay_us: int


class Present(NamedTuple):
    """One reading, counts."""

    current: int
    velocity: int
    position: int


def decode_identity(data: bytes) -> Identity:
    """Addresses 0 to 9. Raises FrameError: fewer bytes."""
    model, firmware, return_delay = _decoded("<H4xB2xB", data, IDENTITY)
    return Identity(model, firmware, 2 * return_delay)


def decode_present(data: bytes) -> Present:
    """Addresses 126 to 135, and more. Raises FrameError: fewer bytes."""
    return Present(*_decoded("<hii", data, PRESENT))


def decode_driven(data: bytes) -> DrivenState:
    """Addresses 98 to 135. Raises FrameError: fewer bytes."""
    return DrivenState(*_decoded("<B17xi3xB4xii", data, DRIVEN))


def _decoded(form: str, data: bytes, first: int) -> tuple[int, ...]:
    if len(data) < (needed := struct.calcsize(form)):
        raise FrameError(f"{len(data)} bytes, {needed} are needed: read addresses {first} to {first + needed - 1}")
    return struct.unpack_from(form, data)


@dataclass(frozen=True)
class DynamixelConfig:
    """One servo.

    Attributes:
        name: Channel of its position; those of velocity and current are ``NAME_velocity`` and ``NAME_torque``.
        id: Its ID on the line.
        counts_per_revolution: 4096 for each turn of the horn in one of the joint; negative: reversed direction.
        zero_count: Reading at joint angle zero, counts.
        velocity: Record its velocity too.
        torque: Record its current too.
        driven: It is sent goals: its Moving Status is recorded too, as ``NAME_status``.
        ampere_per_count: Unit of its current; by its model number where not given.

    Raises:
        ConfigurationError: A value out of range.
    """

    name: str
    id: int = 1
    counts_per_revolution: int = COUNTS
    zero_count: int = 0
    velocity: bool = False
    torque: bool = False
    driven: bool = False
    ampere_per_count: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.id <= LARGEST_ID:
            raise ConfigurationError(f"id = {self.id}: DYNAMIXEL IDs are 0 to {LARGEST_ID}")
        if not self.counts_per_revolution or (self.ampere_per_count is not None and not self.ampere_per_count > 0.0):
            raise ConfigurationError("counts_per_revolution is not 0, ampere_per_count more than 0: correct them")

    @property
    def channels(self) -> tuple[str, ...]:
        """Position, and what else is recorded."""
        others = [f"{self.name}_velocity"] * self.velocity + [f"{self.name}_torque"] * self.torque
        others += [f"{self.name}_status"] * self.driven
        return (self.name, *others)


@dataclass(frozen=True)
class DynamixelTiming:
    """How the servos of a line are asked, all at once.

    Attributes:
        sample_period_ms: Time between two requests; 0: as fast as the link allows.
        timeout_ms: How long an answer may take.
        poll_period_ms: How often the port is read; 0: the port waits.
        fast_sync_read: Use it where the firmware of all servos has it.
    """

    sample_period_ms: float = 5.0
    timeout_ms: float = 30.0
    poll_period_ms: float = 1.0
    fast_sync_read: bool = True


class BetweenRounds(NamedTuple):
    """What one servo is asked between samples, or sent (``data``)."""

    identifier: int
    address: int
    size: int
    data: bytes = b""
    is_driving: bool = False


class KnownServo:
    """What is known of a servo on a line."""

    def __init__(self, config: DynamixelConfig) -> None:
        self.config = config
        many_turns = abs(config.counts_per_revolution) > COUNTS
        self.position = Position(LARGEST_STEP, config.zero_count, 32 if many_turns else 12)
        self.is_there = False
        self.missed = 0
        self.identity = Identity(0, 0, 0)
        self.faults: int | None = 0  # None: the alert bit is set, and what it means is not read yet
        self.temperature_limit = 0
        self.is_hot = False

    @property
    def is_fast(self) -> bool:
        """Whether its firmware has Fast Sync Read."""
        return self.identity.firmware >= self._model.fast_from

    @property
    def _model(self) -> Model:
        return MODELS.get(self.identity.model, UNKNOWN)

    @property
    def health(self) -> tuple[int, int]:
        """Address and bytes of what is looked at once in a while."""
        return (DRIVEN_HEALTH, DRIVEN_HEALTH_BYTES) if self.config.driven else (HEALTH, HEALTH_BYTES)

    @property
    def ampere(self) -> float:
        """Of a count of Present Current, in the joint's direction; 0: unknown."""
        sign = 1.0 if self.config.counts_per_revolution > 0 else -1.0
        return sign * (self.config.ampere_per_count or self._model.ampere)
