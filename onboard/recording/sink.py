"""Output of a log's bytes. The writer gives every offset, so a partly failed write can be repeated."""

import contextlib
import errno
import fcntl
import os
from pathlib import Path
from typing import Protocol


class Sink(Protocol):
    """Output file of the writer. Raises OSError with the kernel's errno."""

    def write_at(self, offset: int, data: bytes) -> None:
        """Put ``data`` at ``offset``; all of it, or OSError."""

    def sync(self) -> None:
        """Everything written is on the medium when this returns."""

    def close(self) -> None:
        """Close the file."""


def sync_directory(path: Path) -> None:
    """Sync the entries of directory ``path`` to the medium.

    Raises:
        OSError: the sync failed.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_locked(path: Path) -> bool:
    """Whether a process is writing the file at ``path``.

    Raises:
        OSError: it cannot be opened.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


class FileSink:
    """A new file, locked while it is open. Its directory entry is on the medium when the constructor returns.

    Args:
        path: file to create; its directory must exist.
        durable: False makes ``sync`` do nothing, for simulated flights.
        overwrite: replace an existing file.

    Raises:
        FileExistsError: there is one and ``overwrite`` is False.
        OSError: it cannot be created.
    """

    def __init__(self, path: str | Path, *, durable: bool = True, overwrite: bool = False) -> None:
        self._durable = durable
        existing = os.O_TRUNC if overwrite else os.O_EXCL
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | existing, 0o644)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if durable:
            try:
                sync_directory(Path(path).parent)
            except OSError:
                os.close(self._descriptor)
                raise

    def write_at(self, offset: int, data: bytes) -> None:
        """See ``Sink``."""
        view = memoryview(data)
        while view:
            written = os.pwrite(self._descriptor, view, offset)
            if not written:
                raise OSError(errno.ENOSPC, "the kernel took no bytes")
            view, offset = view[written:], offset + written

    def sync(self) -> None:
        """See ``Sink``."""
        if self._durable:
            os.fsync(self._descriptor)

    def close(self) -> None:
        """See ``Sink``."""
        os.close(self._descriptor)
