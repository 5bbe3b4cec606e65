"""Which packet is sent next, under a budget of bytes a second. Time is an argument; nothing waits.

In this order: status, what flight this is, mode and phase, at most one event a second, answers, more events, reasons.
Each of the first four is bounded to a share of the budget, so that answers always get theirs; where these do not fit
their rate, each waits equally long. A packet is made when there is room for it, of what is newest then. What
was replaced or left out before it was sent is counted, and the status says it: the log has it all.
"""

import math
import re
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.records import EVENT as EVENT_ROW
from drivers.records import Batch, Severity
from onboard import channels
from onboard.recording.format.texts import printable
from onboard.telemetry.packets import COUNTS, KINDS, LONGEST, MODES, NO_HEALTH, UNKNOWN_MODE, UNKNOWN_PHASE, encode

MOST_EVENTS = 256  # that wait
MOST_ANSWERS = 64  # quantities
STALE_NS = 3_000_000_000  # health records come every second
_BURST_S = 0.5  # of the budget may be sent at once
_EVENT_S = 1.0  # so often one event comes before answers
_PHASE_S = 0.2  # between two packets of changes, at least
_REASON_NS = 5_000_000_000  # between two reasons of a quantity of the same level, at least
_SHARES = {"status": 0.5, "flight": 0.05, "phase": 0.1, "event": 0.25}  # of the budget, at most, before answers
_MODES = {word: number for number, word in MODES}
_NUMBERS = ("value", "low", "high", "sigma")
_PHASE = re.compile(r"phase (-?\d+)")
_NAN = math.nan


class Rates(Protocol):
    """What ``[telemetry]`` of a vehicle file says: :class:`onboard.config.telemetry.Telemetry`."""

    @property
    def bytes_s(self) -> float:
        """Budget."""

    @property
    def status_hz(self) -> float:
        """Of the status."""

    @property
    def answers_hz(self) -> float:
        """Of each answer."""

    @property
    def phase_hz(self) -> float:
        """Of mode and phase."""

    @property
    def flight_hz(self) -> float:
        """Of what flight it is."""

    @property
    def reasons_hz(self) -> float:
        """Of each reason."""

    @property
    def apids(self) -> dict[str, int]:
        """By kind of packet."""


class Flight(NamedTuple):
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
        self.level, self.why = _level(row), _why(row)

    def renew(self, row: np.void, now_ns: int) -> tuple[int, int]:
        """Take a newer row; the number of answers and reasons that it replaces before they were sent."""
        level, why = _level(row), _why(row)
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
        self, settings: Rates, session: int, flight: Flight, now_ns: int, bytes_s: float | None = None
    ) -> None:
        self._settings, self._session, self._flight = settings, session, flight
        self._bytes_s = settings.bytes_s if bytes_s is None else min(bytes_s, settings.bytes_s)
        self._apids = settings.apids
        self._counts = dict.fromkeys(KINDS, 0)
        self._most = max(_BURST_S * self._bytes_s, float(LONGEST))
        self._room, self._at_ns = self._most, now_ns
        self._due = dict.fromkeys(("status", "flight", "phase"), now_ns)
        self._period = {name: self._spaced(name, 1.0 / getattr(settings, f"{name}_hz")) for name in self._due}
        self._event_period_ns, self._change_ns = self._spaced("event", _EVENT_S), self._spaced("phase", _PHASE_S)
        self._answer_ns, self._reason_ns = (round(1e9 / hz) for hz in (settings.answers_hz, settings.reasons_hz))
        self._health: np.void | None = None
        self._was_stale = False
        self._answers: dict[str, _Answer] = {}
        self._events: list[deque[np.void]] = [deque() for _ in Severity]  # by severity, oldest first
        self._event_ns, self._phase_ns = now_ns - self._event_period_ns, now_ns - self._change_ns
        self._mode, self._phase = UNKNOWN_MODE, UNKNOWN_PHASE
        self._changed_ns, self._changed = now_ns, 0  # changes of mode or phase that were not sent
        self._unsent = dict.fromkeys(Unsent._fields, 0)
        self.unread = self.sent = 0

    def _spaced(self, kind: str, period_s: float) -> int:
        """``period_s`` [s] in ns, or more where packets that often would take more than their share."""
        return round(1e9 * max(period_s, KINDS[kind].length / (_SHARES[kind] * self._bytes_s)))

    @property
    def unsent(self) -> Unsent:
        """What was not sent, without what still waits."""
        return Unsent(**self._unsent)

    @property
    def waiting(self) -> int:
        """Events, changes and answers that wait."""
        return self._waiting_events + self._changed + sum(not one.sent for one in self._answers.values())

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
            mode = _MODES.get(text.partition(":")[0], UNKNOWN_MODE)
        elif code == b"phase" and (found := _PHASE.match(text)):
            phase = int(found[1])
        if (mode, phase) != (self._mode, self._phase):
            self._mode, self._phase, self._changed_ns = mode, phase, int(row["host_ns"])
            self._unsent["phases"] += self._changed  # the change before it was not sent
            self._changed = 1
        self._events[min(int(row["severity"]), max(Severity))].append(row)
        if self._waiting_events > MOST_EVENTS:  # the least serious, of these the oldest, is left out
            next(events for events in self._events if events).popleft()
            self._unsent["events"] += 1

    def packets(self, now_ns: int) -> Iterator[bytes]:
        """Packets that are due at ``now_ns`` and fit the budget; those not taken are not sent."""
        self._room = min(self._most, self._room + (now_ns - self._at_ns) * 1e-9 * self._bytes_s)
        self._at_ns = now_ns
        while (found := self._choose(now_ns)) is not None and KINDS[found[0]].length <= self._room:
            kind, what = found
            packet = self._make(kind, what, now_ns)
            self._room -= len(packet)
            yield packet

    def finish(self, now_ns: int) -> None:
        """The flight is over: what is newest is due."""
        for one in self._answers.values():
            one.due_ns = now_ns

    def last(self, now_ns: int) -> Iterator[bytes]:
        """The last packet, which says how it ended: the status."""
        self._due["status"], self._room = now_ns, float(KINDS["status"].length)
        self._at_ns = now_ns
        return self.packets(now_ns)

    def _choose(self, now_ns: int) -> tuple[str, Any] | None:
        """The kind that is next, and of what."""
        for kind in ("status", "flight"):
            if now_ns >= self._due[kind]:
                return kind, None
        if now_ns >= self._due["phase"] or (self._changed and now_ns - self._phase_ns >= self._change_ns):
            return "phase", None
        events = self._waiting_events
        if events and now_ns - self._event_ns >= self._event_period_ns:
            return "event", None
        fresh = [one for one in self._answers.values() if not one.sent and one.due_ns <= now_ns]
        if fresh:
            return "answer", min(fresh, key=lambda one: one.due_ns)
        if events:
            return "event", None
        untold = (one for one in self._answers.values() if one.untold(now_ns))
        first = min(untold, key=lambda one: (one.told, one.told_ns), default=None)
        return None if first is None else ("reason", first)

    def _make(self, kind: str, what: Any, now_ns: int) -> bytes:
        at_ns = now_ns
        if kind in self._due:
            self._unsent["overdue"] += self._late(self._due[kind], self._period[kind], now_ns) * (kind == "status")
            self._due[kind] = self._next(self._due[kind], self._period[kind], now_ns)
        if kind == "status":
            values = self._status(now_ns)
        elif kind == "flight":
            one = self._flight
            values = one._asdict() | {"wall_clock": one.wall_clock_ns, "monotonic": one.monotonic_ns}
        elif kind == "phase":
            self._changed, self._phase_ns = 0, now_ns
            age_s = (now_ns - self._changed_ns) * 1e-9 if self._known_phase else _NAN
            values = {"mode": self._mode, "phase": self._phase, "age": age_s}
        elif kind == "event":
            self._event_ns = now_ns
            severity = max(number for number, events in enumerate(self._events) if events)
            row = self._events[severity].popleft()
            at_ns = int(row["host_ns"])
            values = {"severity": severity, **{key: printable(row[key]) for key in ("code", "source", "text")}}
        elif kind == "answer":
            self._unsent["overdue"] += self._late(what.due_ns, self._answer_ns, now_ns)
            what.due_ns, what.sent = self._next(what.due_ns, self._answer_ns, now_ns), True
            at_ns, values = int(what.row["host_ns"]), _answer_values(what.row)
        else:
            what.told, what.told_ns, what.again_ns = True, now_ns + _REASON_NS, now_ns + self._reason_ns
            at_ns = int(what.row["host_ns"])
            values = {"quantity": printable(what.row["name"]), "level": what.level, "why": what.why}
        number = self._counts[kind]
        self._counts[kind] = (number + 1) % COUNTS
        self.sent += 1
        wall_ns = at_ns - self._flight.monotonic_ns + self._flight.wall_clock_ns
        return encode(KINDS[kind], self._apids[kind], number, self._session, wall_ns, values)

    @property
    def _known_phase(self) -> bool:
        return self._mode != UNKNOWN_MODE or self._phase != UNKNOWN_PHASE

    @staticmethod
    def _late(due_ns: int, period_ns: int, now_ns: int) -> int:
        """Whole periods since it was due."""
        return max(0, (now_ns - due_ns) // period_ns)

    @staticmethod
    def _next(due_ns: int, period_ns: int, now_ns: int) -> int:
        """When it is due again: by its own pace, not in a hurry after a delay."""
        return max(due_ns + period_ns, now_ns + period_ns // 2)

    def _status(self, now_ns: int) -> dict[str, Any]:
        row, unsent = self._health, self.unsent
        age_ns = math.inf if row is None else max(0, now_ns - int(row["host_ns"]))
        if row is None:
            health: dict[str, Any] = {
                name: 0 if field.code in "BHIQ" else _NAN for name, field in _HEALTH_FIELDS.items()
            }
        else:
            health = {name: row[of].item() for name, of in _OF_HEALTH.items()}
            health["health_age"] = age_ns * 1e-9
            clocks = {state: int(row[f"clocks_{state}"]) for state in ("acquiring", "locked", "flywheel", "invalid")}
            health["clocks_locked"] = clocks.pop("locked")
            health["clocks_not_locked"] = sum(clocks.values())
        stale = age_ns > STALE_NS
        self._was_stale |= stale and row is not None
        health["word"] |= NO_HEALTH * stale
        health["latched"] |= NO_HEALTH * (stale or self._was_stale)
        return health | {
            "mode": self._mode,
            "phase": self._phase,
            "sent": self.sent,
            "unsent_answers": unsent.answers,
            "unsent_events": unsent.events,
            "unsent_phases": unsent.phases,
            "unsent_reasons": unsent.reasons,
            "overdue": unsent.overdue,
            "unread": self.unread,
        }


def _level(row: np.void) -> int:
    return min(int(row["level"]), 2) if "level" in (row.dtype.names or ()) else 1


def _why(row: np.void) -> str:
    return printable(row["why"]) if "why" in (row.dtype.names or ()) else ""


def _answer_values(row: np.void) -> dict[str, Any]:
    supported = int(bool(row["supported"]))
    return {
        "quantity": printable(row["name"]),
        "unit": printable(row["unit"]),
        "supported": supported,
        "level": _level(row),
        **{name: float(row[name]) if supported else _NAN for name in _NUMBERS},
    }


_OF_HEALTH = {  # fields of the status, of the row HEALTH
    "latched": "status_latched",
    "word": "status_word",
    "rows": "rows",
    "rows_hz": "rows_hz",
    "slowest": "slowest_percent",
    "gaps": "gaps",
    "missing": "missing",
    "not_recorded": "not_recorded",
    "recorder_backlog": "recorder_backlog_percent",
    "estimator_lag": "estimator_lag_s",
    "estimator_skipped": "estimator_skipped_s",
    "restarts": "restarts",
    "computer_idle": "computer_idle_percent",
    "memory_free": "memory_free_mb",
    "disk_free": "disk_free_mb",
    "temperature": "temperature_deg_c",
}
_HEALTH_FIELDS = {
    field.name: field
    for field in KINDS["status"].fields
    if field.name in (*_OF_HEALTH, "health_age", "clocks_locked", "clocks_not_locked")
}
