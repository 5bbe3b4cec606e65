"""``heft watch``: live state of a flight on one screen, from its rings or from its log.

The board takes batches and reads no clock: "now" is the newest stamp received, so a log played fast looks like the
flight.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from drivers.records import EVENT, GAP, Batch, Rows, Severity
from onboard import channels
from onboard.estimation.gates import GateReason
from onboard.estimation.policy import MISFIT_DOUBTED
from onboard.flight.health.status import standing
from onboard.ground.log.views.health import PROCESSES, is_health
from onboard.ground.log.views.standing import is_withdrawn, standing_of
from onboard.identification.standing import Level
from onboard.recording.format.texts import printable
from onboard.timebase.clock import ClockState

_RATE_NS = 2_000_000_000  # window for rates and gate shares
_QUIET_NS = 1_000_000_000  # silence after which a channel is marked
_POINTS = 32  # points of an interval's trend over the whole flight
_TREND_NS = 250_000_000  # initial spacing of these points
_EVENTS = 4
_BLOCKS = "▁▂▃▄▅▆▇█"
_STATE_STYLE = {
    ClockState.ACQUIRING: "dim",
    ClockState.LOCKED: "green",
    ClockState.FLYWHEEL: "yellow",
    ClockState.INVALID: "bold red",
}


@dataclass
class _Channel:
    rows: int = 0
    missing: int = 0
    told: int = 0
    flagged: int = 0
    last_sequence: int | None = None
    first_ns: int | None = None
    last_ns: int = 0
    recent: deque[tuple[int, int]] = field(default_factory=deque)  # (newest stamp, rows within the window) of batches

    def add(self, rows: Rows) -> None:
        sequence = rows["sequence"].astype(np.int64)
        before = sequence[0] - 1 if self.last_sequence is None else self.last_sequence
        steps = np.diff(sequence, prepend=before)
        self.missing += int((steps[steps > 1] - 1).sum())
        self.rows += len(rows)
        stamps = rows["host_ns"]
        self.first_ns = int(stamps[0]) if self.first_ns is None else self.first_ns
        self.last_sequence, self.last_ns = int(sequence[-1]), max(self.last_ns, int(stamps.max()))
        # what was in the ring before this viewer came is of many seconds
        self.recent.append((int(stamps[-1]), int(np.count_nonzero(stamps > stamps[-1] - _RATE_NS))))
        if "status" in (rows.dtype.names or ()):
            self.flagged += int(np.count_nonzero(rows["status"]))

    def rate_hz(self, now_ns: int) -> float:
        """Of the window before ``now_ns``, or of the time since the first row where that is shorter."""
        while self.recent and self.recent[0][0] <= now_ns - _RATE_NS:
            self.recent.popleft()
        passed_ns = min(_RATE_NS, now_ns - (self.first_ns or 0))
        return sum(count for _, count in self.recent) / (passed_ns * 1e-9) if passed_ns > 0 else 0.0


@dataclass
class _Answer:
    last: np.void
    every_ns: int
    widths: list[float] = field(default_factory=list)
    sampled_ns: int = 0

    def add(self, row: np.void) -> None:
        self.last = row
        if row["supported"] and int(row["host_ns"]) - self.sampled_ns >= self.every_ns:
            self.sampled_ns = int(row["host_ns"])
            self.widths.append(float(row["high"] - row["low"]))
        if len(self.widths) > _POINTS:
            self.widths, self.every_ns = self.widths[::2], 2 * self.every_ns


class Board:
    """State of a flight from the batches so far.

    Args:
        title: heading.

    Attributes:
        answers: the newest by name, and their trends.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.start_ns: int | None = None
        self.now_ns = 0
        self.lost = 0  # rows overwritten in a ring before they were read here; the log has them
        self._channels: dict[str, _Channel] = {}
        self._clocks: dict[str, np.void] = {}
        self.answers: dict[str, _Answer] = {}
        self._gates: deque[tuple[int, np.ndarray]] = deque()
        self._errors: deque[tuple[int, np.ndarray]] = deque()  # (n, 6) in their sigmas
        self._used = self._total = 0
        self._events: deque[tuple[int, int, str]] = deque(maxlen=_EVENTS)
        self._mode = self._phase = ""
        self._health: np.void | None = None

    def add(self, batch: Batch) -> None:
        """Add rows."""
        name, rows = batch
        if not len(rows):
            return
        newest = int(rows["host_ns"].max())
        self.now_ns = max(self.now_ns, newest)
        self.start_ns = int(rows["host_ns"].min()) if self.start_ns is None else self.start_ns
        self._channels.setdefault(name, _Channel()).add(rows)
        fields = set(rows.dtype.names or ())
        if rows.dtype == GAP:
            for row in rows:
                count = int(row["last_missing"]) - int(row["first_missing"]) + 1
                self._channels.setdefault(printable(row["channel"]), _Channel()).told += count
        elif rows.dtype == EVENT:
            self._say(rows)
        elif channels.is_quantity(rows.dtype):
            for row in rows:
                self.answers.setdefault(printable(row["name"]), _Answer(row, _TREND_NS)).add(row)
        elif is_health(rows.dtype):
            self._health = rows[-1]
        elif {"period_ns", "state", "channel"} <= fields:
            self._clocks.update((printable(row["channel"]), row) for row in rows)
        elif name == "row" and "gate" in fields:
            self._gates.append((newest, rows["gate"].copy()))
            self._total += rows["gate"].size
            self._used += int(np.count_nonzero(rows["gate"] == 0))
        elif rows.dtype == channels.INNOVATION:
            self._errors.append((newest, rows["error"] / rows["sigma"]))

    def _say(self, rows: Rows) -> None:
        for row in rows:
            if row["code"] == b"phase":
                self._phase = printable(row["text"])
            elif row["code"] == b"mode":
                self._mode = printable(row["text"]).partition(":")[0]
            else:
                said = f"{printable(row['source'])}: {printable(row['text'])}"
                self._events.append((int(row["host_ns"]), int(row["severity"]), said))

    def render(self) -> RenderableType:
        """The board as a renderable."""
        clocks = Group(self._clock_table(), Text(), self._gate_lines(), *self._error_lines(), Text())
        tables = [Group(self.channel_table(), Text()), clocks]
        side = Columns(tables, padding=(0, 3))  # one below the other where the terminal is too narrow
        parts: list[RenderableType] = [self._head(), *self._health_lines(), Text(), side]
        if self.answers:
            parts += [self._answer_table(), *self._reasons(), Text()]
        return Group(*parts, *self._event_lines())

    def _head(self) -> Text:
        since = 0.0 if self.start_ns is None else (self.now_ns - self.start_ns) * 1e-9
        head = Text.assemble((self.title, "bold"), f"   {since:9.1f} s", f"   {self._mode}   {self._phase}")
        if self.lost:
            head.append(f"   this viewer was too slow for {self.lost:,} rows", "yellow")
        return head

    def _health_lines(self) -> list[RenderableType]:
        row = self._health
        if row is None:
            return []
        word, latched = int(row["status_word"]), int(row["status_latched"])
        cpu, pss = (np.nansum([row[f"{name}_{what}"] for name in PROCESSES]) for what in ("cpu_percent", "pss_mb"))
        temperature = row["temperature_deg_c"]
        told = f"CPU {cpu:.0f} % of a core, {pss:.0f} MB, computer {row['computer_idle_percent']:.0f} % idle, "
        told += "temperature unknown" if np.isnan(temperature) else f"{temperature:.0f} deg C"
        style = "yellow" if word else "green" if not latched else ""
        return [Text(standing(word, latched), style), Text(told, "dim")]

    def channel_table(self) -> Table:
        """Rates, counts and what is missing, a line a channel."""
        table = _table("channel", "Hz", "rows", "missing", "flagged")
        for name, channel in sorted(self._channels.items()):
            if not channel.rows and not channel.told:
                continue
            rate = channel.rate_hz(self.now_ns)
            quiet = self.now_ns - channel.last_ns > _QUIET_NS and channel.rows > 20
            unexplained = channel.missing > channel.told
            missing = Text(f"{channel.missing:,}" if channel.missing else "-", "bold red" if unexplained else "")
            flagged = f"{channel.flagged:,}" if channel.flagged else "-"
            counts = f"{rate:.0f}" if rate else "-", f"{channel.rows:,}"
            table.add_row(Text(name, "red" if quiet and not rate else ""), *counts, missing, flagged)
        return table

    def _clock_table(self) -> Table:
        table = _table("clock", "state", "tick us", "sigma us", "resid us")
        for name, row in sorted(self._clocks.items()):
            state = ClockState(int(row["state"]))
            numbers = (row["period_ns"] * 1e-3, row["sigma_ns"] * 1e-3, row["residual_rms_ns"] * 1e-3)
            shown = [f"{number:.2f}" for number in numbers] if state is not ClockState.ACQUIRING else ["", "", ""]
            table.add_row(name, Text(state.name.lower(), _STATE_STYLE[state]), *shown)
        return table

    def _gate_lines(self) -> Text:
        while self._gates and self._gates[0][0] < self.now_ns - _RATE_NS:
            self._gates.popleft()
        lines = Text(f"rows used {self._used:,} of {self._total:,}")
        if not self._gates:
            return lines
        recent = np.concatenate([gate for _, gate in self._gates])
        share = 100 * np.count_nonzero(recent == 0) / recent.size
        lines.append(f"; of the last two seconds {share:.0f} %", "green" if share else "yellow")
        for reason in GateReason:
            count = int(np.count_nonzero(recent & int(reason))) if reason.name else 0
            if count:
                lines.append(f"\n  {100 * count / recent.size:3.0f} % {(reason.name or '').lower().replace('_', ' ')}")
        return lines

    def _error_lines(self) -> list[Text]:
        """Prediction errors of the base IMU in their sigmas, of the last two seconds: 1 where all is as stated."""
        while self._errors and self._errors[0][0] < self.now_ns - _RATE_NS:
            self._errors.popleft()
        known = [one[np.isfinite(one).all(axis=1)] for _, one in self._errors]
        if not any(map(len, known)):
            return []
        rms = np.sqrt(np.mean(np.concatenate(known) ** 2, axis=0))
        shown = [" ".join(f"{one:.2f}" for one in rms[part]) for part in (slice(3), slice(3, 6))]
        style = "yellow" if rms.max() ** 2 > MISFIT_DOUBTED else ""
        return [Text(f"innovations over sigma: rate {shown[0]}, specific force {shown[1]}", style)]

    def _answer_table(self) -> Table:
        table = _table("estimate", "value", "95 % ±", "", "", "so far")
        table.columns[5].no_wrap, table.columns[5].overflow = False, "crop"  # numbers are never cut
        for name, answer in self.answers.items():
            row = answer.last
            unit = printable(row["unit"])
            if not unit and not row["supported"]:
                continue  # undetermined base parameters are left out to save space
            if not row["supported"]:
                text = str(Level.DO_NOT_USE) if is_withdrawn(row) else "not determined yet"
                table.add_row(Text(name, "dim"), Text(text, "dim"), "", unit, "", "")
                continue
            said = standing_of(row)
            half = float(max(row["high"] - row["value"], row["value"] - row["low"]))
            relative = f"{100 * half / abs(float(row['value'])):.2f} %" if row["value"] else ""
            numbers = f"{row['value']:.6g}", f"{half:.2g}", unit, relative
            style = "" if said is None or said.level is Level.GOOD else "yellow"
            table.add_row(Text(name, style), *numbers, Text(trend(answer.widths), "cyan"))
        return table

    def _reasons(self) -> list[RenderableType]:
        """Why estimates are withdrawn or weak, each reason once."""
        of_reason: dict[str, list[str]] = {}
        for name, answer in self.answers.items():
            row, said = answer.last, standing_of(answer.last)
            told = is_withdrawn(row) or (row["supported"] and said is not None and said.level is not Level.GOOD)
            if told and said is not None and said.why and printable(row["unit"]):
                of_reason.setdefault(said.text, []).append(name)
        everyone = len(self.answers)
        return [
            Text(f"{'all' if 1 < len(names) == everyone else ', '.join(names)}: {reason}", "yellow")
            for reason, names in of_reason.items()
        ]

    def _event_lines(self) -> list[RenderableType]:
        lines: list[RenderableType] = []
        for at_ns, severity, said in self._events:
            style = {Severity.INFO: "dim", Severity.WARNING: "yellow"}.get(Severity(min(severity, 2)), "bold red")
            when = (at_ns - (self.start_ns or at_ns)) * 1e-9
            lines.append(Text(f"{when:9.3f} s  {said}", style, no_wrap=True, overflow="ellipsis"))
        return lines


def trend(values: Iterable[float]) -> str:
    """Positive ``values`` as a line of block characters on a logarithmic scale; the largest is a full block."""
    logs = [math.log(value) for value in values if value > 0.0]
    if not logs:
        return ""
    low, high = min(logs), max(logs)
    scale = (len(_BLOCKS) - 1) / (high - low) if high > low else 0.0
    return "".join(_BLOCKS[round((value - low) * scale)] for value in logs)


def _table(*headings: str) -> Table:
    columns = (Column(one, justify="right" if 0 < k < 5 else "left", no_wrap=True) for k, one in enumerate(headings))
    return Table(*columns, box=None, padding=(0, 1), pad_edge=False, header_style="bold")
