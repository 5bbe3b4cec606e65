"""Motion of a prescribed base on the rows of a plant: its sway, and the parts that a scenario names.

The parts are those of ``motion``: a carrier that cones, structural vibration, the air that brakes and turns the
carrier. Rates and accelerations are sums by axis. Angular rates half a step before each row are kept beside those at
the rows: their differences over the step are the angular accelerations, which is the leapfrog that ``servo_flight``
integrates. The motion is made in chunks, and only what is asked for next is kept: a flight may last for hours.
"""

import copy
from typing import NamedTuple

import numpy as np

from hil_sim.arrays import FloatArray, cross
from hil_sim.plants.motions.base_sway import BasePath, Sway, attitudes
from hil_sim.plants.motions.motion import Gusts, Shaking, coning, dynamic_pressure, rate_before, wind_direction
from hil_sim.scenario.vehicle_tables import Scenario

CHUNK = 3840  # rows, whole blocks of the filters (64) and of attitudes (96)
_NOTHING = np.zeros(0), np.zeros((0, 3))


class Carried(NamedTuple):
    """A base's motion, row k at ``t_k`` unless said: MuJoCo's numbers of a free joint."""

    pose: FloatArray  # (n, 7): place, world; w x y z of its attitude
    velocity: FloatArray  # (n, 6): of its origin, world; rate, its own axes
    acceleration: FloatArray  # (n, 6): the same
    before: FloatArray  # (n, 6): velocity half a step before
    pressure_pa: FloatArray  # (n,) of the air; empty without
    wind: FloatArray  # (n, 3) unit vector in the base's axes, the way the air moves past it


class _Sum:
    """Running sums of rows (n, k) from chunk to chunk, and of all before each."""

    def __init__(self, columns: int) -> None:
        self._last = np.zeros(columns)

    def to(self, rows: FloatArray) -> FloatArray:
        """Sums to each row, (n, k)."""
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


class Carrier:
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
        self._turned, self._twisted, self._moved, self._way = (_Sum(3) for _ in range(4))
        self._attitude = np.array([1.0, 0.0, 0.0, 0.0])
        self._halfway = np.zeros((0, 6))  # velocity half a step before the next row
        self._first_m: FloatArray | None = None  # of the way, at the first row
        self._first_velocity = np.zeros(6)  # half a step before that
        self._made = self._kept_from = 0
        six = np.zeros((0, 6))
        self._kept = Carried(np.zeros((0, 7)), six, six, six, *_NOTHING)

    @property
    def kept(self) -> int:
        """Rows in memory."""
        return self._made - self._kept_from

    def rows(self, first: int, last: int) -> Carried:
        """Rows ``first`` to before ``last``; none before ``first`` is asked for after that."""
        if self._made < min(last, self._count):
            old = min(first, self._made) - self._kept_from
            chunks = [Carried(*(values[old:] for values in self._kept))]
            self._kept_from += old
            while self._made < min(last, self._count):
                end = min(self._made + CHUNK, self._count)
                chunks.append(self._chunk(self._made, end))
                self._made = end
            self._kept = Carried(*(np.concatenate(parts) for parts in zip(*chunks, strict=True)))
        own = slice(first - self._kept_from, last - self._kept_from)
        return Carried(*(values[own] for values in self._kept))

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

    def _chunk(self, begin: int, end: int) -> Carried:
        scenario, step_s, n = self._scenario, self._step_s, end - begin
        (pose, velocity, acceleration), before = self._swayed(begin, end)
        if scenario.coning is None and scenario.vibration is None and scenario.air is None:
            return Carried(pose, velocity, acceleration, before, *_NOTHING)
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
        return Carried(poses, befores + 0.5 * step_s * accelerations, accelerations, befores, pressure, wind)


def _mean_twist(shaking: Shaking, step_s: float, count: int) -> FloatArray:
    """Mean of the rates (3,) that the vibration alone would give: the structure does not turn on the whole."""
    twisted, total = _Sum(3), _Sum(3)
    for begin in range(0, count, CHUNK):
        found = total.to(twisted.before(shaking.angular(min(CHUNK, count - begin)), step_s, np.zeros(3)))
    return np.asarray(found[-1] / count)


def carried(scenario: Scenario, step_s: float, count: int, rng: np.random.Generator) -> Carried:
    """The whole of a motion; see ``Carrier``."""
    return Carrier(scenario, step_s, count, rng).rows(0, count)


def turned(attitude: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) in the axes of attitudes (n, 4), in the world's axes."""
    w, axis = attitude[:, :1], attitude[:, 1:]
    twice = 2.0 * cross(axis, vectors)
    return np.asarray(vectors + w * twice + cross(axis, twice), np.float64)
