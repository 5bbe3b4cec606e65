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
