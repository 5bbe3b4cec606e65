"""The five-joint arm on a fixed base in gravity, with a six-axis load cell between its last link and a gripper.

The joints follow a prescribed motion exactly. MuJoCo's inverse dynamics gives force and moment at the wrist; the cell's
readings and the encoders' counts follow with errors drawn once per run. Error sizes are those of a small cell (40 N, 2
N m); no cross-talk, no drift within a run, joint zeros exact.
"""

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from hil_sim.arrays import FloatArray
from hil_sim.plants.free_flyer import COUNTS_PER_TURN, Body, GRASP_m, JointMotion, arm_xml, body_xml
from hil_sim.plants.motion import STANDARD_GRAVITY

GRIPPER = Body.box(0.45, (0.08, 0.06, 0.10), (0.003, -0.002, 0.040))
TOOL_m = (0.0, 0.0, 0.120)  # the tool's grasp frame in the gripper's, axes alike
COUNT_rad = 2.0 * np.pi / COUNTS_PER_TURN


@dataclass(frozen=True)
class WristErrors:
    """Errors of the wrist's readings: standard deviations per axis of forces, N, and of moments, N m."""

    noise: tuple[float, float] = (0.010, 3e-4)  # of a sample
    step: tuple[float, float] = (0.010, 2.5e-4)  # of a count
    bias: tuple[float, float] = (0.5, 0.02)
    scale: float = 0.0025  # relative, both


class ArmRun(NamedTuple):
    """One run of the arm on the grid of the samples."""

    time_s: FloatArray  # (n,)
    q_rad: FloatArray  # (n, 5)
    wrench: FloatArray  # (n, 6) of the arm on all beyond the cell: force N, moment N m; grasp frame
    held: NDArray[np.bool_]  # (n,)


class Readings(NamedTuple):
    """Sensor readings of a run."""

    time_s: FloatArray  # (n,)
    angle_rad: FloatArray  # (n, 5), in whole counts, the middle of each
    wrench: FloatArray  # (n, 6)
    noise: FloatArray  # (6,) standard deviation of a sample, its step included


def world(tool: Body | None, gripper: Body = GRIPPER) -> mujoco.MjModel:
    """MuJoCo model of the arm."""
    inside = "" if tool is None else body_xml("tool", tool, TOOL_m)
    hand = body_xml("gripper", gripper, GRASP_m, '<site name="cell"/>' + inside)
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/>'
        f'<option gravity="0 0 {-STANDARD_GRAVITY}"><flag contact="disable"/></option>'
        f"<worldbody>{arm_xml(hand)}</worldbody>"
        '<sensor><force site="cell"/><torque site="cell"/></sensor></mujoco>'
    )


def run(
    tool: Body, motion: JointMotion, grasp_s: float, end_s: float, gripper: Body = GRIPPER, step_s: float = 2e-3
) -> ArmRun:
    """One run: the gripper alone, then, from ``grasp_s`` on without shock, gripper and tool."""
    t = np.asarray(step_s * np.arange(round(end_s / step_s)), np.float64)
    held = t >= grasp_s
    q, dq, ddq = motion.at(t)
    wrench = np.empty((len(t), 6))
    for part, model in ((~held, world(None, gripper)), (held, world(tool, gripper))):
        data = mujoco.MjData(model)
        for k in np.flatnonzero(part):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
            mujoco.mj_inverse(model, data)
            wrench[k] = data.sensordata
    return ArmRun(t, q, wrench, held)


def read(flown: ArmRun, errors: WristErrors, rng: np.random.Generator) -> Readings:
    """Readings of the cell and the encoders for a run."""
    noise, step, bias = (np.repeat(pair, 3) for pair in (errors.noise, errors.step, errors.bias))
    scaled = flown.wrench * (1.0 + errors.scale * rng.standard_normal(6)) + bias * rng.standard_normal(6)
    counts = np.rint((scaled + noise * rng.standard_normal(scaled.shape)) / step)
    angle = (np.floor(flown.q_rad / COUNT_rad) + 0.5) * COUNT_rad
    return Readings(flown.time_s, angle, counts * step, np.hypot(noise, step / np.sqrt(12.0)))
