"""HIL harness: the flight app against simulated devices.

It uses the simulator through a protocol and bus URLs, and imports none of it.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from onboard import config
from onboard.flight import rings, runner, simulated
from onboard.flight.acquisition import Acquisition
from onboard.flight.devices import open_devices
from onboard.flight.directories import scratch
from onboard.flight.estimation import EstimationWorker, create_rings
from onboard.flight.estimator import Estimator
from onboard.flight.flight_log import open_simulated_recorder
from onboard.flight.publisher import Publisher
from onboard.flight.runner_processes import FlightError

Progress = Callable[[float], None]


class World(Protocol):
    """Simulated devices on a virtual clock."""

    @property
    def start_ns(self) -> int:
        """When they were powered up."""

    @property
    def end_ns(self) -> int:
        """When the mission is over."""

    def advance(self, now_ns: int) -> None:
        """Everything that happens up to ``now_ns``."""

    def produced(self) -> dict[str, int]:
        """Samples made so far, by channel."""

    def truth(self) -> dict[str, Any]:
        """What an estimate is to be compared with."""


class Flown(NamedTuple):
    """A flight in the harness: its log, what the devices made, what was true."""

    log: Path
    produced: dict[str, int]
    truth: dict[str, Any]


def fly_simulated(
    vehicle: config.Vehicle, world: World, urls: Mapping[str, str], log: Path, progress: Progress = lambda _: None
) -> Flown:
    """Fly a world in this process, in virtual time, as fast as it goes.

    Args:
        vehicle: what flies.
        world: the devices.
        urls: bus name to URL.
        log: where to record; must not exist.
        progress: told the fraction flown.

    Raises:
        ConfigError: the vehicle cannot be used.
        FileExistsError: the log exists.
    """
    flying = vehicle.with_urls(dict(urls))
    clock = simulated.VirtualClock(world.start_ns)
    with ExitStack() as stack:
        directory = stack.enter_context(scratch())
        estimator = Estimator(flying)
        devices = rings.create(directory, flying, rings.device_channels(flying))
        answers = create_rings(directory, estimator)
        opened = open_devices(flying, clock)
        stack.callback(opened.close)
        acquisition = Acquisition(opened.devices, Publisher(devices))
        acquisition.report(opened.problems)
        inputs = rings.readers(directory, estimator.inputs)
        estimation = EstimationWorker(estimator, inputs, Publisher(answers, "_estimation"))
        recorder = open_simulated_recorder(vehicle, directory, log)
        span_ns = world.end_ns - world.start_ns
        simulated.fly(
            clock,
            world.end_ns,
            world.advance,
            acquisition,
            estimation,
            recorder,
            lambda now_ns: progress((now_ns - world.start_ns) / span_ns),
        )
    return Flown(log, world.produced(), world.truth())


def fly_realtime(vehicle: config.Vehicle, serve: list[str], log: Path, progress: Progress = lambda _: None) -> Flown:
    """Fly devices that another process serves, with the flight app's own processes, on the real clock.

    Args:
        vehicle: what flies.
        serve: arguments to the interpreter that start the devices: they print one JSON line with the bus URLs when
            ready, and one with counts and truth at the end.
        log: where to record; must not exist.
        progress: told the fraction flown.

    Raises:
        FlightError: the devices or a worker did not start.
        ConfigError: the vehicle cannot be used.
    """
    with (
        scratch() as directory,
        subprocess.Popen(
            [sys.executable, *serve, "--directory", str(directory)], stdout=subprocess.PIPE, text=True
        ) as devices,
    ):
        assert devices.stdout is not None
        try:
            ready = devices.stdout.readline()
            if not ready:
                raise FlightError("the simulated devices did not start; their message stands above")
            start = json.loads(ready)
            urls = {name: str(url) for name, url in start.items() if name in vehicle.file.bus}
            duration_s = float(start.get("duration_s", 60.0))
            flight = runner.fly(vehicle.with_urls(urls), log, progress=lambda s: progress(min(1.0, s / duration_s)))
            end = devices.stdout.readline()
            if not end:
                raise FlightError(f"the simulated devices died in flight: no counts and no truth; the log is {log}")
        finally:
            devices.terminate()
    if flight.died:
        raise FlightError(f"died in flight: {', '.join(flight.died)}; the log holds what they said")
    counted = json.loads(end)
    return Flown(log, counted["produced"], counted["truth"])
