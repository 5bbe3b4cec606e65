"""Records some buses of a vehicle without estimating: the flight app's acquisition and recorder, for calibration.

One thread pumps all devices in turn. What the operator does is an event in the log, so that the log alone tells a
calibration again.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Protocol

from drivers.records import CAN_SYNC, Rows, Severity, event
from onboard import config
from onboard.devices.base import BusDevice
from onboard.flight import simulated
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.acquire.devices import open_devices
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.hil import World
from onboard.flight.store import rings
from onboard.flight.store.directories import scratch
from onboard.flight.store.flight_log import open_simulated_recorder
from onboard.ring import RingReader

BEGIN, END = "bench_begin", "bench_end"  # events: what the operator holds still, from when to when
PAUSE_S = 1e-3
LOOKED_NS = 100_000_000
LONGEST_STEP_NS = 50_000_000  # of virtual time: nothing waits for a reading


def only(vehicle: config.Vehicle, devices: Iterable[str]) -> config.Vehicle:
    """The vehicle with some of its devices, and with those that time them: the sync line, SYNC on their CAN bus.

    Raises:
        ConfigError: a device that is on no bus.
    """
    wanted = set(devices)
    on_bus = {name: device for name, device in vehicle.file.device.items() if isinstance(device, BusDevice)}
    if missing := sorted(wanted - set(on_bus)):
        raise config.ConfigError(f"device {missing[0]!r} is a recording's: it cannot be run; give --log")
    buses = {on_bus[name].bus for name in wanted}
    kept = {
        name: device
        for name, device in on_bus.items()
        if name in wanted or device.sync_line(name) is not None or (device.records == CAN_SYNC and device.bus in buses)
    }
    return vehicle.with_sections(device=kept)


def on_simulated(vehicle: config.Vehicle, urls: dict[str, str]) -> config.Vehicle:
    """The vehicle on the buses of a simulated bench.

    Raises:
        ConfigError: the bench lacks one of its buses: it is of another file with the same vehicle name.
    """
    buses = {device.bus for device in vehicle.file.device.values() if isinstance(device, BusDevice)}
    if lacking := sorted(buses - set(urls)):
        raise config.ConfigError(
            f"the simulated bench has no bus {lacking[0]!r}; simulate the file: --hil {vehicle.label}"
        )
    return vehicle.with_urls(urls)


class BenchRun:
    """The devices of a vehicle, recorded to a log. A context manager: the log is whole when it ends.

    Args:
        vehicle: see :func:`only`; the log carries its whole file.
        log: to write; must not exist.
        clock: CLOCK_MONOTONIC ns, or a virtual one.
        undisturbed: nothing fails on its buses, as on simulated ones.

    Raises:
        FileExistsError: there is such a log.
        OSError: it cannot be written.
    """

    def __init__(
        self, vehicle: config.Vehicle, log: Path, clock: Callable[[], int], *, undisturbed: bool = False
    ) -> None:
        self._clock = clock
        with ExitStack() as stack:
            directory = stack.enter_context(scratch())
            made = rings.create(directory, vehicle, rings.device_channels(vehicle))
            opened = open_devices(vehicle, clock)
            stack.callback(opened.close)
            self._recorder = open_simulated_recorder(vehicle, directory, log)
            self.acquisition = Acquisition(opened.devices, Publisher(made), undisturbed=undisturbed)
            self._directory = directory
            self._stack = stack.pop_all()
        self.acquisition.report(opened.problems)
        self.acquisition.start(clock())
        self._recorded_ns = clock()

    def mark(self, code: str, text: str) -> None:
        """Put what the operator does into the log."""
        self.acquisition.report([event(self._clock(), Severity.INFO, code, "bench", text)])

    def readers(self, channels: Iterable[str]) -> dict[str, RingReader]:
        """Reading ends of channels, from their first row."""
        opened = rings.readers(self._directory, channels)
        for reader in opened.values():
            self._stack.callback(reader.close)
        return opened

    def step(self, *, hand_over: bool = True, handed_over_at: Callable[[int], int] = int) -> None:
        """Pump what is due, and record now and then; arguments as of :meth:`Acquisition.step`."""
        now_ns = self._clock()
        self.acquisition.step(now_ns, hand_over=hand_over, handed_over_at=handed_over_at)
        if now_ns - self._recorded_ns > 2e8:
            self._recorder.step(now_ns)
            self._recorded_ns = now_ns

    def __enter__(self) -> "BenchRun":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.acquisition.stop(self._clock())
        self._recorder.close(self._clock())
        self._stack.close()


class PumpedBench:
    """A bench run on the real clock, pumped by a thread of its own while the operator is asked."""

    def __init__(self, run: BenchRun) -> None:
        self.run = run
        self._over = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._pump, name="bench", daemon=True)

    def _pump(self) -> None:
        try:
            while not self._over.is_set():
                self.run.step()
                time.sleep(PAUSE_S)
        except Exception as error:  # noqa: BLE001 - shown to the operator by check(), in the thread that asks
            self._error = error

    def check(self) -> None:
        """Raise what ended the recording."""
        if self._error is not None:
            raise self._error

    def __enter__(self) -> "PumpedBench":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()


class Watcher(Protocol):
    """Looks at rows while a bench runs."""

    done: str

    @property
    def channels(self) -> tuple[str, ...]:
        """That it reads."""

    def feed(self, channel: str, rows: Rows) -> None:
        """Rows of a channel, any number of them."""

    def step(self, now_s: float) -> None:
        """Time goes on."""


def run_simulated(vehicle: config.Vehicle, world: World, log: Path, watcher: Watcher) -> None:
    """Record a simulated bench until what looks at it is done, or to its end.

    Args:
        vehicle: with the URLs of the simulated buses.
        world: the bench.
        log: to write; must not exist.
        watcher: looks ten times a second.
    """
    clock = simulated.VirtualClock(world.start_ns)
    with BenchRun(vehicle, log, clock, undisturbed=True) as run:
        readers = run.readers(watcher.channels)
        for now_ns in _stepped(run, world, clock):
            for channel, reader in readers.items():
                watcher.feed(channel, reader.read()[0])
            watcher.step(now_ns * 1e-9)
            if watcher.done:
                return


def record_simulated(vehicle: config.Vehicle, world: World, log: Path, progress: Callable[[float], None]) -> None:
    """Record a simulated bench to its end, in virtual time.

    Args:
        vehicle: with the URLs of the simulated buses.
        world: the bench.
        log: to write; must not exist.
        progress: called with the fraction done.
    """
    clock = simulated.VirtualClock(world.start_ns)
    with BenchRun(vehicle, log, clock, undisturbed=True) as run:
        for now_ns in _stepped(run, world, clock):
            progress((now_ns - world.start_ns) / (world.end_ns - world.start_ns))


def _stepped(run: BenchRun, world: World, clock: simulated.VirtualClock) -> Iterator[int]:
    """Let bench and recording go on to the world's end; each time at which rows were handed over."""
    pause_ns = simulated.step_of(run.acquisition.devices, LONGEST_STEP_NS)
    start_ns, step, every = clock.now_ns, 0, max(1, round(LOOKED_NS / pause_ns))

    def step_at(time_ns: int) -> int:
        return -((start_ns - time_ns) // pause_ns)

    def handed_over(step: int) -> int:  # the first step from this one on that does
        return step + (1 - step) % every

    while clock.now_ns < world.end_ns:
        step = min(max(step + 1, step_at(run.acquisition.idle_until())), handed_over(step + 1))
        clock.now_ns = min(start_ns + step * pause_ns, world.end_ns)
        world.advance(clock.now_ns)
        hands_over = step == handed_over(step)
        run.step(hand_over=hands_over, handed_over_at=lambda now_ns: start_ns + handed_over(step_at(now_ns)) * pause_ns)
        if hands_over or clock.now_ns == world.end_ns:
            yield clock.now_ns
