"""Reads a log from the front, a chunk at a time, in constant memory; what is damaged is skipped and named."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.records import Batch, Rows
from onboard.recording.decode import Decoder, KnownChannel, Run, rows_of
from onboard.recording.errors import ChannelError, LogFormatError
from onboard.recording.mcap_format import Attachment, Chunk, Header, Metadata
from onboard.recording.scan import Damage, Scan
from onboard.recording.writer import LIBRARY

EXIT_COMPLETE = 0
EXIT_DAMAGED = 3


class _Survey(NamedTuple):
    """What a whole pass over a log has found."""

    channels: dict[str, KnownChannel]
    attachments: dict[str, Attachment]
    metadata: dict[str, dict[str, str]]
    damage: tuple[Damage, ...]
    truncated: bool


class LogReader:
    """A log on disk.

    The properties need a whole pass over the file; the first use of one makes it, and so does a loop over
    ``batches`` that comes to its end.

    Args:
        path: the log.

    Raises:
        LogFormatError: the file is not a log of ours, or nothing at all of it can be read.
        OSError: it cannot be opened.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._scan = Scan(self.path)
        self._found: _Survey | None = None
        self._require_ours()

    def _require_ours(self) -> None:
        """One sign is enough: our name in the header, or a chunk as only we write them."""
        writer = ""
        for record in Scan(self.path).records():
            if isinstance(record, Damage):
                continue
            if isinstance(record.content, Header):
                writer = record.content.library
                if writer == LIBRARY:
                    return
            elif isinstance(record.content, Chunk) and _decodes(record.content):
                return
        if writer:
            raise LogFormatError(f"{self.path} was written by {writer!r}, not by heft; read it with a ROS 2 tool")

    @property
    def size(self) -> int:
        """Bytes of the file when it was opened."""
        return self._scan.size

    @property
    def position(self) -> int:
        """Bytes of the file that the present pass has come through."""
        return self._scan.position

    @property
    def channels(self) -> dict[str, np.dtype[np.void]]:
        """Every channel that a readable part of the log defines, and the dtype of its rows; as registered."""
        return {name: channel.dtype for name, channel in self._survey().channels.items()}

    @property
    def units(self) -> dict[str, dict[str, str]]:
        """Channel to field to unit, where the definitions name one."""
        return {name: channel.units for name, channel in self._survey().channels.items()}

    @property
    def attachments(self) -> dict[str, Attachment]:
        """The files that travel with the log, by name; the last of a name."""
        return self._survey().attachments

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The maps of strings in the log, by name; the last of a name."""
        return self._survey().metadata

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What could not be read, in the order of the file; empty for a whole log."""
        return self._survey().damage

    @property
    def truncated(self) -> bool:
        """Whether the log was never closed, or its end is gone."""
        return self._survey().truncated

    @property
    def complete(self) -> bool:
        """Whether every byte is there and as it was written."""
        return not self.damage

    @property
    def exit_code(self) -> int:
        """What a command that read the log returns: 0, or 3 when it is truncated or damaged."""
        return EXIT_COMPLETE if self.complete else EXIT_DAMAGED

    def batches(
        self, channels: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Batch]:
        """The rows of the log: one batch a channel a chunk, in the order of the file.

        Args:
            channels: only these.
            start_ns: only rows with ``host_ns`` >= this.
            end_ns: only rows with ``host_ns`` < this.

        Raises:
            ChannelError: the log has no such channel.
            OSError: the medium refused.
        """
        if channels is not None:
            self._require(channels)
        return self._batches(channels, start_ns, end_ns)

    def read(self, channel: str) -> Rows:
        """All rows (n,) of ``channel``, in the order of the file.

        Raises:
            ChannelError: the log has no such channel.
            OSError: the medium refused.
        """
        parts = [batch.rows for batch in self.batches([channel])]
        return np.concatenate([np.empty(0, self.channels[channel]), *parts])

    def _require(self, channels: Collection[str]) -> None:
        if missing := sorted(set(channels) - set(self.channels)):
            raise ChannelError(f"{self.path} has no channel {missing}; it has {sorted(self.channels)}")

    def _batches(self, channels: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Batch]:
        for chunk in self._chunks():
            runs: dict[str, list[Run]] = {}
            for run in chunk:
                if channels is None or run.channel.name in channels:
                    runs.setdefault(run.channel.name, []).append(run)
            for name, group in runs.items():
                rows = _between(rows_of(group), start_ns, end_ns)
                if len(rows):
                    yield Batch(name, rows)

    def _chunks(self) -> Iterator[list[Run]]:
        """One pass: the runs of each chunk; what else is found is kept when the end is reached."""
        self._scan = scan = Scan(self.path)
        decoder = Decoder()
        attachments: dict[str, Attachment] = {}
        metadata: dict[str, dict[str, str]] = {}
        damage: list[Damage] = []
        for record in scan.records():
            if isinstance(record, Damage):
                damage.append(record)
            elif isinstance(record.content, Attachment):
                attachments[record.content.name] = record.content
            elif isinstance(record.content, Metadata):
                metadata[record.content.name] = record.content.items
            elif isinstance(record.content, Chunk):
                try:
                    runs = decoder.runs(record.content.records)
                except LogFormatError as error:
                    damage.append(Damage(record.start, record.end, str(error)))
                else:
                    yield runs
        channels = dict(sorted(decoder.channels.items(), key=lambda item: item[1].number))
        self._found = _Survey(channels, attachments, metadata, tuple(damage), scan.truncated)

    def _survey(self) -> _Survey:
        if self._found is None:
            for _ in self._chunks():
                pass
        assert self._found is not None
        return self._found


def _decodes(chunk: Chunk) -> bool:
    try:
        Decoder().runs(chunk.records)
    except LogFormatError:
        return False
    return True


def _between(rows: Rows, start_ns: int | None, end_ns: int | None) -> Rows:
    if start_ns is None and end_ns is None:
        return rows
    chosen = np.ones(len(rows), bool)
    if start_ns is not None:
        chosen &= rows["host_ns"] >= start_ns
    if end_ns is not None:
        chosen &= rows["host_ns"] < end_ns
    return rows[chosen]
