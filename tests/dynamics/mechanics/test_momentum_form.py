"""Base rate from joints and momentum, by three derivations: MuJoCo's flight, and MuJoCo's momentum on a level bed."""

import mujoco
import numpy as np
import pytest

from onboard.dynamics.free_flight import rate_of_momentum
from onboard.dynamics.mechanics.momentum_form import Method, momentum_form
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.ground.identify.base_motion.fit import fit
from tests.dynamics import mujoco_twin
from tests.dynamics.mechanics.mujoco_flights import START, URDF, fly, spline

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
