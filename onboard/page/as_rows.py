"""Packets that came down as rows, as the log would have them: what shows a log or a flight can show them, too."""

from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np

from drivers.records import Batch, Severity, event
from onboard import channels
from onboard.telemetry.board import reported
from onboard.telemetry.packets import LEVELS, Packet
from onboard.telemetry.stream import Series, Stream
from onboard.telemetry.values import OF_HEALTH

_LEVELS = {word: number for number, word in LEVELS}
_SEVERITIES = {one.name.lower(): one for one in Severity}
_REMEMBERED = 2000  # events, by which one that is sent once more is known


class AsRows:
    """Rows of packets, in the order in which they come.

    What is not in the packets is NaN. An answer that is older than one before it, and an event that came before, as a
    span of the log has them, make no row: what is shown is the newest.

    Args:
        stream: that the packets come from.
        series: that places them.
    """

    def __init__(self, stream: Stream, series: Series) -> None:
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
