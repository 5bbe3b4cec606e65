"""Output of a log's bytes. The writer gives every offset, so a partly failed write can be repeated."""

import contextlib
import errno
import fcntl
import os
import stat
from pathlib import Path
from typing import NamedTuple


class FileTaken(NamedTuple):
    """A file that is not where it was made, or not as it was written."""

    how: str  # in words, what has happened to it
    rest: int  # bytes of it that can still be read somewhere


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


class NoFileError(OSError):
    """A link, a pipe, a device or a directory where a file is expected."""


def open_file(path: Path, flags: int) -> int:
    """Descriptor of a regular file; a link is not followed, and a pipe not waited for.

    Raises:
        NoFileError: it is something else.
        OSError: it cannot be opened.
    """
    try:
        descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO, errno.EISDIR):
            raise _no_file(path) from error
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise _no_file(path)
    return descriptor


def _no_file(path: Path) -> NoFileError:
    return NoFileError(errno.EINVAL, "no file, but a link, a pipe, a device or a directory", str(path))


def is_locked(path: Path) -> bool:
    """Whether a process is writing the file at ``path``.

    Raises:
        OSError: as ``open_file``.
    """
    descriptor = open_file(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


class FileSink:
    """A new file (mode 0600), locked while it is open. Its directory entry is on the medium once it is made.

    Args:
        path: file to create; its directory must exist.
        durable: False makes ``sync`` do nothing, for simulated flights.
        overwrite: replace an existing file.

    Raises:
        FileExistsError: there is one and ``overwrite`` is False.
        OSError: it cannot be created.
    """

    def __init__(self, path: str | Path, *, durable: bool = True, overwrite: bool = False) -> None:
        self._durable, self._path = durable, Path(path).absolute()
        self._size, self._cut = 0, -1  # as written; as cut off by somebody, -1 where nobody has
        existing = os.O_TRUNC if overwrite else os.O_EXCL
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | existing, 0o600)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if durable:
            try:
                sync_directory(Path(path).parent)
            except OSError:
                os.close(self._descriptor)
                raise

    def write_at(self, offset: int, data: bytes) -> None:
        """Put ``data`` at ``offset``; all of it, or OSError."""
        self._look_at_size()
        view = memoryview(data)
        while view:
            try:
                written = os.pwrite(self._descriptor, view, offset)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(self._path)) from error
            if not written:
                raise OSError(errno.ENOSPC, "the kernel took no bytes", str(self._path))
            view, offset = view[written:], offset + written
            self._size = max(self._size, offset)

    def sync(self) -> None:
        """Everything written is on the medium when this returns. Raises OSError."""
        if self._durable:
            try:
                os.fsync(self._descriptor)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(self._path)) from error

    def taken(self) -> FileTaken | None:
        """What somebody else has done to the file since it was made; None: nothing.

        Of a file that was cut off nothing after that is kept, so that no hole is read as rows.
        """
        self._look_at_size()
        try:
            there = self._path.lstat()
        except OSError:
            there = None
        about = os.fstat(self._descriptor)  # after the path: a file removed in between was not renamed
        if about.st_nlink == 0:
            return FileTaken("removed", 0)
        if self._cut >= 0:
            os.ftruncate(self._descriptor, self._cut)
            return FileTaken(f"cut off after {self._cut} of {self._size} bytes", self._cut)
        if there is not None and (there.st_dev, there.st_ino) == (about.st_dev, about.st_ino):
            return None
        now = Path(f"/proc/self/fd/{self._descriptor}").readlink()
        return FileTaken(f"renamed to {now}", self._size)

    def _look_at_size(self) -> None:
        """Writing on after the end of a file that was cut off would leave a hole in it: note where it was cut."""
        if self._cut < 0 and (size := os.fstat(self._descriptor).st_size) < self._size:
            self._cut = size

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)
