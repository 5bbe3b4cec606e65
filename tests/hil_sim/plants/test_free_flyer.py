"""The free-flyer that captures a payload: what is conserved, by MuJoCo's own account and by Newton's laws."""

import mujoco
import numpy as np
import pytest

from bench.true_flights import free_flyer

BOX = free_flyer.Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08))
CAPTURE = free_flyer.Capture(BOX, 0.4, np.array([0.03, -0.02, -0.05]), np.array([0.02, 0.04, -0.03]))


@pytest.fixture
def motion(rng):
    return free_flyer.JointMotion.draw(rng)


def still():
    zero = np.zeros((5, 1))
    return free_flyer.JointMotion(np.array([0.0, 0.6, 0.0, 0.8, 0.0]), zero, zero, zero)


def momentum(flight):
    """Linear, and angular about the origin of the world, of all that is welded or jointed together; (6,)."""
    model, data = flight.flight.model, flight.flight.data
    flight.flight.show()
    linear, angular = np.zeros(3), np.zeros(3)
    for body in range(1, model.nbody):
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, twist, 0)
        axes = data.ximat[body].reshape(3, 3)
        p = model.body_mass[body] * twist[3:]
        linear += p
        angular += axes @ (model.body_inertia[body] * (axes.T @ twist[:3])) + np.cross(data.xipos[body], p)
    return np.r_[linear, angular]


def test_a_capture_adds_the_payloads_momentum_and_nothing_else(motion):
    flight = free_flyer.FreeFlight(motion, (0.03, -0.02, 0.04))
    flight.advance(100)
    before = momentum(flight)
    model, data = flight.flight.model, flight.flight.data
    tip = data.body("l.link_5")
    R, w, R_B = tip.xmat.reshape(3, 3).copy(), np.zeros(6), data.body("l.base").xmat.reshape(3, 3)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, tip.id, w, 0)
    grasp = R @ (0.0, 0.0, 0.090)
    rate = w[:3] + R_B @ CAPTURE.rate_rad_s
    lever = R @ BOX.centre_of_mass_m
    velocity = w[3:] + np.cross(w[:3], grasp) + R_B @ CAPTURE.velocity_m_s + np.cross(rate, lever)
    own = BOX.mass_kg * velocity
    brought = np.r_[own, R @ BOX.inertia_kg_m2 @ R.T @ rate + np.cross(tip.xpos + grasp + lever, own)]
    joints = data.qvel[6:].copy()
    flight.capture(BOX, CAPTURE.velocity_m_s, CAPTURE.rate_rad_s)
    np.testing.assert_allclose(momentum(flight), before + brought, atol=1e-12)
    np.testing.assert_array_equal(data.qvel[6:], joints)
    flight.advance(200)
    np.testing.assert_allclose(momentum(flight), before + brought, atol=1e-6)


def test_the_accelerometer_shows_what_the_imu_gains_in_a_capture():
    """Nothing moves but the payload that comes: the IMU's velocity afterwards is the sum of its specific forces."""
    flight = free_flyer.FreeFlight(still(), np.zeros(3))
    flown = free_flyer.fly_with_capture(flight, CAPTURE, 0.402)
    model, data = flight.flight.model, flight.flight.data
    flight.flight.show()
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, data.site("at imu_base").id, velocity, 1)
    assert np.linalg.norm(velocity[3:]) > 1e-3
    np.testing.assert_allclose(flown.specific_force_m_s2.sum(axis=0) * 2e-3, velocity[3:], atol=1e-5)


def test_what_is_released_takes_its_momentum_along(motion):
    flight = free_flyer.FreeFlight(motion, (0.03, -0.02, 0.04), BOX)
    flown = flight.advance(100)
    flight.release()
    after = flight.advance(100)
    np.testing.assert_allclose(after.rate_rad_s[0], flown.rate_rad_s[-1], atol=2e-3)
    alone = momentum(flight)
    flight.advance(100)
    np.testing.assert_allclose(momentum(flight), alone, atol=1e-6)
