"""A floating vehicle's mechanics in one batch; truth from MuJoCo's inverse dynamics and from Pinocchio's kinematics."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from bench.identification.momentum import momentum_columns
from onboard.dynamics.kinematics import composite_inertia, link_motions, wrench_columns
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from tests.dynamics.mujoco_twin import inverse_dynamics, random_vehicle, to_mujoco, to_urdf

KINDS = ["revolute", "fixed", "prismatic", "revolute", "fixed", "revolute"]
PARENTS = [0, 1, 2, 0, 4, 3]
TICKS = 4


@pytest.fixture
def twin(rng):
    links = random_vehicle(rng, KINDS, PARENTS)
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.FREE, "base"))
    return vehicle, to_mujoco(links)


def mujoco_order(vehicle, model):
    return [
        vehicle.joints.index(vehicle.joint(f"joint_{model.body(model.jnt_bodyid[j]).name}"))
        for j in range(1, model.njnt)
    ]


def total(columns, vehicle, links, *args):
    return sum(columns(link, *args) @ own for link, own in zip(links, vehicle.chi.reshape(-1, 10), strict=True))


def test_link_motions_are_pinocchios(rng, twin):
    vehicle, _ = twin
    q, dq, ddq = rng.normal(size=(3, TICKS, len(vehicle.joints)))
    found = link_motions(vehicle, q, dq, ddq)
    data = vehicle.model.createData()
    for k in range(TICKS):
        full = np.concatenate([[0, 0, 0, 0, 0, 0, 1], q[k]]), np.r_[np.zeros(6), dq[k]], np.r_[np.zeros(6), ddq[k]]
        pin.forwardKinematics(vehicle.model, data, *full)
        pin.updateFramePlacements(vehicle.model, data)
        for name, link in zip(vehicle.links, found, strict=True):
            frame = vehicle.frame_id(name)
            V = pin.getFrameVelocity(vehicle.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            A = pin.getFrameClassicalAcceleration(vehicle.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(link.R[k], data.oMf[frame].rotation, atol=1e-12)
            np.testing.assert_allclose(link.p[k], data.oMf[frame].translation, atol=1e-12)
            np.testing.assert_allclose(np.r_[link.v[k], link.w[k]], V.vector, atol=1e-12)
            np.testing.assert_allclose(np.r_[link.a[k], link.dw[k]], A.vector, atol=1e-12)


def test_wrench_is_mujocos_inverse_dynamics(rng, twin):
    vehicle, model = twin
    order = mujoco_order(vehicle, model)
    q, dq, ddq = rng.normal(size=(3, TICKS, len(vehicle.joints)))
    w, f, dw = rng.normal(size=(3, TICKS, 3))
    wrench = total(wrench_columns, vehicle, link_motions(vehicle, q, dq, ddq), w, f, dw)
    for k in range(TICKS):
        force, moment, _, _ = inverse_dynamics(
            model, q[k, order], dq[k, order], ddq[k, order], np.zeros(3), w[k], f[k], dw[k]
        )
        np.testing.assert_allclose(wrench[k], np.r_[force, moment], rtol=1e-9, atol=1e-9)


def test_momentum_is_mujocos(rng, twin):
    vehicle, model = twin
    order = mujoco_order(vehicle, model)
    q, dq = rng.normal(size=(2, 1, len(vehicle.joints)))
    v, w = rng.normal(size=(2, 1, 3))
    links = link_motions(vehicle, q, dq, np.zeros_like(q))
    momentum = total(momentum_columns, vehicle, links, v, w)[0]
    data = mujoco.MjData(model)
    data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    data.qpos[7:], data.qvel[6:], data.qvel[:3], data.qvel[3:6] = q[0, order], dq[0, order], v[0], w[0]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    mass, centre = model.body_subtreemass[1], data.subtree_com[1]
    linear = mass * data.subtree_linvel[1]
    np.testing.assert_allclose(momentum[:3], linear, rtol=1e-9)
    np.testing.assert_allclose(momentum[3:], data.subtree_angmom[1] + np.cross(centre, linear), rtol=1e-9)


def test_composite_inertia_is_momentum_per_base_twist(rng, twin):
    vehicle, _ = twin
    q, dq = rng.normal(size=(2, TICKS, len(vehicle.joints)))
    links = link_motions(vehicle, q, dq, np.zeros_like(q))
    v, w, zero = *rng.normal(size=(2, TICKS, 3)), np.zeros((TICKS, 3))
    moving = total(momentum_columns, vehicle, links, v, w) - total(momentum_columns, vehicle, links, zero, zero)
    C = composite_inertia(links, vehicle.chi)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", C, np.c_[v, w]), moving, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(C, C.swapaxes(1, 2), atol=1e-12)


def test_joint_signals_of_another_vehicle_are_refused(twin):
    vehicle, _ = twin
    with pytest.raises(SignalError, match="joint signals must be"):
        link_motions(vehicle, np.zeros((3, 2)), np.zeros((3, 2)), np.zeros((3, 2)))
