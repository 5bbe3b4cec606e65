"""The base's motion predicted from momentum, against MuJoCo's integration of the whole vehicle."""

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard.dynamics.free_flight import predict_base, predict_base_from_rate
from onboard.dynamics.joint_errors import JOINT_ERRORS, EncoderReadings, JointErrors
from onboard.dynamics.kinematics import chain_motion, link_motions
from onboard.dynamics.model.errors import SignalError
from tests.dynamics.derivatives import FIELDS, derivative
from tests.dynamics.free_flyer_twin import BOX, twin

PERIOD_s = 0.01


@pytest.fixture(scope="module")
def flown():
    return twin(3.0)


@pytest.fixture(scope="module")
def predict(flown):
    ticks = flown.flight.time_s[::5]
    q, dq, ddq = flown.motion.at(ticks)
    links = link_motions(flown.vehicle, q, dq, ddq)
    R, _ = flown.vehicle.pose_in_base("imu_base")
    start = flown.momentum(q[0], dq[0], R @ flown.flight.rate_rad_s[0])
    return lambda chi=flown.chi, momentum=start, free=(): predict_base(links, PERIOD_s, chi, momentum, free), start


def test_prediction_is_what_mujoco_does(flown, predict):
    base = predict[0]()
    R, p = flown.vehicle.pose_in_base("imu_base")
    w = base.rate
    force = base.specific_force + np.cross(base.acceleration, p) + np.cross(w, np.cross(w, p))
    a_ten_thousandth_of_the_gyros_noise = 2e-7
    np.testing.assert_allclose(w @ R, flown.flight.rate_rad_s[::5], atol=a_ten_thousandth_of_the_gyros_noise)
    np.testing.assert_allclose(force @ R, flown.flight.specific_force_m_s2[::5], atol=1e-6)


def test_derivatives_are_finite_differences(flown, predict):
    predict, start = predict
    last = len(flown.vehicle.links) - 1
    base = predict(free=(last, 0))
    steps = [(k, np.zeros(70), 1e-5 * unit) for k, unit in enumerate(np.eye(3))]
    for column, index in [*((3 + k, 10 * last + k) for k in range(10)), *((13 + k, k) for k in range(10))]:
        steps.append((column, 1e-5 * np.eye(70)[index], np.zeros(3)))
    for column, chi, momentum in steps:
        up, down = predict(flown.chi + chi, start + momentum), predict(flown.chi - chi, start - momentum)
        for field in FIELDS:
            slope = (getattr(up, field) - getattr(down, field)) / 2e-5
            ours = derivative(base, field)[:, :, column]
            assert np.abs(ours - slope).max() < 2e-4 * np.abs(slope).max(), (column, field)


def test_from_the_rate_it_is_the_same_motion_and_its_derivatives_are_finite_differences(flown, predict):
    predict, _ = predict
    last = len(flown.vehicle.links) - 1
    by_momentum, few = predict(free=(last, 0)), flown.flight.time_s[::5][:300]
    links = link_motions(flown.vehicle, *flown.motion.at(few))
    rate = by_momentum.rate[0]
    base = predict_base_from_rate(links, PERIOD_s, flown.chi, rate, (last, 0))
    for field in FIELDS:
        np.testing.assert_allclose(getattr(base, field), getattr(by_momentum, field)[:300], rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(base.d_rate[0], np.eye(3, base.d_rate.shape[2]), atol=1e-9)  # the start is the rate
    chosen = [*((3 + k, 10 * last + k) for k in range(10)), *((13 + k, k) for k in range(10))]
    steps = [(k, np.zeros(70), 1e-5 * unit) for k, unit in enumerate(np.eye(3))]
    steps += [(column, 1e-5 * np.eye(70)[index], np.zeros(3)) for column, index in chosen]
    assert len(steps) == 23
    for column, chi, moved in steps:
        up = predict_base_from_rate(links, PERIOD_s, flown.chi + chi, rate + moved, ())
        down = predict_base_from_rate(links, PERIOD_s, flown.chi - chi, rate - moved, ())
        for field in FIELDS:
            slope = (getattr(up, field) - getattr(down, field)) / 2e-5
            ours = derivative(base, field)[:, :, column]
            assert np.abs(ours - slope).max() < 2e-4 * np.abs(slope).max() + 1e-9, (column, field)


def test_bodies_of_no_mass_predict_nothing_that_is_finite(flown, predict):
    """A solver's step may go there; it is then refused, as one that overflows."""
    base = predict[0](chi=np.zeros(70))
    assert not np.isfinite(base.rate).any()
    assert not np.isfinite(base.specific_force).any()


def test_too_few_ticks_are_refused(flown):
    links = link_motions(flown.vehicle, *np.zeros((3, 3, 5)))
    with pytest.raises(SignalError, match="four or more"):
        predict_base(links, PERIOD_s, flown.chi, np.zeros(3), ())


def test_derivatives_by_errors_of_joints_are_finite_differences(flown):
    rng = np.random.default_rng(3)
    q, dq, ddq = flown.motion.at(0.3 + PERIOD_s * np.arange(12))
    turns = 4.0 * q[:, [1, 4]]
    waves = np.stack([np.sin(turns), 4.0 * np.cos(turns) * dq[:, [1, 4]], np.zeros((12, 2))], axis=1)
    waves[:, 2] = 4.0 * np.cos(turns) * ddq[:, [1, 4]] - 16.0 * np.sin(turns) * dq[:, [1, 4]] ** 2
    readings = EncoderReadings(q, dq, ddq, PERIOD_s, waves)
    errors, rate = JointErrors(flown.vehicle, cyclic=(1, 4)), np.array([0.03, -0.02, 0.05])
    at = np.append(rng.normal(size=(5, 6)) * [1e-2, 1e-2, 1e-2, 1e-2, 1e-2, 1e-3], [1e-3, -2e-3])

    def predicted(x):
        own = x[:30].reshape(5, 6)
        *motion, functions = readings.corrected(own, x[30:], errors.of_cyclic)
        chain = chain_motion(flown.vehicle, *motion, own[:, :3])
        return predict_base_from_rate(chain.links, PERIOD_s, flown.chi, rate, (0,), errors.along(chain, functions))

    base = predicted(at)
    labels = [f"{kind} of joint {joint + 1}" for joint in range(5) for kind in JOINT_ERRORS]
    for column, of in enumerate([*labels, "wave of joint 2", "wave of joint 5"]):
        step = 1e-5 * np.eye(32)[column]
        up, down = predicted(at + step), predicted(at - step)
        for name in FIELDS:
            slope = (getattr(up, name) - getattr(down, name)) / 2e-5
            found = derivative(base, name)[:, :, 13 + column]
            label = f"{name} by {of}"
            assert np.abs(slope).max() > 1e-3, label
            assert np.abs(found - slope).max() < 2e-3 * np.abs(slope).max(), label


def test_an_arm_drawn_off_its_joints_is_predicted_with_their_offsets(flown):
    """The truth is MuJoCo's, of an arm with every joint 5 mm off."""
    offsets = 5e-3 * np.random.default_rng(4).normal(size=(5, 3))
    rate = np.array([0.03, -0.02, 0.05])
    flight = free_flyer.fly(free_flyer.world(BOX, offsets_m=offsets), flown.motion, rate, 1.0)
    q, dq, ddq = flown.motion.at(flight.time_s)
    period_s = float(flight.time_s[1])
    R_BS = flown.vehicle.pose_in_base("imu_base")[0]
    off = []
    for own in (None, offsets):
        chain = chain_motion(flown.vehicle, q, dq, ddq, own)
        base = predict_base_from_rate(chain.links, period_s, flown.chi, rate, ())
        off.append(np.abs(base.rate @ R_BS - flight.rate_rad_s).max())
    assert off[0] > 1e-4
    assert off[1] < 1e-6
