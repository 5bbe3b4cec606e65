"""Supervision of a worker process: start, heartbeat, kill if it hangs, restart."""

import contextlib
import math
import multiprocessing
import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0
WATCH_PERIOD_S = 0.05
HUNG_S = 7.0  # without a beat of a worker's; the rings hold 10 s
LOOK_S = 4.0  # before the end of that time the process's CPU time is looked at: if it grows, it is slow, not hung
PROGRESS_S = 0.02
LONGEST_SILENCE_S = 60.0  # after which a worker hangs, whatever it does
_LONGEST_PAUSE_S = 5.0  # before a worker that keeps dying is started again
_STABLE_S = 30.0  # a worker that lived so long starts with a clean slate


def _cpu_s(pid: int | None) -> float:
    """CPU time that a process has had; 0 where it is gone."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


class FlightError(RuntimeError):
    """The flight could not be started, or a worker of it died."""


class Worker:
    """A process that is started again when it dies, with a pipe of its own each time."""

    def __init__(self, name: str, body: Callable[..., None], *arguments: object) -> None:
        self.name, self.died = name, False
        self._body, self._arguments = body, arguments
        self._context = multiprocessing.get_context("spawn")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._started_s = self._due_s = self._silent_until_s = 0.0
        self._pause_s = 0.0
        self._slow_until_s = math.inf
        self._cpu_s: float | None = None  # of the process, some seconds into its silence

    @property
    def pid(self) -> int | None:
        """Of the process; None before the first start."""
        return self._process.pid if self._process is not None else None

    @property
    def exit_code(self) -> int | None:
        """Of the process; None while it lives."""
        return self._process.exitcode if self._process is not None else None

    @property
    def is_dead(self) -> bool:
        """Whether it was started and lives no more."""
        return self._process is not None and not self._process.is_alive()

    def start(self) -> None:
        """Start a process, the first or another."""
        if self._pipe is not None:
            self._pipe.close()
        self._pipe, end = self._context.Pipe()
        self._process = self._context.Process(target=self._body, args=(*self._arguments, end), name=f"heft-{self.name}")
        self._process.start()
        end.close()
        self._started_s = time.monotonic()
        self._silent_until_s = self._started_s + START_TIMEOUT_S
        self._slow_until_s, self._cpu_s = self._silent_until_s + LONGEST_SILENCE_S, None
        self.died = False

    def wait_ready(self) -> None:
        """Wait until the worker is at work.

        Raises:
            FlightError: it died, or took too long.
        """
        assert self._pipe is not None
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self._pipe.poll(WATCH_PERIOD_S):
            if self.is_dead or time.monotonic() > deadline:
                raise FlightError(f"the {self.name} worker did not start; its message stands above")
        try:
            self._pipe.recv()
        except EOFError as error:
            raise FlightError(f"the {self.name} worker did not start; its message stands above") from error
        now_s = time.monotonic()
        self._silent_until_s, self._slow_until_s = now_s + HUNG_S, now_s + LONGEST_SILENCE_S

    def watch(self) -> str:
        """Kill it if it hangs, start it again if it is dead and due; what there is to say of that."""
        now_s = time.monotonic()
        if not self.is_dead:
            return self._listen(now_s)
        if not self.died:
            self.died = True
            if now_s - self._started_s > _STABLE_S:
                self._pause_s = 0.0
            self._due_s = now_s + self._pause_s
            self._pause_s = min(_LONGEST_PAUSE_S, max(0.25, 2 * self._pause_s))
            return "died"
        if now_s < self._due_s:
            return ""
        self.start()
        return "restarted"

    def _listen(self, now_s: float) -> str:
        assert self._pipe is not None
        assert self._process is not None
        with contextlib.suppress(EOFError, OSError):  # it is just dying
            while self._pipe.poll():
                self._pipe.recv()
                self._silent_until_s, self._slow_until_s = now_s + HUNG_S, now_s + LONGEST_SILENCE_S
                self._cpu_s = None
        if self._cpu_s is None and now_s > self._silent_until_s - LOOK_S:
            self._cpu_s = _cpu_s(self._process.pid)
        if now_s < self._silent_until_s:
            return ""
        worked_s = _cpu_s(self._process.pid) - (self._cpu_s or 0.0)
        self._silent_until_s, self._cpu_s = now_s + HUNG_S, None
        if worked_s > PROGRESS_S and now_s < self._slow_until_s:
            return "slow"
        self._process.kill()
        return "hung"

    def finish(self) -> None:
        """Tell it to end, wait for that, and kill it where it does not."""
        if self._process is None or self._pipe is None:
            return
        with contextlib.suppress(OSError):  # it is dead, and joined below
            self._pipe.send(True)
        self._process.join(STOP_TIMEOUT_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._pipe.close()
        self.died |= self._process.exitcode != 0
