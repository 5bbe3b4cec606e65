"""Checkpoint of a flight on disk, beside its log: after a loss of power the next start goes on in the same phase.

It says which flight was under way, in which mode and phase, and whether the payload had been taken or released: what
the devices do not say again. It holds no rows and no estimate. While a flight is armed or running it is replaced at
every change and every ten seconds, as a whole (written beside it, synced, renamed, directory synced) and by a thread of
its own, so that a slow disk holds up nothing; a flight that ends removes it.

A file is data: a JSON object with a CRC. One that belongs to another user, that others may read, that is larger than
64 KiB, or whose content is not as expected is refused. The continuation flies with the table
``[estimation.phases.resumed]`` in its vehicle file, which its log carries, so it replays by itself.
"""

import hashlib
import json
import logging
import os
import queue
import threading
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from onboard import config
from onboard.flight.estimate.phases import KnownPhases
from onboard.flight.store.directories import write_private
from onboard.flight.supervise.modes import Mode
from onboard.recording.sink import open_file, sync_directory

_LOGGER = logging.getLogger("heft")
SUFFIX = ".resume"
MOST_BYTES = 1 << 16
CLOSE_S = 2.0  # that a disk may take for the last one
_FileName = Annotated[str, Field(min_length=1, max_length=255, pattern=r"^[^/\x00-\x1f\x7f]+$")]


class ResumeError(ValueError):
    """A checkpoint that cannot be used."""


class FlightState(BaseModel):
    """Content of a checkpoint."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    format: Literal[1] = 1
    first: _FileName  # stem of the first log of the flight
    log: _FileName  # of the part that was under way
    vehicle: Annotated[str, Field(min_length=1, max_length=255)]
    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]  # of vehicle file and URDF
    mode: Literal["armed", "run"]
    phase: int | None
    begun: bool
    taken: bool
    gone: bool
    wall_clock_ns: Annotated[int, Field(ge=0, lt=1 << 63)]

    def to_bytes(self) -> bytes:
        """As a file has it."""
        content = self.model_dump()
        return json.dumps({**content, "crc": _crc(content)}, indent=1).encode() + b"\n"

    @classmethod
    def from_bytes(cls, data: bytes) -> "FlightState":
        """Of a file's content.

        Raises:
            ResumeError: it is damaged, or of another version.
        """
        try:
            content = json.loads(data)
            crc = content.pop("crc")
            state = cls.model_validate(content)
        except (ValidationError, ValueError, KeyError, AttributeError, TypeError, RecursionError) as error:
            raise ResumeError(f"no checkpoint of a flight ({type(error).__name__})") from error
        if crc != _crc(state.model_dump()):
            raise ResumeError("its CRC is wrong")
        return state

    @property
    def phases(self) -> KnownPhases | None:
        """The mission's phases as far as they had come."""
        return None if self.phase is None else KnownPhases(self.phase, self.begun, self.taken, self.gone)


def _crc(content: dict[str, object]) -> int:
    return zlib.crc32(json.dumps(content, sort_keys=True).encode())


def digest(vehicle: config.Vehicle) -> str:
    """SHA-256 of a vehicle's file and URDF."""
    return hashlib.sha256(vehicle.text.encode() + b"\0" + vehicle.urdf_text.encode()).hexdigest()


def path_of(log: Path) -> Path:
    """The checkpoint of the flight that is recorded to ``log``."""
    return log.with_name(log.name + SUFFIX)


class FlightStart(NamedTuple):
    """What a start is to fly."""

    vehicle: config.Vehicle
    log: Path
    first: str  # stem of the first log of the flight
    digest: str
    before: FlightState | None = None  # goes on with it
    superseded: tuple[Path, ...] = ()  # checkpoints of flights that are not gone on with any more
    why_not: str = ""  # why a checkpoint that is there is not used


def planned(
    vehicle: config.Vehicle, new_log: Path, now_ns: int, under_way: set[Path], *, fresh: bool = False
) -> FlightStart:
    """The flight to go on with, or a new one.

    Args:
        vehicle: as its file has it.
        new_log: of a new flight.
        now_ns: wall clock.
        under_way: logs of the flights that fly now.
        fresh: a new one in any case.
    """
    own = digest(vehicle)
    name, why_not = vehicle.file.vehicle.name, ""
    new = FlightStart(vehicle, new_log, new_log.stem, own)
    found: FlightState | None = None
    superseded: list[Path] = []
    for path in sorted(new_log.parent.glob(f"*{SUFFIX}")) if new_log.parent.is_dir() else ():
        try:
            state = load(path)
        except (ResumeError, OSError) as error:
            why_not = f"{path}: {error}"
            continue
        if state.vehicle != name or new_log.with_name(state.log).absolute() in under_way:
            continue
        superseded.append(path)
        if found is None or state.wall_clock_ns > found.wall_clock_ns:
            found = state
    new = new._replace(superseded=tuple(superseded))
    if found is None or fresh:
        return new._replace(why_not=why_not)
    age_s = 1e-9 * max(0, now_ns - found.wall_clock_ns)
    if found.digest != own:
        why_not = f"{found.log} was flown with another vehicle file or URDF"
    elif age_s > vehicle.file.recording.resume_s:
        why_not = f"{found.log} ended {age_s:.0f} s ago, longer than recording.resume_s"
    else:
        part = 2
        while (
            os.path.lexists(log := new_log.with_name(f"{found.first}-part{part}{new_log.suffix}")) or log in under_way
        ):
            part += 1
        try:
            return new._replace(vehicle=_resumed(vehicle, found), log=log, first=found.first, before=found)
        except config.ConfigError as error:  # the table of phases cannot be added to
            why_not = str(error)
    return new._replace(why_not=why_not)


def _resumed(vehicle: config.Vehicle, state: FlightState) -> config.Vehicle:
    known, settings = state.phases, vehicle.file.estimation.phases
    if known is None or settings is None:
        return vehicle
    resumed = {"log": state.log, **known._asdict()}
    table = tomli_w.dumps({"estimation": {"phases": {"resumed": resumed}}})
    return config.parse(f"{vehicle.text.rstrip()}\n\n{table}", vehicle.path, vehicle.urdf_path)


def load(path: Path) -> FlightState:
    """A checkpoint.

    Raises:
        ResumeError: it is not one, or not this user's alone.
        OSError: it cannot be read.
    """
    with open(open_file(path, os.O_RDONLY), "rb") as file:
        about = os.fstat(file.fileno())
        if about.st_uid != os.getuid() or about.st_mode & 0o077:
            raise ResumeError("it is not a file of this user's alone (mode 0600)")
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ResumeError(f"it is longer than {MOST_BYTES} bytes")
    return FlightState.from_bytes(data)


class Keeper:
    """Writes the checkpoints of one flight, in a thread of its own.

    Args:
        plan: of the flight.
        wall_clock_ns: reads the wall clock.
    """

    def __init__(self, plan: FlightStart, wall_clock_ns: Callable[[], int]) -> None:
        self._plan, self._clock = plan, wall_clock_ns
        self._path, self._failed = path_of(plan.log), False
        self._waiting: queue.SimpleQueue[FlightState | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="checkpoint", daemon=True)
        self._thread.start()

    def keep(self, mode: Mode, known: KnownPhases | None) -> None:
        """Have the state written; returns at once."""
        plan = self._plan
        phases = known._asdict() if known else {"phase": None, "begun": False, "taken": False, "gone": False}
        own = {"first": plan.first, "log": plan.log.name, "vehicle": plan.vehicle.file.vehicle.name}
        content = {**own, "digest": plan.digest, "mode": mode.value, **phases, "wall_clock_ns": self._clock()}
        self._waiting.put(FlightState.model_validate(content))

    def close(self, *, ended: bool) -> None:
        """Finish writing; a flight that ``ended`` is not gone on with, so its checkpoint is removed."""
        self._waiting.put(None)
        self._thread.join(CLOSE_S)
        if ended:
            for path in (self._path, *self._plan.superseded):
                path.unlink(missing_ok=True)

    def _write(self) -> None:
        ended = False
        while not ended:
            got = [self._waiting.get()]
            while not self._waiting.empty():
                got.append(self._waiting.get())
            ended, states = None in got, [state for state in got if state is not None]
            try:
                if states:
                    write_durably(self._path, states[-1].to_bytes())
                    for path in self._plan.superseded:
                        path.unlink(missing_ok=True)
            except OSError as error:
                if not self._failed:
                    text = "no checkpoint of the flight (%s): after a loss of power a new flight begins"
                    _LOGGER.warning(text, error, extra={"source": "flight", "code": "no_resume"})
                self._failed = True


def write_durably(path: Path, data: bytes) -> None:
    """Put ``data`` in place of a file, as a whole, and on the medium.

    Raises:
        OSError: it cannot be written.
    """
    unfinished = path.with_name(path.name + ".new")
    write_private(unfinished, data, durable=True)
    unfinished.rename(path)
    sync_directory(path.parent)
