"""Registers of the QSB ("QSB Command List" v1.28) and its set-up commands."""

from dataclasses import dataclass
from typing import NamedTuple

from drivers.errors import ConfigurationError

MODE = 0x00  # 0: quadrature
DIGIO = 0x01
DIGIO_CONFIG = 0x02
MDR0 = 0x03
MDR1 = 0x04
CAPTURE = 0x05
THRESHOLD = 0x0B
INTERVAL = 0x0C
TIMESTAMP = 0x0D
ENCODER = 0x0E
VERSION = 0x14
EOR = 0x15
COMMAND = 0x16

STOP_STREAMS = 1  # COMMAND
CLEAR_TIMESTAMP = 1  # TIMESTAMP
EOR_ALL = 0xF  # LF, CR, timestamp, spaces: 26-byte lines
COUNT_DOWN = 1 << 8  # MDR1
FREE_RUNNING = {1: 1, 2: 2, 4: 3}  # MDR0 by counts a cycle; the factory's 4Fh counts modulo 500
CAPTURE_ON = {"rising": 0x010, "falling": 0x011}  # DIGIO_CONFIG: interrupt on I/O bit 0, which latches CAPTURE
MODELS = {0: "QSB-D", 1: "QSB-M", 2: "QSB-S"}

SHORTEST_TICK_NS = 1_900_000  # 94.5 d to the rollover
LONGEST_TICK_NS = 1_953_125  # 1/512 s
LONGEST_INTERVAL = 0xFFFE  # FFFF switches the stream off


class Command(NamedTuple):
    """One command and its expected reply.

    Attributes:
        text: As sent, without its end.
        kind: First character of the reply: r, w or s.
        register: Register it is about.
        value: Expected echo of a write; None: any value.
        compulsory: Whether a reply is required; a stream of an unchanged register sends none.
    """

    text: str
    kind: str
    register: int
    value: int | None = None
    compulsory: bool = True


@dataclass(frozen=True)
class QsbConfig:
    """Configuration of the adapter.

    The baud rate is set in the bus URL (factory: 230400).

    Attributes:
        counts_per_revolution: Counts per joint revolution, quadrature and gear included.
        counting: Counts per encoder cycle: 1, 2 or 4.
        count_down: Reverse the direction.
        interval_ticks: Ticks of the timestamp between two lines (1: 512 lines a second).
        tick_jitter: Excess ticks between two successive lines that are not taken as a lost line.
        sync_edge: Edge of the sync line (on digital I/O 0) that latches CAPTURE: ``rising``, ``falling``; None: no
            sync line.
        poll_period_ms: How often the port is read; 0: the port waits.
        silence_ms: Time without a position line after which the adapter is set up again.
        reply_timeout_ms: Longest wait for the reply to a command.

    Raises:
        ConfigurationError: A value the adapter does not have.
    """

    counts_per_revolution: int = 500_000
    counting: int = 4
    count_down: bool = False
    interval_ticks: int = 1
    tick_jitter: int = 0
    sync_edge: str | None = "rising"
    poll_period_ms: float = 10.0
    silence_ms: float = 500.0
    reply_timeout_ms: float = 200.0

    def __post_init__(self) -> None:
        if self.counts_per_revolution == 0:
            raise ConfigurationError("counts_per_revolution = 0: give the counts of a turn")
        if self.counting not in FREE_RUNNING:
            raise ConfigurationError(f"counting = {self.counting}: use 1, 2 or 4")
        if not 1 <= self.interval_ticks <= LONGEST_INTERVAL:
            raise ConfigurationError(f"interval_ticks = {self.interval_ticks}: use 1 to {LONGEST_INTERVAL}")
        if self.tick_jitter < 0 or self.reply_timeout_ms <= 0.0:
            raise ConfigurationError("tick_jitter is 0 or more, reply_timeout_ms more than 0: correct them")
        if self.sync_edge is not None and self.sync_edge not in CAPTURE_ON:
            raise ConfigurationError(f"sync_edge = {self.sync_edge!r}: use rising, falling, or leave it out")

    @property
    def interval_ns(self) -> float:
        """Time between two lines, ns, within 1.4 %."""
        return self.interval_ticks * (SHORTEST_TICK_NS + LONGEST_TICK_NS) / 2.0


def write(register: int, value: int, digits: int = 1) -> Command:
    """A write; the adapter extends the value with zeros on the left."""
    return Command(f"W{register:02X}{value:0{digits}X}", "w", register, value)


def read(register: int) -> Command:
    """A read; it ends the stream of that register."""
    return Command(f"R{register:02X}", "r", register)


def stream(register: int, *, compulsory: bool = True) -> Command:
    """Start the stream of a register."""
    return Command(f"S{register:02X}", "s", register, None, compulsory)


def greeting_commands() -> tuple[Command, ...]:
    """Stop all streams, select 26-byte lines, read model and serial number."""
    return write(COMMAND, STOP_STREAMS), write(EOR, EOR_ALL), read(VERSION)


def setup_commands(config: QsbConfig, *, clear_timestamp: bool = True) -> tuple[Command, ...]:
    """Set-up commands after ``greeting_commands``. The position stream is last: its first line is data."""
    commands = [
        write(MODE, 0),
        write(MDR0, FREE_RUNNING[config.counting], 2),
        write(MDR1, COUNT_DOWN if config.count_down else 0, 3),
        write(THRESHOLD, 0),
        write(INTERVAL, config.interval_ticks),
    ]
    if clear_timestamp:
        commands.append(write(TIMESTAMP, CLEAR_TIMESTAMP))
    if config.sync_edge is not None:
        commands += [
            write(DIGIO_CONFIG, CAPTURE_ON[config.sync_edge], 3),
            read(CAPTURE),
            read(DIGIO),
            stream(CAPTURE, compulsory=False),
            stream(DIGIO, compulsory=False),
        ]
    return (*commands, stream(ENCODER))
