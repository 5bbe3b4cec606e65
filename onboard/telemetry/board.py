"""What came down of a flight, on one screen: the newest of each kind, and what did not come."""

import math
from collections import deque
from datetime import UTC, datetime, timedelta
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from onboard.flight.health.status import CAUTION, NO_HEALTH, standing
from onboard.telemetry.packets import Packet
from onboard.telemetry.stream import Series, Splitter

SILENT_S = 5.0  # without a packet, of which some come every second
_EVENTS = 8
_OLD_NS = 10_000_000_000  # an answer that so much has come after
_BODY_UNITS = ("kg", "m", "kg m^2")  # of what is held; others belong to the instruments
_REPORTED = {1: "accepted", 2: "not accepted", 3: "begun", 7: "completed", 8: "not carried out"}
_STYLES = {"good": "", "weak": "yellow", "do not use": "dim"}


class PacketBoard:
    """Packets so far.

    Args:
        stream: that they come from.
        series: that places them.
    """

    def __init__(self, stream: Splitter, series: Series) -> None:
        self._stream, self._series = stream, series
        self._last: dict[str, Packet] = {}
        self._answers: dict[str, Packet] = {}
        self._why: dict[str, tuple[str, str]] = {}  # level, reason
        self._events: deque[Packet] = deque(maxlen=_EVENTS)
        self._reports: deque[Packet] = deque(maxlen=_EVENTS)
        self.packets = self._newest_ns = 0

    def add(self, packet: Packet) -> None:
        """Take a packet that is new; an older one than is shown changes nothing."""
        self.packets += 1
        self._newest_ns = max(self._newest_ns, packet.at_ns)
        kind, values = packet.kind.name, packet.values
        if kind == "event":
            self._events.append(packet)
        elif kind in ("report", "failure"):
            self._reports.append(packet)
        elif kind == "reason":
            self._why[values["quantity"]] = values["level"], values["why"]
        elif kind == "answer":
            if (before := self._answers.get(values["quantity"])) is None or before.at_ns <= packet.at_ns:
                self._answers[values["quantity"]] = packet
        elif (last := self._last.get(kind)) is None or last.at_ns <= packet.at_ns:
            self._last[kind] = packet

    def render(self, silent_s: float = 0.0) -> RenderableType:
        """The screen; ``silent_s``: nothing has come for so long."""
        parts: list[RenderableType] = [self._head(), *self._status(silent_s)]
        if self._answers:
            parts += [Text(), self._answer_table(), *self._reasons()]
        if self._events:
            parts += [Text(), *(self._event(packet) for packet in self._events)]
        if self._reports:
            parts += [Text(), *(Text(f"{when(one.at_ns)}  {reported(one)}") for one in self._reports)]
        return Group(*parts, Text(), *(Text(line) for line in self.losses()))

    def losses(self) -> list[str]:
        """What did not come, in lines."""
        missing = {name: count for name, count in self._series.missing.items() if count}
        lines = [f"{self.packets} packets; missing {_listed(missing) or 'none'}; repeated {self._series.repeated}"]
        if self._series.unheard:
            lines.append(f"{self._series.unheard} packets were sent before the first that came")
        if self._stream.skipped:
            lines.append(f"{self._stream.skipped} bytes belong to no whole packet")
        lines += [f"{count} packets refused: {why}" for why, count in self._stream.refused.items()]
        return lines

    @property
    def is_whole(self) -> bool:
        """Whether nothing is missing or damaged."""
        return not (any(self._series.missing.values()) or self._stream.skipped or self._stream.refused)

    def _head(self) -> Text:
        flight, status = self._last.get("flight"), self._last.get("status")
        head = Text(flight.values["vehicle"] if flight else "flight not known yet", "bold")
        if status is not None:
            phase = status.values["phase"]
            head.append(f"   {when(status.at_ns)}   {status.values['mode']}", "not bold")
            head.append(f"   phase {phase}" if phase >= 0 else "", "not bold")
        return head

    def _status(self, silent_s: float) -> list[Text]:
        status = self._last.get("status")
        if status is None:
            return [Text("no status yet", "yellow")]
        values = status.values
        said = verdict(values, [packet.values for packet in self._answers.values()])
        if silent_s > SILENT_S:
            said = f"NO-GO: nothing has come for {silent_s:.0f} s; before: {said}"
        lines = [Text(said, "bold green" if said.startswith("GO") else "bold red")]
        told = (
            f"{values['rows']:,} rows, {values['gaps']} gaps, {values['missing']} missing; estimator lag "
            f"{_number(values['estimator_lag'], 's')}; disk {_number(values['disk_free'], 'MB')}; "
            f"{_number(values['temperature'], 'deg C')}"
        )
        lines.append(Text(told, "dim"))
        unsent = {name.removeprefix("unsent_"): values[name] for name in values if name.startswith("unsent_")}
        left = f"not sent: {_listed(unsent, zeros=True)}; overdue {values['overdue']}"
        lines.append(Text(left + (f"; unread {values['unread']}" if values["unread"] else ""), "dim"))
        return lines

    def _answer_table(self) -> Table:
        numbers = (Column(name, justify="right", no_wrap=True) for name in ("value", "low", "high"))
        table = Table("estimate", *numbers, "unit", "level", box=None, pad_edge=False, header_style="dim")
        for name, packet in self._answers.items():
            values = packet.values
            shown = [f"{values[key]:.6g}" if values["supported"] == "yes" else "" for key in ("value", "low", "high")]
            is_open = values["supported"] != "yes" and values["level"] == "weak"
            level = "not determined yet" if is_open else values["level"]
            late_ns = self._newest_ns - packet.at_ns
            level += f", {late_ns * 1e-9:.0f} s old" if late_ns > _OLD_NS else ""
            table.add_row(Text(name), *shown, Text(values["unit"]), Text(level, _STYLES[values["level"]]))
        return table

    def _reasons(self) -> list[Text]:
        """Of the level that each answer has now."""
        found: dict[str, list[str]] = {}
        for name, (level, why) in self._why.items():
            if name in self._answers and self._answers[name].values["level"] == level:
                found.setdefault(f"{level}: {why}", []).append(name)
        return [Text(f"{', '.join(names)}: {why}") for why, names in found.items()]

    @staticmethod
    def _event(packet: Packet) -> Text:
        values = packet.values
        style = {"info": "", "warning": "yellow", "error": "bold red"}[values["severity"]]
        return Text(f"{when(packet.at_ns)}  {values['source']}: {values['text']}", style)


def reported(packet: Packet) -> str:
    """What a report says of a command."""
    values = packet.values
    which = f"command {values['sequence_control'] & 0x3FFF} of source {values['destination']}"
    what = _REPORTED.get(values["subtype"], f"report {values['subtype']}")
    return f"{which}: {what}" + (f", {values['code']}: {values['why']}" if "code" in values else "")


def when(at_ns: int) -> str:
    """A time since 1970 as text, to a millisecond."""
    at = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=at_ns // 1000)
    return at.strftime("%Y-%m-%d %H:%M:%S.") + f"{at.microsecond // 1000:03d}"


def verdict(status: dict[str, Any], answers: list[dict[str, Any]]) -> str:
    """Go or no-go with its reasons, of the fields of a status and of answers, as the page says it (docs/ground.md)."""
    word, latched = status["word"] & ~NO_HEALTH, status["latched"] & ~NO_HEALTH
    held = [values for values in answers if values["unit"] in _BODY_UNITS]
    poor = [values["quantity"] for values in held if values["level"] != "good" or values["supported"] == "no"]
    reasons = []
    if status["word"] & NO_HEALTH:
        age_s = status["health_age"]
        reasons.append("health not known" + ("" if math.isnan(age_s) else f" for {age_s:.0f} s"))
    if not held:
        reasons.append("no answer yet")
    if poor:
        reasons.append(f"{len(poor)} of {len(held)} answers are not good")
    is_no_go = bool(reasons) or bool(word & ~CAUTION)
    before = " (health was not known for some time)" if status["latched"] & ~status["word"] & NO_HEALTH else ""
    return f"{'NO-GO' if is_no_go else 'GO'}: {'; '.join([*reasons, standing(word, latched)])}{before}"


def _number(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}" if math.isfinite(value) else "unknown"


def _listed(counts: dict[str, int], *, zeros: bool = False) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count or zeros)
