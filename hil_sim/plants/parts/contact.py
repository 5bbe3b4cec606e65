"""Contact of a gripper with what it catches: a spring and a damper in six directions, until the grip is closed.

The payload is a free body meanwhile. The spring pulls its centre of mass to where the link is to hold it, and turns it
into the link's axes; the force acts at the payload's centre of mass on both bodies, so that momentum and angular
momentum are those of both. The grip closes about the payload where it then stands. With W and P the inverse inertias of
vehicle and payload there, (6, 6), the wrench of a relative motion x is ``-(W + P)^-1 (w^2 x + 2 z w dx/dt)``: then all
relative motion has the angular frequency w and the damping ratio z, also at the end of a long arm, which gives way.
"""

import math

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.body import Solid
from hil_sim.plants.parts.exchange import Moving, Released
from hil_sim.plants.urdf_model import matrix_of

_SETTLED = 6.0  # time constants of the spring after which the grip is closed: 0.25 % of the motion is left


class Contact:
    """A payload between its first touch and the closed grip.

    Args:
        payload: what is caught.
        frequency_Hz: of its motion against the link.
        damping_ratio: of that.
        gravity_m_s2: (3,) world axes.
        R: of the link at the first touch, (3, 3) to world axes.
        rate_rad_s: of the payload then, world axes.
        came: its place and momentum.
        mobility: of the vehicle there, (6, 6): acceleration, linear and angular, by force and torque; world axes.

    Attributes:
        state: place of the centre of mass, attitude as a quaternion, velocity, rate; (13,), world axes.
    """

    def __init__(
        self,
        payload: Solid,
        frequency_Hz: float,
        damping_ratio: float,
        gravity_m_s2: FloatArray,
        R: FloatArray,
        rate_rad_s: FloatArray,
        came: Moving,
        mobility: FloatArray,
    ) -> None:
        self.payload = payload
        self._w, self._ratio, self._gravity = 2.0 * math.pi * frequency_Hz, damping_ratio, gravity_m_s2
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, R.ravel())
        velocity = came.linear_kg_m_s / payload.mass_kg
        self.state: FloatArray = np.concatenate([came.at_m, quaternion, velocity, rate_rad_s])
        own = np.zeros((6, 6))
        own[:3, :3], own[3:, 3:] = np.eye(3) / payload.mass_kg, np.linalg.inv(payload.inertia_kg_m2)
        axes = np.kron(np.eye(2), R)
        reduced = np.linalg.inv(axes.T @ mobility @ axes + own)  # inertia of the relative motion, link's axes
        self._reduced = np.asarray(reduced, np.float64)

    @staticmethod
    def lasts_s(frequency_Hz: float, damping_ratio: float) -> float:
        """From the first touch until the grip is closed."""
        return _SETTLED / (damping_ratio * 2.0 * math.pi * frequency_Hz)

    def wrench(
        self, state: FloatArray, link: tuple[FloatArray, FloatArray], twist: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Force at the payload's centre of mass and torque, of the spring on the payload; world axes.

        Args:
            state: the payload's.
            link: rotation to world axes (3, 3) and place of the link's frame.
            twist: rate of the link and velocity of its frame.
        """
        (R, origin), (rate, velocity) = link, twist
        at, attitude, v, w = _split(state)
        R_p = matrix_of(attitude)
        stretch = at - origin - R @ self.payload.centre_of_mass_m
        slip = v - velocity - np.cross(rate, at - origin)
        away = np.concatenate([R.T @ stretch, _rotation_vector(R.T @ R_p)])
        moving = np.concatenate([R.T @ slip, R.T @ (w - rate)])
        wrench = -self._reduced @ (self._w**2 * away + 2.0 * self._ratio * self._w * moving)
        return R @ wrench[:3], R @ wrench[3:]

    def rates(self, state: FloatArray, force_n: FloatArray, torque_n_m: FloatArray) -> FloatArray:
        """Derivative of the state, (13,)."""
        _, (a, b, c, d), v, w = _split(state)
        R = matrix_of(state[3:7])
        inertia = R @ self.payload.inertia_kg_m2 @ R.T
        x, y, z = w
        turning = 0.5 * np.array(
            [-x * b - y * c - z * d, x * a + y * d - z * c, y * a + z * b - x * d, z * a + x * c - y * b]
        )
        acceleration = force_n / self.payload.mass_kg + self._gravity
        return np.concatenate(
            [v, turning, acceleration, np.linalg.solve(inertia, torque_n_m - np.cross(w, inertia @ w))]
        )

    def moved(self, state: FloatArray) -> None:
        """Stand at a state, its quaternion made one of length 1."""
        state[3:7] /= np.linalg.norm(state[3:7])
        self.state = state

    def released(self, link: tuple[FloatArray, FloatArray], twist: tuple[FloatArray, FloatArray]) -> Released:
        """The payload as it stands in its link, and its motion against that; arguments as of ``wrench``."""
        (R, origin), (rate, velocity) = link, twist
        at, attitude, v, w = _split(self.state)
        turned = self.payload.turned(R.T @ matrix_of(attitude))
        held = Solid(turned.mass_kg, R.T @ (at - origin), turned.inertia_kg_m2)
        return Released(held, R.T @ (v - np.cross(w, at - origin) - velocity), R.T @ (w - rate))


def _split(state: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    return state[:3], state[3:7], state[7:10], state[10:]


def _rotation_vector(R: FloatArray) -> FloatArray:
    """Axis times angle of a rotation, (3,)."""
    quaternion, out = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, R.ravel())
    mujoco.mju_quat2Vel(out, quaternion, 1.0)
    return out
