"""Motion of a base that is prescribed: it sways, each axis by tones drawn per seed."""

from typing import NamedTuple

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.scenario.vehicle_tables import BaseSway


class BasePath(NamedTuple):
    """A base's motion on a grid: MuJoCo's numbers of a free joint, (n, ...)."""

    pose: FloatArray  # (n, 7): place, world; w x y z of its attitude
    velocity: FloatArray  # (n, 6): of its origin, world; rate, its own axes
    acceleration: FloatArray  # (n, 6): the same


def sway(table: BaseSway, time_s: FloatArray, rng: np.random.Generator) -> BasePath:
    """A drawn motion at evenly spaced times (n,); the base stands in the world's axes at the first.

    Up to ``still_s`` it coasts without turning; rate and acceleration then grow within ``ramp_s``.
    """
    shape = (6, table.tones)
    w = 2.0 * np.pi * rng.uniform(*table.band_Hz, shape)
    phase = rng.uniform(0.0, 2.0 * np.pi, shape)
    rms = np.repeat([table.acceleration_m_s2, table.rate_rad_s], 3)[:, None]
    size = rms * np.sqrt(2.0 / table.tones) * rng.uniform(0.6, 1.2, shape)
    turn = time_s[:, None, None] * w + phase  # (n, 6, tones)
    sine, cosine = size * np.sin(turn), size * np.cos(turn)
    acceleration, velocity, pose = np.zeros((len(time_s), 6)), np.zeros((len(time_s), 6)), np.zeros((len(time_s), 7))
    swings, slope = sine.sum(axis=2), (cosine * w).sum(axis=2)
    grown, growth = _grown(table, time_s)
    acceleration[:, :3] = grown * swings[:, :3]
    if table.still_s > 0.0:
        velocity[:, :3] = _integral(acceleration[:, :3], time_s)
        pose[:, :3] = _integral(velocity[:, :3], time_s)
    else:
        velocity[:, :3] = -(cosine / w).sum(axis=2)[:, :3]
        pose[:, :3] = -(sine / w**2).sum(axis=2)[:, :3]
    velocity[:, 3:] = grown * swings[:, 3:]
    acceleration[:, 3:] = grown * slope[:, 3:] + growth * swings[:, 3:]
    middle = 0.5 * (velocity[1:, 3:] + velocity[:-1, 3:])
    attitude = np.array([1.0, 0.0, 0.0, 0.0])
    pose[0, 3:] = attitude
    for k, step_s in enumerate(np.diff(time_s)):
        attitude = _turned(attitude, middle[k] * step_s)
        pose[k + 1, 3:] = attitude
    return BasePath(pose, velocity, acceleration)


def _grown(table: BaseSway, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Share of the motion at times (n,) and its rate of change, (n, 1) each: a quintic after ``still_s``."""
    if table.still_s == 0.0:
        return np.ones((len(time_s), 1)), np.zeros((len(time_s), 1))
    s = np.clip((time_s - table.still_s) / table.ramp_s, 0.0, 1.0)[:, None]
    return s**3 * (10.0 + s * (-15.0 + 6.0 * s)), 30.0 * (s * (1.0 - s)) ** 2 / table.ramp_s


def _integral(values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Of values (n, 3) over time, zero at the first, by trapezoids."""
    out = np.zeros_like(values)
    out[1:] = np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s)[:, None], axis=0)
    return out


def _turned(attitude: FloatArray, turn: FloatArray) -> FloatArray:
    """An attitude, w x y z, turned by a rotation vector in its own axes, rad."""
    angle = float(np.linalg.norm(turn))
    w, x, y, z = np.cos(0.5 * angle), *(0.5 * np.sinc(0.5 * angle / np.pi) * turn)
    left = np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])
    out: FloatArray = left @ attitude
    return np.asarray(out / np.linalg.norm(out), np.float64)
