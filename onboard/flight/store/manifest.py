"""Manifest of a flight's directory: data needed by a later start to write the rings to the log.

It has the log's path and the content of its head. It does not allow the removal of files; that is set by the vehicle
file of the new flight.
"""

import contextlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

from onboard.flight.store import directories
from onboard.flight.store.directories import is_free, write_private
from onboard.recording.format.mcap_format import Attachment
from onboard.recording.segmented import Preamble

_MANIFEST, _ATTACHED = "manifest.json", "attached"


class ManifestError(ValueError):
    """A flight's directory whose manifest is not one of ours."""


class Storage(NamedTuple):
    """How a flight is recorded; ``[recording]`` of its vehicle file."""

    sync_period_ns: int
    segment_span_ns: int
    segment_bytes: int
    reserve_bytes: int


class Manifest(NamedTuple):
    """A flight whose rings are there."""

    directory: Path  # of the rings
    log: Path
    vehicle: str
    storage: Storage
    preamble: Preamble

    def save(self) -> None:
        """Write it into its directory, whole or not at all.

        Raises:
            OSError: there is no room.
        """
        attached = self.directory / _ATTACHED
        attached.mkdir(mode=0o700)
        for number, attachment in enumerate(self.preamble.attachments):
            write_private(attached / str(number), attachment.data)
        content = {
            "log": str(self.log),
            "vehicle": self.vehicle,
            "flight": self.preamble.flight,
            "storage": self.storage._asdict(),
            "metadata": self.preamble.metadata,
            "attachments": [[a.name, a.media_type, a.log_time_ns] for a in self.preamble.attachments],
        }
        unfinished = self.directory / f"{_MANIFEST}.new"
        write_private(unfinished, json.dumps(content).encode())
        unfinished.rename(self.directory / _MANIFEST)

    @classmethod
    def load(cls, directory: Path) -> Self:
        """From a flight's directory.

        Raises:
            OSError: it has no manifest.
            ManifestError: its manifest is of another version.
        """
        text = (directory / _MANIFEST).read_text(encoding="utf-8")
        try:
            content: dict[str, Any] = json.loads(text)
            attachments = tuple(
                Attachment(name, media_type, (directory / _ATTACHED / str(number)).read_bytes(), log_time_ns)
                for number, (name, media_type, log_time_ns) in enumerate(content["attachments"])
            )
            preamble = Preamble(content["flight"], attachments, content["metadata"])
            return cls(directory, Path(content["log"]), content["vehicle"], Storage(**content["storage"]), preamble)
        except (ValueError, KeyError, TypeError) as error:
            raise ManifestError(f"{directory} is of another version of heft ({error}); remove it") from error

    def remove(self) -> None:
        """Remove the directory and the rings in it."""
        shutil.rmtree(self.directory)


@contextlib.contextmanager
def new_flight(log: Path, flight: str) -> Iterator[Path]:
    """A new directory for the flight of id ``flight`` that is recorded to ``log``, which this process belongs to.

    Raises:
        OSError: it cannot be made.
    """
    with directories.made(log.stem, flight[:8]) as directory:
        yield directory


def running() -> list[Manifest]:
    """Flights of this user that have a process."""
    return [Manifest.load(directory) for directory in directories.with_file(_MANIFEST) if not is_free(directory)]


def waiting() -> list[Manifest]:
    """Flights of this user, running or dead, whose rings are there and whose manifest can be read."""
    found = []
    for directory in directories.with_file(_MANIFEST):
        with contextlib.suppress(ManifestError, OSError):
            found.append(Manifest.load(directory))
    return found


@contextlib.contextmanager
def abandoned() -> Iterator[list[Path]]:
    """Directories of this user's flights without a process, locked against others meanwhile.

    What a start that was cut off before its manifest left is removed.
    """
    directories.sweep(_MANIFEST)
    with directories.free(directories.with_file(_MANIFEST)) as found:
        yield found
