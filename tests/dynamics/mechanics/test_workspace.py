"""Singularities, workspaces and attitude drift: closed forms, the generalized Jacobian, MuJoCo."""

import numpy as np
import pinocchio as pin
import pytest

from bench.block_race import BlockRace
from onboard.dynamics.mechanics import barycentric as bary
from onboard.dynamics.mechanics import nonholonomic, workspace
from onboard.dynamics.mechanics import virtual_manipulator as virtual
from onboard.dynamics.mechanics.chain import chain_of, rotations
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.errors import ConvergenceError
from tests.dynamics.mechanics.mujoco_flights import START, arm, fly

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


def planar():
    return FloatingArm(VehicleModel(PLANAR, VehicleSpec(BaseKind.FREE, "base")), "tip")


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


def flown_by(path, cycles, cycle_s=4.0):
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
    with pytest.raises(ConvergenceError, match="ask for a smaller turn"):
        nonholonomic.reorient(arm(), START, np.array([3.0, 0.0, 0.0]), most_cycles=1, harmonics=1)
    with pytest.raises(SignalError, match="shorter than pi"):
        nonholonomic.reorient(arm(), START, np.array([4.0, 0.0, 0.0]))


def test_the_block_system_moves_as_mujoco_does_for_a_minute(rng):
    """Equal steps; both integrators are of the third order in rate times step where rotations do not commute."""
    race = BlockRace(chain_of(arm()), rng.normal(0.0, 0.01, (6, 3)), 0.02)
    assert race.system.bodies == 6
    start = race.state
    race.run(60.0)
    theirs = race.mujoco_rates()
    assert np.abs(theirs - start.rate).max() > 0.5 * np.abs(start.rate).max()  # it did change
    np.testing.assert_allclose(race.state.rate, theirs, rtol=0, atol=1e-6 * np.abs(theirs).max())
    np.testing.assert_allclose(race.state.position, race.data.body("b0").xipos, atol=1e-6)
