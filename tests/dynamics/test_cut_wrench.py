"""The wrench through the wrist: MuJoCo's force sensor, and derivatives of everything by finite differences."""

import numpy as np
import pytest

from onboard import config
from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.free_flight import predict_base_from_rate
from onboard.dynamics.kinematics import chain_motion
from onboard.dynamics.model.errors import UnknownFrameError
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.problem.priors import free_flyer_prior, geometry_prior
from onboard.identification.free_flyer.prediction.further import (
    CellPrior,
    Friction,
    FurtherCell,
    FurtherImu,
    FurtherPose,
    PosePrior,
)
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE, ImuPredictor
from onboard.regressor.rows import joint_torque_row
from tests.dynamics.free_flyer_twin import twin

PERIOD_s = 0.01


def test_it_is_what_mujoco_s_sensor_in_the_wrist_reads():
    flown = twin(1.0)
    every = 5
    flight = flown.flight
    q, dq, ddq = flown.motion.at(flight.time_s[::every])
    chain = chain_motion(flown.vehicle, q, dq, ddq)
    period_s = every * float(flight.time_s[1])
    rate = flown.vehicle.pose_in_base("imu_base")[0] @ flight.rate_rad_s[0]
    base = predict_base_from_rate(chain.links, period_s, flown.chi, rate, ())
    truth = np.concatenate([flight.wrist_force_n, flight.wrist_moment_n_m], axis=1)[::every]
    assert np.abs(truth).max(axis=0).min() > 0.05
    for component, unit in enumerate(np.eye(6)):
        found = CutWrench(flown.vehicle, "link_5", unit, ()).predict(base).values
        a_ten_thousandth = 1e-4 * np.abs(truth).max()
        assert np.abs(found - truth[:, component]).max() < a_ten_thousandth, component


def test_the_torque_of_a_joint_is_what_mujoco_s_drive_exerts():
    flown = twin(1.0)
    flight, every = flown.flight, 5
    chain = chain_motion(flown.vehicle, *flown.motion.at(flight.time_s[::every]))
    rate = flown.vehicle.pose_in_base("imu_base")[0] @ flight.rate_rad_s[0]
    base = predict_base_from_rate(chain.links, every * float(flight.time_s[1]), flown.chi, rate, ())
    truth = flight.torque_n_m[::every]
    assert np.abs(truth).max(axis=0).min() > 0.01
    for joint, torque in zip(flown.vehicle.joints, truth.T, strict=True):
        row = joint_torque_row(flown.vehicle, joint.name)
        found = CutWrench(flown.vehicle, row.frame, np.array(row.projection), ()).predict(base).values
        a_ten_thousandth = 1e-4 * np.abs(truth).max()
        assert np.abs(found - torque).max() < a_ten_thousandth, joint.name


def test_nothing_beyond_a_cut_is_refused():
    with pytest.raises(UnknownFrameError, match="no link with inertia lies beyond"):
        CutWrench(twin(0.1).vehicle, "imu_base", np.eye(6)[0], ())


def test_derivatives_of_all_instruments_are_finite_differences():
    vehicle = config.load(config.packaged("dymaflex"))
    model = build_model(vehicle)
    covariance, prior, _ = free_flyer_prior(vehicle, model)
    cell = FurtherCell("cell", "link_5", (0.6, 0.5, 0.2, 0.3, -0.7, 0.9), 5, CellPrior(0.03, 1e-4, 0.0025, 2e-4))
    friction = Friction(1, 0.3, 0.2, 0.1)
    torque = FurtherCell("torque", "joint_2", (0, 0, 0, 0, 1, 0), 5, CellPrior(0.1, 0.0, 0.01, 2e-4), friction)
    tracker = FurtherPose("tracker", "imu_2", PosePrior(1e-3, 0.02, 3e-3, 1e-3, 1e-3))
    further = [tracker, cell, torque, FurtherImu("imu_2", "imu_2", 10, prior, 0.003, 1.0)]
    geometry = geometry_prior(vehicle, model)
    predictor = ImuPredictor(model, "imu_base", PERIOD_s, 10, covariance, prior, geometry, further)
    assert [own.start for own in predictor.lines] == [0, 6, 12, 13, 14]  # IMUs, cells, trackers
    rng = np.random.default_rng(1)
    t, size, pace, phase = PERIOD_s * np.arange(12)[:, None], *rng.uniform(1.0, 3.0, (3, 5))
    joints = 0.3 * size * np.sin(pace * t + phase), 0.3 * size * pace * np.cos(pace * t + phase)
    joints += (-(pace**2) * joints[0],)
    x = np.nan_to_num(predictor.sigma) * rng.normal(size=len(predictor.names))
    x[predictor.moving] = [0.6, -0.3, 0.7, 0.2, 1.0, 2.0, 3.0, 0.1, 0.2, -0.1]
    x[PAYLOAD], x[RATE] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1], [0.2, -0.3, 0.1]
    predicted = predictor.predict(*joints, x)
    jacobian, moving = predicted.jacobian, predictor.moving
    for k, name in enumerate(predictor.names):
        step = np.zeros(len(x))
        step[k] = 1e-5 if np.isnan(predictor.sigma[k]) else 1e-3 * predictor.sigma[k]
        ends = [predictor.predict(*joints, x + sign * step) for sign in (1.0, -1.0)]
        up, down = (end.values for end in ends)
        slope = (up - down) / (2.0 * step[k])
        of_end = (ends[0].state - ends[1].state)[moving] / (2.0 * step[k])
        of_second_order = 5e-3 * np.abs(of_end).max() + 1e-8 / step[k]
        assert np.abs(predicted.transition[-moving.size :, k] - of_end).max() < of_second_order, name
        for own in predictor.lines:
            of_second_order = 5e-3 * np.abs(slope[:, own]).max() + 1e-8 / step[k]
            assert np.abs(jacobian[:, own, k] - slope[:, own]).max() < of_second_order, (name, own)
