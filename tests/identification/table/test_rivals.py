"""Encoders of a run on the table that are not as stated: named, and the payload's intervals hold the truth."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from onboard.dynamics.model.inertia import elements
from onboard.identification.corrections import contradicted
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior
from onboard.identification.quantities import Findings
from onboard.identification.table.air_bearing import TableFit
from onboard.identification.table.rivals import answered
from tests.identification.table.bed_run import BOX, PRIOR, WIDE, fly, noisy, once_a_turn, vehicle

TRUTH = np.array([BOX.mass_kg, *BOX.centre_of_mass_m, *elements(BOX.inertia_kg_m2)])


@pytest.fixture(scope="module")
def signals():
    return noisy(fly(0.6, 5.0), np.random.default_rng(7)).coarser(2)


def found(signals, prior=PRIOR):
    """What is answered of a run, its errors of mass, centre and moment of inertia in sigmas, those of the plain fit."""
    motion_fit = TableFit(vehicle(), "imu_base", signals, WIDE, {}, prior)
    plain = motion_fit.fit()
    told = answered(motion_fit, plain)
    off = []
    for one in (told.found, plain):
        body, sigma = one.payload.body, np.sqrt(np.diag(one.payload.covariance))
        values = np.array([body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)])
        off.append(np.abs((values - TRUTH) / sigma)[[0, 1, 2, 9]])
    return told, *off


def test_encoders_as_stated_are_not_blamed_and_the_answer_is_that_of_the_fit(signals):
    told, off, _ = found(signals)
    assert told.findings == Findings()
    assert off.max() < 3.3
    assert np.abs(told.found.fit.x - told.stated.fit.x).max() < 0.2 * np.sqrt(np.diag(told.stated.fit.covariance)).max()


@pytest.mark.parametrize(
    ("joint", "error", "since", "name"),
    [
        (4, "scale", 0.4, "a step of scale_joint_5"),
        pytest.param(4, "scale", 0.0, "scale_joint_5", marks=pytest.mark.campaign),  # its step is below
        pytest.param(2, "zero", 0.0, "zero_joint_3", marks=pytest.mark.campaign),  # test_air_bearing has it
        pytest.param(1, "delay", 0.0, "delay_joint_2", marks=pytest.mark.campaign),  # of rows: test_suspects
    ],
)
def test_what_is_wrong_is_named_and_the_payload_told_inside_its_interval(signals, joint, error, since, name):
    """A scale of 5 %, a zero of 10 mrad, a delay of 10 ms; the plain fit is ten sigmas off and more."""
    q, dq, ddq = (motion.copy() for motion in (signals.q, signals.dq, signals.ddq))
    late = np.arange(len(q)) >= since * len(q)
    time_s = signals.period_s * np.arange(len(q))
    if error == "zero":
        q[late, joint] += 0.01
    else:
        for motion in (q, dq, ddq):
            before = CubicSpline(time_s, motion[:, joint])(time_s - 0.01)
            motion[late, joint] = (1.05 * motion[:, joint] if error == "scale" else before)[late]
    told, off, plain = found(signals._replace(q=q, dq=dq, ddq=ddq))
    (doubt,) = told.findings.doubts
    assert doubt.startswith("not as stated: ")
    assert name in doubt.removeprefix("not as stated: ").split(" or ")
    assert plain.max() > 5.0
    assert off.max() < 3.3
    assert contradicted(told.joints.in_told_sigmas) == ()


@pytest.mark.campaign  # of a joint without errors once a turn: above
def test_with_the_error_that_is_named_nothing_else_contradicts_the_run():
    """A scale of 5 % of an encoder that has an error once a turn, which would have to be twenty of its sigmas."""
    signals = noisy(fly(0.6), np.random.default_rng(7)).coarser(2)
    motions = [motion.copy() for motion in (signals.q, signals.dq, signals.ddq)]
    for motion in motions:
        motion[:, 4] *= 1.05
    q, dq, ddq = motions
    functions, joint = once_a_turn(q[:, 4], dq[:, 4], ddq[:, 4]), vehicle().joints[4].name
    exact = JointPrior(2e-4, 1e-3, 2e-4, 2e-4)
    errors = {one.name: exact for one in vehicle().joints} | {joint: exact._replace(cyclic=((1.0, 1e-3),))}
    prior = PRIOR._replace(geometry=GeometryPrior(0.0, errors))
    told, off, _ = found(signals._replace(q=q, dq=dq, ddq=ddq, cyclic=functions), prior)
    assert "scale_joint_5" in told.findings.doubts[0]
    assert off.max() < 3.3
    assert contradicted(told.joints.in_told_sigmas) == ()
