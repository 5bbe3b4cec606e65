"""A flight's log: what every segment of it says, and who records into it."""

import importlib.metadata
import platform
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from threadpoolctl import threadpool_info

from drivers.records import Rows
from onboard import config
from onboard.flight.clocks import known_delays
from onboard.flight.store.directories import write_private
from onboard.flight.store.manifest import Manifest, Storage
from onboard.native import library
from onboard.recording.format.mcap_format import Attachment
from onboard.recording.left import Progress
from onboard.recording.recorder import Recorder
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from onboard.recording.sink import FileSink
from onboard.recording.space import SpaceGuard
from onboard.ring import RingReader

VEHICLE_ATTACHMENT = "vehicle.toml"
DISTRIBUTIONS = ("heft-flight", "numpy", "scipy", "pin", "mcap", "smbus2", "python-can", "pyserial", "gpiod")
PROGRESS = "recorder.progress"  # in the flight's directory
STEP_NS = 50_000_000  # between two steps of the recorder, at most
MIB = 1 << 20


class Started(NamedTuple):
    """One instant on both clocks."""

    wall_clock_ns: int
    monotonic_ns: int


def preamble(vehicle: config.Vehicle, flight: str, started: Started | None = None, continues: str = "") -> Preamble:
    """What every segment of a flight's log says.

    Args:
        vehicle: its files are attached.
        flight: the flight's id.
        started: when, on the wall clock (noted once, here) and on the monotonic one; virtual time has neither.
        continues: the log of the part before, of a flight that lost its power.
    """
    attachments: tuple[Attachment, ...] = (
        Attachment(VEHICLE_ATTACHMENT, "application/toml", vehicle.text.encode(), 0),
        Attachment(vehicle.file.vehicle.urdf, "application/xml", vehicle.urdf_path.read_bytes(), 0),
    )
    segments = vehicle.segments_path
    if segments is not None:
        attachments += (Attachment(segments.name, "application/octet-stream", segments.read_bytes(), 0),)
    metadata = {
        "flight": flight_facts(vehicle, started) | ({"continues": continues} if continues else {}),
        "versions": versions(),
        "clock_map": clock_map(vehicle, started),
    }
    return Preamble(flight, attachments, metadata)


def storage(recording: config.RecordingSection) -> Storage:
    """How a flight is recorded, from its vehicle file."""
    return Storage(
        sync_period_ns=round(recording.sync_period_ms * 1e6),
        segment_span_ns=round(recording.segment_s * 1e9),
        segment_bytes=round(recording.segment_mib * MIB),
        reserve_bytes=round(recording.reserve_mib * MIB),
    )


def step_ns(storage: Storage) -> int:
    """Between two steps of the recorder: what it takes in, it syncs no later than ``sync_period_ns`` after."""
    return min(STEP_NS, storage.sync_period_ns // 2)


def open_recorder(
    manifest: Manifest, min_free_bytes: int = 0, said: Callable[[Rows], object] = lambda rows: None
) -> Recorder:
    """A recorder of every ring of a flight, that goes on where the one before it died, if there was one.

    Args:
        manifest: of the flight.
        min_free_bytes: segments of earlier flights make way while less is free; 0 removes nothing.
        said: called with each event of the recorder's own.

    Raises:
        OSError: the log cannot be read, or no segment created.
    """
    kept, progress = manifest.storage, manifest.directory / PROGRESS

    def keep(now: Progress) -> None:
        try:
            write_private(progress.with_suffix(".new"), now.to_bytes())
            progress.with_suffix(".new").rename(progress)
        except OSError:  # shared memory is full: the next recorder reads the log
            progress.unlink(missing_ok=True)

    writer = SegmentedLog.resume(
        manifest.log,
        manifest.preamble,
        limits=SegmentLimits(kept.segment_span_ns, kept.segment_bytes),
        sync_interval_ns=kept.sync_period_ns - step_ns(kept),
        progress=Progress.from_bytes(progress.read_bytes()) if progress.exists() else None,
        told=keep,
    )
    space = SpaceGuard(
        manifest.log.parent, manifest.log, manifest.preamble.flight, min_free=min_free_bytes, reserve=kept.reserve_bytes
    )
    readers = ring_readers(manifest.directory)
    return Recorder(writer, readers, recorded=writer.recorded, space=space, said=said, losses=writer.take_losses)


def open_simulated_recorder(vehicle: config.Vehicle, directory: Path, log: Path) -> Recorder:
    """A recorder of every ring in ``directory`` into one file, for a flight on a virtual clock that no power cut meets.

    Raises:
        FileExistsError: there is such a log already.
        OSError: the file cannot be created.
    """
    return simulated_recorder(open_simulated_log(vehicle, log), directory)


def simulated_recorder(
    log: SegmentedLog, directory: Path, said: Callable[[Rows], object] = lambda rows: None
) -> Recorder:
    """A recorder of every ring in ``directory`` into ``log``; ``said`` is called with each event of the recorder."""
    return Recorder(log, ring_readers(directory), said=said, losses=log.take_losses)


def open_simulated_log(vehicle: config.Vehicle, log: Path) -> SegmentedLog:
    """A log in one file that says what a flight's says, of something on a virtual clock.

    Where somebody removes, renames or cuts off the file, it goes on in another, as a real flight does.

    Raises:
        FileExistsError: there is such a log already.
        OSError: the file cannot be created.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    never, opened = SegmentLimits(1 << 62, 1 << 62), partial(FileSink, durable=False)
    return SegmentedLog(log, preamble(vehicle, ""), limits=never, open_sink=opened)


def ring_readers(directory: Path) -> list[RingReader]:
    """Reading ends of all rings in ``directory``."""
    return [RingReader(path) for path in sorted(directory.glob("*.ring"))]


def flight_facts(vehicle: config.Vehicle, started: Started | None) -> dict[str, str]:
    """Who flies on what, and since when."""
    facts = {
        "vehicle": vehicle.file.vehicle.name,
        "vehicle_file": vehicle.path.name,
        "host_machine": platform.machine(),
        "host_system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "blas_kernels": blas_kernels(),
        **dict(zip(("compiled_core", "compiled_by"), library.identity(), strict=True)),
    }
    if started is not None:
        facts["wall_clock_ns"], facts["monotonic_ns"] = str(started.wall_clock_ns), str(started.monotonic_ns)
    return facts


def blas_kernels() -> str:
    """For which processors the kernels are that OpenBLAS runs here, as "Haswell": they add up in different orders."""
    blas = (library for library in threadpool_info() if library["user_api"] == "blas")
    return ", ".join(sorted({str(library.get("architecture", "unknown")) for library in blas}))


def computed_on() -> dict[str, str]:
    """What the last bits of estimates depend on, as the log's metadata ``flight`` and ``versions`` say it."""
    core = {"blas_kernels": blas_kernels(), "compiled_core": library.identity()[0]}
    return {"host_machine": platform.machine()} | core | versions()


def clock_map(vehicle: config.Vehicle, started: Started | None) -> dict[str, str]:
    """Which clock each channel's rows are stamped by, and the known delays; channel ``clock`` holds the solutions."""
    facts = {"host_ns": "CLOCK_MONOTONIC"}
    if started is not None:
        facts["wall_clock"] = f"CLOCK_REALTIME {started.wall_clock_ns} at CLOCK_MONOTONIC {started.monotonic_ns}"
    for name, device in vehicle.file.device.items():
        for channel in device.channels(name):
            facts[channel] = f"nominally {vehicle.rate_hz(name):g} Hz"
    for channel, part, delay_s, sigma_s, cause, _ in known_delays(vehicle):
        of = f" of {part}" if part else ""
        facts[channel] = (
            f"{facts.get(channel, '')}; delay{of} {delay_s * 1e3:g} ms, sigma {sigma_s * 1e3:g} ms: {cause}"
        )
    return facts


def versions() -> dict[str, str]:
    """Versions of what takes part in a flight, and the revision of the checkout if it runs from one."""
    found = {}
    for distribution in DISTRIBUTIONS:
        name = "heft" if distribution == "heft-flight" else distribution  # the name that earlier logs have
        try:
            found[name] = importlib.metadata.version(distribution)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    found["revision"] = _revision()
    return found


def _revision() -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True,
            text=True,
            check=False,
            timeout=5,
        )
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return done.stdout.strip() or "unknown"
