"""Encodes and decodes Mantracourt DSC ASCII messages. No port, no clock.

A read is ``!001:SOUT?`` CR; its answer is a sign, DPB digits, a point, DP digits and CR, always of the same length. An
action or a write is answered by CR alone, an unknown command by ``?`` CR or not at all.
"""

import re
from dataclasses import dataclass
from typing import NamedTuple

from drivers.errors import ConfigurationError, FrameError

LONGEST_ANSWER = 32
ANSWER_MS = 50.0  # "at most; after this it can be assumed that there is no response"
_NUMBER = re.compile(rb"([+-])([0-9]+)(?:\.([0-9]*))?")
_NAME = re.compile(r"[A-Z0-9]{1,4}")


@dataclass(frozen=True)
class DscLoadCellConfig:
    """Configuration of a DSC digitiser.

    Attributes:
        station: Station number, 1..999 (0 is the broadcast, which is not answered).
        command: What to read: ``SOUT`` (system output), ``CELL``, ``ELEC``, ``MVV`` ...
        unit: Unit of the answer, set by the system calibration (SGAI, SOFS).
        sample_period_ms: Time between two requests; 0: as fast as it answers.
        timeout_ms: Longest wait for an answer; at least the manual's 50 ms, else a late answer is taken for the next
            one.
        poll_period_ms: How often the port is read; 0: the port waits.

    Raises:
        ConfigurationError: A value out of range.
    """

    station: int = 1
    command: str = "SOUT"
    unit: str = "N"
    sample_period_ms: float = 0.0
    timeout_ms: float = 60.0
    poll_period_ms: float = 1.0

    def __post_init__(self) -> None:
        if not 1 <= self.station <= 999:
            raise ConfigurationError(f"station = {self.station}: use 1..999")
        if not _NAME.fullmatch(self.command):
            raise ConfigurationError(f"command = {self.command!r}: up to four letters or digits, as SOUT")
        if len(self.unit.encode()) > 8:
            raise ConfigurationError(f"unit = {self.unit!r}: 8 bytes at most")
        if self.timeout_ms < ANSWER_MS:
            raise ConfigurationError(f"timeout_ms = {self.timeout_ms}: the manual allows an answer {ANSWER_MS:g} ms")


class Number(NamedTuple):
    """A decimal number as sent: ``counts`` times 10^-``decimals``."""

    counts: int
    decimals: int


def read_command(station: int, command: str) -> bytes:
    """Request that reads a parameter."""
    return f"!{station:03d}:{command}?\r".encode()


def decode_number(text: bytes) -> Number:
    """The answer to a read, without its CR.

    Raises:
        FrameError: The text is not a signed decimal number.
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise FrameError(f"{text!r} is not a number: check the baud rate; is another master on the line?")
    sign, whole, fraction = match[1], match[2], match[3] or b""
    counts = int(whole + fraction)
    return Number(-counts if sign == b"-" else counts, len(fraction))


class DscReply:
    """Gathers the answer to one read."""

    def __init__(self) -> None:
        self._buffer = b""

    @property
    def received(self) -> int:
        """Bytes so far."""
        return len(self._buffer)

    def receive(self, data: bytes) -> bytes | None:
        """More bytes: the answer without its CR when it is whole, None while it is not.

        Raises:
            FrameError: Too many bytes, or bytes after the end.
        """
        self._buffer += data
        text, end, rest = self._buffer.partition(b"\r")
        if rest:
            raise FrameError(f"{rest!r} after the answer, without a request")
        if end:
            return text
        if len(text) > LONGEST_ANSWER:
            raise FrameError(f"{len(text)} bytes without CR: check the baud rate")
        return None
