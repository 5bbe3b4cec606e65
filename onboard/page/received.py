"""A flight as its downlink tells it: packets of a link while they come, or of a file, for the page.

Packets that came down as rows, as the log would have them: what shows a log or a flight can show them, too.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.records import Batch, Severity, event
from onboard import channels
from onboard.page.follow import about
from onboard.page.state import PageState
from onboard.telemetry.board import SILENT_S, reported
from onboard.telemetry.link import Address, received
from onboard.telemetry.packets import LEVELS, Packet
from onboard.telemetry.stream import Series, Splitter
from onboard.telemetry.values import OF_HEALTH

_LEVELS = {word: number for number, word in LEVELS}
_SEVERITIES = {one.name.lower(): one for one in Severity}
_REMEMBERED = 2000  # events, by which one that is sent once more is known
_AGAIN_S = 1.0  # between two tries of a link that failed


class AsRows:
    """Rows of packets, in the order in which they come.

    What is not in the packets is NaN. An answer that is older than one before it, and an event that came before, as a
    span of the log has them, make no row: what is shown is the newest.

    Args:
        stream: that the packets come from.
        series: that places them.
    """

    def __init__(self, stream: Splitter, series: Series) -> None:
        self._stream, self._series = stream, series
        self._why: dict[str, tuple[str, str]] = {}  # level, reason
        self._newest_ns: dict[str, int] = {}
        self._said: deque[tuple[int, str]] = deque(maxlen=_REMEMBERED)

    def of(self, packet: Packet) -> Iterator[Batch]:
        """Rows of a packet that is new."""
        kind, values, at_ns = packet.kind.name, packet.values, packet.at_ns
        if kind == "answer":
            yield from self._answer(at_ns, values)
        elif kind == "reason":
            self._why[values["quantity"]] = values["level"], values["why"]
        elif kind == "event":
            if (key := (at_ns, values["text"])) not in self._said:
                self._said.append(key)
                severity = _SEVERITIES[values["severity"]]
                yield event(at_ns, severity, values["code"], values["source"], values["text"])
        elif kind in ("report", "failure"):
            severity = Severity.WARNING if kind == "failure" else Severity.INFO
            yield event(at_ns, severity, "command", "command", reported(packet))
        elif kind == "status":
            yield Batch("health", _health(at_ns, values))
            yield self._standing(at_ns, values)
        elif kind == "flight" and values["wall_clock"]:
            yield Batch("flight", _rows(channels.STANDING, values["wall_clock"]))  # when it began

    def _answer(self, at_ns: int, values: dict[str, Any]) -> Iterator[Batch]:
        name = values["quantity"]
        if at_ns < self._newest_ns.get(name, 0):
            return
        self._newest_ns[name] = at_ns
        row = _rows(channels.QUANTITY, at_ns)
        level, why = self._why.get(name, ("", ""))
        row["name"], row["unit"], row["level"] = name.encode(), values["unit"].encode(), _LEVELS[values["level"]]
        row["supported"], row["why"] = values["supported"] == "yes", why.encode() if level == values["level"] else b""
        for number in channels.NUMBERS:
            row[number] = values[number]
        yield Batch("quantity", row)

    def _standing(self, at_ns: int, values: dict[str, Any]) -> Batch:
        row = _rows(channels.STANDING, at_ns)
        row["mode"] = values["mode"].encode()
        row["phase"] = f"phase {values['phase']}".encode() if values["phase"] >= 0 else b""
        row["missing"] = sum(self._series.missing.values())
        row["damaged_bytes"] = self._stream.skipped
        return Batch("standing", row)


def _health(at_ns: int, values: dict[str, Any]) -> np.ndarray:
    row = _rows(channels.HEALTH, at_ns)
    for name in channels.HEALTH.names or ():
        if channels.HEALTH[name].kind == "f":
            row[name] = np.nan
    for name, of in OF_HEALTH.items():
        row[of] = values[name]
    return row


def _rows(dtype: np.dtype[np.void], at_ns: int) -> np.ndarray:
    row = np.zeros(1, dtype)
    row["host_ns"] = at_ns
    return row


class Received:
    """State of the flight whose packets come over a link; the link is tried again when it fails.

    Args:
        address: of the link, no file.
        apids: by kind of packet.
        payload: link whose body is asked for; empty: all answers that have a body's units.
        clock: seconds, monotonic.

    Attributes:
        state: so far.
        urdf: none comes down.
        ended: never: another flight may follow.

    Raises:
        OSError: the link cannot be opened.
    """

    live, ended, urdf = True, False, b""

    def __init__(self, address: Address, apids: Mapping[str, int], payload: str, clock: Callable[[], float]) -> None:
        self._address, self._payload, self._clock = address, payload, clock
        self.state = PageState(f"{address.text}: no flight is known yet", payload, live=True)
        self._stream, self._series = Splitter(apids), Series()
        self._rows = AsRows(self._stream, self._series)
        self._flight = ""
        self._waiting: list[Batch] = []  # before it is known of which flight
        self._got: deque[bytes] = deque()
        self._heard_s, self._failed = clock(), ""
        self._over = threading.Event()
        pieces = received(address)
        self._got.append(next(pieces))
        threading.Thread(target=self._read, args=(pieces,), daemon=True).start()

    def look(self) -> None:
        """Take in what has come since the last look."""
        while self._got:
            for packet in self._stream.feed(self._got.popleft()):
                self._heard_s = self._clock()
                if self._series.place(packet).new:
                    self._take(packet)
        silent_s = self._clock() - self._heard_s
        self.state.silence = self._failed
        if not self._failed and silent_s > SILENT_S:
            self.state.silence = f"nothing has come over the link for {silent_s:.0f} s"

    def check_ended(self) -> bool:
        """Whether it is over."""
        return self.ended

    def close(self) -> None:
        """Read no more."""
        self._over.set()

    def about(self) -> dict[str, Any]:
        """What the page needs once."""
        return about(self.state, steps=None)

    def frame_now(self, now_ns: int, *, ended: bool = False) -> dict[str, Any]:
        """The frame of the newest packet: ages are by the flight's clock, which the ground does not have."""
        del now_ns
        return self.state.frame(ended=ended)

    def _take(self, packet: Packet) -> None:
        name = f"{packet.values['vehicle']}: {packet.values['log']}" if packet.kind.name == "flight" else ""
        if name and packet.values["flight"] != self._flight:
            begins = not self._flight
            self._flight = packet.values["flight"]
            self.state = PageState(name, self._payload, live=True)
            self._rows = self._rows if begins else AsRows(self._stream, self._series)
            for batch in self._waiting:
                self.state.add(batch)
            self._waiting = []
        for batch in self._rows.of(packet):
            self.state.add(batch)
            if not self._flight:
                self._waiting.append(batch)

    def _read(self, pieces: Iterator[bytes]) -> None:
        while not self._over.is_set():
            try:
                for piece in pieces:
                    self._failed = ""
                    self._got.append(piece)
                    if self._over.is_set():
                        return
            except OSError as error:
                self._failed = f"{self._address.text}: {error.strerror or error}; tried again every second"
            self._over.wait(_AGAIN_S)
            pieces = received(self._address)


class PacketFile:
    """Packets of a file as a log whose rows are played.

    Args:
        path: of the file.
        apids: by kind of packet.

    Raises:
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, apids: Mapping[str, int]) -> None:
        self.path, self.position = path, 0
        self.stream, self.series = Splitter(apids), Series()
        data = path.read_bytes()
        self._packets = [*self.stream.feed(data), *self.stream.finish()]
        vehicle = next((one.values["vehicle"] for one in self._packets if one.kind.name == "flight"), "")
        self.attachments: dict[str, Any] = {}
        self.metadata = {"flight": {"vehicle": vehicle}}

    def batches(self) -> Iterator[Batch]:
        """Rows in the order in which they came down."""
        rows = AsRows(self.stream, self.series)
        for packet in self._packets:
            if self.series.place(packet).new:
                yield from rows.of(packet)

    @property
    def is_whole(self) -> bool:
        """Whether nothing is missing or damaged, of what was played."""
        return not (any(self.series.missing.values()) or self.stream.skipped or self.stream.refused)
