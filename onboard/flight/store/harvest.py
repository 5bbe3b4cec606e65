"""Before a flight: rows left in the rings by earlier flights whose processes died are written to their logs."""

from pathlib import Path
from typing import NamedTuple

from drivers.records import Severity
from onboard.flight.store import manifest
from onboard.flight.store.flight_log import open_recorder
from onboard.recording.format.errors import RecordingError
from onboard.recording.recorder import Recorder
from onboard.ring import RingError


class Harvest(NamedTuple):
    """What came of one abandoned flight."""

    log: Path  # the directory of its rings, where they do not say
    rows: int
    problem: str = ""  # why its rings are still there


def harvest(now_ns: int) -> list[Harvest]:
    """Bring in what abandoned flights of this user left; one that cannot be is left for the next time.

    No earlier flight is removed to make room for it.

    Raises:
        NotPrivateError: others could have put it there.
    """
    with manifest.abandoned() as directories:
        return [_one(directory, now_ns) for directory in directories]


def _one(directory: Path, now_ns: int) -> Harvest:
    log = directory
    try:
        flight = manifest.Manifest.load(directory)
        log = flight.log
        try:
            recorder = open_recorder(flight)
        except FileExistsError:  # another flight's: two that died before their first row was recorded had one name
            log = log.with_name(f"{log.stem}-{flight.preamble.flight[:8]}{log.suffix}")
            recorder = open_recorder(flight._replace(log=log))
        rows = _bring_in(recorder, log, now_ns)
    except (OSError, manifest.ManifestError, RecordingError, RingError) as error:
        return Harvest(log, 0, f"{error}; {directory} keeps what is not in the log")
    flight.remove()
    return Harvest(log, rows)


def _bring_in(recorder: Recorder, log: Path, now_ns: int) -> int:
    rows = recorder.step(now_ns).rows
    text = f"all processes of the flight had died; the next start added {rows} rows from its rings"
    recorder.say(now_ns, Severity.WARNING, "harvested", text)
    end = recorder.close(now_ns)
    if end.failing:
        recorder.abandon()
        raise OSError(f"the disk refuses the end of {log}")
    return rows + end.rows
