"""MuJoCo flights of the free-flyer with prescribed joints, a moment on the base if wanted; and vehicles to fly."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

import onboard
from bench.true_flights import free_flyer
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec

URDF = Path(onboard.__file__).parent / "vehicles" / "dymaflex" / "dymaflex.urdf"
START = np.array([0.0, 0.6, 0.0, 0.8, 0.0])


class Flown(NamedTuple):
    R_WB: np.ndarray  # (n, 3, 3)
    tip: np.ndarray  # (n, 3) m, inertial axes, of link 5's frame
    tip_velocity: np.ndarray  # (n, 3)


def arm(tip: str = "link_5") -> FloatingArm:
    return FloatingArm(VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload")), tip)


def spline(time_s: np.ndarray, q: np.ndarray) -> Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    by_order = [CubicSpline(time_s, q).derivative(k) if k else CubicSpline(time_s, q) for k in range(3)]
    return lambda t: tuple(f(t) for f in by_order)


def fly(motion, duration_s, step_s=2e-3, rate=(0.0, 0.0, 0.0), base_moment=None) -> Flown:
    """Joints as ``motion(t)`` says, base let go with a rate; ``base_moment(t)``, base axes, acts on the base."""
    model = free_flyer.world(None).model
    model.opt.timestep, model.opt.integrator = step_s, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[7:], data.qvel[6:], _ = motion(0.0)
    data.qvel[3:6] = rate
    H = np.empty((model.nv, model.nv))

    def control(model, data):
        q, dq, ddq = motion(data.time)
        wanted = ddq + 400.0 * (q - data.qpos[7:]) + 40.0 * (dq - data.qvel[6:])
        mujoco.mj_fullM(model, data, H)
        on_base = np.zeros(6)
        if base_moment is not None:
            on_base[3:] = base_moment(data.time)
        base = np.linalg.solve(H[:6, :6], on_base - data.qfrc_bias[:6] - H[:6, 6:] @ wanted)
        data.qfrc_applied[:6] = on_base
        data.qfrc_applied[6:] = data.qfrc_bias[6:] + H[6:, :6] @ base + H[6:, 6:] @ wanted

    steps = round(duration_s / step_s)
    out = Flown(np.empty((steps + 1, 3, 3)), np.empty((steps + 1, 3)), np.empty((steps + 1, 3)))
    mujoco.set_mjcb_control(control)
    try:
        for k in range(steps + 1):
            mujoco.mj_forward(model, data)
            out.R_WB[k] = data.body("l.base").xmat.reshape(3, 3)
            out.tip[k] = data.site("at link_5").xpos
            twist = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, data.site("at link_5").id, twist, 0)
            out.tip_velocity[k] = twist[3:]
            mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_control(None)
    return out
