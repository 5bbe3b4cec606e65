"""A base that nothing pushes, most of a flight: it moves by the motion of its joints alone."""

from collections.abc import Sequence

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray, solved_unchecked

Told = tuple[FloatArray, FloatArray, FloatArray]  # of the joints, (j,) each: angle, rate and acceleration


class Coasting:
    """Steps such a base.

    Args:
        model: the vehicle.
        data: its state, of which the first numbers are the base's.
        pose: how many of the positions.
        freedom: how many of the velocities, b.

    Attributes:
        acceleration: of the base, (b,), in the state.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, pose: int, freedom: int) -> None:
        self._model, self._data = model, data
        self._pose, self._joints = data.qpos[:pose], data.qpos[pose:]
        self._velocity, self._rates = data.qvel[:freedom], data.qvel[freedom:]
        self.acceleration, self._accelerations = data.qacc[:freedom], data.qacc[freedom:]
        self._wrench, self._inertia = data.qfrc_inverse[:freedom], np.zeros((model.nv, model.nv))
        self._own_inertia = self._inertia[:freedom, :freedom]

    def accelerate(self, pose: FloatArray, velocity: FloatArray, told: Told) -> FloatArray:
        """Acceleration of the base, (b,); the state has it at zero, and the joints' own."""
        self._pose[:], self._velocity[:] = pose, velocity
        self._joints[:], self._rates[:], self._accelerations[:] = told
        self.acceleration[:] = 0.0
        mujoco.mj_inverse(self._model, self._data)
        mujoco.mj_fullM(self._model, self._data, self._inertia)
        return solved_unchecked(self._own_inertia, -self._wrench)

    def step(
        self, pose: FloatArray, velocity: FloatArray, told: Sequence[Told], step_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Pose and velocity after a Runge-Kutta step; the state has the acceleration at its start.

        Args:
            pose: at the start.
            velocity: at the start, (b,).
            told: of the joints at the start, half-way and at the end.
            step_s: length.
        """
        rates, forces = [velocity], [self.acceleration.copy()]
        for stage, part_s in ((1, 0.5 * step_s), (1, 0.5 * step_s), (2, step_s)):
            next_rate = velocity + part_s * forces[-1]
            forces.append(self.accelerate(moved(pose, rates[-1], part_s), next_rate, told[stage]))
            rates.append(next_rate)
        return moved(pose, mean(rates), step_s), velocity + step_s * mean(forces)


def moved(pose: FloatArray, velocity: FloatArray, step_s: float) -> FloatArray:
    """The base's pose after a step with a constant velocity."""
    if len(pose) in (0, 3):
        return np.asarray(pose + step_s * velocity, np.float64)
    pose = pose.copy()
    pose[:-4] += step_s * velocity[:-3]
    mujoco.mju_quatIntegrate(pose[-4:], velocity[-3:], step_s)
    return pose


def mean(rates: Sequence[FloatArray]) -> FloatArray:
    """Of the four stages of a Runge-Kutta step."""
    first, second, third, fourth = rates
    return (first + 2.0 * second + 2.0 * third + fourth) / 6.0
