"""Spoilt copies of the real throws (tudelft_tumbling), identified as the originals are, and how far off they come out.

The wheel's inertia and rate are the scale of all inertias in free fall: a constant scale of the rate changes nothing
else, so no instrument sees it.
"""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.records import Rows
from onboard import config
from onboard.dynamics.model.inertia import principal_moments
from onboard.estimation.policy import wider
from onboard.ground.identify.identify import identify
from onboard.ground.identify.kinds.identified import Identified
from onboard.ground.identify.kinds.throws import carrier_of
from onboard.identification.standing import Level
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

SPIN_UP_RAD_S = 100.0  # of the wheel: what the packaged vehicle identifies from
_STREAMS = {"gyro": ("imu_base", "gyro_raw"), "accel": ("imu_base", "accel_raw"), "wheel": ("wheel_rate", "value_raw")}
Streams = dict[str, Rows]
Spoil = Callable[[Streams], None]


def _column(streams: Streams, name: str) -> Rows:
    channel, field = _STREAMS[name]
    return streams[channel][field]


def scaled(name: str, factor: float, streams: Streams, axis: int | None = None) -> None:
    """Multiplies a stream, or one axis of it."""
    values = _column(streams, name)
    part = values if axis is None else values[:, axis]
    limit = np.iinfo(values.dtype)
    part[...] = np.clip(np.rint(factor * part.astype(np.float64)), limit.min, limit.max)


def permuted(name: str, order: list[int], streams: Streams) -> None:
    """Swaps axes of a stream."""
    values = _column(streams, name)
    values[...] = values[:, order]


def late(name: str, delay_s: float, streams: Streams) -> None:
    """Delays a stream's values by so much, at unchanged stamps."""
    channel, _ = _STREAMS[name]
    stamps, values = streams[channel]["host_ns"], _column(streams, name)
    index = np.searchsorted(stamps, stamps - round(1e9 * delay_s))
    values[...] = values[index]


def cut(begin_s: float, end_s: float, streams: Streams) -> None:
    """Keeps the rows between two times after the wheel's spin-up."""
    at_ns = _spun_up_ns(streams)
    for name, rows in streams.items():
        after_s = (rows["host_ns"] - at_ns) * 1e-9
        streams[name] = rows[(after_s >= begin_s) & (after_s < end_s)]


def _spun_up_ns(streams: Streams) -> int:
    wheel = streams["wheel_rate"]
    rate = np.abs(wheel["value_raw"] * wheel["scale"].astype(np.float64)) * 2.0 * np.pi / 60.0
    return int(wheel["host_ns"][int(np.argmax(rate > SPIN_UP_RAD_S))])


WAYS: dict[str, Spoil] = {
    "as recorded": lambda streams: None,
    "gyro x 1.03": partial(scaled, "gyro", 1.03),
    "gyro x 1.1": partial(scaled, "gyro", 1.1),
    "gyro x 0.9": partial(scaled, "gyro", 0.9),
    "gyro x sign": partial(scaled, "gyro", -1.0, axis=0),
    "accel yz swapped": partial(permuted, "accel", [0, 2, 1]),
    "accel sign": partial(scaled, "accel", -1.0),  # no instrument sees it: the wheel is the scale
    "wheel 10 ms late": partial(late, "wheel", 0.01),
    "wheel 20 ms late": partial(late, "wheel", 0.02),
    "cut to 0 .. 0.15 s": partial(cut, 0.0, 0.15),
}


class Said(NamedTuple):
    """What one copy came to."""

    log: str
    level: Level
    off: float  # farthest true moment, half-widths of the 99.9 % interval; NaN without an answer
    text: str


def spoilt(log: Path, spoil: Spoil, directory: Path) -> Path:
    """A copy of a log, spoilt."""
    reader = LogReader(log)
    streams = {name: reader.read(name).copy() for name in reader.channels}
    spoil(streams)
    path = directory / log.name
    with LogWriter.create(path, durable=False, overwrite=True) as writer:
        for name, dtype in reader.channels.items():
            writer.register(name, dtype)
            writer.write(name, streams[name])
    return path


def said(vehicle: config.Vehicle, found: Identified) -> Said:
    """The verdict on a log, and how far off its answer is."""
    throw, off = found.throw, np.nan
    if throw is not None and throw.principal is not None:
        truth = throw.load.truth_kg_m2
        carrier = carrier_of(vehicle)
        assert carrier is not None
        moments = principal_moments(carrier.body) if truth is None else np.sort(truth)
        half = wider() * (throw.principal.high - throw.principal.moments)
        off = float((np.abs(throw.principal.moments - moments) / half).max())
    return Said(found.log.stem, found.verdict.level, off, found.verdict.text)


def judge(vehicle: config.Vehicle, logs: list[Path], spoil: Spoil) -> list[Said]:
    """Spoil every log and identify it."""
    with tempfile.TemporaryDirectory() as directory:
        copies = [spoilt(log, spoil, Path(directory)) for log in logs]
        return [said(vehicle, identify(vehicle, [copy]).logs[0]) for copy in copies]
