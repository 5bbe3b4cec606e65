"""The free-flyer on an air-bearing table: x, y and yaw are free; table tilt and drag of three pucks.

MuJoCo integrates the whole vehicle (RK4); its control callback gives the joint torques of the prescribed accelerations
and applies each puck's drag at its place: a viscous part and a Coulomb part (rounded within 2 mm/s).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants import free_flyer
from hil_sim.plants.motions.motion import STANDARD_GRAVITY
from hil_sim.plants.parts.pucks import AirPuck, drag_wrench

PUCKS_m = ((0.200, 0.0), (-0.100, 0.173), (-0.100, -0.173))  # of the carriage, base axes
_STIFFNESS, _DAMPING = 400.0, 40.0  # 1/s^2, 1/s: corrects integration error


@dataclass(frozen=True)
class Drag:
    """Drag coefficients of one puck."""

    viscous_N_s_m: float = 0.0  # noqa: N815
    coulomb_N: float = 0.0  # noqa: N815


class PlanarFlight(NamedTuple):
    """True signals on the grid of the samples."""

    time_s: FloatArray  # (n,)
    q_rad: FloatArray  # (n, 5)
    dq_rad_s: FloatArray  # (n, 5)
    rate_rad_s: FloatArray  # (n, 3) of the base, IMU axes
    specific_force_m_s2: FloatArray  # (n, 3) at the IMU, its axes: a - g
    velocity: FloatArray  # (n, 3) of the base's origin, base axes: x, y, m/s, and yaw rate, rad/s


def world(
    payload: free_flyer.Body,
    base: free_flyer.Body = free_flyer.BASE,
    arm: Sequence[free_flyer.Body] = free_flyer.ARM,
    tilt_m_s2: Sequence[float] | FloatArray = (0.0, 0.0),
) -> mujoco.MjModel:
    """The vehicle on its table; ``tilt_m_s2``: gravity along the table, table axes."""
    held = free_flyer.body_xml("payload", payload, free_flyer.GRASP_m)
    slides = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>'
    place, turn = (
        " ".join(repr(float(v)) for v in values) for values in (free_flyer.IMU_POSITION_m, free_flyer.IMU_QUATERNION)
    )
    imu = f'<site name="imu" pos="{place}" quat="{turn}"/>'
    on_base = slides + imu + free_flyer.arm_xml(held, arm)
    x, y = (float(value) for value in tilt_m_s2)
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/>'
        f'<option gravity="{x!r} {y!r} {-STANDARD_GRAVITY}" integrator="RK4" timestep="0.002">'
        '<flag contact="disable"/></option>'
        f"<worldbody>{free_flyer.body_xml('base', base, (0.0, 0.0, 0.0), on_base)}</worldbody>"
        '<sensor><gyro site="imu"/><accelerometer site="imu"/></sensor></mujoco>'
    )


def fly(
    model: mujoco.MjModel,
    motion: free_flyer.JointPath,
    velocity: Sequence[float] | FloatArray,
    drags: Sequence[Drag],
    duration_s: float,
) -> PlanarFlight:
    """One run: released with an initial velocity, then the arm moves.

    Args:
        model: from :func:`world`.
        motion: of the joints.
        velocity: of the base at the start: x, y, m/s, and yaw, rad/s, (3,).
        drags: of the three pucks.
        duration_s: of the run; samples at the model's step.
    """
    data = mujoco.MjData(model)
    samples, half_s = round(duration_s / model.opt.timestep), 0.5 * model.opt.timestep
    q, dq, ddq = motion.at(half_s * np.arange(2 * samples + 1))  # the stages of RK4 lie on half steps
    data.qpos[3:], data.qvel[3:], data.qvel[:3] = q[0], dq[0], velocity
    M = np.zeros((model.nv, model.nv))
    each = zip(PUCKS_m, drags, strict=True)
    pucks = [AirPuck(np.array([*place, 0.0]), drag.viscous_N_s_m, drag.coulomb_N) for place, drag in each]

    def torque(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        stage = round(data.time / half_s)
        joints = ddq[stage] + _STIFFNESS * (q[stage] - data.qpos[3:]) + _DAMPING * (dq[stage] - data.qvel[3:])
        mujoco.mj_fullM(model, data, M)
        drag = drag_wrench(pucks, float(data.qpos[2]), data.qvel[:3])
        base = np.linalg.solve(M[:3, :3], drag - data.qfrc_bias[:3] - M[:3, 3:] @ joints)
        data.qfrc_applied[:3] = drag
        data.qfrc_applied[3:] = data.qfrc_bias[3:] + M[3:, :3] @ base + M[3:, 3:] @ joints

    flight = PlanarFlight(*(np.empty((samples, width)) for width in (1, free_flyer.JOINTS, free_flyer.JOINTS, 3, 3, 3)))
    mujoco.set_mjcb_control(torque)
    try:
        for k in range(samples):
            flight.time_s[k], flight.q_rad[k], flight.dq_rad_s[k] = data.time, data.qpos[3:], data.qvel[3:]
            c, s = np.cos(data.qpos[2]), np.sin(data.qpos[2])
            vx, vy, w = data.qvel[:3]
            flight.velocity[k] = c * vx + s * vy, c * vy - s * vx, w
            mujoco.mj_step(model, data)  # its sensors are those of the state before the step
            flight.rate_rad_s[k], flight.specific_force_m_s2[k] = data.sensordata[:3], data.sensordata[3:]
    finally:
        mujoco.set_mjcb_control(None)
    return flight._replace(time_s=flight.time_s[:, 0])
