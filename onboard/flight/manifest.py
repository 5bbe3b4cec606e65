"""Where a flight's rings lie, and whose they are: what a later start needs to bring what they hold into the log.

A flight's directory is ``/dev/shm/heft-<uid>/<log>-<flight>/``, or in ``$HEFT_RINGS``. Each process of it holds a
shared lock on the file ``lock`` in it, which the kernel takes back however the process ends: a directory whose lock is
free belongs to a flight that is over, or dead.
"""

import contextlib
import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

from onboard.recording.mcap_format import Attachment
from onboard.recording.segmented import Preamble

_MANIFEST, _LOCK, _ATTACHED = "manifest.json", "lock", "attached"


class ManifestError(ValueError):
    """A flight's directory whose manifest is not one of ours."""


class Storage(NamedTuple):
    """How a flight is recorded; ``[recording]`` of its vehicle file."""

    sync_period_ns: int
    segment_span_ns: int
    segment_bytes: int
    min_free_bytes: int
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
        attached.mkdir()
        for number, attachment in enumerate(self.preamble.attachments):
            (attached / str(number)).write_bytes(attachment.data)
        content = {
            "log": str(self.log),
            "vehicle": self.vehicle,
            "flight": self.preamble.flight,
            "storage": self.storage._asdict(),
            "metadata": self.preamble.metadata,
            "attachments": [[a.name, a.media_type, a.log_time_ns] for a in self.preamble.attachments],
        }
        unfinished = self.directory / f"{_MANIFEST}.new"
        unfinished.write_text(json.dumps(content), encoding="utf-8")
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


def root() -> Path:
    """Where this user's flights have their directories: ``$HEFT_RINGS``, or in shared memory where there is any."""
    if chosen := os.environ.get("HEFT_RINGS"):
        return Path(chosen)
    memory = Path("/dev/shm")
    return (memory if os.access(memory, os.W_OK) else Path(tempfile.gettempdir())) / f"heft-{os.getuid()}"


def directory_for(log: Path, flight: str) -> Path:
    """A new directory for the flight of id ``flight`` that is recorded to ``log``.

    Raises:
        OSError: it cannot be made.
    """
    root().mkdir(mode=0o700, parents=True, exist_ok=True)
    directory = root() / f"{log.stem}-{flight[:8]}"
    directory.mkdir(mode=0o700)
    return directory


@contextlib.contextmanager
def belong(directory: Path) -> Iterator[None]:
    """Be a process of the flight that has ``directory``."""
    descriptor = os.open(directory / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH)
        yield
    finally:
        os.close(descriptor)


def running() -> list[Manifest]:
    """Flights of this user that have a process."""
    return [Manifest.load(directory) for directory in _directories() if not _is_free(directory)]


@contextlib.contextmanager
def abandoned() -> Iterator[list[Path]]:
    """Directories of this user's flights that have no process any more; nobody else is given them meanwhile."""
    with contextlib.ExitStack() as stack:
        found = []
        for directory in _directories():
            descriptor = os.open(directory / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            stack.callback(os.close, descriptor)
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                found.append(directory)
        yield found


def _is_free(directory: Path) -> bool:
    try:
        descriptor = os.open(directory / _LOCK, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True


def _directories() -> list[Path]:
    return sorted(path.parent for path in root().glob(f"*/{_MANIFEST}"))
