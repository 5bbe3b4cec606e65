"""Free disk space: removal of earlier flights, and a reserve for events.

Only segments of earlier flights are removed, oldest first, and only while less than ``min_free`` is free; imported,
merged or simulated logs, the current flight and other files are never removed. Each removal is an event.

A ballast file reserves ``reserve`` bytes. It is deleted when the disk is otherwise full; from then on only events and
gaps are recorded until there is space again.
"""

import contextlib
import errno
import fcntl
import os
import resource
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.segments import SUFFIX, flight_or_none, segments
from onboard.recording.sink import is_locked

BALLAST_SUFFIX = ".heft-reserve"
MARGIN = 4_000_000  # free space at which the ballast is deleted: some seconds of recording and a segment's head


def refusal(error: OSError, *, short: bool = False) -> str:
    """Why a file was not written: which, how large it is, and what to do; other errors in the system's words.

    ``short``: without its directory, as events have room for.
    """
    what = f"{Path(error.filename).name if short else error.filename}: " if error.filename else ""
    with contextlib.suppress(OSError, TypeError):
        if not os.path.isdir(error.filename):
            what += f"{os.stat(error.filename).st_size} bytes, then "
    reason = (error.strerror or str(error)).lower()
    if error.errno == errno.EFBIG:
        limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
        return f"{what}{reason}: a file may have {limit} bytes here; raise it (ulimit -f, LimitFSIZE=)"
    remedy = {
        errno.ENOSPC: "remove what is not needed, or write to another disk",
        errno.EDQUOT: f"the quota of user {os.getuid()} is used up; remove files, or have it raised",
    }.get(error.errno or 0)
    return what + reason if remedy is None else f"{what}{reason}: {remedy}"


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """A refused write to the file at ``path`` says its name, which the system leaves out."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


class Room(NamedTuple):
    """Result of a check of the disk."""

    for_all: bool  # False: for events and gaps only
    removed: tuple[Path, ...] = ()
    strange: tuple[str, ...] = ()  # what stands where a reserve would, and is left alone; reported once


def free_bytes(directory: Path) -> int:
    """Bytes available to this user on the file system of ``directory``.

    Raises:
        OSError: the file system cannot be queried.
    """
    disk = os.statvfs(directory)
    return disk.f_bavail * disk.f_frsize


class SpaceGuard:
    """Maintains free space for one flight.

    Args:
        flights: directory in which flights lie.
        log: log of the current flight, never removed.
        flight: its id.
        min_free: bytes to keep free by removing earlier flights; 0 removes nothing.
        reserve: bytes reserved for events; 0: none.
        free: returns the free bytes.
    """

    def __init__(
        self,
        flights: Path,
        log: Path,
        flight: str,
        *,
        min_free: int,
        reserve: int,
        free: Callable[[Path], int] = free_bytes,
    ) -> None:
        self._flights, self._flight = flights, flight
        self._min_free, self._reserve, self._free = min_free, reserve, free
        self._ballast = log.with_name(f"{log.name}{BALLAST_SUFFIX}")
        self._descriptor: int | None = None  # of the ballast: locked while it is held
        self._kept: set[Path] = set()  # files not to be removed
        self.free = -1  # bytes, as last looked
        self._strange: list[str] = []
        for stale in flights.glob(f"*{BALLAST_SUFFIX}"):
            try:
                if not is_locked(stale):
                    stale.unlink()
            except FileNotFoundError:
                continue  # of a flight that ended just now
            except OSError as error:
                self._strange.append(_refused(stale, error))

    def look(self, *, refused: bool = False) -> Room:
        """Check the free space, and remove earlier flights if there is too little.

        Args:
            refused: a write has just failed for lack of space.

        Raises:
            OSError: the file system cannot be queried.
        """
        removed = self._remove_oldest() if self._min_free else ()
        free = self.free = self._free(self._flights)
        if refused or free < MARGIN:
            self.close()
        elif self._descriptor is None and free >= self._reserve + 2 * MARGIN:
            self._hold()
        enough = not refused and free >= self._reserve + 2 * MARGIN
        strange, self._strange = tuple(self._strange), []
        return Room(self._descriptor is not None or enough, removed, strange)

    def close(self) -> None:
        """Delete the ballast."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
            self._ballast.unlink(missing_ok=True)

    def _hold(self) -> None:
        """Create the ballast; without one if the disk fails."""
        if not self._reserve:
            return
        with contextlib.suppress(OSError):
            self._descriptor = os.open(self._ballast, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.posix_fallocate(self._descriptor, 0, self._reserve)
            return
        self.close()

    def _remove_oldest(self) -> tuple[Path, ...]:
        removed: list[Path] = []
        if self._free(self._flights) >= self._min_free:
            return ()
        for path in self._earlier():
            if self._free(self._flights) >= self._min_free:
                break
            path.unlink(missing_ok=True)
            removed.append(path)
            if path.parent != self._flights and not any(path.parent.iterdir()):
                path.parent.rmdir()
        return tuple(removed)

    def _earlier(self) -> list[Path]:
        """Segments of earlier flights, the oldest first."""
        files = [path for path in self._flights.glob(f"*{SUFFIX}") if path.is_file() and not path.is_symlink()]
        for directory in self._flights.iterdir():
            if directory.is_dir() and not directory.is_symlink():
                try:
                    files += [path for path in segments(directory) if path.is_file() and not path.is_symlink()]
                except (LogFormatError, OSError):
                    continue  # no flight, or another user's
        flight_of = {path: flight_or_none(path) for path in files if path not in self._kept}
        self._kept |= {path for path, flight in flight_of.items() if flight in ("", self._flight)}
        flying = {flight for path, flight in flight_of.items() if flight and is_locked(path)}
        may_go = [path for path, flight in flight_of.items() if path not in self._kept and flight not in flying]
        return sorted(may_go, key=lambda path: (path.stat().st_mtime_ns, path))


def _refused(path: Path, error: OSError) -> str:
    return f"{path.name} is no reserve of a flight and is left as it is ({(error.strerror or str(error)).lower()})"
