"""Announces warnings, errors, phases, estimates and status of a running flight through ``logging``.

It reads the rings like any other reader, so that every reported event is both announced and recorded. The logger is
``heft``; its handlers must not block, because the supervisor calls them.
"""

import logging
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.records import EVENT, GAP, Rows, Severity
from onboard import config
from onboard.channels import QUANTITY
from onboard.devices.base import BusDevice
from onboard.recording.recorder import NOT_KEPT
from onboard.ring import RingError, RingReader

LOGGER = logging.getLogger("heft")
LOGGER.addHandler(logging.NullHandler())
RECORDER_SAID = "recorder_event.said"  # a ring of the recorder's events: what is in a *.ring it records itself
SILENT = 0.9  # fraction of the nominal rate below which a channel is listed
_LEVELS = {Severity.INFO: logging.INFO, Severity.WARNING: logging.WARNING, Severity.ERROR: logging.ERROR}
_NO_EVENTS = np.zeros(0, EVENT)
_NO_ROWS = {"gap": np.zeros(0, GAP), "quantity": np.zeros(0, QUANTITY)}
_SLOW_HZ = 2.0  # channels that come less often are not judged in every line
_NAMED = 3  # channels in a line
_SAID = {"mode", "zeroed", "realtime", "not_realtime", "mark", "stop", "span"}  # information that is said


class AnnouncedAnswer(NamedTuple):
    """The newest of a quantity that the data support."""

    value: float
    low: float
    high: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:.4g} {self.unit} ({self.low:.4g} to {self.high:.4g})"


class Announcer:
    """Announces one flight.

    Args:
        vehicle: what flies.
        directory: of its rings.
        now_s: time of the call.
        status_s: between two lines that say how it stands; None says none.
    """

    def __init__(self, vehicle: config.Vehicle, directory: Path, now_s: float, status_s: float | None) -> None:
        self._vehicle, self._directory, self._status_s = vehicle, directory, status_s
        self._readers: dict[str, RingReader] = {}
        self._began_s = self._looked_s = now_s
        self._published: dict[str, int] = {}
        self._missing, self._gaps = 0, 0
        self._mode = self._phase = ""
        self.status = ""  # the last line that said how it stands
        self._estimated_ns: int | None = None
        self.answers: dict[str, AnnouncedAnswer] = {}
        self.quantities: dict[bytes, np.void] = {}  # the newest by name
        self.lost, self.troubles = list[str](), list[str]()  # of the log; all that the recorder reported as errors
        self._rates = {
            channel: vehicle.rate_hz(name)
            for name, device in vehicle.file.device.items()
            if isinstance(device, BusDevice) and not device.tells_changes
            for channel in list(device.channels(name))[:1]
        }

    def step(self, now_s: float, health: str = "", ending: str = "") -> None:
        """Announce events since the last step.

        Args:
            now_s: time of the call.
            health: the status word in words.
            ending: what the end of the flight waits for; the devices are stopped then.
        """
        for name in ("event_supervisor", "event", "event_estimation", RECORDER_SAID):
            self._events(self._read(name))
        if len(gaps := self._read("gap")):
            self._gaps += len(gaps)
            self._missing += int(
                (gaps["last_missing"].astype(np.int64) - gaps["first_missing"].astype(np.int64) + 1).sum()
            )
        quantities = self._read("quantity")
        if len(quantities):
            self._estimated_ns = int(quantities["vehicle_ns"][-1])
            self.quantities |= zip(quantities["name"].tolist(), quantities, strict=True)
            newest = quantities["host_ns"] == quantities["host_ns"][-1]
            for row in quantities[newest & (quantities["unit"] != b"")]:  # base parameters are no answers
                self._answer(row)
        if self._status_s is not None and now_s - self._looked_s >= self._status_s:
            self._say_status(now_s, health, ending)

    def end(self, now_s: float, ended_ns: int) -> None:
        """Announce the remaining events and the final estimates, with their age where the last step is missing.

        Args:
            now_s: time of the call.
            ended_ns: when the devices were asked to stop.
        """
        self.step(now_s)
        age_s = self._age_s(ended_ns)
        age = "" if age_s is None else f", as of {age_s:.1f} s before the end"
        for name, answer in self.answers.items():
            LOGGER.info("%s %s%s", name, answer, age, extra={"source": "answer", "code": "answer"})
        if not self.answers:
            text = f"no estimate: not determined by the data{age}"
            LOGGER.info("%s", text, extra={"source": "answer", "code": "no_answer"})

    def _age_s(self, ended_ns: int) -> float | None:
        """How long before the end the estimator's last step was; None where it has made the final one, or none."""
        try:
            ticks = RingReader(self._directory / "tick.ring").read()[0]
        except (OSError, RingError, ValueError):
            return None
        return None if not len(ticks) or ticks["final"][-1] else max(0.0, 1e-9 * (ended_ns - int(ticks["host_ns"][-1])))

    def rows(self) -> dict[str, int]:
        """Rows that each device channel has had, in all."""
        return {name: reader.published for name in self._vehicle.channels if (reader := self._reader(name))}

    def _events(self, rows: Rows) -> None:
        if not len(rows):
            return
        for severity, *said in zip(*(rows[field] for field in ("severity", "code", "source", "text")), strict=True):
            code, source, text = (one.decode(errors="replace") for one in said)
            if code == "phase":
                self._phase = text
            elif code == "mode":
                self._mode = text.partition(":")[0]
            elif code in NOT_KEPT:
                self.lost.append(text)
            if source == "recorder" and severity >= Severity.ERROR:
                self.troubles.append(text)
            if severity >= Severity.WARNING or source == "estimation" or code in _SAID:
                level = _LEVELS.get(Severity(min(int(severity), Severity.ERROR)), logging.ERROR)
                LOGGER.log(level, "%s: %s", code, text, extra={"source": source, "code": code})

    def _answer(self, row: np.void) -> None:
        name, unit = row["name"].decode(), row["unit"].decode()
        if not row["supported"]:
            if self.answers.pop(name, None) is not None:
                LOGGER.warning("%s is no longer determined", name, extra={"source": "answer", "code": "answer_gone"})
            return
        new = name not in self.answers
        self.answers[name] = AnnouncedAnswer(float(row["value"]), float(row["low"]), float(row["high"]), unit)
        if new:
            LOGGER.info("%s %s", name, self.answers[name], extra={"source": "answer", "code": "answer"})

    def _say_status(self, now_s: float, health: str, ending: str) -> None:
        passed_s, self._looked_s = now_s - self._looked_s, now_s
        published = self.rows()
        came = {name: count - self._published.get(name, 0) for name, count in published.items()}
        self._published = published
        parts = [
            f"{now_s - self._began_s:.0f} s",
            self._mode,
            self._phase,
            ending or f"{sum(came.values()) / passed_s:.0f} rows/s",
        ]
        slow = {
            name: came.get(name, 0) / passed_s
            for name, rate_hz in self._rates.items()
            if not ending and rate_hz * passed_s >= _SLOW_HZ and came.get(name, 0) < SILENT * rate_hz * passed_s
        }
        parts += [f"{name} {hz:.0f} of {self._rates[name]:.0f} Hz" for name, hz in list(slow.items())[:_NAMED]]
        if len(slow) > _NAMED:
            parts.append(f"and {len(slow) - _NAMED} more are slow")
        if self._gaps:
            parts.append(f"{self._missing} rows missing in {self._gaps} gaps")
        if self._estimated_ns is not None:
            parts.append(f"estimate {max(0.0, now_s - 1e-9 * self._estimated_ns):.1f} s old")
        parts += [f"{name} {answer}" for name, answer in list(self.answers.items())[:1]]
        parts.append(health)
        self.status = ", ".join(part for part in parts if part)
        LOGGER.info("%s", self.status, extra={"source": "status", "code": "status"})

    def _reader(self, name: str) -> RingReader | None:
        if name not in self._readers:
            path = self._directory / (name if name == RECORDER_SAID else f"{name}.ring")
            try:
                self._readers[name] = RingReader(path)
            except (OSError, RingError, ValueError):
                return None  # it is made later, or just being made
        return self._readers[name]

    def _read(self, name: str) -> Rows:
        reader = self._reader(name)
        if reader is None:
            return _NO_ROWS.get(name, _NO_EVENTS)
        if not reader.backlog:
            return _NO_ROWS.get(name, _NO_EVENTS)
        rows, lost = reader.read()
        if lost:
            LOGGER.warning("%d rows of %s were not read in time to be said", lost, name, extra={"source": "flight"})
        return rows


def missing_all_flight(vehicle: config.Vehicle, rows: dict[str, int]) -> list[str]:
    """Buses and essential devices without a row in a whole flight, one sentence each.

    Args:
        vehicle: what flew.
        rows: of each device channel, in all.
    """
    of_bus: dict[str, int] = defaultdict(int)
    told = []
    for bus in vehicle.buses:
        channels = [c for name, device in vehicle.devices_on(bus).items() for c in device.channels(name)]
        of_bus[bus] = sum(rows.get(channel, 0) for channel in channels)
        if channels and not of_bus[bus]:
            told.append(f"bus {bus} was missing all flight: no row of {', '.join(channels)}")
    for name in vehicle.file.vehicle.essential:
        if not any(rows.get(channel, 0) for channel in vehicle.file.device[name].channels(name)):
            told.append(f"{name}, which is essential, was missing all flight")
    return told
