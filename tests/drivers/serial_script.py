"""Serial ports for the drivers' tests: one that a device model answers, and faults on order."""

import os
import threading
import time
import tty
from collections.abc import Callable, Iterator

import numpy as np
import serial

from drivers.errors import FrameError
from drivers.records import EVENT, GAP, Batch
from tests.drivers.batches import codes, of

MS = 1_000_000


class ScriptedSerial:
    """A port in memory, as much of ``serial.Serial`` as ``drivers.ports.SerialPort`` names.

    ``answer`` gets what the driver writes and returns what comes back; ``say`` makes bytes arrive by themselves.
    ``fail`` counts calls of ``in_waiting``, ``read``, ``write``, ``open`` and fails the one it is told to.
    """

    def __init__(self, answer: Callable[[bytes], bytes] = lambda _: b"") -> None:
        self.answer = answer
        self.waiting = bytearray()
        self.written = bytearray()
        self.calls = 0
        self.fail_at = -1  # number of the call that fails
        self.broken = False  # every call fails
        self.is_open = False
        self.opened = 0
        self.closed = 0
        self.most = 1 << 20  # bytes in one read

    def open(self) -> "ScriptedSerial":
        """The factory that a driver is given."""
        self._call("open")
        assert not self.is_open, "opened twice"
        self.is_open = True
        self.opened += 1
        return self

    def say(self, data: bytes) -> None:
        """Bytes arrive, if somebody has the port open."""
        if self.is_open:
            self.waiting += data

    @property
    def in_waiting(self) -> int:
        self._call("in_waiting")
        assert self.is_open
        return min(len(self.waiting), self.most)

    def read(self, size: int = 1) -> bytes:
        self._call("read")
        assert self.is_open
        assert size > 0
        size = min(size, self.most)
        data, self.waiting = bytes(self.waiting[:size]), self.waiting[size:]
        return data

    def write(self, data: bytes) -> int:
        self._call("write")
        assert self.is_open
        self.written += data
        self.waiting += self.answer(bytes(data))
        return len(data)

    def close(self) -> None:
        self.is_open = False
        self.closed += 1
        self.waiting.clear()
        if self.broken:
            raise OSError("close failed")

    def _call(self, name: str) -> None:
        self.calls += 1
        if self.broken or self.calls == self.fail_at:
            raise serial.SerialException(f"{name} failed")


def fed(stream, data: bytes, sizes: Iterator[int]) -> tuple[list, list[str]]:
    """What a stream decoder makes of ``data`` in pieces of ``sizes``: what it took, and messages of its FrameErrors."""
    taken, errors, at = [], [], 0
    while at < len(data):
        size = next(sizes)
        stream.receive(data[at : at + size])
        at += size
        while True:
            try:
                piece = stream.take()
            except FrameError as error:
                errors.append(str(error))
                continue
            if piece is None:
                break
            taken.append(piece)
    return taken, errors


def whole(data: bytes) -> Iterator[int]:
    """All at once."""
    while True:
        yield max(1, len(data))


def bytewise() -> Iterator[int]:
    """One byte at a time."""
    while True:
        yield 1


def pieces(seed: int, most: int = 60) -> Iterator[int]:
    """Pieces of random length."""
    rng = np.random.default_rng(seed)
    while True:
        yield int(rng.integers(1, most))


class Pty:
    """A pseudo-terminal: ``path`` for pyserial, and a thread that plays the device on the other end."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        self._slave = slave
        self._answer = answer
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def open(self, baud: int = 115_200, timeout: float = 0.02) -> serial.Serial:
        return serial.Serial(self.path, baud, timeout=timeout)

    def say(self, data: bytes) -> None:
        os.write(self.master, data)

    def _run(self) -> None:
        while True:
            try:
                data = os.read(self.master, 4096)
            except OSError:
                return
            reply = self._answer(data)
            if reply:
                os.write(self.master, reply)

    def close(self) -> None:
        os.close(self._slave)
        self._thread.join(1.0)
        os.close(self.master)


def run_for(device, channel: str, rows: int, each=lambda batches: None, seconds=5.0, timeout_s=0.0) -> list[Batch]:
    """Batches of a device on the real clock, to so many rows of a channel; ``each`` has them before a pump."""
    batches = device.start(time.monotonic_ns())
    deadline = time.monotonic() + seconds
    while of(batches, channel).size < rows and time.monotonic() < deadline:
        each(batches)
        batches += device.pump(time.monotonic_ns(), timeout_s)
    return batches + device.stop(time.monotonic_ns())


class SerialFlight:
    """A device on a scripted port under a virtual clock; all batches so far in ``batches``."""

    def __init__(self, clock, port: ScriptedSerial, device) -> None:
        self.clock, self.port, self.device = clock, port, device
        self.batches: list[Batch] = []

    def start(self) -> list[Batch]:
        return self._keep(self.device.start(self.clock()))

    def pump(self, after_ns: int = 10 * MS, said: bytes = b"") -> list[Batch]:
        """Let time pass, bytes arrive at its end, and pump."""
        self.clock.advance(after_ns)
        self.port.say(said)
        return self._keep(self.device.pump(self.clock()))

    def stop(self) -> list[Batch]:
        return self._keep(self.device.stop(self.clock()))

    def _keep(self, made: list[Batch]) -> list[Batch]:
        dtypes = {**self.device.channels, "event": EVENT, "gap": GAP}
        for batch in made:
            assert batch.rows.dtype == dtypes[batch.channel]
        self.batches += made
        return made


class AskedFlight(SerialFlight):
    """A device that answers each question ``delay_ns`` later; the port does not wait.

    Args:
        model: Its ``receive`` gives the answer to a question.
        make: The driver, of a function that opens its port.
    """

    def __init__(self, clock, model, make, delay_ns: int) -> None:
        self.model, self.delay_ns = model, delay_ns
        self.coming: list[tuple[int, bytes]] = []
        port = ScriptedSerial(self.ask)
        super().__init__(clock, port, make(port.open))

    def ask(self, request: bytes) -> bytes:
        answer = self.model.receive(request)
        if not self.delay_ns:
            return answer
        self.coming.append((self.clock() + self.delay_ns, answer))
        return b""

    def fly(self, pumps: int, step_ns: int = MS):
        for _ in range(pumps):
            self.clock.advance(step_ns)
            while self.coming and self.coming[0][0] <= self.clock():
                self.port.say(self.coming.pop(0)[1])
            self.pump(0)
        return self


def fault_at_any_call(
    make: Callable[[], SerialFlight],
    fly: Callable[[SerialFlight], object],
    fly_on: Callable[[SerialFlight], object],
    fewest_calls: int,
    every: int = 1,
) -> Iterator[SerialFlight]:
    """The same flight again and again, each time with another call of its port that fails, and told so.

    Of the calls those from ``every`` to ``every``.
    """
    flight = make()
    flight.start()
    fly(flight)
    flight.stop()
    calls = flight.port.calls
    assert calls > fewest_calls
    for fail_at in range(1, calls + 1, every):
        flight = make()
        flight.port.fail_at = fail_at
        flight.start()
        fly(flight)
        fly_on(flight)
        flight.stop()
        assert "bus_error" in codes(flight.batches), fail_at
        yield flight


def nothing_left_out(batches, channel):
    """Rows and gaps of a channel follow on one another, without expanding gaps that may be billions long."""
    rows = of(batches, channel)
    spans = [(int(number), int(number)) for number in rows["sequence"]]
    for gap in of(batches, "gap"):
        if gap["channel"] == channel.encode():
            assert gap["first_missing"] <= gap["last_missing"]
            spans.append((int(gap["first_missing"]), int(gap["last_missing"])))
    at = 0
    for first, last in sorted(spans):
        assert first == at, channel
        at = last + 1
    assert np.all(np.diff(rows["sequence"].astype(np.int64)) > 0)
    if len(rows):
        assert rows["tick"].max() < 2**63  # never below 0


def fuzzed(flight: SerialFlight, moves: list[tuple], pump: Callable[[int, object], object] | None = None) -> None:
    """A flight under any bytes, stalls and faults never raises, and its rows and gaps leave nothing out.

    Args:
        flight: Started.
        moves: Time that passes, what comes at its end, and a fault: 1 to 3 at that call of the port, 4 a broken port.
        pump: How a move is flown; ``SerialFlight.pump`` by default.
    """
    for after_ns, said, fault in moves:
        flight.port.fail_at = flight.port.calls + fault if fault in {1, 2, 3} else -1
        flight.port.broken = fault == 4
        (pump or flight.pump)(after_ns, said)
    flight.port.fail_at, flight.port.broken = -1, False
    flight.pump()
    flight.stop()
    for channel in flight.device.channels:
        nothing_left_out(flight.batches, channel)
