"""Which packet is sent next, under a budget of bytes a second. Time is an argument; nothing waits.

In this order: status, what flight this is, mode and phase, reports on commands, at most one event a second, answers,
more events, reasons, what was asked for once more. Each of the first five is bounded to a share of the budget, so that
answers always get theirs; where these do not fit their rate, each waits equally long. A packet is made when there is
room for it, of what is newest then. What was replaced or left out before it was sent is counted, and the status says
it: the log has it all.
"""

import math
import re
from collections import deque
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drivers.records import EVENT as EVENT_ROW
from drivers.records import Batch, Severity
from onboard import channels
from onboard.flight.health.status import NO_HEALTH
from onboard.recording.format.texts import printable
from onboard.telemetry import packets
from onboard.telemetry.values import health_values, level_of, of_answer, of_event, why_of

if TYPE_CHECKING:
    from onboard.config.telemetry import Telemetry

MOST_EVENTS = 256  # that wait
MOST_ANSWERS = 64  # quantities
MOST_REPORTS = 64  # on commands, that wait
STALE_NS = 3_000_000_000  # health records come every second
_BURST_S = 0.5  # of the budget may be sent at once
_EVENT_S = 1.0  # so often one event comes before answers
_PHASE_S = 0.2  # between two packets of changes, at least
_REASON_NS = 5_000_000_000  # between two reasons of a quantity of the same level, at least
_REPORT_S = 0.2  # between two reports on commands, at least
# of the budget, at most, before answers
_SHARES = {"status": 0.5, "flight": 0.05, "phase": 0.1, "failure": 0.1, "event": 0.25}
_MODES = {word: number for number, word in packets.MODES}
_PHASE = re.compile(r"phase (-?\d+)")
_NAN = math.nan


class TelemetrySettings(NamedTuple):
    """``[telemetry]`` of the vehicle file."""

    bytes_s: float
    status_hz: float
    answers_hz: float
    phase_hz: float
    flight_hz: float
    reasons_hz: float
    apids: dict[str, int]
    command_apid: int
    commands: list[str]

    @classmethod
    def of(cls, keys: "Telemetry") -> "TelemetrySettings":
        """Without what reads vehicle files: a process that only sends stays small."""
        return cls(*(getattr(keys, name) for name in cls._fields))


class FlightIdentity(NamedTuple):
    """Which flight it is, and one instant on both clocks."""

    flight: str
    vehicle: str
    log: str
    wall_clock_ns: int
    monotonic_ns: int


class Unsent(NamedTuple):
    """What was not sent, by kind; ``overdue``: periods in which the budget held back status or an answer."""

    answers: int
    events: int
    phases: int
    reasons: int
    overdue: int


class _Answer:
    """The newest row of a quantity, and what was sent of it."""

    def __init__(self, row: np.void, now_ns: int) -> None:
        self.row, self.due_ns, self.told_ns, self.again_ns = row, now_ns, now_ns, now_ns
        self.sent = self.told = False
        self.level, self.why = level_of(row), why_of(row)

    def renew(self, row: np.void, now_ns: int) -> tuple[int, int]:
        """Take a newer row; the number of answers and reasons that it replaces before they were sent."""
        level, why = level_of(row), why_of(row)
        changed = (level, why) != (self.level, self.why)
        replaced = int(not self.sent), int(changed and not self.told and bool(self.why))
        if self.sent:
            self.due_ns = max(self.due_ns, now_ns)  # nothing new to send is no delay
        if level != self.level:
            self.told_ns = now_ns
        self.row, self.sent = row, False
        self.level, self.why, self.told = level, why, self.told and not changed
        return replaced

    def untold(self, now_ns: int) -> bool:
        """Whether its reason is to be sent: it changed, or is due again."""
        return bool(self.why) and now_ns >= (self.again_ns if self.told else self.told_ns)


class Downlink:
    """Packets of one flight.

    Args:
        settings: APIDs, rates and budget.
        session: 16 bits, another one for each process that sends.
        flight: which it is.
        now_ns: when it begins, CLOCK_MONOTONIC.
        bytes_s: budget, where a line carries less than the settings say.

    Attributes:
        unread: rows that were overwritten in a ring before they came here; set by who reads it.
        sent: packets so far.
    """

    def __init__(
        self,
        settings: TelemetrySettings,
        session: int,
        flight: FlightIdentity,
        now_ns: int,
        bytes_s: float | None = None,
    ) -> None:
        self._settings, self._session, self._flight = settings, session, flight
        self._bytes_s = settings.bytes_s if bytes_s is None else min(bytes_s, settings.bytes_s)
        self._apids = settings.apids
        self._counts = dict.fromkeys(packets.KINDS, 0)
        self._most = max(_BURST_S * self._bytes_s, float(packets.LONGEST))
        self._room, self._at_ns = self._most, now_ns
        self._due = dict.fromkeys(("status", "flight", "phase"), now_ns)
        self._period = {name: self._spaced(name, 1.0 / getattr(settings, f"{name}_hz")) for name in self._due}
        self._event_period_ns, self._change_ns = self._spaced("event", _EVENT_S), self._spaced("phase", _PHASE_S)
        self._answer_ns, self._reason_ns = (round(1e9 / hz) for hz in (settings.answers_hz, settings.reasons_hz))
        self._report_period_ns = self._spaced("failure", _REPORT_S)
        self._report_ns = now_ns - self._report_period_ns
        self._reports: deque[tuple[str, dict[str, Any]]] = deque(maxlen=MOST_REPORTS)
        self._messages = dict.fromkeys(range(256), 0)  # of service 1, by subtype
        self._again: deque[np.void] = deque()
        self._health: np.void | None = None
        self._was_stale = False
        self._answers: dict[str, _Answer] = {}
        self._events: list[deque[np.void]] = [deque() for _ in Severity]  # by severity, oldest first
        self._event_ns, self._phase_ns = now_ns - self._event_period_ns, now_ns - self._change_ns
        self._mode, self._phase = packets.UNKNOWN_MODE, packets.UNKNOWN_PHASE
        self._changed_ns, self._changed = now_ns, 0  # changes of mode or phase that were not sent
        self._unsent = dict.fromkeys(Unsent._fields, 0)
        self.unread = self.sent = 0

    def _spaced(self, kind: str, period_s: float) -> int:
        """``period_s`` [s] in ns, or more where packets that often would take more than their share."""
        return round(1e9 * max(period_s, packets.KINDS[kind].length / (_SHARES[kind] * self._bytes_s)))

    @property
    def unsent(self) -> Unsent:
        """What was not sent, without what still waits."""
        return Unsent(**self._unsent)

    @property
    def waiting(self) -> int:
        """Events, changes, reports and answers that wait."""
        fresh = sum(not answer.sent for answer in self._answers.values())
        return self._waiting_events + self._changed + len(self._reports) + fresh

    @property
    def _waiting_events(self) -> int:
        return sum(len(events) for events in self._events)

    def add(self, batch: Batch) -> None:
        """Take in rows of a channel; those of other kinds are left out."""
        dtype = batch.rows.dtype
        if dtype == EVENT_ROW:
            for row in batch.rows:
                self._hear(row)
        elif channels.is_quantity(dtype):
            for row in batch.rows:
                self._answer(row)
        elif batch.channel == "health" and "status_latched" in (dtype.names or ()) and len(batch.rows):
            self._health = batch.rows[-1]

    def _answer(self, row: np.void) -> None:
        name = printable(row["name"])
        if not row["unit"]:
            return  # a parameter of the regression
        known = self._answers.get(name)
        if known is not None:
            answers, reasons = known.renew(row, self._at_ns)
            self._unsent["answers"] += answers
            self._unsent["reasons"] += reasons
        elif len(self._answers) < MOST_ANSWERS:
            self._answers[name] = _Answer(row, self._at_ns)
        else:
            self._unsent["answers"] += 1

    def _hear(self, row: np.void) -> None:
        code, text = bytes(row["code"]), printable(row["text"])
        mode, phase = self._mode, self._phase
        if code == b"mode":
            mode = _MODES.get(text.partition(":")[0], packets.UNKNOWN_MODE)
        elif code == b"phase" and (match := _PHASE.match(text)):
            phase = int(match[1])
        if (mode, phase) != (self._mode, self._phase):
            self._mode, self._phase, self._changed_ns = mode, phase, int(row["host_ns"])
            self._unsent["phases"] += self._changed  # the change before it was not sent
            self._changed = 1
        self._events[min(int(row["severity"]), max(Severity))].append(row)
        if self._waiting_events > MOST_EVENTS:  # the least serious, of these the oldest, is left out
            next(events for events in self._events if events).popleft()
            self._unsent["events"] += 1

    def report(self, subtype: int, request: bytes, source: int, **why: Any) -> None:
        """Report on a command, by PUS service 1.

        Args:
            subtype: 1 accepted, 3 begun, 7 completed; 2, 8 not.
            request: the first four bytes of the command.
            source: its source identifier.
            why: ``code`` and ``why`` of a failure.
        """
        packet_id, control = int.from_bytes(request[:2], "big"), int.from_bytes(request[2:], "big")
        values = {"pus": packets.PUS_C, "service": 1, "subtype": subtype, "destination": source, "packet_id": packet_id}
        values |= {"counter": self._messages[subtype] % (1 << 16), "sequence_control": control}
        self._messages[subtype] += 1
        self._reports.append(("report" if subtype % 2 else "failure", values | why))

    def repeat(self, rows: Iterable[np.void]) -> None:
        """Send rows of events and answers once more, when nothing else is due."""
        self._again.extend(rows)

    @property
    def repeating(self) -> int:
        """Rows that are to be sent once more."""
        return len(self._again)

    def packets(self, now_ns: int) -> Iterator[bytes]:
        """Packets that are due at ``now_ns`` and fit the budget; those not taken are not sent."""
        self._room = min(self._most, self._room + (now_ns - self._at_ns) * 1e-9 * self._bytes_s)
        self._at_ns = now_ns
        while (wanted := next(self._wanted(now_ns), None)) is not None:
            kind, what = wanted
            if packets.KINDS[kind].length > self._room:
                return
            packet = self._make(kind, what, now_ns)
            self._room -= len(packet)
            yield packet

    def finish(self, now_ns: int) -> None:
        """The flight is over: what is newest is due."""
        for answer in self._answers.values():
            answer.due_ns = now_ns

    def last(self, now_ns: int) -> Iterator[bytes]:
        """The last packet, which says how it ended: the status."""
        self._due["status"], self._room = now_ns, float(packets.KINDS["status"].length)
        self._at_ns = now_ns
        return self.packets(now_ns)

    def _wanted(self, now_ns: int) -> Iterator[tuple[str, Any]]:
        """Kinds of what is due, the first of them is next, and of what."""
        yield from ((kind, None) for kind in ("status", "flight") if now_ns >= self._due[kind])
        if now_ns >= self._due["phase"] or (self._changed and now_ns - self._phase_ns >= self._change_ns):
            yield "phase", None
        if self._reports and now_ns - self._report_ns >= self._report_period_ns:
            yield self._reports[0][0], None
        events = self._waiting_events
        if events and now_ns - self._event_ns >= self._event_period_ns:
            yield "event", None
        fresh = [answer for answer in self._answers.values() if not answer.sent and answer.due_ns <= now_ns]
        if fresh:
            yield "answer", min(fresh, key=lambda answer: answer.due_ns)
        if events:
            yield "event", None
        untold = [answer for answer in self._answers.values() if answer.untold(now_ns)]
        if untold:
            yield "reason", min(untold, key=lambda answer: (answer.told, answer.told_ns))
        if self._again:
            yield "event" if self._again[0].dtype == EVENT_ROW else "answer", self._again

    def _make(self, kind: str, what: Any, now_ns: int) -> bytes:
        at_ns = now_ns
        if kind in self._due:
            self._unsent["overdue"] += self._late(self._due[kind], self._period[kind], now_ns) * (kind == "status")
            self._due[kind] = self._next(self._due[kind], self._period[kind], now_ns)
        if what is self._again:
            row = self._again.popleft()
            at_ns, values = of_event(row) if kind == "event" else of_answer(row)
        elif kind in ("report", "failure"):
            self._report_ns, values = now_ns, self._reports.popleft()[1]
        elif kind == "status":
            values = self._status(now_ns)
        elif kind == "flight":
            flight = self._flight
            values = flight._asdict() | {"wall_clock": flight.wall_clock_ns, "monotonic": flight.monotonic_ns}
        elif kind == "phase":
            self._changed, self._phase_ns = 0, now_ns
            age_s = (now_ns - self._changed_ns) * 1e-9 if self._known_phase else _NAN
            values = {"mode": self._mode, "phase": self._phase, "age": age_s}
        elif kind == "event":
            self._event_ns = now_ns
            severity = max(number for number, events in enumerate(self._events) if events)
            at_ns, values = of_event(self._events[severity].popleft())
        elif kind == "answer":
            self._unsent["overdue"] += self._late(what.due_ns, self._answer_ns, now_ns)
            what.due_ns, what.sent = self._next(what.due_ns, self._answer_ns, now_ns), True
            at_ns, values = of_answer(what.row)
        else:
            what.told, what.told_ns, what.again_ns = True, now_ns + _REASON_NS, now_ns + self._reason_ns
            at_ns = int(what.row["host_ns"])
            values = {"quantity": printable(what.row["name"]), "level": what.level, "why": what.why}
        number = self._counts[kind]
        self._counts[kind] = (number + 1) % packets.COUNTS
        self.sent += 1
        wall_ns = at_ns - self._flight.monotonic_ns + self._flight.wall_clock_ns
        return packets.encode(packets.KINDS[kind], self._apids[kind], number, self._session, wall_ns, values)

    @property
    def _known_phase(self) -> bool:
        return self._mode != packets.UNKNOWN_MODE or self._phase != packets.UNKNOWN_PHASE

    @staticmethod
    def _late(due_ns: int, period_ns: int, now_ns: int) -> int:
        """Whole periods since it was due."""
        return max(0, (now_ns - due_ns) // period_ns)

    @staticmethod
    def _next(due_ns: int, period_ns: int, now_ns: int) -> int:
        """When it is due again: by its own pace, not in a hurry after a delay."""
        return max(due_ns + period_ns, now_ns + period_ns // 2)

    def _status(self, now_ns: int) -> dict[str, Any]:
        row, unsent = self._health, self.unsent._asdict()
        health = health_values(row, now_ns)
        stale = row is None or now_ns - int(row["host_ns"]) > STALE_NS
        self._was_stale |= stale and row is not None
        health["word"] |= NO_HEALTH * stale
        health["latched"] |= NO_HEALTH * (stale or self._was_stale)
        return health | {
            "mode": self._mode,
            "phase": self._phase,
            "sent": self.sent,
            "overdue": unsent.pop("overdue"),
            "unread": self.unread,
            **{f"unsent_{what}": count for what, count in unsent.items()},
        }
