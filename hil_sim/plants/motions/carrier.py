"""Motion of a prescribed base on the rows of a plant: its sway, and the parts that a scenario names.

The parts are those of ``motion``: a carrier that cones, structural vibration, the air that brakes and turns the
carrier. Rates and accelerations are sums by axis. Angular rates half a step before each row are kept beside those at
the rows: their differences over the step are the angular accelerations, which is the leapfrog that ``servo_flight``
integrates. The motion is made in chunks, and only what is asked for next is kept: a flight may last for hours.

Motion of a base that is prescribed: it sways, each axis by tones drawn per seed.
"""

import copy
from typing import NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray, cross
from hil_sim.plants.motions.motion import Gusts, Shaking, coning, dynamic_pressure, rate_before, wind_direction
from hil_sim.scenario.vehicle_tables import BaseSway, Scenario

_BLOCK = 96  # attitudes that are made side by side
CHUNK = 3840  # rows, whole blocks of the filters (64) and of attitudes (96)
_NOTHING = np.zeros(0), np.zeros((0, 3))


class BasePath(NamedTuple):
    """A base's motion on a grid: MuJoCo's numbers of a free joint, (n, ...)."""

    pose: FloatArray  # (n, 7): place, world; w x y z of its attitude
    velocity: FloatArray  # (n, 6): of its origin, world; rate, its own axes
    acceleration: FloatArray  # (n, 6): the same


class Sway:
    """A drawn motion in chunks; the base stands in the world's axes at the first row.

    Up to ``still_s`` it coasts without turning; rate and acceleration then grow within ``ramp_s``.

    Args:
        table: of it.
        rng: draws the tones.
    """

    def __init__(self, table: BaseSway, rng: np.random.Generator) -> None:
        shape = (6, table.tones)
        self._table = table
        self._w = 2.0 * np.pi * rng.uniform(*table.band_Hz, shape)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, shape)
        self._rms = np.repeat([table.acceleration_m_s2, table.rate_rad_s], 3)[:, None]
        self._size = self._rms * np.sqrt(2.0 / table.tones) * rng.uniform(0.6, 1.2, shape)
        self._last: tuple[FloatArray, BasePath] | None = None  # the last row, and its time
        self._attitude = np.array([1.0, 0.0, 0.0, 0.0])

    def take(self, time_s: FloatArray) -> BasePath:
        """The next rows, at evenly spaced times (n,); n is whole blocks of 96, but of the last."""
        n, w, size = len(time_s), self._w, self._size
        acceleration, velocity, pose = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 7))
        if not self._rms.any():
            pose[:, 3] = 1.0
            return BasePath(pose, velocity, acceleration)
        turn = time_s[:, None, None] * w + self._phase  # (n, 6, tones)
        sine, cosine = size * np.sin(turn), size * np.cos(turn)
        swings, slope = sine.sum(axis=2), (cosine * w).sum(axis=2)
        grown, growth = _grown(self._table, time_s)
        acceleration[:, :3] = grown * swings[:, :3]
        last_s, last = self._last or (time_s[:1], BasePath(pose[:1], velocity[:1], acceleration[:1].copy()))
        steps = np.diff(time_s, prepend=last_s)[:, None]
        if self._table.still_s > 0.0:
            velocity[:, :3] = _integral(acceleration[:, :3], steps, last.acceleration[0, :3], last.velocity[0, :3])
            pose[:, :3] = _integral(velocity[:, :3], steps, last.velocity[0, :3], last.pose[0, :3])
        else:
            velocity[:, :3] = -(cosine / w).sum(axis=2)[:, :3]
            pose[:, :3] = -(sine / w**2).sum(axis=2)[:, :3]
        velocity[:, 3:] = grown * swings[:, 3:]
        acceleration[:, 3:] = grown * slope[:, 3:] + growth * swings[:, 3:]
        before = np.concatenate([last.velocity[:, 3:], velocity[:-1, 3:]])
        pose[:, 3:] = attitudes(0.5 * (velocity[:, 3:] + before) * steps, self._attitude)
        self._last = time_s[-1:], BasePath(pose[-1:].copy(), velocity[-1:].copy(), acceleration[-1:].copy())
        return BasePath(pose, velocity, acceleration)


def _grown(table: BaseSway, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Share of the motion at times (n,) and its rate of change, (n, 1) each: a quintic after ``still_s``."""
    if table.still_s == 0.0:
        return np.ones((len(time_s), 1)), np.zeros((len(time_s), 1))
    s = np.clip((time_s - table.still_s) / table.ramp_s, 0.0, 1.0)[:, None]
    return s**3 * (10.0 + s * (-15.0 + 6.0 * s)), 30.0 * (s * (1.0 - s)) ** 2 / table.ramp_s


def _integral(values: FloatArray, steps_s: FloatArray, last: FloatArray, start: FloatArray) -> FloatArray:
    """Of values (n, 3) by trapezoids: their steps (n, 1), value and integral (3,) at the row before the first."""
    own = 0.5 * (values + np.concatenate([last[None], values[:-1]])) * steps_s
    return np.asarray(np.cumsum(np.concatenate([start[None], own]), axis=0)[1:])


def attitudes(turns_rad: FloatArray, at: FloatArray) -> FloatArray:
    """Attitudes of a body, quaternions w x y z, (n, 4).

    Args:
        turns_rad: rotation vector from the row before to each, its own axes, (n, 3).
        at: of the row before the first, (4,); goes on to that of the last.
    """
    n = len(turns_rad)
    blocks = -(-n // _BLOCK)
    turn = np.zeros((blocks * _BLOCK, 3))
    turn[:n] = turns_rad
    own = np.empty((4, _BLOCK, blocks))  # within each block, then from block to block
    turns = turn.T.reshape(3, blocks, _BLOCK).transpose(0, 2, 1)
    half = 0.5 * np.sqrt((turns * turns).sum(axis=0))
    np.cos(half, out=own[0])
    np.multiply(0.5 * np.sinc(half / np.pi), turns, out=own[1:])
    for k in range(1, _BLOCK):
        own[:, k] = _times(own[:, k - 1], own[:, k])
    starts = np.empty((blocks, 4))
    for start, whole in zip(starts, own[:, -1].T.copy(), strict=True):
        start[:] = at
        mujoco.mju_mulQuat(at, start, whole)
        mujoco.mju_normalize4(at)
    found = _times(starts.T[:, None], own)
    found /= np.sqrt((found * found).sum(axis=0))
    return np.ascontiguousarray(found.transpose(2, 1, 0).reshape(-1, 4)[:n])


def _times(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of quaternions w x y z, (4, ...)."""
    (w, x, y, z), (p, q, r, s) = a, b
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[0], out[1] = w * p - x * q - y * r - z * s, w * q + x * p + y * s - z * r
    out[2], out[3] = w * r - x * s + y * p + z * q, w * s + x * r - y * q + z * p
    return out


class CarrierMotion(NamedTuple):
    """A base's motion, row k at ``t_k`` unless said: MuJoCo's numbers of a free joint."""

    pose: FloatArray  # (n, 7): place, world; w x y z of its attitude
    velocity: FloatArray  # (n, 6): of its origin, world; rate, its own axes
    acceleration: FloatArray  # (n, 6): the same
    before: FloatArray  # (n, 6): velocity half a step before
    pressure_pa: FloatArray  # (n,) of the air; empty without
    wind: FloatArray  # (n, 3) unit vector in the base's axes, the way the air moves past it


class _Sum:
    """Running sums of rows (n, 3) from chunk to chunk, and of all before each."""

    def __init__(self) -> None:
        self._last = np.zeros(3)

    def to(self, rows: FloatArray) -> FloatArray:
        """Sums to each row, (n, 3)."""
        out: FloatArray = np.cumsum(np.concatenate([self._last[None], rows]), axis=0)[1:]
        self._last = out[-1].copy()
        return out

    def before(self, accelerations: FloatArray, step_s: float, first: FloatArray) -> FloatArray:
        """Velocities half a step before each row, of that of the first of all and accelerations at the rows."""
        out = self.to(accelerations)
        out -= accelerations
        out *= step_s
        out += first
        return out


class CarrierMaker:
    """Draws a motion, and makes it as it is asked for; the base stands in the world's axes at the first row.

    Args:
        scenario: its ``[base_motion]``, and ``[coning]``, ``[vibration]``, ``[air]`` where they are given.
        step_s: between rows.
        count: of rows.
        rng: draws the sway, then the parts in the order named.
    """

    def __init__(self, scenario: Scenario, step_s: float, count: int, rng: np.random.Generator) -> None:
        self._scenario, self._step_s, self._count = scenario, step_s, count
        self._sway = Sway(scenario.base_motion, rng)
        self._phase = rng.uniform(0.0, 2.0 * np.pi) if scenario.coning is not None else 0.0
        self._shaking: Shaking | None = None
        self._twist_mean = np.zeros(3)
        if scenario.vibration is not None:
            again = copy.deepcopy(rng)
            self._shaking = Shaking(scenario.vibration, step_s, count, rng)
            self._twist_mean = _mean_twist(Shaking(scenario.vibration, step_s, count, again), step_s, count)
        if scenario.air is not None:
            self._gusts = Gusts(scenario.air, step_s, count, rng)
            self._wind_rad = rng.uniform(0.0, 2.0 * np.pi)
        self._turned, self._twisted, self._moved, self._way = (_Sum() for _ in range(4))
        self._attitude = np.array([1.0, 0.0, 0.0, 0.0])
        self._halfway = np.zeros((0, 6))  # velocity half a step before the next row
        self._first_m: FloatArray | None = None  # of the way, at the first row
        self._first_velocity = np.zeros(6)  # half a step before that
        self._made = self._kept_from = 0
        six = np.zeros((0, 6))
        self._kept = CarrierMotion(np.zeros((0, 7)), six, six, six, *_NOTHING)

    @property
    def kept(self) -> int:
        """Rows in memory."""
        return self._made - self._kept_from

    def rows(self, first: int, last: int) -> CarrierMotion:
        """Rows ``first`` to before ``last``; none before ``first`` is asked for after that."""
        if self._made < min(last, self._count):
            old = min(first, self._made) - self._kept_from
            chunks = [CarrierMotion(*(values[old:] for values in self._kept))]
            self._kept_from += old
            while self._made < min(last, self._count):
                end = min(self._made + CHUNK, self._count)
                chunks.append(self._chunk(self._made, end))
                self._made = end
            self._kept = CarrierMotion(*(np.concatenate(parts) for parts in zip(*chunks, strict=True)))
        own = slice(first - self._kept_from, last - self._kept_from)
        return CarrierMotion(*(values[own] for values in self._kept))

    def _swayed(self, begin: int, end: int) -> tuple[BasePath, FloatArray]:
        """The sway at rows, and its velocities half a step before each, (n, 6)."""
        last = min(2 * end, 2 * self._count - 1)
        halves: FloatArray = 0.5 * self._step_s * np.arange(2 * begin, last, dtype=np.float64)
        path = self._sway.take(halves)
        if not begin:
            self._halfway = path.velocity[:1] - 0.5 * self._step_s * path.acceleration[:1]
        before = np.concatenate([self._halfway, path.velocity[1::2]])
        self._halfway = before[end - begin :].copy()
        return BasePath(*(values[::2] for values in path)), before[: end - begin]

    def _chunk(self, begin: int, end: int) -> CarrierMotion:
        scenario, step_s, n = self._scenario, self._step_s, end - begin
        (pose, velocity, acceleration), before = self._swayed(begin, end)
        if scenario.coning is None and scenario.vibration is None and scenario.air is None:
            return CarrierMotion(pose, velocity, acceleration, before, *_NOTHING)
        times: FloatArray = step_s * np.arange(begin, end, dtype=np.float64)
        turning, rate_start, r = np.zeros((n, 3)), np.zeros(3), np.zeros(3)
        spin, pushed = 0.0, np.zeros((n, 3))
        shaken, twisted = np.zeros((n, 3)), np.zeros((n, 3))
        if scenario.coning is not None:
            turning = coning(scenario.coning, self._phase, times)
            rate_start = rate_before(scenario.coning, self._phase, step_s)
            spin, r = scenario.coning.spin_rad_s, np.asarray(scenario.coning.centre_of_mass_to_base_m)
        if self._shaking is not None:
            shaken, twisted = self._shaking.linear(n), self._shaking.angular(n)
        pressure, wind = _NOTHING
        if (air := scenario.air) is not None:
            pressure = dynamic_pressure(air, times, self._gusts.take(n))
            wind = wind_direction(air, spin, times, self._wind_rad)
            pushed = air.carrier_area_over_mass_m2_kg * pressure[:, None] * wind  # along the wind
            turning[:, 0] -= air.pitch_moment_rad_s2_per_m_s2 * pushed[:, 1]  # across z and the push
            turning[:, 1] += air.pitch_moment_rad_s2_per_m_s2 * pushed[:, 0]
            turning[:, 2] += air.roll_moment_rad_s2_per_m_s2 * np.linalg.norm(pushed, axis=1)
        rigid_before = self._turned.before(turning, step_s, rate_start)
        twist_before = self._twisted.before(twisted, step_s, np.zeros(3))
        rigid = rigid_before + 0.5 * step_s * turning
        twist_before -= self._twist_mean
        befores, accelerations, poses = np.empty((n, 6)), np.empty((n, 6)), np.empty((n, 7))
        befores[:, 3:] = rigid_before + twist_before + before[:, 3:]
        accelerations[:, 3:] = turning + twisted + acceleration[:, 3:]
        turns = step_s * befores[:, 3:]
        if not begin:
            turns[0] = 0.0
            self._first_velocity = before[0, :3].copy()
        poses[:, 3:] = attitudes(turns, self._attitude)
        arm = np.broadcast_to(r, turning.shape)
        own = cross(turning, arm)  # base axes
        own += cross(rigid, cross(rigid, arm))
        own += pushed
        own += shaken
        np.add(acceleration[:, :3], turned(poses[:, 3:], own), out=accelerations[:, :3])
        befores[:, :3] = self._moved.before(accelerations[:, :3], step_s, self._first_velocity)
        way = self._way.to(befores[:, :3])
        self._first_m = way[0].copy() if self._first_m is None else self._first_m
        poses[:, :3] = (way - self._first_m) * step_s
        return CarrierMotion(poses, befores + 0.5 * step_s * accelerations, accelerations, befores, pressure, wind)


def _mean_twist(shaking: Shaking, step_s: float, count: int) -> FloatArray:
    """Mean of the rates (3,) that the vibration alone would give: the structure does not turn on the whole."""
    twisted, total = _Sum(), _Sum()
    for begin in range(0, count, CHUNK):
        found = total.to(twisted.before(shaking.angular(min(CHUNK, count - begin)), step_s, np.zeros(3)))
    return np.asarray(found[-1] / count)


def carried(scenario: Scenario, step_s: float, count: int, rng: np.random.Generator) -> CarrierMotion:
    """The whole of a motion; see ``CarrierMaker``."""
    return CarrierMaker(scenario, step_s, count, rng).rows(0, count)


def turned(attitude: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) in the axes of attitudes (n, 4), in the world's axes."""
    w, axis = attitude[:, :1], attitude[:, 1:]
    twice = 2.0 * cross(axis, vectors)
    return np.asarray(vectors + w * twice + cross(axis, twice), np.float64)
