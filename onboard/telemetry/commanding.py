"""Commands of the uplink: handed to the flight's supervisor, and reported on. Nothing waits; time is an argument."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from drivers.records import Rows
from onboard.channels import Order, Refusal
from onboard.flight.store.orders import UPLINK, OrderBook, order_row
from onboard.telemetry.downlink import Downlink
from onboard.telemetry.span import TOO_MANY
from onboard.telemetry.uplink import WHY, Telecommand, Uplink

REPLY_NS = 3_000_000_000  # the supervisor looks ten times a second
SPAN_NS = 120_000_000_000  # that reading a span may take
_ACCEPTED, _NOT_ACCEPTED, _BEGUN, _COMPLETED, _NOT_COMPLETED = 1, 2, 3, 7, 8  # subtypes of service 1
_WANTED = {_ACCEPTED: 8, _BEGUN: 4, _COMPLETED: 1}  # acknowledgement flags of a command


class _Given(NamedTuple):
    command: Telecommand
    since_ns: int


class Commanding:
    """Of one flight and one link.

    Args:
        directory: of the flight's rings.
        log: of the flight.
        uplink: decodes and judges what comes.
        downlink: sends the reports.
        answers_hz: of each answer in a span.

    Raises:
        OSError: the flight's rings are just being made.
    """

    def __init__(self, directory: Path, log: Path, uplink: Uplink, downlink: Downlink, answers_hz: float) -> None:
        self._book = OrderBook(directory, UPLINK)
        self._log, self._uplink, self._downlink = log, uplink, downlink
        self._period_ns = round(1e9 / answers_hz)
        self._given: dict[int, _Given] = {}
        self._span: _Given | None = None
        self._reading: tuple[subprocess.Popen[bytes], IO[bytes]] | None = None

    def step(self, data: bytes, origin: str, now_ns: int) -> None:
        """Take the bytes that came from ``origin``, and go on with what was accepted."""
        for command in self._uplink.feed(data, now_ns):
            self._take(command, origin, now_ns)
        for number, refused in self._book.replies().items():
            if (given := self._given.pop(number, None)) is not None:
                self._replied(given, refused, now_ns)
        for number in [one for one, given in self._given.items() if now_ns - given.since_ns > REPLY_NS]:
            self._fail(self._given.pop(number).command, _NOT_COMPLETED, Refusal.NOT_DONE)
        if self._span is not None:
            self._go_on(self._span, now_ns)

    def close(self) -> None:
        """End a span that is being read, and close the rings."""
        if self._reading is not None:
            process, file = self._reading
            process.kill()
            process.wait()
            file.close()
        self._book.close()

    def _take(self, command: Telecommand, origin: str, now_ns: int) -> None:
        asks = any(given.command.order == Order.SPAN for given in self._given.values()) or self._span is not None
        refused = command.refused or (Refusal.BUSY if asks and command.order == Order.SPAN else Refusal.NONE)
        count = int.from_bytes(command.request[2:], "big") & 0x3FFF
        who = f"source {command.source}, count {count}, of {origin}"  # a long path is cut at its end
        fields = {"number": command.number, "begin_ns": command.begin_ns, "end_ns": command.end_ns}
        number = self._book.give(order_row(now_ns, command.order, who, refused, **fields))
        if refused:
            self._fail(command, _NOT_ACCEPTED, refused)
        else:
            self._report(command, _ACCEPTED)
            self._given[number] = _Given(command, now_ns)

    def _replied(self, given: _Given, refused: Refusal, now_ns: int) -> None:
        command = given.command
        if refused:
            self._fail(command, _NOT_COMPLETED, refused)
            return
        if command.order != Order.SPAN:
            self._report(command, _COMPLETED)
            return
        self._report(command, _BEGUN)
        span = [str(one) for one in (self._log, command.begin_ns, command.end_ns, self._period_ns)]
        file = tempfile.TemporaryFile()  # noqa: SIM115 - until it is read
        asked = [sys.executable, "-m", "onboard.telemetry.span", *span]
        self._reading = subprocess.Popen(asked, stdin=subprocess.DEVNULL, stdout=file), file
        self._span = _Given(command, now_ns)

    def _go_on(self, given: _Given, now_ns: int) -> None:
        if self._reading is None:
            if not self._downlink.repeating:
                self._span = None
                self._report(given.command, _COMPLETED)
            return
        process, file = self._reading
        if process.poll() is None and now_ns - given.since_ns > SPAN_NS:
            process.kill()
            process.wait()
        if process.poll() is None:
            return
        if process.returncode:
            why = "more rows than are sent again: ask for less" if process.returncode == TOO_MANY else ""
            self._span = None
            self._fail(given.command, _NOT_COMPLETED, Refusal.NOT_DONE, why)
        else:
            for rows in _arrays(file):
                self._downlink.repeat(rows)
        file.close()
        self._reading = None

    def _report(self, command: Telecommand, subtype: int) -> None:
        if command.acknowledge & _WANTED[subtype]:
            self._downlink.report(subtype, command.request, command.source)

    def _fail(self, command: Telecommand, subtype: int, code: Refusal, why: str = "") -> None:
        self._downlink.report(subtype, command.request, command.source, code=int(code), why=why or WHY[code])


def _arrays(file: IO[bytes]) -> Iterator[Rows]:
    """What such a process wrote into ``file``."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    while file.tell() < size:
        yield np.load(file, allow_pickle=False)
