"""Checkpoints of the running estimator, kept beside the rings.

A checkpoint is data (:mod:`onboard.flight.estimate.state`) in a file that only this user can write. A step of the
estimator is determined by the rows named in its TICK record, so a checkpoint and the ticks after it restore the
estimator of a dead process.

Two files are written in turn: allocating the memory of a new file would cost more than the rest of a checkpoint.
"""

import ctypes
import errno
import os
from pathlib import Path
from typing import NamedTuple

from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.state import StateError, UnwrittenParts, from_bytes, write
from onboard.flight.store.directories import open_private, write_private

_NAME, _UNDERWAY = "estimator.checkpoint", "estimator.redoing"
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # fcntl.h, linux/fs.h


class Checkpoint(NamedTuple):
    """An estimator after so many ticks."""

    ticks: int
    events: int  # in its event channel
    positions: dict[str, int]  # in the rings of its inputs
    estimator: Estimator


class Checkpoints:
    """The newest checkpoint of a flight.

    Args:
        directory: of the flight's rings.
        places: of an estimator of the same vehicle that has not made a step: the model in it is not written.
    """

    def __init__(self, directory: Path, places: UnwrittenParts) -> None:
        self._path, self._underway = directory / _NAME, directory / _UNDERWAY
        self._places = places

    def save(self, checkpoint: Checkpoint) -> None:
        """Put ``checkpoint`` in place of the one before.

        Raises:
            OSError: shared memory is full.
            StateError: a part of the estimator is not data.
        """
        unfinished = self._path.with_suffix(".new")
        with open_private(unfinished, keep=True) as file:
            write(file, tuple(checkpoint), self._places)
            file.truncate()
        if self._path.exists():
            _exchange(unfinished, self._path)
        else:
            unfinished.rename(self._path)
        self.taken_over()

    def taken_over(self) -> None:
        """What :meth:`load` gave has been restored: it may be loaded again."""
        self._underway.unlink(missing_ok=True)

    def load(self) -> Checkpoint | None:
        """The newest checkpoint; None if there is none, or if restarting from it has already failed.

        Raises:
            StateError: it is damaged.
        """
        if self._underway.exists() or not self._path.exists():
            return None
        parts = from_bytes(self._path.read_bytes(), self._places)
        if not (isinstance(parts, tuple) and len(parts) == len(Checkpoint._fields)):
            raise StateError(f"{self._path} holds no checkpoint")
        checkpoint = Checkpoint(*parts)
        if not isinstance(checkpoint.estimator, Estimator):
            raise StateError(f"{self._path} holds no estimator")
        write_private(self._underway, b"")
        return checkpoint


def _exchange(one: Path, other: Path) -> None:
    """Let two files have each other's names, at once; where the file system cannot, one takes the other's place."""
    names = (_AT_FDCWD, os.fsencode(one)), (_AT_FDCWD, os.fsencode(other))
    if ctypes.CDLL(None, use_errno=True).renameat2(*names[0], *names[1], _RENAME_EXCHANGE):
        if (number := ctypes.get_errno()) not in (errno.EINVAL, errno.ENOSYS):
            raise OSError(number, os.strerror(number), str(one))
        one.rename(other)
