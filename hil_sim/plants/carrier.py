"""Motion of a prescribed base on the rows of a plant: its sway, and the parts that a scenario names.

The parts are those of ``motion``: a carrier that cones, structural vibration, the air that brakes and turns the
carrier. Rates and accelerations are sums by axis. Angular rates half a step before each row are kept beside those at
the rows: their differences over the step are the angular accelerations, which is the leapfrog that ``servo_flight``
integrates.
"""

from typing import NamedTuple

import numpy as np

from hil_sim.arrays import FloatArray, cross
from hil_sim.plants.base_sway import attitudes, sway
from hil_sim.plants.motion import coning, dynamic_pressure, vibration, wind_direction
from hil_sim.scenario.vehicle_tables import VehicleScenario


class Carried(NamedTuple):
    """A base's motion, row k at ``t_k`` unless said: MuJoCo's numbers of a free joint."""

    pose: FloatArray  # (n, 7): place, world; w x y z of its attitude
    velocity: FloatArray  # (n, 6): of its origin, world; rate, its own axes
    acceleration: FloatArray  # (n, 6): the same
    before: FloatArray  # (n, 6): velocity half a step before
    pressure_pa: FloatArray  # (n,) of the air; empty without
    wind: FloatArray  # (n, 3) unit vector in the base's axes, the way the air moves past it


def carried(scenario: VehicleScenario, step_s: float, count: int, rng: np.random.Generator) -> Carried:
    """Draw a motion; the base stands in the world's axes at the first row.

    Args:
        scenario: its ``[base_motion]``, and ``[coning]``, ``[vibration]``, ``[air]`` where they are given.
        step_s: between rows.
        count: of rows, n.
        rng: draws the sway, then the parts in the order named.
    """
    halves: FloatArray = 0.5 * step_s * np.arange(2 * count - 1, dtype=np.float64)
    path = sway(scenario.base_motion, halves, rng)
    pose, velocity, acceleration = path.pose[::2], path.velocity[::2], path.acceleration[::2]
    first = path.velocity[:1] - 0.5 * step_s * path.acceleration[:1]
    before = np.concatenate([first, path.velocity[1::2]])
    nothing = np.zeros(0), np.zeros((0, 3))
    if scenario.coning is None and scenario.vibration is None and scenario.air is None:
        return Carried(pose, velocity, acceleration, before, *nothing)
    times: FloatArray = step_s * np.arange(count, dtype=np.float64)
    turning, rate_start, r = np.zeros((count, 3)), np.zeros(3), np.zeros(3)
    spin, pushed = 0.0, np.zeros((count, 3))
    shaken, twisted = np.zeros((count, 3)), np.zeros((count, 3))
    if scenario.coning is not None:
        turning, rate_start = coning(scenario.coning, times, step_s, rng)
        spin, r = scenario.coning.spin_rad_s, np.asarray(scenario.coning.centre_of_mass_to_base_m)
    if scenario.vibration is not None:
        shaken, twisted = vibration(scenario.vibration, step_s, count, rng)
    air, pressure, wind = scenario.air, *nothing
    if air is not None:
        pressure = dynamic_pressure(air.pressure_Pa, air, times, step_s, rng)
        wind = wind_direction(air, spin, times, rng)
        pushed = air.carrier_area_over_mass_m2_kg * pressure[:, None] * wind  # along the wind
        turning[:, 0] -= air.pitch_moment_rad_s2_per_m_s2 * pushed[:, 1]  # across z and the push
        turning[:, 1] += air.pitch_moment_rad_s2_per_m_s2 * pushed[:, 0]
        turning[:, 2] += air.roll_moment_rad_s2_per_m_s2 * np.linalg.norm(pushed, axis=1)
    rigid_before, twist_before = _before(turning, step_s, rate_start), _before(twisted, step_s, np.zeros(3))
    rigid = rigid_before + 0.5 * step_s * turning
    twist_before -= twist_before.mean(axis=0)
    befores, accelerations, poses = np.empty((count, 6)), np.empty((count, 6)), np.empty((count, 7))
    rate_before = befores[:, 3:]
    np.add(rigid_before, twist_before, out=rate_before)
    rate_before += before[:, 3:]
    np.add(turning, twisted, out=accelerations[:, 3:])
    accelerations[:, 3:] += acceleration[:, 3:]
    poses[:, 3:] = attitudes(step_s * rate_before)
    arm = np.broadcast_to(r, turning.shape)
    own = cross(turning, arm)  # base axes
    own += cross(rigid, cross(rigid, arm))
    own += pushed
    own += shaken
    np.add(acceleration[:, :3], turned(poses[:, 3:], own), out=accelerations[:, :3])
    befores[:, :3] = _before(accelerations[:, :3], step_s, before[0, :3])
    np.cumsum(befores[:, :3], axis=0, out=poses[:, :3])
    poses[:, :3] -= poses[0, :3].copy()
    poses[:, :3] *= step_s
    return Carried(poses, befores + 0.5 * step_s * accelerations, accelerations, befores, pressure, wind)


def _before(accelerations: FloatArray, step_s: float, first: FloatArray) -> FloatArray:
    """Velocities half a step before each row, of those of the first and accelerations at the rows, (n, 3)."""
    out: FloatArray = np.cumsum(accelerations, axis=0)
    out -= accelerations
    out *= step_s
    out += first
    return out


def turned(attitude: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) in the axes of attitudes (n, 4), in the world's axes."""
    w, axis = attitude[:, :1], attitude[:, 1:]
    twice = 2.0 * cross(axis, vectors)
    return np.asarray(vectors + w * twice + cross(axis, twice), np.float64)
