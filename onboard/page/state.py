"""State of a flight from its rows, as a frame of plain numbers and texts: what the page shows.

The same for a flight and a log. Reads no clock: the time is an argument.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.records import EVENT, GAP, Batch, Rows
from onboard import channels
from onboard.flight.health.status import CAUTION, MEANINGS, NO_HEALTH, Status, words
from onboard.page.signals import PageSignals
from onboard.recording.format.texts import listed, printable
from onboard.timebase.clock import ClockState

LEVELS = ("good", "weak", "do not use")  # onboard.identification.standing, which takes 30 MB to import
KINDS = {"kg": "mass", "m": "centre", "kg m^2": "inertia"}  # by unit; others belong to the instruments
BODY = ("m", "c_x", "c_y", "c_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
SILENT_NS = 3_000_000_000  # without a health record, of which there is one a second
EVENTS = 2000  # the newest are kept
POINTS = 400  # of a quantity's history at most: of twice as many every second is left
_RATE_NS = 2_000_000_000
_POINT_NS = 250_000_000
_PROCESSES = ("acquisition", "estimation", "recording", "supervisor", "others")
_COMPUTER = (
    *("computer_idle_percent", "memory_free_mb", "disk_free_mb", "temperature_deg_c", "estimator_lag_s"),
    *("recorder_backlog_percent", "not_recorded", "restarts"),
)


@dataclass
class _Stream:
    """A device's channel."""

    rows: int = 0
    newest_ns: int = 0
    gaps: int = 0
    missing: int = 0
    nominal_hz: float | None = None
    clock: ClockState | None = None
    sigma_ns: float | None = None
    recent: deque[tuple[int, int]] = field(default_factory=deque)  # newest stamp, rows until then

    def saw(self, rows: int, newest_ns: int) -> None:
        self.rows = rows
        if newest_ns <= self.newest_ns:
            return
        self.newest_ns = newest_ns
        self.recent.append((newest_ns, rows))
        while len(self.recent) > 2 and self.recent[1][0] <= newest_ns - _RATE_NS:
            self.recent.popleft()

    def rate_hz(self, now_ns: int) -> float | None:
        """Mean of the last two seconds, by the stamps of the rows; None: not known."""
        if now_ns - self.newest_ns > _RATE_NS or len(self.recent) < 2:
            return 0.0 if self.rows and now_ns - self.newest_ns > _RATE_NS else None
        (first_ns, first), (last_ns, last) = self.recent[0], self.recent[-1]
        return (last - first) / ((last_ns - first_ns) * 1e-9)


@dataclass
class _Quantity:
    """An answer and its course: (stamp, value, low, high) where it was determined."""

    row: np.void
    every_ns: int = _POINT_NS
    history: list[tuple[int, float, float, float]] = field(default_factory=list)

    def add(self, row: np.void) -> None:
        self.row = row
        at_ns = int(row["host_ns"])
        numbers = float(row["value"]), float(row["low"]), float(row["high"])
        if not _is_told(row) or not all(map(math.isfinite, numbers)):
            return
        if not self.history or at_ns - self.history[-1][0] >= self.every_ns:
            self.history.append((at_ns, *numbers))
        if len(self.history) > POINTS:
            self.history, self.every_ns = self.history[::2], 2 * self.every_ns


class PageState:
    """What is known of a flight.

    Args:
        title: of the flight.
        payload: link whose body is asked for; empty where the vehicle file names none.
        arm: what the page draws of the vehicle, see :func:`onboard.page.arm.tree_of`.
        live: whether the flight goes on: then the age of its health records counts.

    Attributes:
        start_ns: oldest stamp, CLOCK_MONOTONIC.
        now_ns: newest stamp.
        signals: of the devices.
        lost: rows that a ring no longer had when they were to be read here; the log has them.
        event_count: events so far.
        silence: why nothing comes of a flight that is seen through a link; empty: it does.
    """

    def __init__(self, title: str, payload: str = "", arm: dict[str, Any] | None = None, *, live: bool) -> None:
        self.title, self.live, self.arm = title, live, arm
        self._body = [f"{kind}_{payload}" for kind in BODY] if payload else []
        self.start_ns: int | None = None
        self.now_ns = 0
        self.signals = PageSignals()
        self.silence = ""
        self.lost = self.event_count = 0
        self._streams: dict[str, _Stream] = {}
        self._quantities: dict[str, _Quantity] = {}
        self._events: deque[tuple[int, int, int, str, str, str]] = deque(maxlen=EVENTS)
        self._mode = self._phase = ""
        self._health: np.void | None = None
        self._standing: np.void | None = None
        self._pss = dict.fromkeys(_PROCESSES, math.nan)
        self._request: np.void | None = None
        self._row: np.void | None = None

    def add(self, batch: Batch) -> None:
        """Take in rows of any channel; those that the page shows nothing of count as time alone."""
        name, rows = batch
        if not len(rows):
            return
        self._time(rows)
        fields = set(rows.dtype.names or ())
        if rows.dtype == EVENT:
            self._say(rows)
        elif rows.dtype == GAP:
            self._gap(rows)
        elif channels.is_quantity(rows.dtype):
            for row in rows:
                self._quantities.setdefault(printable(row["name"]), _Quantity(row)).add(row)
        elif {"status_word", "status_latched", "computer_idle_percent"} <= fields:
            self._take_health(rows)
        elif rows.dtype == channels.STANDING:
            self._standing, self._mode, self._phase = rows[-1], *map(printable, (rows["mode"][-1], rows["phase"][-1]))
        elif "channel" in fields:
            self._about_streams(rows, fields)
        elif "joint_rad" in fields:
            known = np.isfinite(np.asarray(rows["joint_rad"], float).reshape(len(rows), -1)).all(axis=1)
            self._row = rows[known][-1] if known.any() else self._row
            self.signals.add("estimator", rows)
        elif {"act", "ratio", "segment"} <= fields:
            self._request = rows[-1]
        elif rows.dtype == channels.INNOVATION:
            self.signals.add(name, rows)
        elif is_device(rows.dtype):
            stream = self._streams.setdefault(name, _Stream())
            stream.saw(stream.rows + len(rows), int(rows["host_ns"].max()))
            self.signals.add(name, rows)

    def count(self, name: str, total: int, rows: Rows) -> None:
        """A device's channel has had ``total`` rows since its start, the newest of them are ``rows``."""
        self._time(rows)
        self._streams.setdefault(name, _Stream()).saw(total, int(rows["host_ns"][-1]))
        self.signals.add(name, rows)

    def _time(self, rows: Rows) -> None:
        first_ns = int(rows["host_ns"].min())
        self.start_ns = first_ns if self.start_ns is None else min(self.start_ns, first_ns)
        self.now_ns = max(self.now_ns, int(rows["host_ns"].max()))

    def _stream(self, name: bytes) -> _Stream:
        return self._streams.setdefault(printable(name), _Stream())

    def _take_health(self, rows: Rows) -> None:
        self._health = rows[-1]
        for process in _PROCESSES:  # one process a second is looked at
            found = rows[f"{process}_pss_mb"][np.isfinite(rows[f"{process}_pss_mb"])]
            self._pss[process] = float(found[-1]) if len(found) else self._pss[process]

    def _about_streams(self, rows: Rows, fields: set[str]) -> None:
        for row in rows:
            if {"nominal_hz", "clock_state"} <= fields:
                self._stream(row["channel"]).nominal_hz = float(row["nominal_hz"]) or None
            elif {"period_ns", "state"} <= fields:
                stream = self._stream(row["channel"])
                stream.clock, stream.sigma_ns = _clock(int(row["state"])), float(row["sigma_ns"])

    def _gap(self, rows: Rows) -> None:
        for row in rows:
            stream = self._stream(row["channel"])
            stream.gaps += 1
            stream.missing += int(row["last_missing"]) - int(row["first_missing"]) + 1

    def _say(self, rows: Rows) -> None:
        for row in rows:
            code, source, text = (printable(row[key]) for key in ("code", "source", "text"))
            if code == "phase":
                self._phase = text
            elif code == "mode":
                self._mode = text.partition(":")[0]
            self._events.append((self.event_count, int(row["host_ns"]), int(row["severity"]), source, code, text))
            self.event_count += 1

    def events(self, since: int = 0) -> list[dict[str, Any]]:
        """Events from number ``since`` on, as far as they are kept."""
        return [
            {"n": n, "t": self._seconds(at_ns), "severity": severity, "source": source, "code": code, "text": text}
            for n, at_ns, severity, source, code, text in self._events
            if n >= since
        ]

    def history(self) -> dict[str, list[tuple[float, float, float, float]]]:
        """Course of each quantity that is shown: seconds since the start, value, low, high."""
        return {
            name: [(self._seconds(at_ns), *numbers) for at_ns, *numbers in known.history]  # type: ignore[misc]
            for name, known in self._quantities.items()
            if self._is_shown(known)
        }

    def frame(self, now_ns: int | None = None, *, ended: bool = False) -> dict[str, Any]:
        """Everything that changes, JSON values in SI units; None where a number is not known.

        Args:
            now_ns: CLOCK_MONOTONIC; of a log its newest stamp, the default.
            ended: the flight is over.
        """
        now_ns = self.now_ns if now_ns is None else max(now_ns, self.now_ns)
        return {
            "title": self.title,
            "t": self._seconds(now_ns),
            "ended": ended,
            "mode": self._mode,
            "phase": self._phase,
            "go": self._go(now_ns, ended),
            "held": [_answer(name, known.row) for name, known in self._quantities.items() if self._is_shown(known)],
            "devices": self._devices(now_ns),
            "processes": self._processes(),
            "computer": self._computer(),
            "joints": self._joints(),
            "asked": self._asked(),
            "event_count": self.event_count,
            "lost": self.lost,
        }

    def _seconds(self, at_ns: int) -> float:
        return 0.0 if self.start_ns is None else round((at_ns - self.start_ns) * 1e-9, 6)

    def _is_shown(self, known: _Quantity) -> bool:
        return bool(known.row["unit"])  # base parameters have none

    def _asked_names(self) -> list[str]:
        """Of what is held: the payload's ten numbers where they are estimated, or all that have a body's units."""
        if self._body and self._quantities.keys() >= set(self._body):
            return self._body
        return [name for name, known in self._quantities.items() if printable(known.row["unit"]) in KINDS]

    def _go(self, now_ns: int, ended: bool) -> dict[str, Any]:
        """``word``: go, or no-go where a reason is ``against`` or an answer is ``open``."""
        silence = "note" if self._mode == "stopped" else "against"  # after it nothing is to come
        reasons = [*self._of_link(silence), *self._of_health(now_ns, ended, silence), *self._of_answers()]
        if ended:
            reasons.insert(0, ("note", "the flight has ended: these are its last numbers"))
        if not reasons:
            reasons.append(("note", "all numbers of what is held are good, and nothing fails"))
        stops = {kind for kind, _ in reasons} & {"against", "open"}
        told = [{"kind": kind, "text": text} for kind, text in reasons]
        return {"word": "NO-GO" if stops else "GO", "reasons": told}

    def _of_link(self, silence: str) -> Iterator[tuple[str, str]]:
        if self.silence:
            yield silence, self.silence
        if (row := self._standing) is not None and any(lost := row[["missing", "damaged_bytes"]].tolist()):
            yield "note", "{} packets did not come, {} bytes belong to no whole packet: the log has all".format(*lost)

    def _of_health(self, now_ns: int, ended: bool, silence: str) -> Iterator[tuple[str, str]]:
        if self._health is None:
            if self.live:
                waiting = self.start_ns is None or now_ns - self.start_ns < SILENT_NS
                yield "open" if waiting else "against", "no health record has come yet"
            return
        age_ns = now_ns - int(self._health["host_ns"])
        if self.live and not ended and age_ns > SILENT_NS:
            why = "the flight's supervisor does not answer" if self._standing is None else "no status came down"
            yield silence, f"no health record for {age_ns * 1e-9:.0f} s: {why}"
        word = int(self._health["status_word"])
        if word & NO_HEALTH:
            yield silence, "health is not known: there is no record of it on board that is new"
        for bit in Status:
            if word & bit:
                kind = "note" if bit & CAUTION else "against"
                yield kind, f"{words(bit)}: {MEANINGS[bit].replace('`', '')}"
        if other := word & ~sum(Status) & ~NO_HEALTH:
            yield "against", f"status {words(other)}: of another version of heft"

    def _of_answers(self) -> Iterator[tuple[str, str]]:
        names = self._asked_names()
        if not names:
            yield "open", "nothing is estimated yet"
        of_reason: dict[str, list[str]] = {}
        for name in names:
            known = self._quantities.get(name)
            answer = None if known is None else _answer(name, known.row)
            if answer is None or answer["level"] != LEVELS[0]:
                why = "not estimated" if answer is None else ": ".join(filter(None, (answer["level"], answer["why"])))
                of_reason.setdefault(why, []).append(name)
        for why, those in of_reason.items():
            against = why.startswith(LEVELS[2])
            yield "against" if against else "open", f"{listed(those)}: {why}"

    def _devices(self, now_ns: int) -> list[dict[str, Any]]:
        return [
            {
                "name": name,
                "rate_hz": _known(stream.rate_hz(now_ns)),
                "nominal_hz": _known(stream.nominal_hz),
                "rows": stream.rows,
                "gaps": stream.gaps,
                "missing": stream.missing,
                "age_s": (now_ns - stream.newest_ns) * 1e-9 if stream.newest_ns else None,
                "clock": None if stream.clock is None else stream.clock.name.lower(),
                "sigma_us": None if stream.clock is ClockState.ACQUIRING else _known(stream.sigma_ns, 1e-3),
            }
            for name, stream in sorted(self._streams.items())
        ]

    def _processes(self) -> list[dict[str, Any]]:
        row = self._health
        if row is None or self._standing is not None:  # a downlink does not have them
            return []
        return [
            {"name": name, "cpu_percent": _known(row[f"{name}_cpu_percent"]), "pss_mb": _known(self._pss[name])}
            for name in _PROCESSES
        ]

    def _computer(self) -> dict[str, Any] | None:
        row = self._health
        if row is None:
            return None
        numbers = {name: _known(row[name]) for name in _COMPUTER if name in (row.dtype.names or ())}
        word, before = int(row["status_word"]), int(row["status_latched"]) & ~int(row["status_word"])
        return numbers | {"status": words(word), "before": words(before) if before else ""}

    def _joints(self) -> list[float] | None:
        """Positions of the newest row of the regression that has them, rad or m, in the model's order."""
        if self._row is None:
            return None
        return [round(float(value), 5) for value in np.atleast_1d(self._row["joint_rad"])]

    def _asked(self) -> dict[str, Any] | None:
        """The motion that the flight asked for last, of ``--until``."""
        row = self._request
        if row is None:
            return None
        act = int(row["act"])
        known = {int(one): one.name.lower().replace("_", " ") for one in channels.Act}
        numbers = {"ratio": _known(row["ratio"]), "expected": _known(row["expected"]), "number": int(row["number"])}
        return numbers | {"act": known.get(act, f"act {act}"), "segment": printable(row["segment"])}


def is_device(dtype: np.dtype[np.void]) -> bool:
    """Whether rows are a device's: they have its own tick, or are edges of the pulse."""
    return bool({"tick", "edge_ns"} & set(dtype.names or ()))


def _is_told(row: np.void) -> bool:
    """Whether a value may be shown: the data determine it, and it is not withdrawn."""
    return bool(row["supported"]) and ("level" not in (row.dtype.names or ()) or int(row["level"]) < 2)


def _answer(name: str, row: np.void) -> dict[str, Any]:
    has_level = "level" in (row.dtype.names or ())
    unit, supported = printable(row["unit"]), _is_told(row)
    level = LEVELS[min(int(row["level"]), 2)] if has_level else LEVELS[0] if supported else LEVELS[1]
    return {
        "name": name,
        "unit": unit,
        "kind": KINDS.get(unit, "other"),
        "supported": supported,
        "level": level,
        "why": printable(row["why"]) if has_level else "",
        **{key: _known(number) for key, number in channels.numbers_of(row).items() if key != "sigma"},
    }


def _clock(state: int) -> ClockState | None:
    return ClockState(state) if state in ClockState._value2member_map_ else None


def _known(value: Any, scale: float = 1.0) -> float | None:
    number = math.nan if value is None else float(value)
    return number * scale if math.isfinite(number) else None
