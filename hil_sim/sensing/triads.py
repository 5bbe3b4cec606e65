"""Errors of a three-axis sensor: drawn once per seed, and those of its bias that change in flight."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from hil_sim import filters
from hil_sim.arrays import FloatArray
from hil_sim.scenario.sensor_tables import Axes


def within_limits(rng: np.random.Generator, shape: int | tuple[int, ...]) -> FloatArray:
    """Normal deviates truncated at two standard deviations, the datasheet limits."""
    low, high = special.ndtr([-2.0, 2.0])
    deviates: FloatArray = special.ndtri(rng.uniform(low, high, shape))
    return deviates


@dataclass(frozen=True)
class Triad:
    """Errors of a three-axis sensor: reading = matrix (I + scale + cross-axis) x truth + bias + per kelvin x rise."""

    matrix: FloatArray  # (3, 3)
    bias: FloatArray  # (3,)
    per_kelvin: FloatArray  # (3,)

    @staticmethod
    def draw(axes: Axes, mounting: FloatArray, rng: np.random.Generator) -> "Triad":
        """``mounting`` (3,): small rotation of the package [rad]; it turns accelerometer and gyro together."""
        own = np.eye(3) + np.diag(axes.scale_sigma * within_limits(rng, 3))
        own += axes.cross_axis_sigma * within_limits(rng, (3, 3)) * (1.0 - np.eye(3))
        x, y, z = mounting
        package = np.eye(3) - np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # designed axes to package axes
        matrix = own @ package
        bias = np.asarray(axes.bias_sigma) * within_limits(rng, 3)
        per_kelvin = np.asarray(axes.bias_per_kelvin_sigma) * within_limits(rng, 3)
        for array in (matrix, bias, per_kelvin):
            array.setflags(write=False)
        return Triad(matrix, bias, per_kelvin)


class Wander:
    """Change of a triad's bias in flight: a Gauss-Markov process (in place of flicker) and a random walk."""

    def __init__(self, axes: Axes, step_s: float, rng: np.random.Generator) -> None:
        self._memory = math.exp(-step_s / axes.bias_instability_time_s)
        self._sigmas = axes.bias_instability, axes.bias_walk_sqrt_s * math.sqrt(step_s)
        self._rng = rng.spawn(1)[0]  # the numbers that other errors are drawn from stay
        self._slow = axes.bias_instability * self._rng.standard_normal(3)
        self._walked = np.zeros(3)

    def add_to(self, rows: FloatArray) -> None:
        """Add the next rows, (n, 3)."""
        slow, walk = self._sigmas
        if slow:
            steps = slow * math.sqrt(1.0 - self._memory**2) * self._rng.standard_normal(rows.shape)
            own = filters.remembered(self._memory, steps, self._slow)
            rows += own
            self._slow = own[-1]
        if walk:
            walked = self._walked + np.cumsum(walk * self._rng.standard_normal(rows.shape), axis=0)
            rows += walked
            self._walked = walked[-1]
