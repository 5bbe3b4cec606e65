"""Where a flight of a campaign keeps its files while it flies: in memory, where that is a file system with room.

A recorder writes to the medium five times a second, and a campaign throws most logs away. A worker that is killed
leaves its directory behind; whoever comes next removes those that nobody holds a lock on.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

MEMORY = Path("/dev/shm")
_ROOM = 1 << 30  # bytes free, or the disk is taken: a log has 10 to 100 MB
_FRESH_S = 60.0  # since a directory was made: it may not be locked yet
_PREFIX = "heft_campaign_"


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """An empty directory, removed at the end; temporary files that are made meanwhile are in it."""
    where = MEMORY if _has_room() else Path(tempfile.gettempdir())
    before = tempfile.tempdir
    with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=where) as directory, _locked(Path(directory)):
        _tidy(where, Path(directory).lstat().st_mtime)
        tempfile.tempdir = directory
        try:
            yield Path(directory)
        finally:
            tempfile.tempdir = before


def _has_room() -> bool:
    try:
        return os.access(MEMORY, os.W_OK | os.X_OK) and shutil.disk_usage(MEMORY).free >= _ROOM
    except OSError:
        return False


@contextlib.contextmanager
def _locked(directory: Path) -> Iterator[bool]:
    """Whether the lock on a directory is ours."""
    held = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(held)


def _tidy(where: Path, now_s: float) -> None:
    """Remove directories of this user's workers that are no more."""
    for old in where.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):  # another's, or removed by another
            about = old.lstat()
            if about.st_uid == os.geteuid() and now_s - about.st_mtime > _FRESH_S:
                with _locked(old) as dead:
                    if dead:
                        shutil.rmtree(old)
