"""A running flight, followed by its rings.

A log as the page shows it: the frames that a viewer of the flight would have had, kept compressed.
"""

import contextlib
import json
import tomllib
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from drivers.records import EVENT, GAP, Batch
from onboard import channels
from onboard.flight.store import manifest
from onboard.flight.store.directories import is_free
from onboard.page.arm import tree_of, urdf_of
from onboard.page.state import PageState, is_device
from onboard.ring import RingReader

_MOST_ROWS = 4096  # per ring and look
_SAMPLES = 1024  # of a device, or rows of the regression, in a look
_READ = (EVENT, GAP, channels.CLOCK, channels.HEALTH, channels.HEALTH_STREAM, channels.REQUEST, channels.INNOVATION)
FRAMES = 2400  # at most: of twice as many every second is kept
_STEP_NS = 100_000_000  # between two frames of a short log
_AHEAD_NS = 2_000_000_000  # read before a frame is made: a log has the channels of a time one after the other


class Followed:
    """State of the flight that records to ``log``, from the time on when it has rings.

    Args:
        log: of the flight, absolute.
        left: whether a flight that has not begun will not any more.

    Attributes:
        state: so far.
        urdf: that the log carries, or empty.
        ended: whether the flight is over.
        directory: of its rings; None before it has begun.
    """

    live = True

    def __init__(self, log: Path, left: Callable[[], bool] = lambda: False) -> None:
        self.log, self._left = log, left
        self.state = PageState(log.name, live=True)
        self.urdf, self.ended = b"", False
        self.directory: Path | None = None
        self._rings: dict[Path, RingReader] = {}

    def look(self) -> None:
        """Take in what the flight has written since the last look.

        Raises:
            OSError: a ring cannot be read.
        """
        if self.directory is None:
            self._find()
        if self.directory is None:
            return
        self._open()
        for reader in self._rings.values():
            if is_device(reader.dtype) or _is_row(reader.dtype):
                self._newest(reader)
            else:
                rows, lost = reader.read(_MOST_ROWS)
                self.state.lost += lost
                self.state.add(Batch(reader.name, rows))

    def check_ended(self) -> bool:
        """Whether the flight that was followed has no process any more, or will not begin."""
        if self.directory is None:
            self.ended = self._left()
        elif not self.directory.exists() or is_free(self.directory):
            self.ended = True
        return self.ended

    def close(self) -> None:
        """Close the rings."""
        for reader in self._rings.values():
            reader.close()
        self._rings = {}

    def about(self) -> dict[str, Any]:
        """What the page needs once: see :func:`about`."""
        return about(self.state, steps=None)

    def frame_now(self, now_ns: int, *, ended: bool = False) -> dict[str, Any]:
        """The frame of CLOCK_MONOTONIC ``now_ns``; of a flight that has ended that of its newest row."""
        return self.state.frame(None if ended else now_ns, ended=ended)

    def _find(self) -> None:
        found = None
        with contextlib.suppress(OSError, manifest.ManifestError):  # of another flight, that comes or goes: tried again
            found = next((flight for flight in manifest.running() if flight.log == self.log), None)
        if found is None:
            return
        self.directory = found.directory
        files = {one.name: one.data for one in found.preamble.attachments}
        payload, self.urdf = payload_of(found.preamble.metadata, files), urdf_of(files)
        self.state = PageState(f"{found.vehicle}: {self.log.name}", payload, tree_of(files, payload), live=True)

    def _open(self) -> None:
        assert self.directory is not None
        for path in sorted(self.directory.glob("*.ring")):
            if path in self._rings:
                continue
            try:
                reader = RingReader(path)
            except (OSError, ValueError):
                continue  # under construction: retried in the next look
            if is_device(reader.dtype) or _is_row(reader.dtype) or _is_read(reader.dtype):
                # not from the oldest row, which is being overwritten
                reader.position = max(0, reader.published - reader.capacity * 9 // 10)
                self._rings[path] = reader
            else:
                reader.close()

    def _newest(self, reader: RingReader) -> None:
        """Those since the last look, no more than :data:`_SAMPLES`."""
        total = reader.published
        reader.position = max(reader.position, total - _SAMPLES)
        rows, _ = reader.read(_SAMPLES)
        if not len(rows):
            return
        if is_device(reader.dtype):
            self.state.count(reader.name, total, rows)
        else:
            self.state.add(Batch(reader.name, rows))


def _is_row(dtype: np.dtype[np.void]) -> bool:
    return "joint_rad" in (dtype.names or ())


def _is_read(dtype: np.dtype[np.void]) -> bool:
    return dtype in _READ or channels.is_quantity(dtype)


def about(state: PageState, steps: list[float] | None) -> dict[str, Any]:
    """What the page asks for once: title, events and courses so far, and of a log the times of its frames."""
    return {
        "title": state.title,
        "arm": state.arm,
        "live": steps is None,
        "steps": steps,
        "events": state.events(),
        "history": state.history(),
    }


def payload_of(metadata: Mapping[str, Mapping[str, str]], files: Mapping[str, bytes]) -> str:
    """``payload_link`` of the vehicle file that a log carries; empty where there is none, or it cannot be read."""
    name = metadata.get("flight", {}).get("vehicle_file", "vehicle.toml")
    try:
        said = tomllib.loads(files[name].decode()).get("vehicle", {})
    except (KeyError, ValueError):
        return ""
    link = said.get("payload_link", "") if isinstance(said, dict) else ""
    return link if isinstance(link, str) else ""


def packed(content: Any) -> str:
    """JSON of plain values, in one line; NaN is refused, since it is none."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False, default=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is no JSON value")


class PlayedLog(Protocol):
    """A log, or what can be played as one is."""

    @property
    def path(self) -> Path:
        """Of its file."""

    @property
    def position(self) -> int:
        """Bytes read so far."""

    @property
    def attachments(self) -> Mapping[str, Any]:
        """Files that it carries, by name, each with its ``data``."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Facts by name of their record."""

    def batches(self) -> Iterator[Batch]:
        """Rows in the order of their times, nearly."""


class LogFrames:
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
