"""Spoilt copies of DYMAFLEX flights: is an answer ever confident while the truth is far outside?

Run ``python -m bench.spoilt_flights LOG ...`` with logs of ``heft hil dymaflex --log LOG`` beside which their truth is
(LOG.truth.json); ``--vehicle dymaflex_wheels`` for logs of that mission, whose wheels are spoilt too; for logs of a
rehearsed vehicle ``--vehicle VEHICLE/vehicle.toml`` (an arm with a load cell: ``--only "cell x" --from 0.6 --alone``).
Each log is spoilt in one or two streams, or cut, and identified, from its onboard answer.
A copy is *wrong* where the truth of a quantity lies beyond its 99.9 % interval. Exit code 1: good and wrong.

``--on-board`` runs the onboard estimator on each copy instead. Wrong is a supported quantity at any time of the flight,
or one before anything is held; what was left out and every capture reported are printed with their times. ``--from
0.5``: streams are spoilt from the middle of the flight on. ``--pairs``: two instruments each.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drivers.records import Rows
from onboard import config
from onboard.channels import outer_ends
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.campaign.instants import off_by
from onboard.ground.identify.identify import identify
from onboard.ground.identify.mission.own_mission import true_values
from onboard.ground.identify.replay.feed import feed
from onboard.identification.standing import LEVELS
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

Spoil = Callable[[str, Rows], None]
_IMU, _IMU_2, _CELL = "imu_base", "imu_2", "load_cell"
_FIELDS = {_IMU: ("gyro_raw", "accel_raw"), _IMU_2: ("gyro_raw", "accel_raw")}  # of other channels: value_raw
_ANSWERS = ("estimate", "event_estimation")


def _scaled(channel: str, field: str, factor: float, axes: Sequence[int] | None, name: str, rows: Rows) -> None:
    if name == channel:
        values = rows[field] if axes is None else rows[field][:, list(axes)]
        about = 1_000_000 if channel.startswith("joint") else 0  # reading at joint angle zero
        made = np.rint(about + factor * (values.astype(np.float64) - about))
        if axes is None:
            rows[field] = made
        else:
            rows[field][:, list(axes)] = made


def _shifted(channel: str, field: str, step: float, name: str, rows: Rows) -> None:
    """A stream reads more by a step, SI."""
    if name == channel:
        rows[field] += np.rint(step / rows["scale"]).astype(rows[field].dtype)


def _permuted(field: str, order: list[int], name: str, rows: Rows) -> None:
    if name == _IMU:
        rows[field] = rows[field][:, order]


def _late(channel: str, delay_s: float, name: str, rows: Rows) -> None:
    """Readings of an instrument by its neighbours so much earlier, at unchanged stamps, within each batch."""
    if name != channel:
        return
    stamps = rows["host_ns"].astype(np.float64)
    for one in _FIELDS.get(channel, ("value_raw",)):
        values = rows[one].astype(np.float64).reshape(len(rows), -1)
        moved = [np.interp(stamps - 1e9 * delay_s, stamps, column) for column in values.T]
        rows[one] = np.rint(np.stack(moved, axis=1)).reshape(rows[one].shape)


def _clipped(channel: str, field: str, share: float, name: str, rows: Rows) -> None:
    """Readings beyond a share of the largest are that."""
    if name == channel:
        about = np.median(rows[field], axis=0)
        most = share * np.abs(rows[field] - about).max()
        rows[field] = np.clip(rows[field], about - most, about + most)


def _stuck(channel: str, share: float, name: str, rows: Rows) -> None:
    """An instrument repeats its reading after a share of the flight."""
    if name == channel:
        for field in _FIELDS.get(channel, ("value_raw",)):
            first = int(share * len(rows))
            rows[field][first:] = rows[field][first]


def spoils() -> dict[str, Spoil]:
    """Every way of spoiling, by name."""
    made: dict[str, Spoil] = {"as flown": lambda name, rows: None}
    for words, field in (("gyro", "gyro_raw"), ("accel", "accel_raw")):
        for factor in (0.9, 0.95, 0.96, 0.97, 1.03, 1.04, 1.05, 1.1, -1.0):
            made[f"{words} x {factor:g}"] = partial(_scaled, _IMU, field, factor, None)
        made[f"{words} y sign"] = partial(_scaled, _IMU, field, -1.0, (1,))
        made[f"{words} z x 1.1"] = partial(_scaled, _IMU, field, 1.1, (2,))
        made[f"{words} xy swapped"] = partial(_permuted, field, [1, 0, 2])
        made[f"{words} yz swapped"] = partial(_permuted, field, [0, 2, 1])
    for joint in ("joint_2", "joint_4"):
        made[f"{joint} 10 ms late"] = partial(_late, joint, 0.01)
        made[f"{joint} clipped at 70 %"] = partial(_clipped, joint, "value_raw", 0.7)
        made[f"{joint} stuck from mid-flight"] = partial(_stuck, joint, 0.5)
        made[f"{joint} x 1.03"] = partial(_scaled, joint, "value_raw", 1.03, None)
        made[f"{joint} sign"] = partial(_scaled, joint, "value_raw", -1.0, None)
    for words, channel in (("IMU", _IMU), ("IMU 2", _IMU_2), ("cell", _CELL)):
        made[f"{words} 10 ms late"] = partial(_late, channel, 0.01)
        made[f"{words} stuck from mid-flight"] = partial(_stuck, channel, 0.5)
        for field in _FIELDS.get(channel, ("value_raw",)):
            made[f"{words} {field} clipped at 50 %"] = partial(_clipped, channel, field, 0.5)
    for factor in (0.0, 0.5, 0.9, 0.95, 1.05, -1.0):  # dead at 0
        made[f"cell x {factor:g}"] = partial(_scaled, _CELL, "value_raw", factor, None)
    made["cell + 2 N"] = partial(_shifted, _CELL, "value_raw", 2.0)
    made["cell + 2 N from mid-flight"] = partial(_late_part, 0.5, made["cell + 2 N"])
    for words, field in (("gyro", "gyro_raw"), ("accel", "accel_raw")):
        for factor in (0.7, 0.9, 0.97, 1.03, -1.0):
            made[f"{words} 2 x {factor:g}"] = partial(_scaled, _IMU_2, field, factor, None)
    return made


def of_wheels(channels: Sequence[str]) -> dict[str, Spoil]:
    """Ways of spoiling reaction wheels, by name."""
    made: dict[str, Spoil] = {}
    for wheel in (name for name in channels if name.startswith("wheel_")):
        for factor in (0.0, 0.9, 0.97, 1.03, 1.1, -1.0):
            made[f"{wheel} x {factor:g}"] = partial(_scaled, wheel, "value_raw", factor, None)
        made[f"{wheel} stuck from mid-flight"] = partial(_stuck, wheel, 0.5)
        made[f"{wheel} 20 ms late"] = partial(_late, wheel, 0.02)
    return made


PAIRS = (  # of ways, two instruments at once
    ("gyro x 0.9", "cell x 0.5"),
    ("gyro x 1.1", "cell x 1.05"),
    ("gyro xy swapped", "cell x -1"),
    ("accel x 0.9", "cell x 1.05"),
    ("accel x 0.9", "cell x 0.5"),
    ("IMU 10 ms late", "cell + 2 N"),
    ("cell x 0.5", "joint_2 x 1.03"),
    ("cell x 1.05", "joint_2 10 ms late"),
    ("cell + 2 N", "joint_4 x 1.03"),
    ("gyro 2 x 0.7", "cell x 0.5"),
    ("accel 2 x 0.9", "cell x 1.05"),
    ("gyro 2 x 0.97", "cell x 0.95"),
    ("gyro x 0.9", "gyro 2 x 0.9"),
    ("accel x 0.9", "accel 2 x 0.9"),
)


def _both(spoils: Sequence[Spoil], name: str, rows: Rows) -> None:
    for spoil in spoils:
        spoil(name, rows)


def _late_part(share: float, spoil: Spoil, name: str, rows: Rows) -> None:
    """Spoil a stream from a share of it on."""
    kept = rows[: int(share * len(rows))].copy()
    spoil(name, rows)
    rows[: len(kept)] = kept


CUTS = {  # what is left: of which channels, and between which shares of the flight
    "cut to the first half": ("", 0.0, 0.5),
    "cut to the last half": ("", 0.5, 1.0),
    "cut to the last 5 %": ("", 0.95, 1.0),
    "IMU cut to the first half": (_IMU, 0.0, 0.5),
    "IMU cut to the last half": (_IMU, 0.5, 1.0),
    "IMU 2 cut to the first half": (_IMU_2, 0.0, 0.5),
    "cell cut to the first half": (_CELL, 0.0, 0.5),
    "joint_2 cut to the first half": ("joint_2", 0.0, 0.5),
}


def spoilt(log: LogReader, spoil: Spoil, out: Path, channels: Sequence[str], cut: str = "") -> Path:
    """A copy of a log with a stream spoilt or cut; batches of a channel are joined for delays."""
    only, begin, end = CUTS.get(cut, ("", 0.0, 1.0))
    kept: dict[str, list[Rows]] = {}
    for name, rows in log.batches(channels):
        kept.setdefault(name, []).append(rows)
    with LogWriter.create(out, durable=False, overwrite=True) as writer:
        for name, parts in kept.items():
            rows = np.concatenate(parts)
            spoil(name, rows)
            if only in ("", name):
                rows = rows[int(begin * len(rows)) : int(end * len(rows))]
            writer.register(name, rows.dtype)
            for first in range(0, len(rows), 2000):
                writer.write(name, rows[first : first + 2000])
    return out


class Report(NamedTuple):
    """What a flight or the ground said."""

    level: str
    worst: str  # the quantity that is farthest off
    off: float  # over half of its 99.9 % interval; 0: no answer
    text: str

    @property
    def wrong(self) -> bool:
        """Whether the truth is beyond the interval."""
        return abs(self.off) > 1.0

    @property
    def line(self) -> str:
        """As it is printed."""
        told = f"{self.worst} at {self.off:+.1f} of its 99.9 % interval" if self.worst else "no answer"
        return f"{self.level:11}{'WRONG ' if self.wrong else ''}{told}; {self.text}"


def _signed(value: float, low: float, high: float, truth: float) -> float:
    return float(np.sign(value - truth) * off_by(value, low, high, truth))


def on_the_ground(vehicle: config.Vehicle, copy: Path, truth: dict[str, float]) -> Report:
    """What ``heft identify`` makes of a copy."""
    (found,) = identify(vehicle, [copy]).logs
    off = {
        one.name: _signed(one.value, *one.outer, truth[one.name])
        for one in found.answers
        if one.supported and one.name in truth
    }
    worst = max(off, key=lambda one: abs(off[one]), default="")
    return Report(found.verdict.level, worst, off.get(worst, 0.0), found.verdict.text[:170])


def on_board(vehicle: config.Vehicle, copy: Path, truth: dict[str, float], start_ns: int, capture_s: float) -> Report:
    """What the onboard estimator makes of a copy: the worst of its supported answers, and its events."""
    worst, off, at_s, events = "", 0.0, 0.0, list[str]()
    last = np.zeros(0)
    for channel, rows in feed(Estimator(vehicle), LogReader(copy)):
        if "code" in (rows.dtype.names or ()):
            for row in rows:
                if row["code"] in (b"left_out", b"absent", b"taken_back", b"capture", b"ejection", b"instrument"):
                    what = row["text"].decode().split(" ")[0] if row["code"] in (b"left_out", b"absent") else ""
                    events.append(f"{row['code'].decode()} {what} {1e-9 * (row['host_ns'] - start_ns):.1f}")
        if channel != "quantity":
            continue
        last = rows
        now_s = 1e-9 * (float(rows["host_ns"][0]) - start_ns)
        for row in rows[rows["supported"] != 0]:
            if (name := row["name"].decode()) in truth:
                away = _signed(row["value"], *outer_ends(row), truth[name]) if now_s > capture_s else np.inf
                if abs(away) > abs(off):
                    worst, off, at_s = name, float(away), now_s
    answers = [row for row in last if row["name"].decode() in truth]
    if not answers:
        return Report("none", worst, off, f"nothing was ever told; {', '.join(events)}")
    told = next((row for row in answers if row["supported"]), answers[0])
    mass = f"m {told['value'] / truth[answers[0]['name'].decode()] - 1.0:+.2%}" if told["supported"] else "none"
    text = f"at {at_s:.1f} s; in the end {mass}: {told['why'].decode()[:110]}; {', '.join(events)}"
    return Report(LEVELS[int(told["level"])], worst, off, text)


def main() -> int:
    """Print a line for each copy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--only", default="", help="ways whose name contains this")
    parser.add_argument("--alone", action="store_true", help="without the onboard answer")
    parser.add_argument("--on-board", action="store_true", help="by the onboard estimator")
    parser.add_argument("--from", dest="since", type=float, default=0.0, help="share of the flight that is as flown")
    parser.add_argument("--pairs", action="store_true", help="two instruments at once")
    parser.add_argument("--vehicle", default="dymaflex", help="packaged, or vehicle.toml")
    arguments = parser.parse_args()
    vehicle = config.named(arguments.vehicle)
    every, failed = spoils() | of_wheels(tuple(vehicle.channels)), 0
    ways = [*every.items(), *((cut, every["as flown"]) for cut in CUTS)]
    if arguments.pairs:
        ways = [(" and ".join(pair), partial(_both, [every[one] for one in pair])) for pair in PAIRS]
    for path in arguments.logs:
        log = LogReader(path)
        known = json.loads(Path(f"{path}.truth.json").read_text())
        truth = true_values(vehicle, known)
        channels = [*vehicle.channels, *(() if arguments.alone or arguments.on_board else _ANSWERS)]
        for name, spoil in ways:
            if arguments.only not in name:
                continue
            with tempfile.TemporaryDirectory() as directory:
                some = partial(_late_part, arguments.since, spoil)
                copy = spoilt(log, some, Path(directory) / "copy.mcap", channels, name)
                begun_s = time.process_time()
                if arguments.on_board:
                    told = on_board(vehicle, copy, truth, known["start_ns"], known["capture_s"])
                else:
                    told = on_the_ground(vehicle, copy, truth)
            failed += told.wrong and (arguments.on_board or told.level == "good")
            print(f"{path.name:14}{name:30}{time.process_time() - begun_s:4.0f} s of CPU  {told.line}", flush=True)
    print(f"{'supported' if arguments.on_board else 'good'} and wrong: {failed}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
