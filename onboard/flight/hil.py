"""HIL harness: the flight app against simulated devices.

It uses the simulator through a protocol and bus URLs, and imports none of it.
"""

import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.records import Severity
from onboard import config
from onboard.channels import Act
from onboard.flight import simulated
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.acquire.arming import REQUESTS, Arming
from onboard.flight.acquire.devices import open_devices
from onboard.flight.acquire.expected import expected
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.estimate import hand_over
from onboard.flight.estimate.estimation import EstimationWorker, create_rings
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.store import manifest, rings
from onboard.flight.store.directories import scratch
from onboard.flight.store.flight_log import open_simulated_log, simulated_recorder
from onboard.flight.supervise import runner
from onboard.flight.supervise.runner_processes import FlightError
from onboard.recording.format.texts import printable
from onboard.recording.recorder import NOT_KEPT
from onboard.ring import RingReader

Progress = Callable[[float], None]
OVER_NS = 2_000_000_000  # after a goal is met, or given up
ANSWER_S = 15.0  # devices that do not end then are killed
_DIED = "the simulated devices died in flight, or hang: no counts and no truth; the log is {}"


class World(Protocol):
    """Simulated devices on a virtual clock."""

    @property
    def start_ns(self) -> int:
        """When they were powered up."""

    @property
    def end_ns(self) -> int:
        """When the mission is over."""

    @property
    def undisturbed(self) -> bool:
        """Whether no device and no bus has a fault in it."""

    def ask(self, segment: str) -> bool:
        """The flight computer asks for a motion; False where the arm cannot play it now."""

    def advance(self, now_ns: int) -> None:
        """Everything that happens up to ``now_ns``."""

    def produced(self) -> dict[str, int]:
        """Samples made so far, by channel."""

    def truth(self) -> dict[str, Any]:
        """What an estimate is to be compared with."""


class Flown(NamedTuple):
    """A flight in the harness."""

    log: Path
    produced: dict[str, int]  # by the devices
    truth: dict[str, Any]
    answers: Mapping[bytes, np.void] = {}  # the last of each name, whether the log has them or not
    troubles: tuple[str, ...] = ()  # of the recorder
    lost: tuple[str, ...] = ()  # of these, what says that rows are not in the log


def fly_simulated(
    vehicle: config.Vehicle, world: World, urls: Mapping[str, str], log: Path, progress: Progress = lambda _: None
) -> Flown:
    """Fly a world in this process, in virtual time, as fast as it goes.

    Args:
        vehicle: what flies; its drives play their motion where it is armed.
        world: the devices.
        urls: bus name to URL.
        log: where to record; must not exist.
        progress: called with the fraction flown.

    Raises:
        ConfigError: the vehicle cannot be used.
        FileExistsError: the log exists.
    """
    flying = vehicle.with_urls(dict(urls))
    clock = simulated.VirtualClock(world.start_ns)
    with ExitStack() as stack:
        stack.enter_context(simulated.seldom_collected())
        directory = stack.enter_context(scratch())
        estimator = Estimator(flying)
        hand_over.check(flying, estimator.online.quantity_names)
        devices = rings.create(directory, flying, rings.device_channels(flying))
        answers = create_rings(directory, estimator)
        opened = open_devices(flying, clock)
        stack.callback(opened.close)
        arming = Arming(flying, directory) if flying.arm else None
        acquisition = Acquisition(opened.devices, Publisher(devices), arming, undisturbed=world.undisturbed)
        acquisition.report(opened.problems)
        for bus in flying.buses:
            acquisition.expect(expected(flying, bus), world.start_ns)
        inputs = rings.readers(directory, estimator.inputs)
        estimation = EstimationWorker(estimator, inputs, Publisher(answers, "_estimation"))
        requests = rings.readers(directory, ["request"])["request"] if "request" in estimator.outputs else None
        told: list[np.void] = []
        writer = open_simulated_log(vehicle, log)
        recorder = simulated_recorder(writer, directory, told.extend)

        def answered(now_ns: int) -> int | None:
            """Pass on what was asked for; a flight that knows enough, or has given up, ends soon after."""
            return now_ns + OVER_NS if requests is not None and _pass_on(requests, world.ask) else None

        span_ns = world.end_ns - world.start_ns
        simulated.fly(
            clock,
            world.end_ns,
            world.advance,
            acquisition,
            estimation,
            recorder,
            lambda now_ns: progress((now_ns - world.start_ns) / span_ns),
            answered,
        )
        quantities = RingReader(directory / "quantity.ring").read()[0]
    lost, troubles = (
        tuple(printable(row["text"]) for row in told if row["severity"] >= Severity.ERROR and of(row["code"].decode()))
        for of in (NOT_KEPT.__contains__, lambda _: True)
    )
    last = dict(zip(quantities["name"].tolist(), quantities, strict=True))
    return Flown(writer.path, world.produced(), world.truth(), last, troubles, lost)


def _pass_on(requests: RingReader, ask: Callable[[str], object]) -> bool:
    """Ask the arm for the segments that the flight asks for; whether that knows enough, or has given up."""
    over = False
    for row in requests.read()[0]:
        if row["act"] == Act.SEGMENT:
            ask(row["segment"].decode())
        over |= bool(row["act"] != Act.SEGMENT)
    return over


def _end(devices: subprocess.Popen[str]) -> None:
    """End the simulated devices, also stopped ones."""
    devices.terminate()
    try:
        devices.wait(ANSWER_S)
    except subprocess.TimeoutExpired:
        devices.kill()


def fly_realtime(vehicle: config.Vehicle, serve: list[str], log: Path, progress: Progress = lambda _: None) -> Flown:
    """Fly devices that another process serves, with the flight app's processes, on the real clock.

    Mission time begins when the flight app is ready, however long it took to start on a busy computer. The devices end
    with this process, whatever ends it.

    Args:
        vehicle: what flies.
        serve: arguments to the interpreter that start the devices: with ``--wait`` they print one JSON line with the
            bus URLs when ready, one with ``start_ns`` after a line on stdin, and one with counts and truth at the end,
            which is when they are commanded to: a flight that no phase has ended is stopped when the mission is over,
            and devices that end by themselves then lose what a busy computer has not read. Lines ``ask SEGMENT`` on
            stdin are the motions that the flight asks for.
        log: where to record; must not exist.
        progress: called with the fraction flown.

    Raises:
        FlightError: the devices or a worker did not start, or died.
        ConfigError: the vehicle cannot be used.
        FileExistsError: there is such a log already, or what would be a segment of it.
    """
    runner.require_new(log)
    with (
        scratch() as directory,
        subprocess.Popen(
            [sys.executable, *serve, "--wait", "--directory", str(directory)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as devices,
    ):
        try:
            start = _line_of(devices, "the simulated devices did not start; their message stands above")
            urls = {name: str(url) for name, url in start.items() if name in vehicle.file.bus}
            mission_s = float(start["duration_s"])

            def tell(line: str) -> None:
                assert devices.stdin is not None
                with suppress(BrokenPipeError):  # they died; they say no line either
                    os.write(devices.stdin.fileno(), f"{line}\n".encode())

            def begin() -> None:
                tell("start")
                _line_of(devices, "the simulated devices cannot fly; their message stands above")

            asked = _Asked(log, tell) if vehicle.segments_path is not None else None

            def watch(elapsed_s: float) -> None:
                if devices.poll():
                    raise FlightError(_DIED.format(log))
                progress(min(1.0, elapsed_s / mission_s))

            flight = runner.fly(
                vehicle.with_urls(urls),
                log,
                duration_s=mission_s,
                progress=watch,
                ready=begin,
                enough=lambda elapsed_s: asked is not None and asked.is_over(elapsed_s),
            )
            devices.terminate()  # they say their counts; samples after the flight's end are none
            end = _line_of(devices, _DIED.format(log), ANSWER_S)
        finally:
            _end(devices)
    troubles = flight.troubles
    if died := [name for name in flight.died if name != "recording"]:
        raise FlightError(f"died in flight: {', '.join(died)}; the log holds what they said")
    if flight.died:
        troubles += ("the log could not be ended; the next start adds what the rings hold",)
    return Flown(log, end["produced"], end["truth"], flight.answers, troubles, flight.lost)


class _Asked:
    """Passes on what a real flight asks for.

    Args:
        log: of the flight.
        tell: the devices a line.
    """

    def __init__(self, log: Path, tell: Callable[[str], None]) -> None:
        self._log, self._tell = log.absolute(), tell
        self._ring: RingReader | None = None
        self._over_s: float | None = None

    def is_over(self, elapsed_s: float) -> bool:
        """Whether the flight has known enough, or given up, for :data:`OVER_NS`."""
        if self._ring is None:
            [directory] = [flight.directory for flight in manifest.waiting() if flight.log == self._log]
            self._ring = RingReader(directory / REQUESTS)
        if _pass_on(self._ring, lambda name: self._tell(f"ask {name}")) and self._over_s is None:
            self._over_s = elapsed_s + 1e-9 * OVER_NS
        return self._over_s is not None and elapsed_s > self._over_s


def _line_of(devices: "subprocess.Popen[str]", otherwise: str, timeout_s: float | None = None) -> dict[str, Any]:
    """The next line of the devices; a FlightError that says ``otherwise`` if there is none, or none in time."""
    assert devices.stdout is not None
    line = devices.stdout.readline() if select.select([devices.stdout], [], [], timeout_s)[0] else ""
    if not line:
        raise FlightError(otherwise)
    said: dict[str, Any] = json.loads(line)
    return said
