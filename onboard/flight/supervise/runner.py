"""The real runner: a process for each worker, and a supervisor that starts, watches and stops them in order.

A worker that dies is started again: at once the first time, later and later while it keeps dying. The rings hold what
comes meanwhile. Before a flight, the rings of flights that died as a whole are harvested.
"""

import errno
import math
import os
import time
import uuid
from collections.abc import Callable, Mapping
from functools import partial
from multiprocessing import connection
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from drivers.records import EVENT, Severity, event
from onboard import config
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.health.stream import CHANNELS, HealthMonitor, WorkerState, rates_hz
from onboard.flight.store import directories, manifest, rings
from onboard.flight.store.flight_log import MIB, Started, preamble, storage
from onboard.flight.store.harvest import Harvest, harvest
from onboard.flight.store.orders import order_channels
from onboard.flight.supervise import pages, realtime, workers
from onboard.flight.supervise.announcer import LOGGER, Announcer, missing_all_flight
from onboard.flight.supervise.end_of_mission import EndOfMission
from onboard.flight.supervise.modes import Modes
from onboard.flight.supervise.orders import Orders
from onboard.flight.supervise.resume import FlightStart, Keeper, planned
from onboard.flight.supervise.runner_forks import ForkError, ForkServer, PreparedServer
from onboard.flight.supervise.runner_notify import Notifier
from onboard.flight.supervise.runner_processes import HUNG_S, FlightError, Worker
from onboard.flight.supervise.stop_signals import StopSignals
from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.segments import continuing, segment_path, segments

_LOOK_S = 0.1  # between two looks at a flight in which nobody says anything
ESTIMATOR_ENDS_S = 10.0  # then the answer of its last finished step is the answer


class Flight(NamedTuple):
    """How a flight went."""

    log: Path
    died: tuple[str, ...]  # workers that were not running at the end
    restarted: tuple[str, ...] = ()  # workers that died, once for each time, and were started again
    harvested: tuple[Harvest, ...] = ()  # earlier flights that had died
    missing: tuple[str, ...] = ()  # buses and essential devices that never brought a row
    lost: tuple[str, ...] = ()  # of the log, what somebody removed or cut off in flight
    answers: Mapping[bytes, np.void] = {}  # the last QUANTITY row of each name
    troubles: tuple[str, ...] = ()  # errors that the recorder reported
    was_over: bool = False  # the first phase that was seen was the one that ends the mission: nothing was to be flown


def fly(
    vehicle: config.Vehicle,
    log: Path,
    *,
    duration_s: float | None = None,
    progress: Callable[[float], None] = lambda _: None,
    status_s: float | None = None,
    ready: Callable[[], None] = lambda: None,
    enough: Callable[[float], bool] = lambda _: False,
    plan: FlightStart | None = None,
    servers: "Servers | None" = None,
) -> Flight:
    """Fly until the mission's end phase, ``duration_s``, ``enough``, SIGINT or SIGTERM; then stop in order.

    Nothing is lost then. SIGHUP, of a terminal that is gone, ends nothing. What happens is said to the logger ``heft``,
    and every ``status_s`` how the flight stands. A flight that is refused leaves nothing behind. ``ready`` is called
    when all is at work but acquisition, which opens the buses after it. With a ``plan`` of it the flight leaves a
    checkpoint, from which the start after a loss of power goes on. ``servers`` are of this vehicle, and closed in the
    end.

    Raises:
        FlightError: a worker did not start.
        ConfigError: the vehicle cannot be estimated.
        FileExistsError: there is such a log already, or what would be a segment of it.
        OSError: the log's directory or the rings cannot be made.
    """
    require_new(log)
    with servers or Servers(vehicle) as its:
        return _flight(vehicle, log, its, duration_s, _Listeners(progress, ready, enough, status_s, plan))


def plan_of(vehicle: config.Vehicle, new_log: Path, *, fresh: bool = False) -> FlightStart:
    """The flight that lost its power and is to be gone on with, or a new one; see :func:`planned`."""
    under_way = {one.log for one in manifest.waiting() if not directories.is_free(one.directory)}
    return planned(vehicle, new_log, time.time_ns(), under_way, fresh=fresh)


def _flight(
    vehicle: config.Vehicle, log: Path, servers: "Servers", duration_s: float | None, listeners: "_Listeners"
) -> Flight:
    """Fly with workers that ``servers`` fork."""
    estimation = servers.estimation_rings()
    harvested, before = harvest(time.monotonic_ns()), listeners.plan.before if listeners.plan else None
    _require_place(log)
    flight, started = uuid.uuid4().hex, Started(time.time_ns(), time.monotonic_ns())
    with manifest.new_flight(log, flight) as directory:
        about = manifest.Manifest(
            directory,
            log.absolute(),
            vehicle.file.vehicle.name,
            storage(vehicle.file.recording),
            preamble(vehicle, flight, started, before.log if before else ""),
        )
        crew = _Crew(vehicle, directory, servers)
        try:
            about.save()
            rings.create(directory, vehicle, *estimation)
            flown = _fly(vehicle, directory, crew, harvested, duration_s, listeners)
        finally:
            if crew.recording.exit_code == 0 or not any(path.exists() for path in _written(log)):
                about.remove()
    return flown._replace(log=log)


def require_new(log: Path) -> None:
    """See that neither ``log`` is there, nor a file whose name is that of a later segment of it.

    Raises:
        FileExistsError: with the remedy.
    """
    if any(map(os.path.lexists, (log, segment_path(log, 0)))):  # a link to nothing too
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(log))
    if left := continuing(log):
        text = f"{left} has the name of a later segment of {log.name}: name another log, or move that file away"
        raise FileExistsError(text)


def _require_place(log: Path) -> None:
    """Make the directory of ``log``, and raise OSError unless a new log can be written there."""
    require_new(log)
    if log.absolute() in {one.log for one in manifest.waiting()}:
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(log))
    log.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(log.parent, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(log.parent))


def _written(log: Path) -> tuple[Path, ...]:
    """Segments of ``log``; none of a directory without any."""
    try:
        return segments(log)
    except LogFormatError:
        return ()


class _Listeners(NamedTuple):
    """What is called as a flight goes on; see :func:`fly`."""

    progress: Callable[[float], None]
    ready: Callable[[], None]
    enough: Callable[[float], bool]
    status_s: float | None
    plan: FlightStart | None = None


class Servers:
    """The fork servers of a flight.

    Args:
        vehicle: what flies.
        shared: see :class:`onboard.flight.supervise.runner_forks.ForkServer`.
    """

    def __init__(self, vehicle: config.Vehicle, *, shared: bool = False) -> None:
        self.light = ForkServer(shared=shared)
        self.prepared = PreparedServer(self.light, workers.prepare_estimation, vehicle)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.prepared.close()
        self.light.close()

    def estimation_rings(self) -> workers.Prepared:
        """What the estimator writes.

        Raises:
            ConfigError: the vehicle cannot be estimated.
            FlightError: no estimator could be built.
        """
        try:
            first = self.prepared.first()
        except ForkError as error:
            raise FlightError(f"the estimator could not be built: {error}") from error
        if isinstance(first, workers.Refused):
            raise config.ConfigError(first.why)
        assert isinstance(first, workers.Prepared)
        return first

    def look(self) -> list[str]:
        """Start those again that died; their names."""
        return [name for name, one in (("forks", self.light), ("forks-est", self.prepared)) if one.look()]


class _Crew:
    """The workers of a flight."""

    def __init__(self, vehicle: config.Vehicle, directory: Path, servers: Servers) -> None:
        min_free = round(vehicle.file.recording.min_free_mib * MIB)
        wanted = realtime.settings(vehicle.file.realtime, "recording")
        light, prepared = servers.light, servers.prepared
        self.servers = servers
        self.acquisition = Worker("acquisition", lambda: light.fork(workers.acquire, vehicle, directory))
        self.estimation = Worker("estimation", lambda: prepared.fork(workers.estimate, vehicle, directory))
        self.recording = Worker("recording", lambda: light.fork(workers.record, directory, min_free, wanted))
        self.everyone = (self.recording, self.estimation, self.acquisition)

    def start(self, ready: Callable[[], None]) -> None:
        """Start them; ``ready`` is called before acquisition, which is at hand by then."""
        for worker in (self.recording, self.estimation):
            worker.start()
        self.acquisition.make_spare()
        for worker in (self.recording, self.estimation):
            worker.wait_ready()
        ready()
        self.acquisition.start()
        self.acquisition.wait_ready()

    def finish(
        self,
        before_the_log: Callable[[], None],
        tell: Callable[[Severity, str, str, str], None],
        meanwhile: Callable[[str, float], None],
    ) -> None:
        """Stop them.

        Args:
            before_the_log: called before the recorder, which closes the log.
            tell: of an event.
            meanwhile: called often, with the worker that is waited for, and since when [s].
        """
        for worker, most_s in ((self.acquisition, math.inf), (self.estimation, ESTIMATOR_ENDS_S)):
            if waited_s := worker.finish(most_s, partial(meanwhile, worker.name)):
                text = f"had not ended {waited_s:.0f} s after it was asked to: it is killed; its last rows are missing"
                tell(Severity.ERROR, "worker_killed", worker.name, text)
        before_the_log()
        if self.recording.is_dead:
            self.recording.start()  # to end the log
        self.recording.finish(meanwhile=partial(meanwhile, self.recording.name))

    def states(self) -> list[WorkerState]:
        """How they stand."""
        now_s = time.monotonic()
        return [WorkerState(one.name, one.pid, one.answers(now_s), one.restarts, one.beat) for one in self.everyone]

    def wait(self) -> None:
        """Until one of them has said something or died, but not long."""
        connection.wait([one.pipe for one in self.everyone if one.pipe is not None], _LOOK_S)


def _fly(
    vehicle: config.Vehicle,
    directory: Path,
    crew: _Crew,
    harvested: list[Harvest],
    duration_s: float | None,
    listeners: "_Listeners",
) -> Flight:
    """Fly with rings in ``directory``."""
    channels = {**rings.device_channels(vehicle), **CHANNELS, **order_channels(vehicle), "event_supervisor": EVENT}
    supervisor = Publisher(rings.create(directory, vehicle, channels, rates_hz(vehicle)), "_supervisor")
    everyone = crew.everyone
    asked_to_stop = StopSignals()
    restarted: list[str] = []
    why = ""  # the flight is ended; empty for an error

    def tell(severity: Severity, code: str, source: str, text: str) -> None:
        supervisor.publish([event(time.monotonic_ns(), severity, code, source, text)])

    for one in harvested:
        text = one.problem or f"{one.rows} rows brought in"
        tell(Severity.ERROR if one.problem else Severity.WARNING, "harvest", one.log.name, text)
    _say_plan(listeners.plan, tell)
    modes = Modes(vehicle, directory, tell, Keeper(listeners.plan, time.time_ns) if listeners.plan else None)
    notifier = Notifier()
    announcer = Announcer(vehicle, directory, time.monotonic(), listeners.status_s)
    health = HealthMonitor(vehicle, directory, os.getpid(), time.monotonic_ns())
    end, orders = EndOfMission(vehicle, directory), Orders(vehicle, directory, tell, supervisor.publish)
    try:
        crew.start(listeners.ready)
        for worker in everyone:
            worker.make_spare()
        pages.give_back()
        started = time.monotonic()
        notifier.ready()
        modes.at_work(started)
        LOGGER.info("every worker is at work", extra={"source": "flight", "code": "started"})
        while not (
            why := orders.step(time.monotonic_ns())
            or _why_ended(asked_to_stop, end, time.monotonic() - started, duration_s)
        ):
            if listeners.enough(time.monotonic() - started):
                why = "enough is known, or what is asked for is given up"
                break
            asked_to_stop.tell_hangup(tell)
            restarted += [worker.name for worker in everyone if _watch(worker, tell)]
            for name in crew.servers.look():
                tell(Severity.WARNING, "fork_server_restarted", name, "it had died; the workers went on")
            supervisor.publish(health.step(time.monotonic_ns(), crew.states()))
            announcer.step(time.monotonic(), health.said)
            modes.step(time.monotonic(), announcer.rows())
            notifier.feed(time.monotonic(), answering=all(one.answers(time.monotonic()) for one in everyone))
            notifier.status(announcer.status)
            listeners.progress(time.monotonic() - started)
            crew.wait()
    finally:
        notifier.stopping()
        modes.end(why)
        ended_ns = time.monotonic_ns()
        crew.finish(modes.stopped, tell, partial(_still_ending, announcer, notifier, health))
        modes.close()
        asked_to_stop.restore()
        announcer.end(time.monotonic(), ended_ns)
    missing = missing_all_flight(vehicle, announcer.rows())
    for text in missing:
        LOGGER.error(text, extra={"source": "flight", "code": "missing"})
    return Flight(
        directory,
        tuple(worker.name for worker in everyone if worker.died),
        tuple(restarted),
        tuple(harvested),
        tuple(missing),
        tuple(announcer.lost),
        announcer.quantities,
        tuple(announcer.troubles),
        end.was_over,
    )


def _still_ending(
    announcer: Announcer, notifier: Notifier, health: HealthMonitor, worker: str, waited_s: float
) -> None:
    """Say how a flight stands whose ``worker`` is waited for; how long that may last is bounded."""
    announcer.step(time.monotonic(), health.said, f"waits for {worker} since {waited_s:.0f} s")
    notifier.feed(time.monotonic(), answering=True)


def _say_plan(plan: FlightStart | None, tell: Callable[[Severity, str, str, str], None]) -> None:
    if plan is None:
        return
    if plan.before is not None:
        known = plan.before.phases
        text = f"goes on in mode {plan.before.mode}" + (f", phase {known.phase}" if known else "")
        tell(Severity.WARNING, "resumed", plan.before.log, f"{text}: it had lost its power, or was killed")
    elif plan.why_not:
        tell(Severity.WARNING, "not_resumed", "flight", f"a new flight: {plan.why_not}")


def _why_ended(asked: StopSignals, end: EndOfMission, elapsed_s: float, duration_s: float | None) -> str:
    """Why the flight is over; empty while it is not."""
    if asked.seen:
        return "a signal asked for an end"
    if end.reached(time.monotonic()):
        return "the mission's end phase"
    return f"{duration_s:g} s are over" if duration_s is not None and elapsed_s > duration_s else ""


def _watch(worker: Worker, tell: Callable[[Severity, str, str, str], None]) -> bool:
    """Look after a worker, and tell what happened to it; whether it was started again."""
    happened = worker.watch()
    if happened == "died":
        _tell(worker, happened, tell)
        happened = worker.watch()  # it is started at once, unless it keeps dying
    if happened:
        _tell(worker, happened, tell)
    return happened == "restarted"


def _tell(worker: Worker, happened: str, tell: Callable[[Severity, str, str, str], None]) -> None:
    if happened == "died":
        text = f"exit code {worker.exit_code}; the others go on, and it is started again"
        tell(Severity.ERROR, "worker_died", worker.name, text)
    elif happened == "hung":
        tell(Severity.ERROR, "worker_hung", worker.name, f"silent for {HUNG_S:g} s: it is killed")
    elif happened == "slow":
        text = f"no beat for {HUNG_S:g} s, but it works: the computer is busy"
        tell(Severity.WARNING, "worker_slow", worker.name, text)
    elif happened == "restarted":
        tell(Severity.WARNING, "worker_restarted", worker.name, f"process {worker.pid}")
    else:
        worker.make_spare()
        tell(Severity.INFO, "worker_back", worker.name, f"at work {1e3 * worker.started_in_s:.0f} ms after its start")
