"""A floating vehicle's mechanics in one batch; truth from MuJoCo's inverse dynamics and from Pinocchio's kinematics.

Bodies in spatial algebra against the links' own columns, of random trees with revolute and prismatic joints.
"""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from bench.identification.momentum import momentum_columns
from onboard.dynamics.kinematics import Bodies, chain_motion, composite_inertia, frames_of, link_motions, wrench_columns
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.spatial import crm, force_cross
from tests.dynamics.mujoco_twin import inverse_dynamics, random_vehicle, to_mujoco, to_urdf
from tests.native.oracle.bodies import Columns, coad


@pytest.fixture
def flown(rng):
    vehicle = VehicleModel(to_urdf(random_vehicle(rng, KINDS, PARENTS)), VehicleSpec(BaseKind.FREE, "base"))
    motion = rng.normal(size=(3, TICKS, len(vehicle.joints)))
    twist, thrust = rng.normal(size=(2, TICKS, 6))
    bodies = Bodies.of(chain_motion(vehicle, *motion).links, vehicle.chi, twist, thrust)
    return vehicle, link_motions(vehicle, *motion), bodies, twist, thrust


def close(found, truth):
    np.testing.assert_allclose(found, truth, rtol=1e-9, atol=1e-9 * np.abs(truth).max())


def test_products_of_spatial_vectors_are_dual(rng):
    V, U, F = rng.normal(size=(3, TICKS, 6, 1))
    power = F.swapaxes(1, 2) @ crm(V[..., 0]) @ U  # of a wrench that moves with the frame
    of_force = force_cross(V[..., 0], F[..., 0])[..., None]
    np.testing.assert_allclose(power, -of_force.swapaxes(1, 2) @ U)
    np.testing.assert_allclose(coad(F[..., 0]) @ V, of_force)
    assert np.abs(power).min() > 0.0


def test_columns_and_sums_are_those_of_the_links(flown):
    vehicle, links, bodies, twist, thrust = flown
    v, w, f, dw = twist[:, :3], twist[:, 3:], thrust[:, :3], thrust[:, 3:]
    which = (len(links) - 1, 0)
    H, W = np.empty((2, TICKS, 6, 20))
    Columns(which).into(H, bodies.X, bodies.V)
    Columns(which).into(W, bodies.X, bodies.V, bodies.A)
    close(H, np.concatenate([momentum_columns(links[k], v, w) for k in which], axis=2))
    close(W, np.concatenate([wrench_columns(links[k], w, f, dw) for k in which], axis=2))
    halves = np.random.default_rng(2).normal(size=(2, 10, 10))
    mixed = np.empty_like(W)
    Columns(which, list(halves)).into(mixed, bodies.X, bodies.V, bodies.A)
    close(mixed, np.concatenate([W[..., :10] @ halves[0], W[..., 10:] @ halves[1]], axis=2))
    groups = np.eye(len(links))[[0, 1]] + np.eye(len(links))[[2, 3]]
    found, own = bodies.sums(groups), vehicle.chi.reshape(-1, 10)
    for group, members in enumerate([(0, 2), (1, 3)]):
        close(found.momentum[:, group], sum(momentum_columns(links[k], v, w) @ own[k] for k in members))
        close(found.wrench[:, group], sum(wrench_columns(links[k], w, f, dw) @ own[k] for k in members))


def test_the_slope_of_the_wrench_is_a_finite_difference(flown):
    vehicle, links, bodies, twist, _ = flown
    frames, still, every = frames_of(links), np.zeros_like(twist), np.ones((1, len(links)))

    def wrench(at):
        return Bodies.of(frames, vehicle.chi, at, still).sums(every).wrench[:, 0]

    for axis in range(3):
        step = np.zeros(6)
        step[3 + axis] = 1e-6
        change = (wrench(twist + step) - wrench(twist - step)) / 2e-6
        np.testing.assert_allclose(bodies.slope[..., axis], change, atol=1e-6 * np.abs(wrench(twist)).max())


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
