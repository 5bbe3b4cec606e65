"""A DYNAMIXEL X servo that is given goal positions: its set-up, its answers, and what is written to command it.

Every value is read back. Set-up checks Status Return Level (68), Shutdown (63), Homing Offset (20), Velocity Limit (44)
and Hardware Error Status (70), and writes Drive Mode (10), Operating Mode (11), position limits (48, 52), Profile
Acceleration and Velocity (108, 112); what is kept without supply is written where it differs, with the torque off only.
Operating Mode is 3, whose limits the servo keeps itself, where the joint's range is within one turn of the horn, else
4, which has none. Goals are one Sync Write for all servos, which nobody acknowledges: each round reads them back.

Bus Watchdog (98) stops a servo that hears no instruction for so long: it keeps its torque, and takes no goal until
the watchdog is cleared. In mode 4 with a homing offset firmware was seen to move instead (ROBOTIS-GIT/DynamixelSDK
issue 584): refused. No quick stop is in the table: the goal is where the servo gets to rest by its Profile
Acceleration. Nothing brakes a servo without torque.
"""

import math
from collections import deque
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

import numpy as np

from drivers.dynamixel import registers as table
from drivers.dynamixel.packet import ALERT, ERRORS, Block
from drivers.dynamixel.registers import DrivenState, DynamixelConfig
from drivers.errors import ConfigurationError
from drivers.play.axis import RATE_SLACK, Axis, AxisConfig
from drivers.play.player import LATENCY
from drivers.records import REGISTER_WRITE, Severity
from drivers.reporter import Reporter

WATCHDOG_MS: Final = 20  # of a count
TRIPPED: Final = 0xFF  # what Bus Watchdog reads then
POSITION_MODE, EXTENDED_POSITION_MODE = 3, 4
NOT_IN_DRIVE_MODE: Final = 0x0C  # Torque On by Goal Update, Time-based Profile
SHUTS_DOWN: Final = 0x34  # Overload, Electrical Shock, Overheating: the defaults of all X servos
EVERY_INSTRUCTION: Final = 2  # of Status Return Level
IN_POSITION, ON_PROFILE = 0x01, 0x02  # of Moving Status


class RegisterTransfer(NamedTuple):
    """Read ``wanted`` bytes, or write ``data``."""

    address: int
    wanted: int
    data: bytes = b""


Script = Generator[RegisterTransfer, bytes, None]


@dataclass(frozen=True)
class DynamixelAxisConfig(AxisConfig):
    """A servo that is driven.

    Attributes:
        drive: What is read from it.
    """

    drive: DynamixelConfig

    @property
    def is_single_turn(self) -> bool:
        """Whether its range is within one turn of the horn, so that the servo keeps its limits itself."""
        return abs(self.drive.counts_per_revolution) <= table.COUNTS and self.low >= 0 and self.high < table.COUNTS


class RequestRounds:
    """Numbers the rounds of requests, as ``drivers.play.axis.Ticks``.

    A round that is late, as other requests were before it, is the next one: the motion waits for it. Rounds that
    are missing for longer than a limit have numbers, which nobody has sent goals for.

    Args:
        period_ns: Between two.
        limit_ns: How late one may be.

    Attributes:
        instant: When the last was asked, in periods.
    """

    WHAT: ClassVar[str] = "answer"

    def __init__(self, period_ns: int, limit_ns: int) -> None:
        self.period_ns, self._limit_ns = period_ns, limit_ns
        self.instant = 0.0
        self.tick: int | None = None
        self.host_ns = self._asked_ns = 0

    def answered(self, asked_ns: int, host_ns: int) -> None:
        """A round was answered."""
        elapsed_ns = asked_ns - self._asked_ns
        ahead = 1 if elapsed_ns <= self._limit_ns else round(elapsed_ns / self.period_ns)
        self.instant = asked_ns / self.period_ns
        self.tick = 0 if self.tick is None else self.tick + ahead
        self._asked_ns, self.host_ns = asked_ns, host_ns


class DynamixelAxis(Axis):
    """One servo, as its master has it.

    Args:
        config: The servo.
        rounds: Numbers the rounds, which its positions are of.
        watchdog_ms: How long it does without an instruction.
        is_profile: It makes profiles between way points.
        report: Where its events and what it is sent go.

    Raises:
        ConfigurationError: A watchdog that it cannot have.
    """

    SHOWS: ClassVar = "Moving Status"

    def __init__(
        self, config: DynamixelAxisConfig, rounds: RequestRounds, watchdog_ms: int, is_profile: bool, report: Reporter
    ) -> None:
        super().__init__(config, rounds)
        self.config: DynamixelAxisConfig = config
        self._rounds = rounds
        self._watchdog, self._is_profile, self._report = math.ceil(watchdog_ms / WATCHDOG_MS), is_profile, report
        if not 1 <= self._watchdog <= 127:
            raise ConfigurationError(f"{self.name}: its watchdog has 20 to 2540 ms, not {watchdog_ms} ms")
        self._is_set_up = self._is_enabled = self._stands = self._has_way_point = False
        self._torque: bool | None = None
        self._failed = ""
        self._alert, self._said = False, DrivenState(0, 0, 0, 0, 0)
        self._heard_ns = 0
        self._script: Script | None = None
        self._transfer: RegisterTransfer | None = None
        self._pending: tuple[int, bytes] | None = None
        self._goals: deque[int] = deque(maxlen=LATENCY + 1)  # the servo has one of them
        self._stop_goal: int | None = None
        self._rows: list[tuple[int, int, int, int, list[int]]] = []
        self._sequence = 0

    # Transfers

    @property
    def transfer(self) -> RegisterTransfer | None:
        """What it is to be asked now."""
        return self._transfer

    def found(self) -> None:
        """It has said who it is, after it was silent or at the start: it has to be set up."""
        self._is_set_up = self._is_enabled = False
        self._torque, self._failed = None, ""
        self._forget()
        self._begin(self._set_up())

    def asked(self, transfer: RegisterTransfer) -> None:
        """A transfer of it is on the wire."""
        if transfer.data:
            self._note(transfer.address, transfer.data)

    def answered(self, block: Block) -> None:
        """The answer to its transfer."""
        error = block.error & ~ALERT
        if error and self._transfer is not None:
            why = f"it refuses address {self._transfer.address} ({ERRORS.get(error, 'unknown error')})"
            self._fail(f"{self.name} cannot be driven safely: {why}")
        else:
            self._go_on(block.data)

    def lost(self) -> None:
        """It is silent: a transfer, which is repeated as long as it is there, is given up."""
        self._begin(None)

    def _begin(self, script: Script | None) -> None:
        self._script, self._transfer = script, None
        if script is not None:
            self._go_on(None)

    def _go_on(self, data: bytes | None) -> None:
        if self._script is None:
            return
        try:
            self._transfer = next(self._script) if data is None else self._script.send(data)
        except StopIteration:
            self._script = self._transfer = None
        except ConfigurationError as error:
            self._fail(str(error))

    def _fail(self, why: str) -> None:
        self._script = self._transfer = None
        self._failed = why
        self._report.event(self.now_ns, Severity.ERROR, "configuration", why, self.name)

    def _set_up(self) -> Script:
        config, wanted = self.config, self._kept_values()
        said = yield RegisterTransfer(table.SETTINGS, table.SETTINGS_BYTES)
        self._torque = _of(said, table.TORQUE_ENABLE, 1) != 0
        for why in self._refusals(said):
            raise ConfigurationError(f"{self.name} cannot be driven safely: {why}")
        mode = _of(said, table.DRIVE_MODE, 1)
        wanted = [(table.DRIVE_MODE, 1, mode & ~NOT_IN_DRIVE_MODE), *wanted]
        if self._torque:  # of an earlier flight: it may be under way
            yield from self._write(table.BUS_WATCHDOG, 1, 0)
            data = yield RegisterTransfer(table.PRESENT_POSITION, 4)
            position = int.from_bytes(data, "little", signed=True)
            yield from self._write(table.GOAL_POSITION, 4, self._placed(position))
        for address, size, value in wanted:
            found = _of(said, address, size)
            if found != value and self._torque:
                text = f"address {address} is {found}, not {value}, and its torque is on"
                raise ConfigurationError(f"{self.name}: {text}: switch that off with its tool; the arm may fall")
            if found != value:
                yield from self._write(address, size, value)
        yield from self._write(table.BUS_WATCHDOG, 1, 0)
        rate = config.rate if self._is_profile else RATE_SLACK * config.rate
        yield from self._write(table.PROFILE_ACCELERATION, 4, _acceleration(config.acceleration) * self._is_profile)
        yield from self._write(table.PROFILE_VELOCITY, 4, _velocity(rate))
        self._is_set_up = True

    def _kept_values(self) -> list[tuple[int, int, int]]:
        """Address, size and value of what it keeps without supply."""
        if not self.config.is_single_turn:
            return [(table.OPERATING_MODE, 1, EXTENDED_POSITION_MODE)]
        limits = [(table.MAX_POSITION, 4, self.config.high), (table.MIN_POSITION, 4, self.config.low)]
        return [(table.OPERATING_MODE, 1, POSITION_MODE), *limits]

    def _refusals(self, said: bytes) -> Iterator[str]:
        if error := _of(said, table.HARDWARE_ERROR, 1):
            yield f"it reports hardware error {error:02X}h: see to its cause, and reboot it"
        if (level := _of(said, table.STATUS_LEVEL, 1)) != EVERY_INSTRUCTION:
            yield f"its Status Return Level (68) is {level}: write 2, so that it acknowledges what is written"
        if _of(said, table.SHUTDOWN, 1) & SHUTS_DOWN != SHUTS_DOWN:
            yield "its Shutdown (63) leaves out overload, shock or heat: write 52"
        if not self.config.is_single_turn and _of(said, table.HOMING_OFFSET, 4):
            yield "its Homing Offset (20) is not 0, with which its watchdog can move it: write 0, and zero_count"
        fastest = _of(said, table.VELOCITY_LIMIT, 4) * table.VELOCITY_COUNTS_S
        if fastest < self.config.rate:
            needed = math.ceil(self.config.rate / table.VELOCITY_COUNTS_S)
            yield f"its Velocity Limit (44) is too low: {needed} is needed; or give a smaller [drive] rate_rad_s"

    def _enabling(self) -> Script:
        """The goal is where it stands, before the torque comes."""
        yield from self._write(table.GOAL_POSITION, 4, self._held(self.position or 0))
        yield from self._write(table.BUS_WATCHDOG, 1, self._watchdog)
        self._torque = None  # until it is known to have it
        yield from self._write(table.TORQUE_ENABLE, 1, 1)
        self._torque = self._is_enabled = True
        self._goals.clear()

    def _releasing(self) -> Script:
        yield from self._write(table.TORQUE_ENABLE, 1, 0)
        self._torque = self._is_enabled = False

    def _write(self, address: int, size: int, value: int) -> Script:
        """Write a value, and read it back."""
        yield RegisterTransfer(address, 0, value.to_bytes(size, "little", signed=size > 1))
        data = yield RegisterTransfer(address, size)
        if (found := int.from_bytes(data, "little", signed=size > 1)) != value:
            raise ConfigurationError(f"{self.name}: address {address} keeps {found}, not {value}: it is not driven")

    # What it says

    def on_round(self, host_ns: int, error: int, said: DrivenState) -> None:
        """What it answered in a round."""
        self._heard_ns, self._alert, self._said = host_ns, bool(error & ALERT), said
        self._is_at(self._placed(said.position), self._rounds.instant)

    def on_torque(self, is_on: bool) -> None:
        """Torque Enable, read between rounds."""
        if self._is_enabled and not is_on:
            self._failed = "has lost its torque, without an error: does another master write to it?"

    def _placed(self, position: int) -> int:
        """In one turn, where that is its range: without torque it counts on, across 4095."""
        if not self.config.is_single_turn:
            return position
        least = (self.config.low + self.config.high) // 2 - table.COUNTS // 2
        return least + (position - least) % table.COUNTS

    @property
    def is_ready(self) -> bool:
        """See ``Axis``."""
        return self._is_set_up and self.position is not None

    @property
    def heard_ns(self) -> int:
        """See ``Axis``."""
        return self._heard_ns

    @property
    def is_enabled(self) -> bool:
        """See ``Axis``."""
        return self._is_enabled and not self._stands

    @property
    def may_move(self) -> bool:
        """See ``Axis``."""
        return self._torque is not False and not self._stands

    @property
    def shown(self) -> str:
        """See ``Axis``."""
        return f"{self._said.moving:02X}h"

    @property
    def has_taken(self) -> bool:
        """See ``Axis``: its goal is read back."""
        return self._has_way_point and self._said.goal == self._goals[-1]

    @property
    def has_arrived(self) -> bool:
        """See ``Axis``."""
        there = self._said.moving & (IN_POSITION | ON_PROFILE) == IN_POSITION
        return there and bool(self._goals) and self._said.goal == self._goals[-1]

    def not_to_be_armed(self) -> str:
        """See ``Axis``."""
        return "reports a hardware error: reboot it with its tool" if self._alert else ""

    def broken(self) -> str:
        """See ``Axis``."""
        if self._failed:
            return self._failed.removeprefix(f"{self.name} ").removeprefix(f"{self.name}: ")
        if not self._is_set_up:
            return "was set up again: it had rebooted, or was silent"
        if self._alert:
            return "reports a hardware error"
        if self._said.watchdog == TRIPPED:
            return f"has stopped itself: it heard nothing for {self._watchdog * WATCHDOG_MS} ms (98)"
        return ""

    def astray(self) -> Iterator[str]:
        """See ``Axis``."""
        if not self._is_enabled:
            yield "has no torque"
        if self._said.watchdog != self._watchdog:
            yield f"has {self._said.watchdog} for a watchdog (98), not {self._watchdog}: it rebooted"
        if len(self._goals) == self._goals.maxlen and self._said.goal not in self._goals:
            yield f"takes no goals: it has {self._said.goal}"

    # Commands

    def enable(self) -> None:
        """See ``Axis``."""
        if self._script is None and not self._is_enabled and not self._failed:
            self._begin(self._enabling())

    def target(self, counts: int) -> None:
        """See ``Axis``."""
        if not self._is_enabled:
            return
        goal = self._held(counts)
        self._goals.append(goal)
        self._pending = table.GOAL_POSITION, _bytes(goal)

    def way_point(self, counts: int) -> None:
        """See ``Axis``."""
        self.target(counts)
        self._has_way_point = True

    def confirm(self) -> None:
        """See ``Axis``: nothing is sent."""
        self._has_way_point = False

    def quick_stop(self) -> None:
        """See ``Axis``: a goal where it comes to rest; then, where it is not to hold itself, no torque."""
        if self._stop_goal is None:
            self._begin(None)
            speed = self._said.velocity * table.VELOCITY_COUNTS_S
            way = round(0.5 * speed * abs(speed) / self.config.quick_stop)
            self._stop_goal = self._held((self.position or 0) + way)
        elif not self._said.velocity or self._alert or self._said.watchdog == TRIPPED:
            self._stands = self.config.holds and not self._alert
            if not self._stands and self._script is None:
                self._begin(self._releasing())
            return
        profile = _bytes(_acceleration(self.config.quick_stop)) + _bytes(_velocity(RATE_SLACK * self.config.rate))
        self._pending = table.PROFILE_ACCELERATION, profile + _bytes(self._stop_goal)

    def cut(self) -> None:
        """See ``Axis``."""
        self._pending = table.TORQUE_ENABLE, b"\0"

    def take_pending(self) -> tuple[int, bytes] | None:
        """Address and bytes that are to be written to it by the next Sync Write."""
        pending, self._pending = self._pending, None
        if pending is not None:
            self._note(*pending)
        return pending

    def forget(self) -> None:
        """What was to be written is not."""
        self._pending = None

    def hand_over(self) -> None:
        """See ``Axis``."""
        if self._rows:
            rows = np.zeros(len(self._rows), REGISTER_WRITE)
            rows[:] = [(*head, tuple(body)) for *head, body in self._rows]
            self._rows.clear()
            self._report.rows(self.config.sent, rows)

    def _note(self, address: int, data: bytes) -> None:
        self._rows.append((self._sequence, self.now_ns, address, len(data), [*data, *bytes(12 - len(data))]))
        self._sequence += 1


def _of(said: bytes, address: int, size: int) -> int:
    """A number out of the settings."""
    at = address - table.SETTINGS
    return int.from_bytes(said[at : at + size], "little", signed=size > 1)


def _bytes(value: int) -> bytes:
    return value.to_bytes(4, "little", signed=True)


def _velocity(counts_s: float) -> int:
    """Profile Velocity; 0 would be no limit."""
    return max(1, math.ceil(counts_s / table.VELOCITY_COUNTS_S))


def _acceleration(counts_s2: float) -> int:
    """Profile Acceleration; 0 would be no limit."""
    return max(1, math.floor(counts_s2 / table.ACCELERATION_COUNTS_S2))
