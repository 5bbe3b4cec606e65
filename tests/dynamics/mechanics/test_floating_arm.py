"""The generalized Jacobian and what follows from it, against MuJoCo's motion of the same vehicle.

Base rate from joints and momentum, by three derivations: MuJoCo's flight, and MuJoCo's momentum on a level bed.
"""

import mujoco
import numpy as np
import pytest

from onboard.dynamics.free_flight import rate_of_momentum
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.mechanics.inverse_kinematics import follow, straight_line
from onboard.dynamics.mechanics.momentum_form import Method, momentum_form
from onboard.dynamics.mechanics.reaction import reaction
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.ground.identify.base_motion.fit import fit
from tests.dynamics import mujoco_twin
from tests.dynamics.mechanics.mujoco_flights import START, URDF, arm, fly, spline

STEP_s = 5e-3


@pytest.fixture(scope="module")
def flight():
    """Ten seconds: joints, base rate (base axes) and the vehicle."""
    rng = np.random.default_rng(5)
    knots = np.arange(-1.0, 12.0, 1.0)
    motion = spline(knots, START + rng.normal(0.0, 0.4, (len(knots), 5)))
    flown = fly(motion, 10.0, STEP_s, rate=(0.05, -0.1, 0.15))
    time_s = STEP_s * np.arange(len(flown.R_WB))
    q, dq, _ = (np.array(part) for part in zip(*(motion(t) for t in time_s), strict=True))
    change = np.gradient(flown.R_WB, STEP_s, axis=0, edge_order=2)
    W = np.swapaxes(flown.R_WB, 1, 2) @ change
    rate = np.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], axis=1)
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    chi = vehicle.chi.copy()
    chi[vehicle.payload_columns()] = 0.0
    return vehicle, chi, time_s, q, dq, rate


@pytest.mark.parametrize("method", Method)
def test_each_derivation_predicts_mujocos_flight(flight, method):
    vehicle, chi, time_s, q, dq, rate = flight
    found = fit(momentum_form(vehicle, chi, method, q, dq), rate, time_s, STEP_s)
    assert (found.swing > 0.05).all()
    assert np.abs(found.error[:-1]).max() < 1e-3 * found.swing.max()  # the rate itself is a difference quotient
    assert np.abs(found.offset).max() < 1e-4
    turned, off = found.turned()
    assert turned.max() > 0.3
    assert off.max() < 1e-3


def test_a_base_twice_as_heavy_does_not(flight):
    vehicle, chi, time_s, q, dq, rate = flight
    wrong = chi.copy()
    wrong[:10] *= 2.0
    found = fit(momentum_form(vehicle, wrong, Method.EXIDDM, q, dq), rate, time_s, STEP_s)
    assert np.abs(found.error).max() > 0.05 * found.swing.max()


def test_the_three_are_one_and_their_slope_is_right(rng):
    links = mujoco_twin.random_vehicle(rng, ["revolute"] * 4)
    vehicle = VehicleModel(mujoco_twin.to_urdf(links), VehicleSpec(BaseKind.FREE, "base"))
    q, dq = np.cumsum(rng.normal(0.0, 0.02, (2, 50, 4)), axis=1)
    one, *others = (momentum_form(vehicle, vehicle.chi, method, q, dq) for method in Method)
    for other in others:
        for ours, theirs in zip(one, other, strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-10)
    momentum = rng.normal(0.0, 0.5, 3)
    rate, slope = rate_of_momentum(*one, momentum, 0.01)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        numeric = (rate_of_momentum(*one, momentum + step, 0.01)[0] - rate) / 1e-6
        np.testing.assert_allclose(slope[:, :, axis], numeric, atol=1e-5)


def test_on_a_level_bed_the_yaw_rate_is_mujocos(rng):
    links = mujoco_twin.random_vehicle(rng, ["revolute"] * 3)
    vehicle = VehicleModel(mujoco_twin.to_urdf(links), VehicleSpec(BaseKind.PLANAR, "base"))
    sliding = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>'
    model = mujoco_twin.to_mujoco(links, free=sliding)
    data, M = mujoco.MjData(model), np.empty((model.nv, model.nv))
    q, dq = rng.uniform(-2.0, 2.0, (2, 10, 3))
    form = momentum_form(vehicle, vehicle.chi, Method.GENERALIZED_JACOBIAN, q, dq).on_a_level_bed()
    for k in range(10):
        data.qpos[3:] = q[k]
        mujoco.mj_forward(model, data)
        for row, unit in zip(M, np.eye(model.nv), strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        base = -np.linalg.solve(M[:3, :3], M[:3, 3:] @ dq[k])
        np.testing.assert_allclose(-form.still[k], [0.0, 0.0, base[2]], atol=1e-9)


def test_an_arm_that_slides_has_no_barycentric_vectors(rng):
    links = mujoco_twin.random_vehicle(rng, ["revolute", "prismatic"])
    vehicle = VehicleModel(mujoco_twin.to_urdf(links), VehicleSpec(BaseKind.FREE, "base"))
    with pytest.raises(SignalError, match="revolute joints only"):
        momentum_form(vehicle, vehicle.chi, Method.VIRTUAL_MANIPULATOR, np.zeros((4, 2)), np.zeros((4, 2)))


ONE_MILLIMETRE = 1e-3


def swing(t):
    rate, size = np.array([1.1, 1.7, 2.3, 1.3, 1.9]), 0.4
    return START + size * np.sin(rate * t), size * rate * np.cos(rate * t), -size * rate**2 * np.sin(rate * t)


def test_tip_velocity_at_zero_momentum_is_mujocos():
    floating = arm()
    q, dq, _ = swing(0.0)
    start = floating.base_motion(q, dq)
    flown = fly(swing, 0.01, 1e-3, start[3:])  # MuJoCo's base has no velocity at the start, so momentum is m v: removed
    R = flown.R_WB[0]
    expected = R @ (floating.generalized_jacobian(q) @ dq)[:3]
    np.testing.assert_allclose(flown.tip_velocity[0] + R @ start[:3], expected, atol=1e-12)


def test_a_momentum_moves_the_tip_of_an_arm_at_rest(rng):
    floating, momentum = arm(), rng.normal(size=6)
    twist = floating.base_motion(START, np.zeros(5), momentum)
    R, p = floating.tip_pose(START)
    assert R.shape == (3, 3)
    expected = twist[:3] + np.cross(twist[3:], p), twist[3:]
    np.testing.assert_allclose(floating.tip_drift(START, momentum), np.concatenate(expected), atol=1e-13)


@pytest.mark.parametrize("with_rate", [pytest.param(False, marks=pytest.mark.campaign), True])  # the harder one
def test_the_tip_follows_a_straight_line_to_a_millimetre_while_the_base_floats(with_rate):
    floating = arm()
    momentum = np.zeros(6)
    if with_rate:
        momentum[3:] = [0.02, -0.04, 0.03]
    line = straight_line(floating, START, np.array([-0.06, 0.08, -0.05]), 4.0)
    planned = follow(floating, START, line, 4.0, momentum=momentum)
    assert np.linalg.norm(planned.q[-1] - planned.q[0]) > 0.2
    motion = spline(planned.time_s, planned.q)
    twist = floating.base_motion(START, motion(0.0)[1], momentum)
    flown = fly(motion, 4.0, 2e-3, twist[3:])
    time_s = 2e-3 * np.arange(len(flown.tip))
    wanted = np.array([line(t) for t in time_s])
    wanted -= np.outer(time_s, twist[:3])  # MuJoCo's base starts without velocity, so its centre of mass has one
    assert np.linalg.norm(wanted[-1] - wanted[0]) > 0.1
    assert np.linalg.norm(flown.tip - wanted, axis=1).max() < ONE_MILLIMETRE
    turned = np.arccos(np.clip((np.trace(flown.R_WB[-1]) - 1.0) / 2.0, -1.0, 1.0))
    assert turned > 0.005  # the base did float


def test_near_a_singularity_rates_stay_bounded_and_limits_are_kept():
    floating = arm()
    far = straight_line(floating, START, np.array([0.4, 0.4, 0.4]), 4.0)  # out of reach
    planned = follow(floating, START, far, 4.0)
    assert np.linalg.norm(planned.error[-1]) > 0.05
    assert np.abs(planned.dq).max() < 10.0
    assert (np.abs(planned.q) <= 3.1).all()


def test_wheels_that_take_the_reaction_moment_keep_the_attitude():
    floating = arm()

    def gentle(t):
        s, ds, dds = 0.5 - 0.5 * np.cos(t), 0.5 * np.sin(t), 0.5 * np.cos(t)
        size = np.array([0.8, -0.5, 0.6, 0.7, 0.4])
        return START + size * s, size * ds, size * dds

    free = fly(gentle, 2.0)
    held = fly(gentle, 2.0, base_moment=lambda t: reaction(floating, *gentle(t)).wheel_moment)
    angles = [np.arccos(np.clip((np.trace(f.R_WB[-1]) - 1.0) / 2.0, -1.0, 1.0)) for f in (free, held)]
    assert angles[0] > np.deg2rad(1.0)
    assert np.linalg.norm(held.R_WB[-1] - np.eye(3)) < 1e-6


def test_the_wheels_momentum_is_the_integral_of_their_moment(rng):
    floating = arm()
    q, dq, ddq = rng.uniform(-1, 1, (3, 5))
    h = 1e-5

    def momentum(t):
        return floating.attitude_hold_momentum(q + t * dq + 0.5 * t * t * ddq, dq + t * ddq)

    slope = (momentum(h) - momentum(-h)) / (2 * h)
    np.testing.assert_allclose(reaction(floating, q, dq, ddq).wheel_moment, -slope, atol=1e-8)


def test_the_force_on_the_arm_is_the_sum_over_its_bodies(rng):
    """(2.20), each body's acceleration by differences of its position."""
    floating = arm()
    q, dq, ddq = rng.uniform(-1, 1, (3, 5))
    model, h = floating.model, 1e-4

    def first_moment(t):
        floating.centre_of_mass(q + t * dq + 0.5 * t * t * ddq)
        base = model.inertias[1]
        return floating.mass_kg * floating.centre_of_mass(q + t * dq + 0.5 * t * t * ddq) - base.mass * base.lever

    sum_m_rho = (first_moment(h) - 2 * first_moment(0.0) + first_moment(-h)) / h**2
    expected = model.inertias[1].mass / floating.mass_kg * sum_m_rho
    np.testing.assert_allclose(reaction(floating, q, dq, ddq).arm_force, expected, atol=1e-6)


def test_adopted_parameters_change_the_mechanics():
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    chi = vehicle.chi.copy()
    chi[vehicle.payload_columns()] = [5.0, 0.1, -0.1, 0.4, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1]
    heavy = FloatingArm(vehicle, "payload", chi)
    assert heavy.mass_kg == pytest.approx(arm().mass_kg + 5.0)
    assert not np.allclose(heavy.generalized_jacobian(START), arm("payload").generalized_jacobian(START), atol=1e-3)


def test_bad_input_is_refused(rng):
    with pytest.raises(UnknownFrameError, match="fixed in the base"):
        arm("imu_base")
    with pytest.raises(SignalError, match="5 joints"):
        arm().generalized_jacobian(np.zeros(4))
    with pytest.raises(SignalError, match="must be positive"):
        follow(arm(), START, lambda t: np.zeros(3), 1.0, 0.0)
    links = mujoco_twin.random_vehicle(rng, ["revolute"])
    vehicle = VehicleModel(mujoco_twin.to_urdf(links), VehicleSpec(BaseKind.FREE, "base"))
    with pytest.raises(SignalError, match="have 20 parameters"):
        FloatingArm(vehicle, "link_1", np.zeros(10))
