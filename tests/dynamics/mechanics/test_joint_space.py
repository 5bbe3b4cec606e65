"""Joint torques with the base left to itself, against MuJoCo's forward dynamics of the same vehicle."""

import mujoco
import numpy as np
import pytest

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.mechanics.joint_space import JointSpace
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from tests.dynamics import mujoco_twin

SLIDE = '<joint type="slide" axis="{}"/>'
TABLE = SLIDE.format("1 0 0") + SLIDE.format("0 1 0") + '<joint type="hinge" axis="0 0 1"/>'
BASES = {BaseKind.FREE: ("<freejoint/>", 6, 7), BaseKind.PLANAR: (TABLE, 3, 3), BaseKind.FIXED: ("", 0, 0)}


@pytest.mark.parametrize("base", BASES)
def test_mujoco_accelerates_as_asked(rng, base):
    links = mujoco_twin.random_vehicle(rng, ["revolute", "revolute", "revolute"])
    joint, freedom, pose = BASES[base]
    model = mujoco_twin.to_mujoco(links, joint)
    space = JointSpace(
        FloatingArm(
            VehicleModel(mujoco_twin.to_urdf(links), VehicleSpec(base, "base", gravity_m_s2=(0.3, -1.0, -9.0))),
            "link_3",
        )
    )
    if base is not BaseKind.FREE:
        model.opt.gravity = (0.0, 0.0, -9.0) if base is BaseKind.PLANAR else (0.3, -1.0, -9.0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 3))
    data = mujoco.MjData(model)
    if base is BaseKind.FREE:
        data.qpos[3] = 1.0
    data.qpos[pose:], data.qvel[freedom:] = q, dq
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    for row, unit in zip(M, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    data.qvel[:freedom] = -np.linalg.solve(M[:freedom, :freedom], M[:freedom, freedom:] @ dq)  # no momentum
    data.qfrc_applied[freedom:] = space.torque(q, dq, ddq)
    mujoco.mj_forward(model, data)
    assert data.qacc[freedom:] == pytest.approx(ddq, abs=1e-9)
    inverse = np.linalg.inv(M)[freedom:, freedom:]
    assert space.inertia(q) @ inverse == pytest.approx(np.eye(3), abs=1e-9)
