"""Processes of a real flight (acquisition, estimation, recording); each runs its worker's step until stopped.

Only the acquisition process has real-time priority: one thread per bus, blocked in I/O or asleep until its next poll,
and a thread that waits for the stop command.

A restarted process finds the progress of its predecessor in the rings or in the log.
"""

import contextlib
import ctypes
import sys
import threading
import time
from collections.abc import Callable, Iterable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drivers.records import EVENT, Batch, Severity, event
from onboard import config
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.acquire.arming import Arming
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.health.status import Status
from onboard.flight.health.stream import Beat
from onboard.flight.store import directories, manifest, rings
from onboard.flight.supervise import realtime
from onboard.flight.supervise.announcer import RECORDER_SAID
from onboard.flight.supervise.runner_forks import leave_signals_to_supervisor, name_process, serve
from onboard.ring import RingWriter

if TYPE_CHECKING:
    from onboard.flight.acquire.devices import OpenDevices
    from onboard.flight.estimate.estimator import Estimator
    from onboard.flight.estimate.state import UnwrittenParts
    from onboard.recording.recorder import Recorder

RECEIVE_TIMEOUT_S = 0.05
SWITCH_S = 0.0005  # between the threads of the buses: an I2C drain is a dozen transfers, each may wait so long
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 2.0  # before a bus that could not be opened is tried again
BEAT_S = 1.0  # a worker that has said nothing for several of these hangs
ORPHAN_S = 2.0  # a recorder without a supervisor waits so long for the others to end
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h
_KEPT_BYTES = 32 << 20
TRIM_S = 5.0
EVENTS_SAID = 200  # of the recorder, for whoever listens
WORK_OFF_S = 5.0  # of the 10 s that the estimator has at the end of a flight: the rest is for its final step
CLOSE_S = 10.0  # for a disk that refuses at the end of a flight: what is left is harvested before the next


class Supervised:
    """A worker's end of the pipe to its supervisor. The pipe also ends when the supervisor does.

    A pipe is used instead of a shared event, because a process killed while it holds the event leaves it locked.

    Args:
        pipe: this end.
        name: for the lists of processes that an operator looks at.
    """

    def __init__(self, pipe: Connection, name: str) -> None:
        self._pipe, self._beat_s = pipe, 0.0
        name_process(name)
        self.stop, self.orphaned = threading.Event(), False
        leave_signals_to_supervisor()
        threading.Thread(target=self._wait, name="supervised", daemon=True).start()

    def ready(self) -> None:
        """Say that the worker is at work."""
        self._pipe.send(True)

    def beat(self, say: Callable[[], Beat]) -> None:
        """Say, once in a while, that it has come round again, and how it stands."""
        now_s = time.monotonic()
        if now_s - self._beat_s > BEAT_S and not self.stop.is_set():
            self._beat_s = now_s
            with contextlib.suppress(OSError):  # the supervisor is gone: the other thread sees it
                self._pipe.send(say())

    def _wait(self) -> None:
        try:
            self._pipe.recv()
        except (EOFError, OSError):
            self.orphaned = True
        self.stop.set()


def acquire(vehicle: config.Vehicle, directory: Path, pipe: Connection) -> None:
    """Body of the acquisition process."""
    supervised = Supervised(pipe, "acquire")
    with directories.belong(directory):
        _acquire(vehicle, directory, supervised)


def _acquire(vehicle: config.Vehicle, directory: Path, supervised: Supervised) -> None:
    from onboard.flight.acquire.devices import open_devices

    sys.setswitchinterval(SWITCH_S)
    told = {name: device for bus in vehicle.buses for name, device in vehicle.devices_on(bus).items()}
    changes = [channel for name, device in told.items() if device.tells_changes for channel in device.channels(name)]
    writers = rings.create(directory, vehicle, rings.device_channels(vehicle))
    publisher = Publisher(writers, renumber=True, changes=changes)
    opened = open_devices(vehicle, time.monotonic_ns)
    acquisition = Acquisition(opened.devices, publisher, Arming(vehicle, directory))
    acquisition.report(opened.problems)
    has = realtime.apply(realtime.settings(vehicle.file.realtime, "acquisition"))
    if said := has.said():
        acquisition.report([event(time.monotonic_ns(), said[0], said[1], "acquisition", said[2])])
    missed = dict.fromkeys(vehicle.buses, 0)
    threads = [
        threading.Thread(
            target=_run_bus, args=(vehicle, acquisition, opened, _Bus(bus, supervised.stop, missed)), daemon=True
        )
        for bus in vehicle.buses
        if vehicle.devices_on(bus)
    ]
    for thread in threads:
        thread.start()
    supervised.ready()
    while not supervised.stop.wait(BEAT_S):  # with no bus at all there is still a flight to log
        supervised.beat(lambda: Beat(sum(missed.values()), has.status))
    for thread in threads:
        thread.join()
    acquisition.finish(time.monotonic_ns())
    opened.close()


class _Bus(NamedTuple):
    """One bus: its name, what ends it, and where its thread counts by name the polls that came too late."""

    name: str
    stop: threading.Event
    missed: dict[str, int]


def _run_bus(vehicle: config.Vehicle, acquisition: Acquisition, opened: "OpenDevices", its: _Bus) -> None:
    """One bus for a whole flight; where it could not be opened it is tried again, and joins when it is there."""
    from onboard.flight.acquire.devices import open_bus
    from onboard.flight.acquire.expected import expected

    bus, stop, _ = its
    since_ns, pause_s, tries = time.monotonic_ns(), FIRST_PAUSE_S, 1
    acquisition.expect(expected(vehicle, bus, is_open=bus in opened.by_bus), since_ns)
    while bus not in opened.by_bus:
        if stop.wait(pause_s):
            return
        pause_s, tries = min(2 * pause_s, LONGEST_PAUSE_S), tries + 1
        if not open_bus(vehicle, bus, time.monotonic_ns, opened):
            now_ns = time.monotonic_ns()
            text = f"{vehicle.url(bus)}: open after {1e-9 * (now_ns - since_ns):.1f} s, at try {tries}"
            acquisition.report([event(now_ns, Severity.WARNING, "bus_opened", bus, text)])
    _pump_bus(acquisition, opened, its)


def _pump_bus(acquisition: Acquisition, opened: "OpenDevices", its: _Bus) -> None:
    """All devices of one bus: they share a port, so one thread drives them, and closes it."""
    bus, stop, missed = its
    running = [device for device in opened.by_bus[bus] if acquisition.start_device(device, time.monotonic_ns())]
    due_ns = {device.name: 0 for device in running}
    while running and not stop.is_set():
        for device in running:
            now_ns = time.monotonic_ns()
            if now_ns >= due_ns[device.name]:
                acquisition.pump(device, now_ns, RECEIVE_TIMEOUT_S if device.period_ns == 0 else 0.0)
                period_ns = device.period_ns
                next_ns = due_ns[device.name] + period_ns
                if period_ns and due_ns[device.name] and next_ns <= now_ns:
                    missed[bus] += 1 + (now_ns - next_ns) // period_ns
                due_ns[device.name] = max(next_ns, now_ns)
        wait_ns = min(due_ns.values()) - time.monotonic_ns()
        if wait_ns > 0:
            time.sleep(wait_ns * 1e-9)
    for device in running:
        acquisition.stop_device(device, time.monotonic_ns())
    opened.close_bus(bus)


def run_for(opened: "OpenDevices", seconds: float) -> list[Batch]:
    """Run devices as in flight, and nothing else: what they say in so many seconds, their being stopped aside."""
    said: list[Batch] = []
    stop = threading.Event()
    acquisition = Acquisition(opened.devices, _Keeper(said))
    threads = [
        threading.Thread(target=_pump_bus, args=(acquisition, opened, _Bus(bus, stop, {bus: 0})), daemon=True)
        for bus in opened.by_bus
    ]
    for thread in threads:
        thread.start()
    time.sleep(seconds)
    until_now = list(said)
    stop.set()
    for thread in threads:
        thread.join()
    return until_now


class _Keeper(Publisher):
    """Keeps batches in a list in place of rings."""

    def __init__(self, kept: list[Batch]) -> None:
        super().__init__({})
        self._kept = kept

    def publish(self, batches: Iterable[Batch]) -> None:
        """See ``Publisher``."""
        self._kept.extend(batches)


class Prepared(NamedTuple):
    """What an estimator writes: records by channel, and how often rows of some come [Hz]."""

    channels: dict[str, np.dtype[np.void]]
    rates_hz: dict[str, float]


class Refused(NamedTuple):
    """A vehicle that cannot be estimated."""

    why: str


def prepare_estimation(vehicle: config.Vehicle, control: Connection) -> None:
    """Body of the fork server that has an estimator; its first message is what that writes, or a refusal."""
    from onboard.flight.estimate import hand_over
    from onboard.flight.estimate.estimation import answer_rates_hz, estimation_channels
    from onboard.flight.estimate.estimator import Estimator
    from onboard.flight.estimate.state import UnwrittenParts

    name_process("forks-est")
    try:
        estimator = Estimator(vehicle)
        hand_over.check(vehicle, estimator.online.quantity_names)
    except config.ConfigError as error:
        control.send(Refused(str(error)))
        return
    control.send(Prepared(estimation_channels(estimator), answer_rates_hz(estimator)))
    serve(control, estimator, UnwrittenParts(estimator))


def estimate(
    vehicle: config.Vehicle, directory: Path, estimator: "Estimator", places: "UnwrittenParts", pipe: Connection
) -> None:
    """Body of the estimation process, with an ``estimator`` that has not made a step and its ``places``."""
    from onboard.flight.estimate.estimation import DurableEstimation

    supervised = Supervised(pipe, "estimate")
    heap = _Heap()
    with directories.belong(directory):
        built = estimator, places
        worker = DurableEstimation(vehicle, directory, time.monotonic_ns(), built, time.process_time_ns)
        realtime.apply(realtime.settings(vehicle.file.realtime, "estimation"))
        supervised.ready()
        pace = _Pace(int(vehicle.file.estimation.step_ms * 1e6))
        while not supervised.stop.is_set():
            worker.step(time.monotonic_ns())
            supervised.beat(lambda: Beat(pace.missed))
            heap.give_back()
            pace.sleep()
        over_s = time.monotonic() + WORK_OFF_S
        worker.finish(time.monotonic_ns(), lambda: time.monotonic() > over_s)


class _Heap:
    """Keeps freed memory, and gives it back to the system once in a while (glibc).

    A prediction over a window needs a dozen blocks of some MB one after the other, and so does a checkpoint. Taken from
    the system each time, their page faults cost half as much again as the prediction.
    """

    def __init__(self) -> None:
        self._trim: Callable[[int], object] | None = None
        self._trimmed_s = time.monotonic()
        with contextlib.suppress(AttributeError, OSError):
            libc = ctypes.CDLL(None)
            for limit in (_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD):
                libc.mallopt(limit, _KEPT_BYTES)
            self._trim = libc.malloc_trim

    def give_back(self) -> None:
        """Return what is free, if that has not been done for some seconds."""
        if self._trim is not None and time.monotonic() - self._trimmed_s > TRIM_S:
            self._trimmed_s = time.monotonic()
            self._trim(0)


def record(directory: Path, min_free_bytes: int, wanted: realtime.Settings, pipe: Connection) -> None:
    """Body of the recording process.

    Args:
        directory: of the flight.
        min_free_bytes: earlier flights' segments make way while less is free.
        wanted: of the system.
        pipe: to the supervisor.
    """
    from onboard.flight.store.flight_log import open_recorder, step_ns

    supervised = Supervised(pipe, "record")
    with directories.belong(directory):
        flight = manifest.Manifest.load(directory)
        said = RingWriter(directory / RECORDER_SAID, EVENT, EVENTS_SAID)
        recorder = open_recorder(flight, min_free_bytes, said.push)
        has = realtime.apply(wanted)
        if told := has.said():
            recorder.say(time.monotonic_ns(), *told)
        recorder.step(time.monotonic_ns())
        supervised.ready()
        period_ns = step_ns(flight.storage)
        pace = _Pace(period_ns)
        while not supervised.stop.is_set():
            supervised.beat(lambda: _recorder_beat(recorder, pace.missed, has.status))
            recorder.step(time.monotonic_ns())
            pace.sleep()
        end_ns = time.monotonic_ns() + int(ORPHAN_S * 1e9) * supervised.orphaned
        while time.monotonic_ns() < end_ns:
            recorder.step(time.monotonic_ns())
            time.sleep(period_ns * 1e-9)
        end_ns = time.monotonic_ns() + int(CLOSE_S * 1e9)
        while recorder.close(time.monotonic_ns()).failing:
            if time.monotonic_ns() > end_ns:
                raise SystemExit("the log could not be closed (disk error): the next start adds the rows in the rings")
            time.sleep(period_ns * 1e-9)


def _recorder_beat(recorder: "Recorder", missed: int, status: Status) -> Beat:
    status |= Status.DISK_REFUSES if recorder.failing else Status(0)
    status |= Status(0) if recorder.has_room else Status.DISK_LOW
    return Beat(missed, status, recorder.backlog(), recorder.lost, recorder.disk_free)


class _Pace:
    """Sleeps from tick to tick.

    Args:
        period_ns: between two ticks.

    Attributes:
        missed: ticks that were over when the step before them ended. A step begins then, and later ticks count from it.
    """

    def __init__(self, period_ns: int) -> None:
        self.missed = 0
        self._period_ns, self._next_ns = period_ns, time.monotonic_ns()

    def sleep(self) -> None:
        """Until the next tick; returns at once if that is over."""
        self._next_ns += self._period_ns
        now_ns = time.monotonic_ns()
        if now_ns <= self._next_ns:
            time.sleep((self._next_ns - now_ns) * 1e-9)
        else:
            self.missed += 1 + (now_ns - self._next_ns) // self._period_ns
            self._next_ns = now_ns
