"""Supervision of a worker process: start, heartbeat, kill if it hangs, restart."""

import contextlib
import math
import os
import signal
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from onboard.flight.health.stream import Beat
from onboard.flight.supervise.runner_forks import Forked, exit_code

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0
WATCH_PERIOD_S = 0.05
HUNG_S = 7.0  # without a beat of a worker's; the rings hold 10 s
LOOK_S = 4.0  # before the end of that time the process's CPU time is looked at: if it grows, it is slow, not hung
PROGRESS_S = 0.02
LONGEST_SILENCE_S = 60.0  # after which a worker hangs, whatever it does
_JOIN_PERIOD_S = 0.005
_TEND_S = 0.1  # between two looks at the rest of a flight that ends
_LONGEST_PAUSE_S = 5.0  # before a worker that keeps dying is started again
_STABLE_S = 5.0  # a worker that lived so long starts with a clean slate


def _cpu_s(pid: int | None) -> float:
    """CPU time that a process has had; 0 where it is gone."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


class FlightError(RuntimeError):
    """The flight could not be started, or a worker of it died."""


class Worker:
    """A process that is started again when it dies, with a pipe of its own each time.

    Args:
        name: of the worker.
        fork: makes its process, which waits for a message to begin.
    """

    def __init__(self, name: str, fork: Callable[[], Forked]) -> None:
        self.name, self.died = name, False
        self._fork = fork
        self.pid: int | None = None  # of the process; None before the first start
        self.exit_code: int | None = None  # of the process; None while it lives
        self._pipe: Connection | None = None
        self._spare: Forked | None = None
        self._started_s = self._due_s = self._silent_until_s = 0.0
        self._pause_s = 0.0
        self._slow_until_s = math.inf
        self._cpu_s: float | None = None  # of the process, some seconds into its silence
        self.started_in_s = math.nan  # from its start to its being at work
        self.beat, self.restarts = Beat(), 0  # what it said last
        self._heard_s = -math.inf

    @property
    def is_dead(self) -> bool:
        """Whether it was started and lives no more."""
        if self.pid is not None and self.exit_code is None:
            self.exit_code = exit_code(self.pid)
        return self.exit_code is not None

    @property
    def pipe(self) -> Connection | None:
        """Readable when it has said something or died; None while it is dead."""
        return None if self.pid is None or self.died else self._pipe

    def answers(self, now_s: float) -> bool:
        """Whether it lives and has said something within :data:`HUNG_S`, or has just been started."""
        return self.pid is not None and not self.is_dead and now_s - self._heard_s < HUNG_S

    def start(self) -> None:
        """Start a process, the first or another."""
        if self._pipe is not None:
            self._pipe.close()
        self.pid, self._pipe = self._take_spare() or self._fork()
        with contextlib.suppress(OSError):  # it is dead already: that is seen soon
            self._pipe.send(True)
        self.exit_code, self.started_in_s = None, math.nan
        self._started_s = self._heard_s = time.monotonic()
        self._silent_until_s = self._started_s + START_TIMEOUT_S
        self._slow_until_s, self._cpu_s = self._silent_until_s + LONGEST_SILENCE_S, None
        self.died = False

    def make_spare(self) -> None:
        """Have a process at hand for the next start."""
        if self._spare is None or exit_code(self._spare.pid) is not None:
            self._spare = self._fork()

    def _take_spare(self) -> Forked | None:
        spare, self._spare = self._spare, None
        return None if spare is None or exit_code(spare.pid) is not None else spare

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
            said = self._pipe.recv()
        except EOFError as error:
            raise FlightError(f"the {self.name} worker did not start; its message stands above") from error
        self._hear(said, time.monotonic())

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
        self.restarts += 1
        return "restarted"

    def _listen(self, now_s: float) -> str:
        assert self._pipe is not None
        assert self.pid is not None
        was_at_work = not math.isnan(self.started_in_s)
        with contextlib.suppress(EOFError, OSError):  # it is just dying
            while self._pipe.poll():
                self._hear(self._pipe.recv(), now_s)
        if not (was_at_work or math.isnan(self.started_in_s)):
            return "back"
        if self._cpu_s is None and now_s > self._silent_until_s - LOOK_S:
            self._cpu_s = _cpu_s(self.pid)
        if now_s < self._silent_until_s:
            return ""
        worked_s = _cpu_s(self.pid) - (self._cpu_s or 0.0)
        self._silent_until_s, self._cpu_s = now_s + HUNG_S, None
        if worked_s > PROGRESS_S and now_s < self._slow_until_s:
            return "slow"
        os.kill(self.pid, signal.SIGKILL)
        return "hung"

    def _hear(self, said: object, now_s: float) -> None:
        self._heard_s = now_s
        if isinstance(said, Beat):
            self.beat = said
        self._silent_until_s, self._slow_until_s = now_s + HUNG_S, now_s + LONGEST_SILENCE_S
        self._cpu_s = None
        if math.isnan(self.started_in_s):
            self.started_in_s = now_s - self._started_s

    def finish(self, most_s: float = math.inf, meanwhile: Callable[[float], None] = lambda _: None) -> float:
        """Tell it to end, wait for that as long as it works, and kill it where it does not end; after how many s, or 0.

        Args:
            most_s: that it is waited for; :data:`LONGEST_SILENCE_S` at most.
            meanwhile: called ten times a second with the seconds waited.
        """
        if self.pid is None or self._pipe is None:
            return 0.0
        most_s = min(most_s, LONGEST_SILENCE_S)
        with contextlib.suppress(OSError):  # it is dead, and reaped below
            self._pipe.send(True)
        asked_s = time.monotonic()
        look_s, last_s = asked_s + min(STOP_TIMEOUT_S, most_s), asked_s + most_s
        had_s, killed_s, tend_s = _cpu_s(self.pid), 0.0, asked_s + _TEND_S
        while not self.is_dead:
            now_s = time.monotonic()
            if now_s > tend_s:
                tend_s = now_s + _TEND_S
                meanwhile(now_s - asked_s)
            if now_s > look_s:
                has_s = _cpu_s(self.pid)
                if has_s - had_s > PROGRESS_S and now_s < last_s:
                    look_s, had_s = min(last_s, now_s + HUNG_S), has_s
                else:
                    killed_s = now_s - asked_s
                    os.kill(self.pid, signal.SIGKILL)
                    self.exit_code = exit_code(self.pid, wait=True)
            time.sleep(_JOIN_PERIOD_S)
        self._pipe.close()
        self.died |= self.exit_code != 0 and not (killed_s and most_s < LONGEST_SILENCE_S)  # as was arranged
        if (spare := self._take_spare()) is not None:
            spare.pipe.close()
            with contextlib.suppress(ProcessLookupError):
                os.kill(spare.pid, signal.SIGKILL)  # it holds nothing yet
            exit_code(spare.pid, wait=True)
        return killed_s
