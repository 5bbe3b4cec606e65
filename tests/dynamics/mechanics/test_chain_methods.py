"""Virtual manipulator, barycentric vectors, Mayeda's counts: second derivations against Pinocchio and MuJoCo."""

import mujoco
import numpy as np
import pytest

from onboard.dynamics.mechanics import barycentric as bary
from onboard.dynamics.mechanics import virtual_manipulator as virtual
from onboard.dynamics.mechanics.base_parameter_count import first_cluster, fixed_base_count, free_base_count
from onboard.dynamics.mechanics.chain import chain_of
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from tests.dynamics import mujoco_twin
from tests.dynamics.mechanics.mujoco_flights import arm

KINDS = (["revolute"] * 5, ["revolute", "prismatic", "continuous", "fixed", "revolute"], ["prismatic"] * 2)


def random_arm(rng, kinds):
    links = mujoco_twin.random_vehicle(rng, kinds)
    vehicle = VehicleModel(mujoco_twin.to_urdf(links), VehicleSpec(BaseKind.FREE, "base"))
    return FloatingArm(vehicle, links[-1].name), mujoco_twin.to_mujoco(links), links


@pytest.mark.parametrize("kinds", KINDS, ids=str)
def test_the_virtual_tip_is_the_real_tip_of_mujoco(rng, kinds):
    for _ in range(20):
        floating, model, links = random_arm(rng, kinds)
        chain, q = chain_of(floating), rng.uniform(-2, 2, floating.joints)
        data = mujoco.MjData(model)
        data.qpos[7:] = q
        mujoco.mj_forward(model, data)
        tip, base = data.body(links[-1].name).xpos, data.body("base")
        centre = base.subtree_com if hasattr(base, "subtree_com") else data.subtree_com[base.id]
        np.testing.assert_allclose(centre + virtual.virtual_tip(chain, q), tip, atol=1e-9)


def test_virtual_links_are_constant_but_for_prismatic_joints(rng):
    floating, _, _ = random_arm(rng, ["revolute", "prismatic", "revolute"])
    chain = chain_of(floating)
    one, other = (virtual.virtual_links(chain, q) for q in (np.zeros(3), np.array([0.3, 0.2, -1.0])))
    moved = np.linalg.norm(other - one, axis=1)
    assert moved[1] == pytest.approx(0.2 * virtual.mass_shares(chain)[1])  # (2.29)
    assert np.delete(moved, 1).max() == 0.0


def test_the_virtual_jacobian_is_the_generalized_one(rng):
    for _ in range(10):
        floating, _, _ = random_arm(rng, ["revolute"] * 4)
        chain, q = chain_of(floating), rng.uniform(-2, 2, 4)
        J = virtual.virtual_jacobian(chain, q, bary.body_rates(chain, q))
        np.testing.assert_allclose(J, floating.generalized_jacobian(q)[:3], atol=1e-12)


def test_momentum_and_energy_from_barycentric_vectors(rng):
    for _ in range(20):
        floating, _, _ = random_arm(rng, ["revolute"] * rng.integers(1, 7))
        chain, n = chain_of(floating), floating.joints
        q, dq, w = rng.uniform(-2, 2, n), rng.normal(size=n), rng.normal(size=3)
        A, H = floating.momentum_map(q), floating.mass_matrix(q)
        v = -np.linalg.solve(A[:3, :3], A[:3, 3:6] @ w + A[:3, 6:] @ dq)  # the centre of mass at rest
        nu = np.concatenate([v, w, dq])
        D, D_q, D_qq = bary.reduced_inertia(chain, q)
        np.testing.assert_allclose(D @ w + D_q @ dq, (A @ nu)[3:], rtol=0, atol=1e-10)
        energy = 0.5 * (w @ D @ w + 2 * w @ D_q @ dq + dq @ D_qq @ dq)
        assert energy == pytest.approx(0.5 * nu @ H @ nu, abs=1e-10)
        for ours, fast in zip((D, D_q, D_qq), floating.reduced_inertia(q), strict=True):
            np.testing.assert_allclose(ours, fast, atol=1e-10)


def test_barycentric_vectors_of_a_body_close(rng):
    """Mass-weighted positions of all bodies about the vehicle's centre of mass vanish (2.30-2.33)."""
    floating, _, _ = random_arm(rng, ["revolute"] * 4)
    chain = chain_of(floating)
    b, m = bary.barycentric(chain), chain.mass
    for i in range(5):
        np.testing.assert_allclose(m[:i].sum() * b.l[i] - m[i] * b.c[i] + m[i + 1 :].sum() * b.r[i], 0.0, atol=1e-12)


def test_arms_that_are_no_chain_are_refused(rng):
    links = mujoco_twin.random_vehicle(rng, ["revolute", "revolute"], [0, 0])
    vehicle = VehicleModel(mujoco_twin.to_urdf(links), VehicleSpec(BaseKind.FREE, "base"))
    with pytest.raises(SignalError, match="serial arms"):
        chain_of(FloatingArm(vehicle, "link_2"))
    floating, _, _ = random_arm(rng, ["revolute", "prismatic"])
    with pytest.raises(SignalError, match="revolute joints only"):
        bary.barycentric(chain_of(floating))


def test_closed_form_counts_of_dymaflex():
    chain = chain_of(arm())  # yaw, pitch, roll, pitch, roll: every axis across the one before
    assert first_cluster(chain) == 1
    assert fixed_base_count(chain, np.array([0.0, 0.0, -9.81])).parameters == 7 * 5 - 4 - 2
    assert fixed_base_count(chain, np.array([9.81, 0.0, 0.0])).parameters == 7 * 5 - 4
    assert free_base_count(chain).parameters == 45


def test_other_joints_have_no_closed_form(rng):
    floating, _, _ = random_arm(rng, ["revolute", "prismatic"])
    assert fixed_base_count(chain_of(floating), np.array([0.0, 0.0, -9.81])) is None
    assert free_base_count(chain_of(floating)) is None
