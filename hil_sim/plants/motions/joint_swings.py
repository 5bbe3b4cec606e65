"""Motion of a vehicle's joints: holds and multi-tone swings inside the drawing's limits, or a recorded one.

Besides, strokes at constant speed or of minimum jerk, pushes, and segments that the flight computer asks for. Every
joint has a swing of its own size.
"""

import csv
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.motions.motion import PhaseSpan, Program, minimum_jerk
from hil_sim.plants.motions.spline import CubicSpline
from hil_sim.plants.urdf_drawing import DrawnJoint
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import MotionTable, Scenario, SequenceStep

_FREE_RAD, _FREE_M = 1.0, 0.2  # way to the end of a joint that has none, or one far away
_MARGIN = 0.9  # of the way to an end, and of the largest speed, that is used at most


class Swinging(NamedTuple):
    """One swing: its span, its ramp, and its tones, (joints, tones) each."""

    start_s: float
    end_s: float
    ramp_s: float
    amplitude_rad: FloatArray
    rate_rad_s: FloatArray
    phase_rad: FloatArray

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Sum of the tones without the envelope at times (n,), and its derivatives; (n, joints) each."""
        w = self.rate_rad_s
        turn = (time_s[:, None, None] - self.start_s) * w + self.phase_rad  # (n, joints, tones)
        sine, cosine = self.amplitude_rad * np.sin(turn), self.amplitude_rad * w * np.cos(turn)
        return sine.sum(axis=2), cosine.sum(axis=2), -(sine * w * w).sum(axis=2)


class Sweeping(NamedTuple):
    """Strokes out and back at a constant speed, which is reached and left by quintics within a ramp."""

    start_s: float
    end_s: float
    strokes: int
    ramp_s: float
    rates: FloatArray  # (joints,) speed of the way out

    @property
    def way_s(self) -> float:
        """How long the full speed would take for the way out."""
        return self._half_s - self.ramp_s

    @property
    def _half_s(self) -> float:
        return 0.5 * (self.end_s - self.start_s) / self.strokes

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Way in seconds of full speed at times (n,), and its derivatives; (n,) each."""
        half_s, ramp_s = self._half_s, self.ramp_s
        number, t = np.divmod(time_s - self.start_s, half_s)
        sign = np.where(number % 2.0 == 0.0, 1.0, -1.0)
        t = np.where(sign > 0.0, t, half_s - t)  # the way back is the way out in reverse
        up, down = np.clip(t / ramp_s, 0.0, 1.0), np.clip((half_s - t) / ramp_s, 0.0, 1.0)
        middle = np.clip(t - ramp_s, 0.0, half_s - 2.0 * ramp_s)
        way = ramp_s * (_ramp(up, 0) + 0.5 - _ramp(down, 0)) + middle
        rate = np.where(t < 0.5 * half_s, _ramp(up, 1), _ramp(down, 1))
        change = np.where(t < 0.5 * half_s, _ramp(up, 2), -_ramp(down, 2)) / ramp_s
        return way, sign * rate, change


def _ramp(s: FloatArray, order: int) -> FloatArray:
    """Integral of a quintic from 0 to 1 over s, the quintic, or its derivative."""
    if order == 0:
        return s**4 * (2.5 + s * (-3.0 + s))
    return s**3 * (10.0 + s * (-15.0 + 6.0 * s)) if order == 1 else 30.0 * (s * (1.0 - s)) ** 2


def envelope(time_s: FloatArray, swing: Swinging) -> tuple[FloatArray, FloatArray, FloatArray]:
    """From 0 to 1 and back by quintics of zero end rates and accelerations; value, rate, acceleration, (n,) each."""
    rising = time_s - swing.start_s < swing.end_s - time_s
    side = np.where(rising, 1.0, -1.0) / swing.ramp_s
    s = np.clip(np.minimum(time_s - swing.start_s, swing.end_s - time_s) / swing.ramp_s, 0.0, 1.0)
    value = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
    return value, side * 30.0 * (s * (1.0 - s)) ** 2, side**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


class JointSwings(Program):
    """Joint motion of a vehicle's sequence.

    Args:
        scenario: its ``[motion]`` and ``[[sequence]]``.
        joints: in the order of the columns.
        rng: draws posture and tones, in the order of the sequence.

    Raises:
        ScenarioError: a posture outside the limits, of a joint that is not there, or a CSV that does not fit.
    """

    def __init__(self, scenario: Scenario, joints: Sequence[DrawnJoint], rng: np.random.Generator) -> None:
        names = [joint.name for joint in joints]
        unknown = sorted(scenario.motion.posture.keys() - set(names))
        if unknown:
            raise ScenarioError(f"motion.posture names {', '.join(unknown)}; the joints are {', '.join(names)}")
        drawn = rng.uniform(-1.0, 1.0, len(joints))
        self.posture = np.array([_posture(joint, scenario.motion, by) for joint, by in zip(joints, drawn, strict=True)])
        spinning = wheels(scenario)
        room = np.array([_room(joint, at) for joint, at in zip(joints, self.posture, strict=True)])
        room[[joint.name in spinning for joint in joints]] = 0.0
        speed = np.array([joint.speed for joint in joints])
        self._swings: list[Swinging] = []
        self._sweeps: list[Sweeping] = []
        self._knots = [(0.0, np.zeros(len(joints)))]  # of strokes and pushes: time, and angles off the posture
        spans: list[PhaseSpan] = []
        now_s = 0.0
        for step in scenario.sequence:
            end_s = round(now_s + step.duration_s, 9)
            if step.action == "swing":
                self._swings.append(_draw(step, now_s, end_s, room, speed, rng))
            if step.action == "sweep":
                self._sweeps.append(_sweep(step, now_s, end_s, joints, self.posture))
            if step.action in ("strokes", "push"):
                self._go(step, now_s, joints)
            spans.append(PhaseSpan(step.phase, step.action, now_s, end_s))
            now_s = end_s
        self.spans = tuple(spans)
        self._strokes = np.array([at for at, _ in self._knots]), np.array([angles for _, angles in self._knots])
        self._segments: dict[str, CubicSpline] = {}
        self.asked: list[tuple[float, str]] = []  # start and name of the segments asked for so far
        if scenario.motion.segments is not None:
            self._segments, self.posture = _segments(Path(scenario.motion.segments), joints)
        self._recorded: tuple[CubicSpline, float, float] | None = None
        if scenario.motion.csv is not None:
            self._recorded = _recorded(Path(scenario.motion.csv), joints)
            self.posture = self._recorded[0](self._recorded[1])

    def _go(self, step: SequenceStep, start_s: float, joints: Sequence[DrawnJoint]) -> None:
        """Knots of a step of strokes, or of a push."""
        named = step.amplitude if step.action == "strokes" else step.to
        names = [joint.name for joint in joints]
        if unknown := sorted(named.keys() - set(names)):
            raise ScenarioError(f"sequence.{step.action} names {', '.join(unknown)}; the joints are {', '.join(names)}")
        way = np.array([named.get(name, 0.0) for name in names])
        if step.action == "push":
            parts = [(way, step.approach_s), (way, step.hold_s), (0.0 * way, step.retreat_s)]
        else:
            for joint, at, by in zip(joints, self.posture.tolist(), np.abs(way).tolist(), strict=True):
                if by and not joint.low <= at - by < at + by <= joint.high:
                    raise ScenarioError(
                        f"sequence.amplitude.{joint.name}: {at:.3g} +- {by:.3g} is beyond the URDF's limits, "
                        f"{joint.low:g} to {joint.high:g}"
                    )
            sides = [(-1.0) ** k * -way for k in range(step.strokes + 1)]
            parts = [(sides[0], step.transfer_s)]
            for side in sides[1:]:
                parts += [(side, step.stroke_s), (side, step.pause_s)]
            parts.append((0.0 * way, step.transfer_s))
        if start_s > self._knots[-1][0]:
            self._knots.append((start_s, self._knots[-1][1]))
        for angles, lasts_s in parts:
            if lasts_s > 0.0:
                self._knots.append((round(self._knots[-1][0] + lasts_s, 9), angles))

    @property
    def waits(self) -> bool:
        """Whether the flight computer asks for some of the motion, so that it is not known beforehand."""
        return bool(self._segments)

    def ask(self, name: str, start_s: float) -> bool:
        """Play a segment from a time on; False where there is none of this name, or the arm moves already.

        Args:
            name: of the segment.
            start_s: nothing that was read of the motion is later.
        """
        if name not in self._segments:
            return False
        end_s = start_s + float(self._segments[name].x[-1])
        busy = any(start_s < at_s + self._segments[other].x[-1] for at_s, other in self.asked)
        moving = [span for span in self.spans if span.action in ("swing", "strokes", "push")]
        swings = any(span.start_s < end_s and start_s < span.end_s for span in moving)
        if busy or swings or end_s > self.duration_s:
            return False
        self.asked.append((start_s, name))
        return True

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle, rate and acceleration at times (n,); (n, joints) each, rad or m."""
        if self._recorded is not None:
            spline, first_s, last_s = self._recorded
            inside = ((time_s >= first_s) & (time_s <= last_s))[:, None]
            t = np.clip(time_s, first_s, last_s)
            return spline(t), np.where(inside, spline(t, 1), 0.0), np.where(inside, spline(t, 2), 0.0)
        q = np.tile(self.posture, (len(time_s), 1))
        dq, ddq = np.zeros_like(q), np.zeros_like(q)
        for swing in self._swings:
            rows = (time_s > swing.start_s) & (time_s < swing.end_s)
            s, ds, dds = swing.at(time_s[rows])
            e, de, dde = (part[:, None] for part in envelope(time_s[rows], swing))
            q[rows] += e * s
            dq[rows] = de * s + e * ds
            ddq[rows] = dde * s + 2.0 * de * ds + e * dds
        for sweep in self._sweeps:
            rows = (time_s > sweep.start_s) & (time_s < sweep.end_s)
            if rows.any():
                way, rate, change = sweep.at(time_s[rows])
                q[rows] += np.outer(way, sweep.rates)
                dq[rows], ddq[rows] = np.outer(rate, sweep.rates), np.outer(change, sweep.rates)
        if len(self._knots) > 1:
            q, dq, ddq = map(np.add, (q, dq, ddq), minimum_jerk(*self._strokes, time_s))
        for start_s, name in self.asked:
            spline = self._segments[name]
            rows = (time_s > start_s) & (time_s < start_s + spline.x[-1])
            if rows.any():
                q[rows], dq[rows], ddq[rows] = (spline(time_s[rows] - start_s, order) for order in range(3))
        return q, dq, ddq


def wheels(scenario: Scenario) -> frozenset[str]:
    """The joints whose speed alone is measured: wheels, which run by ``sweep`` and do not swing."""
    tables = [device.model_dump() for device in scenario.device.values()]
    sensors = {name for name, sensor in scenario.sensor.items() if sensor.quantity == "wheel_rate"}
    return frozenset(str(table["at"]) for table in tables if table.get("measures") in sensors)


def _posture(joint: DrawnJoint, motion: MotionTable, drawn: float) -> float:
    """``drawn``: from -1 to 1."""
    if joint.name in motion.posture:
        at = motion.posture[joint.name] + motion.posture_spread * drawn
        if not joint.low <= at <= joint.high:
            raise ScenarioError(f"motion.posture.{joint.name}: it goes from {joint.low:g} to {joint.high:g}")
        return at
    middle = 0.5 * (joint.low + joint.high) if joint.bounded else 0.0
    reach = min(0.5 * (joint.high - joint.low), _FREE_M if joint.slides else 2.0 * _FREE_RAD)
    return middle + motion.spread * drawn * reach


def _room(joint: DrawnJoint, posture: float) -> float:
    way = min(posture - joint.low, joint.high - posture)
    return _MARGIN * min(way, _FREE_M if joint.slides else _FREE_RAD)


def _draw(
    step: SequenceStep, start_s: float, end_s: float, room: FloatArray, speed: FloatArray, rng: np.random.Generator
) -> Swinging:
    """Tones whose sum stays within the room and the speed of every joint."""
    shape = (len(room), step.tones)
    amplitude = step.swing * room[:, None] * np.sqrt(2.0 / step.tones) * rng.uniform(0.6, 1.2, shape)
    rate = 2.0 * np.pi * rng.uniform(*step.band_Hz, shape)
    largest = amplitude.sum(axis=1)
    fastest = (amplitude * rate).sum(axis=1) + 1.875 * largest / step.ramp_s
    shrunk = np.minimum(room / np.maximum(largest, 1e-12), _MARGIN * speed / np.maximum(fastest, 1e-12))
    amplitude *= np.minimum(shrunk, 1.0)[:, None]
    return Swinging(start_s, end_s, step.ramp_s, amplitude, rate, rng.uniform(0.0, 2.0 * np.pi, shape))


def _sweep(
    step: SequenceStep, start_s: float, end_s: float, joints: Sequence[DrawnJoint], posture: FloatArray
) -> Sweeping:
    """Strokes of a step, within the limits and the speed of the joints."""
    names = [joint.name for joint in joints]
    if unknown := sorted(step.rates.keys() - set(names)):
        raise ScenarioError(f"sequence.rates names {', '.join(unknown)}; the joints are {', '.join(names)}")
    stroke_s = 0.5 * (end_s - start_s) / step.strokes
    rates = np.array([step.rates.get(name, 0.0) for name in names])
    sweep = Sweeping(start_s, end_s, step.strokes, min(step.ramp_s, 0.25 * stroke_s), rates)
    for joint, rate, at in zip(joints, rates.tolist(), posture.tolist(), strict=True):
        end = at + rate * sweep.way_s
        if rate and (abs(rate) > joint.speed or not joint.low <= end <= joint.high):
            raise ScenarioError(
                f"sequence.rates.{joint.name}: from {at:.3g} to {end:.3g} at {abs(rate):.3g} a second is beyond the "
                f"URDF's limits, {joint.low:g} to {joint.high:g} at {joint.speed:g}"
            )
    return sweep


def _recorded(path: Path, joints: Sequence[DrawnJoint]) -> tuple[CubicSpline, float, float]:
    """Spline through a CSV's columns, and its first and last time."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            names, *rows = (row for row in csv.reader(file) if row)
            columns = dict(zip(map(str.strip, names), np.array(rows, dtype=np.float64).T, strict=True))
    except (OSError, ValueError, csv.Error) as error:
        raise ScenarioError(f"motion.csv: {path} cannot be read: {error}; give rows of numbers below names") from error
    wanted = ["time_s", *(joint.name for joint in joints)]
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise ScenarioError(f"motion.csv: {path} has no column {', '.join(missing)}; its columns: {', '.join(columns)}")
    time_s, q = columns["time_s"], np.column_stack([columns[joint.name] for joint in joints])
    if len(time_s) < 4 or not (np.isfinite(time_s).all() and np.isfinite(q).all() and (np.diff(time_s) > 0.0).all()):
        raise ScenarioError(f"motion.csv: {path} needs four rows and more of numbers, time_s rising")
    for joint, column in zip(joints, q.T, strict=True):
        if column.min() < joint.low or column.max() > joint.high:
            raise ScenarioError(
                f"motion.csv: {joint.name} goes from {column.min():g} to {column.max():g}, beyond the URDF's limits"
            )
    return CubicSpline(time_s, q, clamped=True), float(time_s[0]), float(time_s[-1])


def _segments(path: Path, joints: Sequence[DrawnJoint]) -> tuple[dict[str, CubicSpline], FloatArray]:
    """Splines of the motions in a file, by name, from time 0; and the posture at which all begin and end."""
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: np.asarray(file[name]) for name in ("names", "joints", "time_s", "q", "ticks")}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise ScenarioError(
            f"motion.segments: {path} cannot be read: {error}; heft plan --segments writes it"
        ) from error
    names = found["joints"].tolist()
    if sorted(names) != sorted(joint.name for joint in joints):
        raise ScenarioError(f"motion.segments: {path} is of {', '.join(names)}; the joints are others")
    order = [names.index(joint.name) for joint in joints]
    q = found["q"][:, :, order]
    posture = q[0, 0]
    splines = {}
    for name, n, own in zip(found["names"].tolist(), found["ticks"].tolist(), q, strict=True):
        if np.abs(own[[0, n - 1]] - posture).max() > 1e-6:
            raise ScenarioError(
                f"motion.segments: {name} of {path} does not begin and end in the posture of the others"
            )
        splines[name] = CubicSpline(found["time_s"][:n], own[:n], clamped=True)
    return splines, posture
