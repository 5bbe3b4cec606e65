"""Spoilt copies of the real throws (tudelft_tumbling): is a verdict ever good while the truth is far outside?

Run ``python bench/spoilt_throws.py DIR [--every 1]`` with the directory of the recordings. Each recording is imported,
spoilt in one stream (sign, swapped axes, scale, delay, clipping, cut), and identified as the original is. A copy is
*wrong* where a true principal moment of its load lies beyond the 99.9 % interval; the carrier alone, which has no drawn
truth, is compared with the vehicle file's calibration. Counted per way of spoiling: verdicts, wrong ones, and
verdicts that are good and wrong.

The wheel's inertia and rate are the scale of all inertias in free fall: a constant scale of the rate changes nothing
else, so no instrument sees it (marked "invisible"). Exit code 1: good and wrong, in a way that is not invisible.
"""

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drivers.records import Rows
from onboard import config
from onboard.dynamics.model.inertia import principal_moments
from onboard.estimation.policy import wider
from onboard.ground.identify.identify import identify
from onboard.ground.identify.kinds.identified import Identified
from onboard.ground.identify.kinds.throws import carrier_of
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.identification.standing import Level
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

SPIN_UP_RAD_S = 100.0  # of the wheel: what the packaged vehicle identifies from
_STREAMS = {"gyro": ("imu_base", "gyro_raw"), "accel": ("imu_base", "accel_raw"), "wheel": ("wheel_rate", "value_raw")}
_AXES = {"x": 0, "y": 1, "z": 2}
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


def clipped(name: str, share: float, streams: Streams) -> None:
    """Clips a stream at a share of its largest reading since the wheel spun up."""
    values = _column(streams, name)
    flying = streams[_STREAMS[name][0]]["host_ns"] > _spun_up_ns(streams)
    most = share * np.abs(values[flying].astype(np.float64)).max()
    values[...] = np.clip(values, -most, most)


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


def spoils() -> dict[str, Spoil]:
    """Every way of spoiling, by name."""
    made: dict[str, Spoil] = {"as recorded": lambda streams: None}
    for name in ("gyro", "accel"):
        for letter, axis in _AXES.items():
            made[f"{name} {letter} sign"] = partial(scaled, name, -1.0, axis=axis)
            made[f"{name} {letter} x 1.1"] = partial(scaled, name, 1.1, axis=axis)
        made[f"{name} sign"] = partial(scaled, name, -1.0)
        for words, order in (("xy", [1, 0, 2]), ("yz", [0, 2, 1]), ("xz", [2, 1, 0]), ("xyz", [1, 2, 0])):
            made[f"{name} {words} swapped"] = partial(permuted, name, order)
        for factor in (0.5, 0.9, 0.97, 1.03, 1.1, 2.0):
            made[f"{name} x {factor:g}"] = partial(scaled, name, factor)
    made["wheel sign"] = partial(scaled, "wheel", -1.0)
    for factor in (0.5, 0.9, 0.97, 1.03, 1.1, 2.0):
        made[f"wheel x {factor:g}"] = partial(scaled, "wheel", factor)
    for name in _STREAMS:
        for delay_ms in (2, 5, 10, 20, 50):
            made[f"{name} {delay_ms} ms late"] = partial(late, name, 1e-3 * delay_ms)
        for percent in (80, 50, 20):
            made[f"{name} clipped at {percent} %"] = partial(clipped, name, 0.01 * percent)
    for begin_s, end_s in ((0.0, 0.1), (0.0, 0.15), (0.0, 0.2), (0.0, 0.3), (0.1, 0.25), (0.15, 0.35), (0.2, 0.7)):
        made[f"cut to {begin_s:g} .. {end_s:g} s"] = partial(cut, begin_s, end_s)
    return made


INVISIBLE = {f"wheel x {factor:g}" for factor in (0.5, 0.9, 0.97, 1.03, 1.1, 2.0)} | {
    "accel sign",
    *(f"accel x {factor:g}" for factor in (0.5, 0.9, 0.97, 1.03, 1.1, 2.0)),
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


def main() -> int:
    """Print one line for each way of spoiling."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path, help="directory of the recordings (*.npz)")
    parser.add_argument("--every", type=int, default=1, help="take only every n-th recording")
    parser.add_argument("--only", default="", help="ways of spoiling whose name contains this")
    parser.add_argument("--show", action="store_true", help="also print each copy that is good and wrong")
    arguments = parser.parse_args()
    vehicle, bad = config.load(config.packaged("tudelft")), 0
    print(f"{'':26}{'good':>6}{'weak':>6}{'do not use':>12}{'wrong':>7}{'good and wrong':>16}")
    with tempfile.TemporaryDirectory() as directory:
        logs = [log.path for log in import_recordings("tudelft", arguments.source, Path(directory))]
        for name, spoil in spoils().items():
            if arguments.only not in name:
                continue
            told = judge(vehicle, logs[:: arguments.every], spoil)
            levels = Counter(one.level for one in told)
            wrong = [one for one in told if one.off > 1.0]
            false = [one for one in wrong if one.level is Level.GOOD]
            bad += len(false) * (name not in INVISIBLE)
            counts = "".join(f"{levels[level]:{width}d}" for level, width in zip(Level, (6, 6, 12), strict=True))
            note = "  invisible" if name in INVISIBLE else ""
            print(f"{name:26}{counts}{len(wrong):7d}{len(false):16d}{note}", flush=True)
            for one in false if arguments.show else ():
                print(f"    {one.log}: {one.off:.1f} half-widths off")
    print(f"good and wrong where a witness exists: {bad}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
