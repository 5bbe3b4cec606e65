"""A log as the page shows it: the frames that a viewer of the flight would have had, kept compressed."""

import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from drivers.records import Batch
from onboard.page.arm import tree_of, urdf_of
from onboard.page.follow import about, packed, payload_of
from onboard.page.state import PageState

FRAMES = 2400  # at most: of twice as many every second is kept
_STEP_NS = 100_000_000  # between two frames of a short log
_AHEAD_NS = 2_000_000_000  # read before a frame is made: a log has the channels of a time one after the other


class AttachedFile(Protocol):
    """A file that a log carries."""

    @property
    def data(self) -> bytes:
        """Its bytes."""


class PlayedLog(Protocol):
    """A log, or what can be played as one is."""

    @property
    def path(self) -> Path:
        """Of its file."""

    @property
    def position(self) -> int:
        """Bytes read so far."""

    @property
    def attachments(self) -> Mapping[str, AttachedFile]:
        """Files by name."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Facts by name of their record."""

    def batches(self) -> Iterator[Batch]:
        """Rows in the order of their times, nearly."""


class Recorded:
    """Frames of a log. Reads it once, from begin to end.

    Args:
        log: to show.
        told: is given the number of bytes read, now and then.

    Attributes:
        state: at the end.
        urdf: that the log carries, or empty.

    Raises:
        OSError: the log cannot be read.
        ValueError: it has no rows.
    """

    live = False

    def __init__(self, log: PlayedLog, told: Callable[[int], None] = lambda _: None) -> None:
        self._frames: list[tuple[int, bytes]] = []  # stamp, frame
        self._step_ns = _STEP_NS
        files: dict[str, bytes] = {name: one.data for name, one in log.attachments.items()}
        payload, self.urdf = payload_of(log.metadata, files), urdf_of(files)
        self.state = PageState(self._title(log), payload, tree_of(files, payload), live=False)
        due_ns = 0
        ahead: list[Batch] = []
        for batch in log.batches():
            first_ns = int(batch.rows["host_ns"][0])
            due_ns = due_ns or first_ns + self._step_ns
            while ahead and first_ns >= due_ns + _AHEAD_NS:
                ahead, due_ns = self._take(ahead, due_ns)
                told(log.position)
            ahead.append(batch)
        while ahead:
            ahead, due_ns = self._take(ahead, min(due_ns, max(int(rows["host_ns"].max()) for _, rows in ahead)))
        if self.state.start_ns is None:
            raise ValueError(f"{log.path} has no rows: there is nothing to show; heft info says what it has")

    def _take(self, batches: list[Batch], until_ns: int) -> tuple[list[Batch], int]:
        """Make the frame of ``until_ns``; what comes after it, and when the next is due."""
        rest = []
        for name, rows in batches:
            count = int(np.searchsorted(rows["host_ns"], until_ns, side="right"))
            self.state.add(Batch(name, rows[:count]))
            if count < len(rows):
                rest.append(Batch(name, rows[count:]))
        self._frames.append((until_ns, zlib.compress(packed(self.state.frame(until_ns)).encode(), 1)))
        if len(self._frames) > FRAMES:
            self._frames, self._step_ns = self._frames[::2], 2 * self._step_ns
        return rest, max(until_ns + self._step_ns, min((int(rows["host_ns"][0]) for _, rows in rest), default=0))

    @staticmethod
    def _title(log: PlayedLog) -> str:
        vehicle = log.metadata.get("flight", {}).get("vehicle", "")
        return f"{vehicle}: {log.path.name}" if vehicle else log.path.name

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, number: int) -> bytes:
        """Frame ``number``, JSON.

        Raises:
            IndexError: there is none.
        """
        if not 0 <= number < len(self._frames):
            raise IndexError(number)
        return zlib.decompress(self._frames[number][1])

    def about(self) -> dict[str, Any]:
        """What the page needs once."""
        start_ns = self.state.start_ns or 0
        return about(self.state, [round((at_ns - start_ns) * 1e-9, 6) for at_ns, _ in self._frames])
