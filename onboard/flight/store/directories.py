"""Private directories in shared memory, locked while a process uses them, removed afterwards.

They are in ``/dev/shm/heft-<uid>/``, or in ``$HEFT_RINGS``. Other users with write access could make the flight read or
write arbitrary data, so a directory of another user, or accessible to others, is refused.

Each process that uses one holds a shared lock on its file ``lock``, which the kernel releases when the process ends: a
directory with a free lock is unused.
"""

import contextlib
import fcntl
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from onboard.recording.sink import open_file

_LOCK = "lock"
_NAME_LENGTH = 64  # of the part of a directory's name that is taken from a log's


class NotPrivateError(PermissionError):
    """A directory for rings that belongs to another user, or that other users may enter."""


def own_root() -> Path:
    """This user's directory in shared memory, or where there is none among the temporary files."""
    memory = Path("/dev/shm")
    return (memory if os.access(memory, os.W_OK) else Path(tempfile.gettempdir())) / f"heft-{os.getuid()}"


def root() -> Path:
    """Where this user's flights have their directories: ``$HEFT_RINGS``, or :func:`own_root`."""
    return Path(chosen) if (chosen := os.environ.get("HEFT_RINGS")) else own_root()


def require_private(directory: Path) -> None:
    """Raises NotPrivateError unless this user owns ``directory`` and no other may enter it; OSError."""
    about = directory.lstat()
    if not stat.S_ISDIR(about.st_mode):
        raise NotPrivateError(f"{directory} is not a directory; remove it, or set HEFT_RINGS to a directory of yours")
    if about.st_uid != os.getuid():
        raise NotPrivateError(
            f"{directory} belongs to user {about.st_uid}, who could read and alter the flight; "
            "have it removed, or set HEFT_RINGS to a private directory"
        )
    if about.st_mode & 0o077:
        raise NotPrivateError(
            f"other users may enter {directory} (mode {stat.S_IMODE(about.st_mode):04o}); "
            "check its content, then chmod 700 it"
        )


@contextlib.contextmanager
def _claimed(place: Path) -> Iterator[None]:
    """Lock ``place`` (created if missing) against creation and removal of directories by others."""
    with contextlib.suppress(FileExistsError):
        place.mkdir(mode=0o700, parents=True)
    require_private(place)
    descriptor = os.open(place, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def belong(directory: Path) -> Iterator[None]:
    """Be a process that uses ``directory``: of the flight that has it."""
    with contextlib.ExitStack() as stack:
        _lock(directory, stack)
        yield


def _lock(directory: Path, stack: contextlib.ExitStack) -> None:
    descriptor = os.open(directory / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    stack.callback(os.close, descriptor)
    fcntl.flock(descriptor, fcntl.LOCK_SH)


@contextlib.contextmanager
def made(name: str, suffix: str) -> Iterator[Path]:
    """A new directory in :func:`root` that this process uses. It stays when the block ends.

    Raises:
        NotPrivateError: others could get at it.
        OSError: it cannot be made.
    """
    with contextlib.ExitStack() as stack:
        with _claimed(root()):
            directory = root() / f"{name[:_NAME_LENGTH]}-{suffix}"
            directory.mkdir(mode=0o700)
            _lock(directory, stack)
        yield directory


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """A directory in :func:`own_root` that is gone with the block, or at the latest at the next call after a kill.

    Raises:
        NotPrivateError: others could get at it.
        OSError: it cannot be made.
    """
    place = own_root()
    with contextlib.ExitStack() as stack:
        with _claimed(place):
            _sweep(place, ())
            directory = Path(tempfile.mkdtemp(prefix="scratch-", dir=place))
            _lock(directory, stack)
        stack.callback(shutil.rmtree, directory, ignore_errors=True)
        yield directory


def sweep(keep: str) -> None:
    """Remove the unused directories in :func:`root` without a file ``keep``."""
    if root().exists():
        with _claimed(root()):
            _sweep(root(), (keep,))


def _sweep(place: Path, keep: tuple[str, ...]) -> None:
    prefix = "" if keep else "scratch-"
    for directory in place.iterdir():
        wanted = directory.name.startswith(prefix) and not any((directory / name).exists() for name in keep)
        if wanted and directory.is_dir() and not directory.is_symlink() and is_free(directory):
            shutil.rmtree(directory, ignore_errors=True)


def is_free(directory: Path) -> bool:
    """Whether no process uses ``directory``."""
    try:
        descriptor = os.open(directory / _LOCK, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True


@contextlib.contextmanager
def free(directories: list[Path]) -> Iterator[list[Path]]:
    """The unused ones of ``directories``, locked against others meanwhile."""
    with contextlib.ExitStack() as stack:
        found = []
        for directory in directories:
            descriptor = os.open(directory / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            stack.callback(os.close, descriptor)
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                found.append(directory)
        yield found


def with_file(name: str) -> list[Path]:
    """The directories in :func:`root` that have a file ``name``; none where there is no root.

    Raises:
        NotPrivateError: others could have put them there.
    """
    if not root().exists():
        return []
    require_private(root())
    return sorted(path.parent for path in root().glob(f"*/{name}"))


def write_private(path: Path, data: bytes, *, durable: bool = False) -> None:
    """Write ``data`` to a file that only this user may read, in place of what was there; ``durable``: to the medium.

    Raises:
        OSError: there is no room.
    """
    with open_private(path) as file:
        file.write(data)
        if durable:
            file.flush()
            os.fsync(file.fileno())


def open_private(path: Path, *, keep: bool = False) -> BinaryIO:
    """A file that only this user may read, to be written in place of what was there.

    Args:
        path: of the file.
        keep: what was there stays until it is written over, and its memory with it.

    Raises:
        NotPrivateError: another user's file is there, or one that others may read.
        OSError: there is no room, or it cannot be made; a link, a pipe or a directory is there.
    """
    descriptor = open_file(path, os.O_WRONLY | os.O_CREAT)
    about = os.fstat(descriptor)
    if about.st_uid != os.getuid() or about.st_mode & 0o077:
        os.close(descriptor)
        raise NotPrivateError(f"{path} is not a file of this user's alone (mode 0600); remove it")
    if not keep:
        os.ftruncate(descriptor, 0)
    return open(descriptor, "wb")
