"""The real runner: a process for each worker, and a supervisor that starts, watches and stops them in order.

A worker that dies is started again: at once the first time, later and later while it keeps dying. The rings hold what
comes meanwhile. Before a flight, the rings of flights that died as a whole are harvested.
"""

import contextlib
import math
import multiprocessing
import signal
import time
import uuid
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from drivers.records import EVENT, Severity, event
from onboard import config
from onboard.flight import manifest, rings, workers
from onboard.flight.estimation import create_rings
from onboard.flight.estimator import Estimator
from onboard.flight.flight_log import Started, preamble, storage
from onboard.flight.harvest import Harvest, harvest
from onboard.flight.publisher import Publisher
from onboard.recording.segments import segment_path
from onboard.ring import RingReader

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0
WATCH_PERIOD_S = 0.05
HUNG_S = 7.0  # without a beat of a worker's; the rings hold 10 s
_LAST_WORDS_S = 0.25  # from the phase that ends the flight to its end: an answer may be on its way
_LONGEST_PAUSE_S = 5.0  # before a worker that keeps dying is started again
_STABLE_S = 30.0  # a worker that lived so long starts with a clean slate


class FlightError(RuntimeError):
    """The flight could not be started, or a worker of it died."""


class Flight(NamedTuple):
    """How a flight went."""

    log: Path
    died: tuple[str, ...]  # workers that were not running at the end
    restarted: tuple[str, ...] = ()  # workers that died, once for each time, and were started again
    harvested: tuple[Harvest, ...] = ()  # earlier flights that had died


class _Worker:
    """A process that is started again when it dies, with a pipe of its own each time."""

    def __init__(self, name: str, body: Callable[..., None], *arguments: object) -> None:
        self.name, self.died = name, False
        self._body, self._arguments = body, arguments
        self._context = multiprocessing.get_context("spawn")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._started_s = self._due_s = self._silent_until_s = 0.0
        self._pause_s = 0.0

    @property
    def pid(self) -> int | None:
        return self._process.pid if self._process is not None else None

    @property
    def exit_code(self) -> int | None:
        return self._process.exitcode if self._process is not None else None

    @property
    def is_dead(self) -> bool:
        return self._process is not None and not self._process.is_alive()

    def start(self) -> None:
        if self._pipe is not None:
            self._pipe.close()
        self._pipe, end = self._context.Pipe()
        self._process = self._context.Process(target=self._body, args=(*self._arguments, end), name=f"heft-{self.name}")
        self._process.start()
        end.close()
        self._started_s = time.monotonic()
        self._silent_until_s = self._started_s + START_TIMEOUT_S
        self.died = False

    def wait_ready(self) -> None:
        assert self._pipe is not None
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self._pipe.poll(WATCH_PERIOD_S):
            if self.is_dead or time.monotonic() > deadline:
                raise FlightError(f"the {self.name} worker did not start; its message stands above")
        try:
            self._pipe.recv()
        except EOFError as error:
            raise FlightError(f"the {self.name} worker did not start; its message stands above") from error
        self._silent_until_s = time.monotonic() + HUNG_S

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
                self._silent_until_s = now_s + HUNG_S
        if now_s < self._silent_until_s:
            return ""
        self._silent_until_s = now_s + HUNG_S
        self._process.kill()
        return "hung"

    def finish(self) -> None:
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


def fly(
    vehicle: config.Vehicle,
    log: Path,
    *,
    duration_s: float | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Flight:
    """Fly until the mission's end phase, ``duration_s``, SIGINT or SIGTERM; then stop in order, losing nothing.

    Raises:
        FlightError: a worker did not start.
        FileExistsError: there is such a log already.
    """
    harvested = harvest(time.monotonic_ns())
    if log.exists() or segment_path(log, 0).exists():
        raise FileExistsError(f"{log} is there already; give another name")
    flight, started = uuid.uuid4().hex, Started(time.time_ns(), time.monotonic_ns())
    directory = manifest.directory_for(log, flight)
    with manifest.belong(directory):
        about = manifest.Manifest(
            directory,
            log.absolute(),
            vehicle.file.vehicle.name,
            storage(vehicle.file.recording),
            preamble(vehicle, flight, started),
        )
        about.save()
        died, restarted = _fly(vehicle, directory, harvested, duration_s, progress)
        if not died:
            about.remove()
    return Flight(log, died, restarted, tuple(harvested))


def _fly(
    vehicle: config.Vehicle,
    directory: Path,
    harvested: list[Harvest],
    duration_s: float | None,
    progress: Callable[[float], None],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Fly with rings in ``directory``; returns the workers that are dead at the end, and those that were restarted."""
    create_rings(directory, Estimator(vehicle))
    channels = {**rings.device_channels(vehicle), "event_supervisor": EVENT}
    supervisor = Publisher(rings.create(directory, vehicle, channels), "_supervisor")
    acquisition = _Worker("acquisition", workers.acquire, vehicle, directory)
    estimation = _Worker("estimation", workers.estimate, vehicle, directory)
    recording = _Worker("recording", workers.record, directory)
    asked_to_stop = _StopSignals()
    everyone = [recording, estimation, acquisition]
    restarted: list[str] = []

    def tell(severity: Severity, code: str, source: str, text: str) -> None:
        supervisor.publish([event(time.monotonic_ns(), severity, code, source, text)])

    for one in harvested:
        text = one.problem or f"{one.rows} rows brought in"
        tell(Severity.ERROR if one.problem else Severity.WARNING, "harvest", one.log.name, text)
    try:
        for worker in everyone:
            worker.start()
        for worker in everyone:
            worker.wait_ready()
        started = time.monotonic()
        end = _EndOfMission(vehicle, directory)
        while not asked_to_stop.seen and not end.reached():
            elapsed = time.monotonic() - started
            if duration_s is not None and elapsed > duration_s:
                break
            for worker in everyone:
                happened = worker.watch()
                if happened == "died":
                    text = f"exit code {worker.exit_code}; the others go on, and it is started again"
                    tell(Severity.ERROR, "worker_died", worker.name, text)
                elif happened == "hung":
                    tell(Severity.ERROR, "worker_hung", worker.name, f"silent for {HUNG_S:g} s: it is killed")
                elif happened:
                    restarted.append(worker.name)
                    tell(Severity.WARNING, "worker_restarted", worker.name, f"process {worker.pid}")
            progress(elapsed)
            time.sleep(WATCH_PERIOD_S)
    finally:
        for worker in reversed(everyone):
            if worker is recording and worker.is_dead:
                worker.start()  # to end the log
            worker.finish()
        asked_to_stop.restore()
    return tuple(worker.name for worker in everyone if worker.died), tuple(restarted)


class _StopSignals:
    """SIGINT and SIGTERM asked for an end. Children get SIGINT from a terminal too: they ignore it, we tell them."""

    def __init__(self) -> None:
        self.seen = False
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.seen = True

    def restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


class _EndOfMission:
    """Watches the phase channel for the phase that ends the flight; what is under way then still comes in."""

    def __init__(self, vehicle: config.Vehicle, directory: Path) -> None:
        phases = vehicle.file.estimation.phases
        self._end = phases.end if phases else None
        self._reader = RingReader(directory / f"{phases.channel}.ring") if phases else None
        self._seen_s = math.inf

    def reached(self) -> bool:
        if self._reader is None or self._end is None:
            return False
        rows, _ = self._reader.read()
        now_s = time.monotonic()
        if (rows["value_raw"] == self._end).any():
            self._seen_s = min(self._seen_s, now_s)
        return now_s - self._seen_s > _LAST_WORDS_S
