"""Stoneking's block system: Newton and Euler of bodies joined by passive spherical joints (2.102-2.109).

All accelerations and joint forces of a chain of N bodies are one linear system of order 6 N + 3 (N - 1): each body's
angular and linear acceleration, and the constraint that both bodies of a joint accelerate alike there. Accelerations
are eliminated block by block: what a force at one joint of a body does to the acceleration of its other joint is
constant in the body's axes, so that what is left is a symmetric system of order 3 (N - 1) for the joint forces. Rates
are in body axes, velocities and forces in inertial ones. Integrated by Runge and Kutta's fourth order; positions
follow from the first body's, so joints do not come apart.

Stoneking's block system and MuJoCo integrate the same chain of ball joints with the same steps.

``bench/mechanics.py`` runs it over a minute and times both; the test of the block system asks for the agreement.
"""

import time
from typing import NamedTuple

import mujoco
import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided
from scipy.linalg.lapack import dposv

from onboard.dynamics.mechanics.chain import SerialChain
from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import FloatArray

_SKEW = np.stack([pin.skew(unit) for unit in np.eye(3)]).reshape(3, 9)  # w @ _SKEW: the matrix of w x, row by row


class BlockState(NamedTuple):
    """Of N bodies."""

    R: FloatArray  # (N, 3, 3) R_Wi
    rate: FloatArray  # (N, 3) rad/s, body axes
    position: FloatArray  # (3,) m, centre of mass of the first body, inertial axes
    velocity: FloatArray  # (3,) m/s


class BlockSystem:
    """A chain of bodies with spherical joints.

    Args:
        chain: masses, centres of mass, inertias and joint places; its joints' axes are not used.

    Raises:
        SignalError: fewer than two bodies.
    """

    def __init__(self, chain: SerialChain) -> None:
        n = len(chain.mass)
        if n < 2:
            raise SignalError("a block system joins two bodies or more")
        self.bodies, self._mass = n, chain.mass
        self._inertia, self._inverse = chain.inertia, np.linalg.inv(chain.inertia)
        places = np.stack([chain.next_origin - chain.centre, -chain.centre], axis=1)  # joint after the body, before it
        self._places = np.ascontiguousarray(np.swapaxes(places, 1, 2))  # (N, 3, 2)
        lever = (places @ _SKEW).reshape(n, 2, 3, 3)  # (N, 2, 3, 3)
        self._swing = -lever.reshape(n, 6, 3)  # angular acceleration to those of both places
        sign = np.array([-1.0, 1.0])  # a joint's force acts on the body after it, its opposite on the one before
        self._by_force = sign[:, None, None] * (self._inverse[:, None] @ lever)  # (N, 2, 3, 3) angular acceleration
        pair = -lever[:, :, None] @ self._inverse[:, None, None] @ lever[:, None]  # (N, 2, 2, 3, 3)
        pair += np.eye(3) / chain.mass[:, None, None, None, None]
        self._pairs = sign[:, None, None, None] * sign[:, None, None] * pair  # acceleration at one place by the other
        self._system = np.zeros((3 * (n - 1), 3 * (n - 1)))
        row, column = self._system.strides
        step = 3 * (row + column), row, column
        self._own = as_strided(self._system, (n - 1, 3, 3), step)  # diagonal blocks, and those below them
        self._below = as_strided(self._system[3:], (n - 2, 3, 3), step)

    def accelerations(self, R: FloatArray, rate: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Angular accelerations (N, 3), body axes, and the first body's linear one (3,), inertial axes (2.109).

        Args:
            R: axes of the bodies, (N, 3, 3).
            rate: their rates, (N, 3), body axes.
            torque: of each joint on the body after it, (N - 1, 3), inertial axes.
        """
        n = self.bodies
        turning = np.swapaxes(R, 1, 2)  # R_iW
        spin = (rate @ _SKEW).reshape(n, 3, 3)
        applied = -(spin @ (self._inertia @ rate[:, :, None]))  # (N, 3, 1)
        applied[1:] += turning[1:] @ torque[:, :, None]
        applied[:-1] -= turning[:-1] @ torque[:, :, None]
        free = self._inverse @ applied  # with joints that exert no force
        at = spin @ (spin @ self._places) + np.swapaxes((self._swing @ free).reshape(n, 2, 3), 1, 2)
        at = R @ at  # (N, 3, 2) accelerations of both places, inertial axes
        pairs = R[:, None, None] @ self._pairs @ turning[:, None, None]
        np.add(pairs[:-1, 0, 0], pairs[1:, 1, 1], out=self._own)
        self._below[...] = pairs[1:-1, 0, 1]
        apart = (at[:-1, :, 0] - at[1:, :, 1]).ravel()
        force = dposv(self._system, apart, lower=1)[1].reshape(n - 1, 3, 1)
        angular = free
        angular[:-1] += self._by_force[:-1, 0] @ (turning[:-1] @ force)
        angular[1:] += self._by_force[1:, 1] @ (turning[1:] @ force)
        return angular[:, :, 0], -force[0, :, 0] / self._mass[0]

    def step(self, state: BlockState, step_s: float, torque: FloatArray | None = None) -> BlockState:
        """One step of Runge and Kutta, joint torques held, (N - 1, 3)."""
        tau = np.zeros((self.bodies - 1, 3)) if torque is None else torque
        slopes: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = []
        for share in (0.0, 0.5, 0.5, 1.0):
            R, rate, velocity = state.R, state.rate, state.velocity
            if slopes:
                spin, acceleration, linear, _ = slopes[-1]
                R = _turned(state.R, share * step_s * spin)
                rate, velocity = state.rate + share * step_s * acceleration, state.velocity + share * step_s * linear
            acceleration, linear = self.accelerations(R, rate, tau)
            slopes.append((rate, acceleration, linear, velocity))
        spin, acceleration, linear, velocity = (
            (a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(*slopes, strict=True)
        )
        return BlockState(
            _turned(state.R, step_s * spin),
            state.rate + step_s * acceleration,
            state.position + step_s * velocity,
            state.velocity + step_s * linear,
        )


def _turned(R: FloatArray, angle: FloatArray) -> FloatArray:
    return np.stack([one @ pin.exp3(by) for one, by in zip(R, angle, strict=True)])


def ball_jointed(chain: SerialChain, step_s: float) -> mujoco.MjModel:
    """The same chain in MJCF, its joints spherical."""

    def numbers(values: FloatArray) -> str:
        return " ".join(repr(float(v)) for v in np.ravel(values))

    def body(i: int) -> str:
        full = numbers(chain.inertia[i][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        inertial = f'<inertial pos="{numbers(chain.centre[i])}" mass="{float(chain.mass[i])!r}" fullinertia="{full}"/>'
        w = pin.Quaternion(chain.next_axes[i - 1]).coeffs()[[3, 0, 1, 2]] if i else np.empty(0)
        place = f'pos="{numbers(chain.next_origin[i - 1])}" quat="{numbers(w)}"' if i else ""
        joint = '<joint type="ball"/>' if i else "<freejoint/>"
        inner = body(i + 1) if i + 1 < len(chain.mass) else ""
        return f'<body name="b{i}" {place}>{joint}{inertial}{inner}</body>'

    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler boundmass="0" boundinertia="0"/><option gravity="0 0 0" integrator="RK4" '
        f'timestep="{step_s!r}"><flag contact="disable"/></option><worldbody>{body(0)}</worldbody></mujoco>'
    )


class BlockRace:
    """Both from the same state.

    Args:
        chain: of N bodies.
        relative: rate of each body in the one before, its axes, (N, 3) rad/s.
        step_s: of both.

    Attributes:
        state: the block system's.
        ours_s, theirs_s: CPU time that each took so far.
    """

    def __init__(self, chain: SerialChain, relative: FloatArray, step_s: float) -> None:
        n = len(chain.mass)
        self.system, self.step_s = BlockSystem(chain), step_s
        self.model = ball_jointed(chain, step_s)
        self.data = mujoco.MjData(self.model)
        self.data.qvel[3:6], self.data.qvel[6:] = relative[0], relative[1:].ravel()
        mujoco.mj_forward(self.model, self.data)
        R = np.array([self.data.body(f"b{i}").xmat.reshape(3, 3) for i in range(n)])
        rate = np.array(relative, np.float64)
        for i in range(1, n):
            rate[i] += R[i].T @ R[i - 1] @ rate[i - 1]
        velocity = R[0] @ np.cross(rate[0], chain.centre[0])
        self.state = BlockState(R, rate, np.array(self.data.body("b0").xipos), velocity)
        self.ours_s = self.theirs_s = 0.0

    def run(self, seconds: float) -> None:
        """Advance both."""
        for _ in range(round(seconds / self.step_s)):
            start = time.process_time()
            self.state = self.system.step(self.state, self.step_s)
            between = time.process_time()
            mujoco.mj_step(self.model, self.data)
            self.ours_s += between - start
            self.theirs_s += time.process_time() - between

    def mujoco_rates(self) -> FloatArray:
        """Angular rates of MuJoCo's bodies, (N, 3) rad/s, their axes."""
        mujoco.mj_forward(self.model, self.data)
        out, twist = np.empty((self.system.bodies, 3)), np.zeros(6)
        for i in range(len(out)):
            body = self.data.body(f"b{i}").id
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 1)
            out[i] = twist[:3]
        return out

    def relative_error(self) -> float:
        """Largest difference of a rate, of the largest rate."""
        theirs = self.mujoco_rates()
        return float(np.abs(self.state.rate - theirs).max() / np.abs(theirs).max())
