"""A laboratory's motion capture: pose of a frame of markers on the vehicle, in the laboratory's axes.

The axes of the laboratory are drawn: any attitude, an origin a few metres away. The markers' frame is a little off
where it is drawn. Noise is white, of each pose alone. Left out: errors that change with the place in the room, and
markers that are seen by fewer cameras at times.
"""

from typing import Any

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.world import Plant
from hil_sim.scenario.sensor_tables import PoseTable
from hil_sim.sensing.interpolation import interpolate

_ROOM_m = 2.0  # 1 sigma of each coordinate of where the vehicle's first place lies in the laboratory's axes


class PoseSensor:
    """The tracker's cameras and its solver, without latency."""

    def __init__(self, plant: Plant, table: PoseTable, rng: np.random.Generator, at: str = "") -> None:
        self._plant, self._pose = plant, plant.pose(at)
        self.turn = unit(rng.standard_normal(4))  # inertial axes in the laboratory's
        self.room_m = _ROOM_m * rng.standard_normal(3)
        self.scale = 1.0 + table.scale_sigma * float(rng.standard_normal())
        self.place_m = 1e-3 * table.place_sigma_mm * rng.standard_normal(3)
        self.mounting_rad = np.deg2rad(table.mounting_sigma_deg) * rng.standard_normal(3)
        self._noise = 1e-3 * table.position_noise_mm, np.deg2rad(table.attitude_noise_deg)
        self._rng = rng.spawn(1)[0]

    def poses(self, times_s: FloatArray) -> FloatArray:
        """Position, m, and attitude, w x y z, without noise, at mission times (n,); (n, 7)."""
        if len(times_s):
            self._plant.require(float(times_s[0]))
            self._plant.require(float(times_s[-1]))
        true = interpolate(self._pose, times_s / self._plant.step_s)
        true[:, 3:] /= np.linalg.norm(true[:, 3:], axis=1, keepdims=True)
        out = np.empty_like(true)
        marker = true[:, :3] + turned(true[:, 3:], np.broadcast_to(self.place_m, (len(true), 3)))
        out[:, :3] = self.scale * (turned(np.broadcast_to(self.turn, (len(true), 4)), marker) + self.room_m)
        mounted = product(true[:, 3:], small(np.broadcast_to(self.mounting_rad, (len(true), 3))))
        out[:, 3:] = product(np.broadcast_to(self.turn, (len(true), 4)), mounted)
        return out

    def noisy(self, poses: FloatArray) -> FloatArray:
        """Poses (n, 7) with noise of their own."""
        position, attitude = self._noise
        out = poses.copy()
        out[:, :3] += position * self._rng.standard_normal((len(poses), 3))
        out[:, 3:] = product(poses[:, 3:], small(attitude * self._rng.standard_normal((len(poses), 3))))
        return out

    def truth(self) -> dict[str, Any]:
        """The errors drawn, and the laboratory's axes."""
        return {
            "scale": self.scale,
            "place_m": self.place_m,
            "mounting_rad": self.mounting_rad,
            "laboratory_quaternion": self.turn,
            "laboratory_m": self.room_m,
        }


def unit(quaternion: FloatArray) -> FloatArray:
    """Of length one."""
    return np.asarray(quaternion / np.linalg.norm(quaternion), np.float64)


def small(turn_rad: FloatArray) -> FloatArray:
    """Quaternions of small rotation vectors, (n, 3) to (n, 4)."""
    whole = np.column_stack([np.ones(len(turn_rad)), 0.5 * turn_rad])
    return np.asarray(whole / np.linalg.norm(whole, axis=1, keepdims=True), np.float64)


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Hamilton's product of quaternions (n, 4)."""
    w = p[:, :1] * q[:, :1] - np.sum(p[:, 1:] * q[:, 1:], axis=1, keepdims=True)
    v = p[:, :1] * q[:, 1:] + q[:, :1] * p[:, 1:] + np.cross(p[:, 1:], q[:, 1:])
    return np.hstack([w, v])


def turned(q: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (n, 3) turned by unit quaternions (n, 4)."""
    t = 2.0 * np.cross(q[:, 1:], v)
    return np.asarray(v + q[:, :1] * t + np.cross(q[:, 1:], t), np.float64)
