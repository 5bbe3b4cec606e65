"""Finds missing and unreadable segments of a flight; bounds their rows and times by the segments beside them."""

from collections.abc import Mapping
from typing import NamedTuple

from onboard.recording.format.decode import MessageRun, rows_of
from onboard.recording.format.scan import Damage
from onboard.recording.format.segments import END, METADATA, RECORDED, proven, without_crc, written_as
from onboard.recording.recorded import ChannelProgress, marks_of, note

_NAMED = 4  # channels named in a text


class Lost(NamedTuple):
    """A missing or unreadable segment."""

    number: int
    name: str
    reason: str


class SegmentsSeen:
    """Follows the segments of a flight in their order.

    Args:
        first: expected number of the first segment; None where a part of a flight is read.
        to_the_end: whether the last segment must carry ``flight_end``.
        alone: it is one file.
    """

    def __init__(self, first: int | None, *, to_the_end: bool, alone: bool) -> None:
        self._next, self._to_the_end, self._alone = first, to_the_end, alone
        self._reached: dict[str, ChannelProgress] = {}
        self._lost: list[Lost] = []
        self._newest: dict[str, MessageRun] = {}
        self._told: dict[str, Mapping[str, str]] = {}
        self._altered: list[str] = []
        self._checked = self._ended = self._closed = False

    def run(self, run: MessageRun) -> None:
        """Messages of the present segment."""
        self._newest[run.channel.name] = run

    def metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Metadata of the present segment."""
        meant = written_as(name, items)
        if meant in (METADATA, RECORDED, END):
            self._told[meant] = items
            if meant != name or proven(meant, items) is False:
                self._altered.append(meant)

    def unreadable(self, number: int, name: str, reason: str) -> None:
        """The present segment cannot be read."""
        self._gap_before(number, name)
        self._lost.append(Lost(number, name, reason))
        self._next = number + 1
        self._forget()

    def _forget(self) -> None:
        self._newest, self._told, self._altered = {}, {}, []

    def end(self, number: int, name: str, *, closed: bool, unused: bool) -> list[Damage]:
        """Ends the present segment; returns the damage found before it.

        Args:
            number: from its file name, for one without a number in its metadata.
            name: its file's.
            closed: it was ended, with a summary.
            unused: it was opened ahead, and nothing is in it.
        """
        told = self._told
        said = told.get(METADATA, {})
        self._checked |= proven(METADATA, said) is True
        if proven(METADATA, said) and said.get("number", "").isdecimal():
            number = int(said["number"][:9])
        elif METADATA not in told and self._alone:
            self._forget()
            return []  # a log without segments
        self._gap_before(number, name)
        marks = marks_of(told.get(RECORDED, {}))
        damage = self._resolve(marks)
        altered = [Damage(0, 0, f"its metadata {one!r} is altered", name) for one in self._altered]
        self._reached |= marks
        for channel, run in self._newest.items():
            note(self._reached, channel, rows_of([run._replace(records=run.records[-1:])]))
        self._forget()
        if unused:
            return [*damage, *altered]
        self._next = number + 1
        self._ended, self._closed = bool(proven(END, told.get(END, {}))), closed
        if self._ended and (count := without_crc(told[END]).get("segments", "")).isdecimal():
            self._next = max(self._next, int(count[:9]))
        return [*damage, *altered]

    def finish(self) -> list[Damage]:
        """Ends the flight; returns the damage after the last readable segment."""
        damage = self._resolve({})
        if not damage and self._to_the_end and self._checked and self._closed and not self._ended:
            text = "is missing: the flight went on after those that can be read, or was cut off there"
            damage = [Damage(0, 0, f"segment {self._next} {text}")]
        return damage

    def _gap_before(self, number: int, name: str) -> None:
        if self._next is not None:
            self._lost += [Lost(n, name, "missing") for n in range(self._next, min(number, self._next + 1000))]

    def _resolve(self, marks: Mapping[str, ChannelProgress]) -> list[Damage]:
        """Damage of the lost segments, from the marks before and after them."""
        if not self._lost:
            return []
        lost, self._lost = self._lost, []
        held = _held(self._reached, marks, "they" if len(lost) > 1 else "it")
        return [
            Damage(0, 0, f"segment {one.number} is missing; {held}", "")
            if one.reason == "missing"
            else Damage(0, 0, f"segment {one.number} cannot be read: {one.reason}; {held}", one.name)
            for one in lost
        ]


def _held(before: Mapping[str, ChannelProgress], after: Mapping[str, ChannelProgress], they: str) -> str:
    """Rows and time between two readable neighbours."""
    if not after:
        return f"what {they} held is not known"
    spans = {
        name: (before[name].sequence + 1 if name in before else 0, mark.sequence)
        for name, mark in after.items()
        if name not in before or mark.sequence > before[name].sequence
    }
    rows = sum(last - first + 1 for first, last in spans.values())
    newest = max(mark.host_ns for mark in after.values())
    span = ""
    if before:
        span = f" over {max(0.0, 1e-9 * (newest - max(mark.host_ns for mark in before.values()))):.1f} s"
    ranges = [f"{name} {first} to {last}" for name, (first, last) in spans.items()]
    more = f" and {len(ranges) - _NAMED} more channels" if len(ranges) > _NAMED else ""
    return f"{they} held {rows} rows{span}: {', '.join(ranges[:_NAMED])}{more}"
