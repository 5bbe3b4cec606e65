"""Singularities, workspaces and attitude drift: closed forms, the generalized Jacobian, MuJoCo.

Virtual manipulator, barycentric vectors, Mayeda's counts: second derivations against Pinocchio and MuJoCo.

Joint torques with the base left to itself, against MuJoCo's forward dynamics of the same vehicle.
"""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from bench.block_system import BlockRace
from onboard.dynamics.mechanics import barycentric as bary
from onboard.dynamics.mechanics import nonholonomic, workspace
from onboard.dynamics.mechanics import virtual_manipulator as virtual
from onboard.dynamics.mechanics.base_parameter_count import first_cluster, fixed_base_count, free_base_count
from onboard.dynamics.mechanics.chain import chain_of, rotations
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.mechanics.joint_space import JointSpace
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.errors import ConvergenceError
from tests.dynamics import mujoco_twin
from tests.dynamics.mechanics.mujoco_flights import START, arm, fly

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


# Base 40 kg, links 4 and 3 kg, 1 and 1 m long, joints about z, the first half a metre from the base's centre.
PLANAR = """<robot name="planar">
<link name="base"><inertial><mass value="40"/><inertia ixx="7" iyy="7" izz="6.667" ixy="0" ixz="0"
 iyz="0"/></inertial></link>
<link name="a"><inertial><origin xyz="0.5 0 0"/><mass value="4"/><inertia ixx="0.01" iyy="0.333" izz="0.333"
 ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><origin xyz="0.5 0 0"/><mass value="3"/><inertia ixx="0.01" iyy="0.25" izz="0.25"
 ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tip"/>
<joint name="one" type="continuous"><parent link="base"/><child link="a"/><origin xyz="0.5 0 0"/>
 <axis xyz="0 0 1"/></joint>
<joint name="two" type="continuous"><parent link="a"/><child link="b"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="end" type="fixed"><parent link="b"/><child link="tip"/><origin xyz="1 0 0"/></joint>
</robot>"""


def planar(urdf=PLANAR):
    return FloatingArm(VehicleModel(urdf, VehicleSpec(BaseKind.FREE, "base")), "tip")


def test_the_planar_determinant_is_that_of_the_barycentric_form(rng):
    """Papadopoulos: det S* of the tip relative to the centre of mass, from vectors and reduced inertia alone."""
    floating, chain = planar(), chain_of(planar())
    for _ in range(20):
        q = rng.uniform(-np.pi, np.pi, 2)
        R, v = rotations(chain, q), virtual.virtual_links(chain, q)
        arms = np.einsum("iab,ib->ia", R, v)  # (3, 3)
        D, D_q, _ = bary.reduced_inertia(chain, q)
        base = -D_q[2] / D[2, 2]
        rates = base + np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])  # (3 bodies, 2 joints)
        J = np.einsum("ik,ia->ak", rates, np.column_stack([-arms[:, 1], arms[:, 0]]))
        assert workspace.pair_measure(floating, q, (0, 1)) == pytest.approx(np.linalg.det(J), abs=1e-12)


def test_workspaces_of_a_planar_arm():
    floating = planar()
    found = workspace.singularity_map(floating, np.zeros(2), (0, 1), 91)
    chain = chain_of(floating)
    v = [virtual.virtual_links(chain, np.zeros(2))[i, 0] for i in range(3)]
    assert found.reachable[1] == pytest.approx(sum(v), rel=1e-3)  # all in line
    assert found.reachable[0] == pytest.approx(max(0.0, 2 * max(v) - sum(v)), abs=np.deg2rad(4.0))  # a step of the grid
    assert found.dependent
    for low, high in found.dependent:
        assert found.reachable[0] <= low <= high <= found.reachable[1]
    inside = np.concatenate([found.distance[:-1][found.measure[:-1] * found.measure[1:] < 0.0]])
    assert inside.size > 10
    for low, high in found.independent:  # no singular cell lies well inside a path-independent span
        assert not ((inside > low + 0.05) & (inside < high - 0.05)).any()
    assert found.independent


def test_the_outer_edge_is_singular_and_dymaflex_has_a_map():
    assert abs(workspace.pair_measure(planar(), np.zeros(2), (0, 1))) < 1e-12
    assert workspace.least_singular_value(arm(), START) > 0.01
    found = workspace.singularity_map(arm(), START, (1, 3), 41)
    assert found.dependent
    assert np.isfinite(found.measure).all()
    with pytest.raises(SignalError, match="name two joints"):
        workspace.singularity_map(arm(), START, (1, 1))


def closed(size):
    coefficients = np.zeros((2, 1, 5))
    coefficients[0, 0, 1], coefficients[1, 0, 3], coefficients[0, 0, 0] = size, size, 0.5 * size
    return nonholonomic.fourier_path(START, coefficients)


def flown_by(path, cycles, cycle_s=2.0):
    """MuJoCo's attitude after cycles at rest at both ends."""

    def motion(t):
        u = min(t / cycle_s, cycles - 1e-12) % 1.0
        s = 10 * u**3 - 15 * u**4 + 6 * u**5
        ds = (30 * u**2 - 60 * u**3 + 30 * u**4) / cycle_s
        dds = (60 * u - 180 * u**2 + 120 * u**3) / cycle_s**2
        q, slope = path(s)
        h = 1e-5
        curvature = (path(s + h)[1] - path(s - h)[1]) / (2 * h)
        return q, slope * ds, slope * dds + curvature * ds**2

    return fly(motion, cycles * cycle_s).R_WB[-1]


def angle(R):
    return float(np.linalg.norm(pin.log3(R)))


def test_attitude_after_a_closed_path_is_mujocos_to_a_percent():
    path = closed(0.6)
    predicted = nonholonomic.attitude_after(arm(), path)
    assert angle(predicted) > np.deg2rad(0.5)
    assert angle(predicted.T @ flown_by(path, 1)) < 0.01 * angle(predicted)


def test_the_pace_does_not_matter_and_the_way_back_undoes_it():
    floating, path = arm(), closed(0.6)
    there = nonholonomic.attitude_after(floating, path, 400)

    def back(s):
        q, slope = path(1.0 - s)
        return q, -slope

    np.testing.assert_allclose(there @ nonholonomic.attitude_after(floating, back, 400), np.eye(3), atol=1e-9)


def test_the_base_is_turned_by_arm_cycles_alone():
    wanted = np.deg2rad([3.0, -4.0, 6.0])
    found = nonholonomic.reorient(arm(), START, wanted)
    assert found.error_rad < np.deg2rad(0.01)
    np.testing.assert_allclose(found.path(0.0)[0], found.path(1.0)[0], atol=1e-12)
    flown = flown_by(found.path, found.cycles)
    assert angle(flown.T @ pin.exp3(wanted)) < np.deg2rad(0.1)


def test_a_turn_that_is_too_large_for_the_cycles_is_refused():
    limited = PLANAR.replace("continuous", "revolute").replace(
        '<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/>'
    )
    turn = np.array([0.0, 0.0, 3.0])
    assert nonholonomic.reorient(planar(), np.zeros(2), turn, 1, 1).swing_rad.max() > 2.0
    with pytest.raises(ConvergenceError, match="ask for a smaller turn"):
        nonholonomic.reorient(planar(limited), np.zeros(2), turn, 1, 1)
    with pytest.raises(SignalError, match="shorter than pi"):
        nonholonomic.reorient(arm(), START, np.array([4.0, 0.0, 0.0]))


def test_the_block_system_moves_as_mujoco_does(rng):
    """Equal steps; both integrators are of the third order in rate times step where rotations do not commute."""
    race = BlockRace(chain_of(arm()), rng.normal(0.0, 0.01, (6, 3)), 0.02)
    assert race.system.bodies == 6
    start = race.state
    race.run(20.0)
    theirs = race.mujoco_rates()
    assert np.abs(theirs - start.rate).max() > 0.5 * np.abs(start.rate).max()  # it did change
    np.testing.assert_allclose(race.state.rate, theirs, rtol=0, atol=1e-6 * np.abs(theirs).max())
    np.testing.assert_allclose(race.state.position, race.data.body("b0").xipos, atol=1e-6)
