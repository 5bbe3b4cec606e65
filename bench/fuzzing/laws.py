"""What every decoder and every device has to hold under fuzz, and how bytes are cut into what they are fed.

What is let pass is the named error of a decoder. ``start``, ``pump`` and ``stop`` of a device may raise nothing at all,
and rows and gaps of every channel have to add up to 0, 1, 2 ... without hole or overlap (``drivers.records``).
"""

import random
from collections.abc import Iterator
from typing import Protocol

import numpy as np

from bench import peers
from drivers import marks, records
from drivers.device import Device
from drivers.errors import FrameError
from drivers.records import Batch

MS = 1_000_000
STEPS_NS = (10 * MS, MS, 100 * MS, 0, 1000 * MS, 60_000 * MS, 5 * MS, 3_600_000 * MS)
MOST_PUMPS = 48


class Stream(Protocol):
    """A decoder that is fed, and asked until it has nothing more."""

    def receive(self, data: bytes) -> None:
        """More bytes."""

    def take(self) -> object | None:
        """What they made; raises FrameError."""


class Ledger:
    """Batches of one device: are their dtypes known ones, do rows and gaps add up?"""

    _DTYPES = (records.IMU, records.SCALAR, records.CAN_SYNC, records.PULSE, records.EVENT, records.GAP, marks.MARK)

    def __init__(self) -> None:
        self._spans: dict[str, list[tuple[int, int]]] = {}

    def take(self, batches: list[Batch]) -> None:
        """Enter batches."""
        for channel, rows in batches:
            assert rows.dtype in self._DTYPES, f"{channel}: {rows.dtype}"
            assert len(rows), f"{channel}: a batch of nothing"
            if channel == "gap":
                for gap in rows:
                    span = int(gap["first_missing"]), int(gap["last_missing"])
                    self._spans.setdefault(gap["channel"].decode(), []).append(span)
            elif channel != "event":
                numbers = rows["sequence"]
                ends = np.flatnonzero(np.diff(numbers) != 1) + 1
                spans = [(int(run[0]), int(run[-1])) for run in np.split(numbers, ends)]
                self._spans.setdefault(channel, []).extend(spans)

    def check(self) -> None:
        """Every number of every channel once."""
        for channel, spans in self._spans.items():
            following = 0
            for first, last in sorted(spans):
                assert first == following, f"{channel}: {first}..{last} where {following} follows"
                assert last >= first, f"{channel}: a gap from {first} to {last}"
                following = last + 1


def cut(data: bytes, how: int, least: int = 1) -> Iterator[bytes]:
    """Pieces of ``data``: all at once (0), ``least`` bytes at a time (1), or of random length."""
    rng = random.Random(how)
    at = 0
    while at < len(data):
        size = len(data) if how == 0 else least if how == 1 else least + rng.randrange(60)
        yield data[at : at + size]
        at += size


def split(data: bytes) -> Iterator[bytes]:
    """Records, each led by its length."""
    at = 0
    while at < len(data):
        yield data[at + 1 : at + 1 + data[at]]
        at += 1 + data[at]


def joined(*parts: bytes) -> bytes:
    """The inverse of ``split``."""
    return b"".join(bytes([len(part)]) + part for part in parts)


def leading(data: bytes, size: int) -> tuple[bytes, bytes]:
    """The head, zeros where it is short, and the rest."""
    return data[:size].ljust(size, b"\0"), data[size:]


def exhaust(stream: Stream, data: bytes, how: int) -> None:
    """Feed a stream decoder: it must come to an end."""
    for piece in cut(data, how):
        stream.receive(piece)
        for _ in range(2 * len(data) + 2):
            try:
                if stream.take() is None:
                    break
            except FrameError:
                continue
        else:
            raise AssertionError("take gives something without end")


def drive(device: Device, clock: peers.Clock, steps: Iterator[None], step_ns: int) -> None:
    """Start, pump once a step, stop; start and stop again, as after a pause."""
    ledger = Ledger()
    ledger.take(device.start(clock()))
    for _ in steps:
        clock.now_ns += step_ns
        ledger.take(device.pump(clock()))
    for _ in range(2):
        clock.now_ns += step_ns
        ledger.take(device.stop(clock()))
        ledger.take(device.start(clock()))
        ledger.take(device.pump(clock()))
    ledger.take(device.stop(clock()))
    ledger.check()


def spoken(port: peers.MemorySerial, data: bytes, how: int) -> Iterator[None]:
    """What a talker says, a piece a step."""
    for piece in cut(data, how, len(data) // MOST_PUMPS + 1):
        port.waiting += piece
        yield


def polled(device: Device, port: peers.MemorySerial, clock: peers.Clock, answers: Iterator[bytes], how: int) -> None:
    """A polled device; each question is given the next answer, at once or half now and half later."""
    late: list[bytes] = []

    def answer(question: bytes) -> bytes:
        del question
        said = next(answers, b"")
        half = len(said) // 2 if how & 8 else len(said)
        late.append(said[half:])
        return said[:half]

    def steps() -> Iterator[None]:
        for _ in range(MOST_PUMPS // 2):
            port.waiting += b"".join(late)
            late.clear()
            yield

    port.answer = answer
    drive(device, clock, steps(), STEPS_NS[how & 7])
