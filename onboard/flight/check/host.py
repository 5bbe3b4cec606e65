"""The flight computer before a flight: room and speed of the disk against what the mission records, and its clock."""

import ctypes
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from onboard import config
from onboard.flight.estimate.estimation import answer_rates_hz, estimation_channels
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.store.rings import device_channels

MESSAGE_BYTES = 51  # of MCAP around each row: record head 9, message head 22, CDR head 4, its place in the index 16
OVERHEAD = 1.05  # definitions at the head of each chunk, indexes of chunks, heads of segments
TRIES, TRY_BYTES = 16, 1 << 18
FASTER = 3.0  # than what is recorded must the disk be: others write too
SLOW_SYNC_S = 2.0  # rings keep 9 s while the disk does not answer
FIRST_SENSIBLE_S = 1_700_000_000  # 2023: a computer without a clock begins before that

Clock = Callable[[], int]
_CLOCK_UNSYNCHRONISED = 0x40  # STA_UNSYNC of linux/timex.h


class Host(NamedTuple):
    """What the computer offers.

    Attributes:
        free_bytes: room where flights are recorded.
        bytes_per_s: what this vehicle records: devices, and at most what the estimator says.
        write_bytes_s: how fast the disk takes it, brought to the medium; 0: it takes nothing.
        problems: what stands against flying, with the remedy.
        warnings: what it can be flown with.
    """

    free_bytes: int
    bytes_per_s: float
    write_bytes_s: float
    problems: tuple[str, ...]
    warnings: tuple[str, ...]


def recorded_bytes_s(vehicle: config.Vehicle, estimator: Estimator | None) -> float:
    """Bytes that a flight records a second: rows of each channel at its nominal or highest rate, and their frames."""
    sizes, rates = device_channels(vehicle), {}
    if estimator is not None:
        sizes, rates = {**sizes, **estimation_channels(estimator)}, answer_rates_hz(estimator)
    for name, device in vehicle.file.device.items():
        rates |= dict.fromkeys(device.channels(name), vehicle.rate_hz(name))
    return OVERHEAD * sum((sizes[name].itemsize + MESSAGE_BYTES) * rate for name, rate in rates.items())


def look_over(
    vehicle: config.Vehicle,
    estimator: Estimator | None,
    flight_s: float,
    clock: Clock,
    wall_s: float | None,
    unsynchronised: bool | None,
) -> Host:
    """Check the computer for a flight of ``flight_s``.

    Args:
        vehicle: its file names the directory of flights.
        estimator: whose answers are recorded too.
        flight_s: how long it is to last.
        clock: CLOCK_MONOTONIC, ns.
        wall_s: what the system clock says, Unix time; None: it is not looked at.
        unsynchronised: whether the system clock is; None: that is not known.
    """
    bytes_per_s = recorded_bytes_s(vehicle, estimator)
    directory = Path(vehicle.file.recording.directory).absolute()
    there = next(path for path in (directory, *directory.parents) if path.exists())
    free_bytes = shutil.disk_usage(there).free
    problems, warnings = [], _of_clock(wall_s, unsynchronised)
    need = flight_s * bytes_per_s + vehicle.file.recording.reserve_mib * 2**20
    if free_bytes < need:
        minutes = free_bytes / bytes_per_s / 60.0
        problems.append(
            f"{there} has room for {minutes:.0f} minutes of this vehicle, {need / 1e9:.2f} GB are needed for "
            f"{flight_s / 60.0:.0f}: clear it, or name another recording directory"
        )
    speed = slowest_s = 0.0
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        problems.append(f"{there} cannot be written: give this user the right to, or name another recording directory")
    elif free_bytes > 4 * TRIES * TRY_BYTES:
        try:
            speed, slowest_s = write_speed(there, clock)
        except OSError as error:
            problems.append(f"{there} takes no data ({error.strerror}): name another recording directory")
        else:
            problems += _of_speed(there, speed, bytes_per_s)
    if slowest_s > SLOW_SYNC_S:
        warnings.append(f"{there} took {slowest_s:.1f} s to bring data to the medium once: use a faster medium")
    return Host(free_bytes, bytes_per_s, speed, tuple(problems), tuple(warnings))


def _of_speed(there: Path, speed: float, bytes_per_s: float) -> list[str]:
    if speed >= FASTER * bytes_per_s:
        return []
    what = f"{there} takes {speed / 1e6:.2f} MB/s where {bytes_per_s / 1e6:.2f} MB/s are recorded"
    return [f"{what}: use a medium that takes {FASTER:.0f} times that"]


def write_speed(directory: Path, clock: Clock) -> tuple[float, float]:
    """Bytes a second that reach the medium, and the longest wait for it [s], by a file that has no name.

    Raises:
        OSError: it cannot be written.
    """
    block = os.urandom(TRY_BYTES)
    slowest_s = 0.0
    with tempfile.TemporaryFile(dir=directory, buffering=0) as file:
        began = clock()
        for _ in range(TRIES):
            before = clock()
            file.write(block)
            os.fsync(file.fileno())
            slowest_s = max(slowest_s, 1e-9 * (clock() - before))
        return TRIES * TRY_BYTES / max(1e-9 * (clock() - began), 1e-9), slowest_s


def unsynchronised() -> bool | None:
    """Whether nothing disciplines the system clock, by adjtimex(2); None where the kernel does not say."""
    status_at = 5 * ctypes.sizeof(ctypes.c_long)  # struct timex: modes (filled up), offset, freq, maxerror, esterror
    timex = ctypes.create_string_buffer(512)
    try:
        if ctypes.CDLL(None, use_errno=True).adjtimex(timex) < 0:
            return None
    except (AttributeError, OSError):
        return None
    return bool(int.from_bytes(timex.raw[status_at : status_at + 4], "little") & _CLOCK_UNSYNCHRONISED)


def _of_clock(now_s: float | None, is_unsynchronised: bool | None) -> list[str]:
    remedy = "sample times do not depend on it; for the UTC in the log use chrony or a real-time clock"
    if now_s is not None and now_s < FIRST_SENSIBLE_S:
        return [f"the system clock says {time.strftime('%Y-%m-%d', time.gmtime(now_s))}, it was not set: {remedy}"]
    if is_unsynchronised:
        return [f"the system clock is not synchronised, nothing disciplines it: {remedy}"]
    return []
