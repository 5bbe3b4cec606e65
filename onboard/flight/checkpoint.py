"""The state of a running estimator, kept beside the rings so that it outlives its process.

It is pickled into a file that only this user can write. What an estimator does in a step follows from the rows that
the step's TICK record names; so a state and the ticks after it give back the estimator as it was when its process died.
"""

import contextlib
import pickle
from pathlib import Path
from typing import NamedTuple

from onboard.flight.estimator import Estimator

_NAME, _UNDERWAY = "estimator.checkpoint", "estimator.redoing"


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
    """

    def __init__(self, directory: Path) -> None:
        self._path, self._underway = directory / _NAME, directory / _UNDERWAY

    def save(self, checkpoint: Checkpoint) -> None:
        """Put ``checkpoint`` in place of the one before.

        Raises:
            OSError: shared memory is full.
        """
        unfinished = self._path.with_suffix(".new")
        unfinished.write_bytes(pickle.dumps(checkpoint, pickle.HIGHEST_PROTOCOL))
        unfinished.rename(self._path)
        self._underway.unlink(missing_ok=True)

    def load(self) -> Checkpoint | None:
        """The newest; None when there is none, or when to go on from it has been tried and did not get anywhere."""
        if self._underway.exists():
            return None
        with contextlib.suppress(FileNotFoundError):
            checkpoint = pickle.loads(self._path.read_bytes())
            assert isinstance(checkpoint, Checkpoint)
            self._underway.touch()
            return checkpoint
        return None
