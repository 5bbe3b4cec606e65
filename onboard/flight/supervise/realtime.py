"""What ``[realtime]`` asks of the system for a worker: memory lock, SCHED_FIFO, CPU affinity, frozen garbage collector.

Each is asked for when the worker starts, and what was granted or refused becomes one event, with the remedy. A refusal
never stops a flight. Where the vehicle file asks, it is a warning and sets ``not realtime`` in the status word; where a
default asks, it is information.

Memory is locked as it is used (``MCL_ONFAULT``): to lock all of it at once would copy every page that the worker shares
with its fork server. Where the limit is finite it is refused: a later allocation beyond it would end the process.
"""

import ctypes
import errno
import gc
import os
import resource
from collections.abc import Callable
from typing import NamedTuple

from drivers.records import Severity
from onboard.config.vehicle import Realtime
from onboard.flight.health.status import Status

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
SERVICE = "deploy/heft.service"


class Settings(NamedTuple):
    """Of one worker.

    Attributes:
        priority: of SCHED_FIFO; 0 leaves the scheduler as it is.
        cpus: that it may run on; none leaves them as they are.
        lock_memory: whether its pages stay in memory.
        freeze: whether the garbage collector leaves alone what was there at the start.
        by_file: whether the vehicle file has any of these.
    """

    priority: int
    cpus: tuple[int, ...]
    lock_memory: bool
    freeze: bool
    by_file: bool


UNCHANGED = Settings(0, (), lock_memory=False, freeze=False, by_file=False)


class SchedulingOutcome(NamedTuple):
    """What came of it.

    Attributes:
        granted: in words.
        refused: in words, with the remedy.
        by_file: whether the vehicle file asked for something.
    """

    granted: tuple[str, ...]
    refused: tuple[str, ...]
    by_file: bool

    @property
    def status(self) -> Status:
        """The bit that it sets."""
        return Status.NOT_REALTIME if self.refused and self.by_file else Status(0)

    def said(self) -> tuple[Severity, str, str] | None:
        """Severity, code and text of an event; None where nothing was asked for."""
        if not self.granted and not self.refused:
            return None
        has = f"has {', '.join(self.granted)}" if self.granted else "has nothing that it asked for"
        if not self.refused:
            return Severity.INFO, "realtime", has
        severity = Severity.WARNING if self.by_file else Severity.INFO
        return severity, "not_realtime", f"{has}; refused: {'; '.join(self.refused)}"


def settings(realtime: Realtime, worker: str) -> Settings:
    """Those of ``acquisition`` or ``recording``; the scheduling of other workers is left as it is."""
    asked = realtime.model_fields_set
    if worker not in ("acquisition", "recording"):
        return Settings(0, (), False, realtime.freeze_gc, False)
    acquires = worker == "acquisition"
    return Settings(
        realtime.acquisition_priority if acquires else realtime.recording_priority,
        tuple(realtime.acquisition_cpus if acquires else realtime.recording_cpus),
        realtime.lock_memory,
        realtime.freeze_gc,
        bool(asked & {f"{worker}_priority", f"{worker}_cpus", "lock_memory"}),
    )


class System(NamedTuple):
    """What is asked; each raises OSError where it is refused."""

    set_priority: Callable[[int], None]
    set_cpus: Callable[[tuple[int, ...]], None]
    lock_memory: Callable[[], None]


def _set_priority(priority: int) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def _set_cpus(cpus: tuple[int, ...]) -> None:
    os.sched_setaffinity(0, cpus)


def _lock_memory() -> None:
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and os.geteuid():
        raise OSError(errno.EPERM, f"the limit is {limit // 1024} kB")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


OF_THE_KERNEL = System(_set_priority, _set_cpus, _lock_memory)


def apply(wanted: Settings, system: System = OF_THE_KERNEL) -> SchedulingOutcome:
    """Ask for ``wanted``, for this process and the threads that it starts later."""
    granted: list[str] = []
    refused: list[str] = []

    def ask(what: str, call: Callable[[], None], remedy: str) -> None:
        try:
            call()
        except OSError as error:
            refused.append(f"{what} ({error.strerror}): {remedy}")
        else:
            granted.append(what)

    if wanted.lock_memory:
        ask("locked memory", system.lock_memory, f"LimitMEMLOCK=infinity in {SERVICE}, or ulimit -l unlimited")
    if wanted.cpus:
        named = ",".join(map(str, wanted.cpus))
        there = ",".join(map(str, sorted(os.sched_getaffinity(0))))
        remedy = f"it may use {there}; correct the vehicle file, or CPUAffinity in {SERVICE}"
        ask(f"CPU {named}", lambda: system.set_cpus(wanted.cpus), remedy)
    if wanted.priority:
        remedy = f"LimitRTPRIO={wanted.priority} in {SERVICE}, or ulimit -r {wanted.priority}"
        ask(f"SCHED_FIFO {wanted.priority}", lambda: system.set_priority(wanted.priority), remedy)
    if wanted.freeze:
        gc.collect()
        gc.freeze()
    return SchedulingOutcome(tuple(granted), tuple(refused), wanted.by_file)
