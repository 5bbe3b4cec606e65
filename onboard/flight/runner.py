"""The real runner: a process for each worker, and a supervisor that starts, watches and stops them in order."""

import multiprocessing
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from drivers.records import EVENT, Severity, event
from onboard import config
from onboard.flight import rings, workers
from onboard.flight.estimation import estimation_channels
from onboard.flight.estimator import Estimator
from onboard.flight.publisher import Publisher
from onboard.ring import RingReader

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 30.0


class FlightError(RuntimeError):
    """The flight could not be started, or a worker of it died."""


class Flight(NamedTuple):
    """How a flight went."""

    log: Path
    died: tuple[str, ...]  # workers that ended before they were told to


class _Worker:
    """A process with its own ready and stop flags."""

    def __init__(self, name: str, body: Callable[..., None], *arguments: object) -> None:
        context = multiprocessing.get_context("spawn")
        self.name, self.died = name, False
        self.ready, self.stop = context.Event(), context.Event()
        self.process = context.Process(target=body, args=(*arguments, self.ready, self.stop), name=f"heft-{name}")

    def start(self) -> None:
        self.process.start()

    def wait_ready(self) -> None:
        deadline = time.monotonic() + START_TIMEOUT_S
        while not self.ready.wait(0.05):
            if not self.process.is_alive() or time.monotonic() > deadline:
                raise FlightError(f"the {self.name} worker did not start; its message stands above")

    def finish(self) -> None:
        self.stop.set()
        self.process.join(STOP_TIMEOUT_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.died |= self.process.exitcode != 0


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
    """
    directory = rings.new_directory()
    channels = {**rings.device_channels(vehicle), **estimation_channels(Estimator(vehicle)), "event_supervisor": EVENT}
    supervisor = Publisher(rings.create(directory, vehicle, channels), "_supervisor")
    acquisition = _Worker("acquisition", workers.acquire, vehicle, directory)
    estimation = _Worker("estimation", workers.estimate, vehicle, directory)
    recording = _Worker("recording", workers.record, vehicle, directory, log)
    asked_to_stop = _StopSignals()
    everyone = [recording, estimation, acquisition]
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
                if not worker.died and not worker.process.is_alive():
                    worker.died = True
                    text = f"exit code {worker.process.exitcode}; the others go on"
                    supervisor.publish([event(time.monotonic_ns(), Severity.ERROR, "worker_died", worker.name, text)])
            progress(elapsed)
            time.sleep(0.1)
    finally:
        for worker in reversed(everyone):
            if worker.process.pid is not None:
                worker.finish()
        asked_to_stop.restore()
    died = tuple(worker.name for worker in everyone if worker.died)
    if not died:
        for path in directory.iterdir():
            path.unlink()
        directory.rmdir()
    return Flight(log, died)


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
    """Watches the phase channel for the phase that ends the flight."""

    def __init__(self, vehicle: config.Vehicle, directory: Path) -> None:
        phases = vehicle.file.estimation.phases
        self._end = phases.end if phases else None
        self._reader = RingReader(directory / f"{phases.channel}.ring") if phases else None

    def reached(self) -> bool:
        if self._reader is None or self._end is None:
            return False
        rows, _ = self._reader.read()
        return bool((rows["value_raw"] == self._end).any())
