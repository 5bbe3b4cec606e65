"""Progress where stderr is no terminal: lines, as many as a log of a service or a pipe can take."""

import contextlib
import sys
import threading
import time
from typing import Any

from rich.console import Console
from rich.progress import Progress

FIRST_S, EVERY_S = 2.0, 5.0


class ProgressLines(Progress):
    """``heft: rocksat, seed 1: 43 %, 12 s so far`` after 2 s and then each 5 s, of the last task that is not done.

    Args:
        threads: a thread writes them; without, they come with updates alone.
    """

    def __init__(self, *, threads: bool = True) -> None:
        super().__init__(disable=True, console=Console(stderr=True, force_terminal=False))
        self._began_s = time.monotonic()
        self._due_s = self._began_s + FIRST_S
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._write, name="progress", daemon=True) if threads else None

    def start(self) -> None:
        """See ``Progress``."""
        if self._thread is not None:
            self._thread.start()

    def stop(self) -> None:
        """See ``Progress``."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def update(self, task_id: Any, **changes: Any) -> None:
        """See ``Progress``."""
        super().update(task_id, **changes)
        if self._thread is None and time.monotonic() >= self._due_s:
            self._say()

    def _write(self) -> None:
        while not self._ended.wait(max(0.0, self._due_s - time.monotonic())):
            self._say()

    def _say(self) -> None:
        now_s = time.monotonic()
        self._due_s = now_s + EVERY_S
        for task in [*self.tasks, *(one for one in self.tasks if not one.finished)][-1:]:
            share = "" if task.total is None else f"{task.percentage:.0f} %, "
            with contextlib.suppress(OSError, ValueError):  # the reader has gone: the work goes on
                sys.stderr.write(f"heft: {task.description}: {share}{now_s - self._began_s:.0f} s so far\n")
                sys.stderr.flush()
