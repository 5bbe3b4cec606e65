"""Motion of a base that is prescribed: it sways, each axis by tones drawn per seed."""

from typing import NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.scenario.vehicle_tables import BaseSway

_BLOCK = 96  # attitudes that are made side by side


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
    acceleration, velocity, pose = np.zeros((len(time_s), 6)), np.zeros((len(time_s), 6)), np.zeros((len(time_s), 7))
    if not rms.any():
        pose[:, 3] = 1.0
        return BasePath(pose, velocity, acceleration)
    turn = time_s[:, None, None] * w + phase  # (n, 6, tones)
    sine, cosine = size * np.sin(turn), size * np.cos(turn)
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
    pose[:, 3:] = attitudes(np.concatenate([np.zeros((1, 3)), middle * np.diff(time_s)[:, None]]))
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


def attitudes(turns_rad: FloatArray) -> FloatArray:
    """Attitudes of a body that stands in the world's axes at the first row, quaternions w x y z, (n, 4).

    Args:
        turns_rad: rotation vector from the row before to each, its own axes, (n, 3); that of the first is not used.
    """
    n = len(turns_rad)
    blocks = -(-n // _BLOCK)
    turn = np.zeros((blocks * _BLOCK, 3))
    turn[1:n] = turns_rad[1:]
    own = np.empty((4, _BLOCK, blocks))  # within each block, then from block to block
    turns = turn.T.reshape(3, blocks, _BLOCK).transpose(0, 2, 1)
    half = 0.5 * np.sqrt((turns * turns).sum(axis=0))
    np.cos(half, out=own[0])
    np.multiply(0.5 * np.sinc(half / np.pi), turns, out=own[1:])
    for k in range(1, _BLOCK):
        own[:, k] = _times(own[:, k - 1], own[:, k])
    starts = np.empty((blocks, 4))
    at = np.array([1.0, 0.0, 0.0, 0.0])
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
