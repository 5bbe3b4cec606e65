"""A flight's log: what is attached to it, and who records into it."""

import importlib.metadata
import platform
import subprocess
from pathlib import Path
from typing import NamedTuple

from onboard import config
from onboard.recording.recorder import Recorder
from onboard.recording.writer import LogWriter
from onboard.ring import RingReader

VEHICLE_ATTACHMENT = "vehicle.toml"
DEPENDENCIES = ("heft", "numpy", "scipy", "pin", "mcap", "smbus2", "python-can", "pyserial", "gpiod")


class Started(NamedTuple):
    """One instant on both clocks."""

    wall_clock_ns: int
    monotonic_ns: int


def open_recorder(
    vehicle: config.Vehicle, directory: Path, log: Path, *, durable: bool, started: Started | None = None
) -> Recorder:
    """Create ``log`` and a recorder of every ring in ``directory``.

    Args:
        vehicle: its files are attached.
        directory: the flight's rings.
        log: the file to create, its directory too.
        durable: fsync as it goes.
        started: when, on the wall clock (noted once, here) and on the monotonic one; virtual time has neither.

    Raises:
        FileExistsError: there is such a log already.
        OSError: the file cannot be created.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    writer = LogWriter.create(log, durable=durable)
    writer.attach(VEHICLE_ATTACHMENT, "application/toml", vehicle.text.encode())
    writer.attach(vehicle.file.vehicle.urdf, "application/xml", vehicle.urdf_path.read_bytes())
    writer.add_metadata("flight", flight_facts(vehicle, started))
    writer.add_metadata("versions", versions())
    return Recorder(writer, [RingReader(path) for path in sorted(directory.glob("*.ring"))])


def flight_facts(vehicle: config.Vehicle, started: Started | None) -> dict[str, str]:
    """Who flies on what, and since when."""
    facts = {
        "vehicle": vehicle.file.vehicle.name,
        "vehicle_file": vehicle.path.name,
        "host_machine": platform.machine(),
        "host_system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }
    if started is not None:
        facts["wall_clock_ns"], facts["monotonic_ns"] = str(started.wall_clock_ns), str(started.monotonic_ns)
    return facts


def versions() -> dict[str, str]:
    """Versions of what takes part in a flight, and the revision of the checkout if it runs from one."""
    found = {}
    for name in DEPENDENCIES:
        try:
            found[name] = importlib.metadata.version(name)
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
