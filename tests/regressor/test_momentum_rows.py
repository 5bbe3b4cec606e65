"""Momentum rows against MuJoCo: its own momentum at every instant, and a vehicle left to itself."""

import mujoco
import numpy as np
import pytest

from onboard.dynamics.errors import SignalError
from onboard.dynamics.vehicle import BaseKind, VehicleModel, VehicleSpec
from onboard.regressor.momentum_rows import BaseState, momentum_names, momentum_rows
from tests.dynamics.mujoco_twin import random_vehicle, to_mujoco, to_urdf

KINDS = ["revolute", "revolute", "fixed", "prismatic", "continuous"]
PARENTS = [0, 1, 2, 0, 1]
STEPS = 40


def momentum(model, data):
    mujoco.mj_subtreeVel(model, data)
    linear = model.body_subtreemass[1] * data.subtree_linvel[1]
    return np.r_[linear, data.subtree_angmom[1] + np.cross(data.subtree_com[1], linear)]


@pytest.fixture
def drift(rng):
    """A vehicle that tumbles with its joints free, and MuJoCo's momentum at the start."""
    links = random_vehicle(rng, KINDS, PARENTS)
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.FREE, "base", "link_3"))
    model = to_mujoco(links)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 1e-3
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[3:7], data.qvel[:] = rng.normal(size=3), rng.normal(size=4), rng.normal(size=model.nv)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    mujoco.mj_forward(model, data)
    order = [int(model.body(joint.name.removeprefix("joint_")).jntadr[0]) - 1 for joint in vehicle.joints]
    start, states = momentum(model, data), []
    for _ in range(STEPS):
        R = data.body("base").xmat.reshape(3, 3).copy()
        q, dq = data.qpos[7:][order].copy(), data.qvel[6:][order].copy()
        states.append((R, data.qpos[:3].copy(), R.T @ data.qvel[:3], data.qvel[3:6].copy(), q, dq))
        mujoco.mj_step(model, data, 5)
    *base, q, dq = (np.array(column) for column in zip(*states, strict=True))
    return vehicle, BaseState(*base), q, dq, start


def test_momentum_stays_what_mujoco_says_it_was(drift):
    vehicle, base, q, dq, start = drift
    rows = momentum_rows(vehicle, q, dq, base)
    assert rows.shape == (STEPS, 6, len(momentum_names(vehicle)))
    np.testing.assert_allclose(rows @ np.r_[vehicle.chi, start], 0.0, atol=1e-7 * np.abs(start).max())


def test_the_start_and_the_payload_come_out_together(drift):
    """All else known, twenty columns are independent but for what momentum can never show: none here."""
    vehicle, base, q, dq, start = drift
    rows = momentum_rows(vehicle, q, dq, base)
    unknown = np.r_[np.arange(len(vehicle.chi))[vehicle.payload_columns()], len(vehicle.chi) + np.arange(6)]
    known = np.setdiff1d(np.arange(rows.shape[2]), unknown)
    y = -(rows[:, :, known] @ np.r_[vehicle.chi, start][known])
    found = np.linalg.lstsq(rows[:, :, unknown].reshape(-1, unknown.size), y.ravel())[0]
    np.testing.assert_allclose(found, np.r_[vehicle.chi, start][unknown], rtol=1e-4, atol=1e-4)


def test_joint_signals_of_another_vehicle_are_refused(drift):
    vehicle, base, q, dq, _ = drift
    with pytest.raises(SignalError, match="joint signals must be"):
        momentum_rows(vehicle, q[:, :2], dq[:, :2], base)
