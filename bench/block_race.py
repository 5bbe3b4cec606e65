"""Stoneking's block system and MuJoCo integrate the same chain of ball joints with the same steps.

``bench/mechanics.py`` runs it over a minute and times both; the test of the block system asks for the agreement.
"""

import time

import mujoco
import numpy as np
import pinocchio as pin

from bench.block_system import BlockState, BlockSystem
from onboard.dynamics.mechanics.chain import SerialChain
from onboard.estimation.arrays import FloatArray


def ball_jointed(chain: SerialChain, step_s: float) -> mujoco.MjModel:
    """The same chain in MJCF, its joints spherical."""

    def numbers(values: FloatArray) -> str:
        return " ".join(repr(float(v)) for v in np.ravel(values))

    def body(i: int) -> str:
        full = numbers(chain.inertia[i][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        inertial = f'<inertial pos="{numbers(chain.centre[i])}" mass="{float(chain.mass[i])!r}" fullinertia="{full}"/>'
        w = pin.Quaternion(chain.next_axes[i - 1]).coeffs() if i else None
        place = f'pos="{numbers(chain.next_origin[i - 1])}" quat="{numbers(w[[3, 0, 1, 2]])}"' if i else ""
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
