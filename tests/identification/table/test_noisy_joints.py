"""Noise and cyclic errors of the encoders of a run on the table, and pucks that push at first."""

import numpy as np
import pytest

from onboard.estimation.smoothing import SmoothingWindow, uncorrelated_s
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior
from onboard.identification.table.air_bearing import TableFit
from onboard.identification.table.rivals import joint_step
from tests.identification.table.bed_run import BOX, DRAGS, PAYLOAD, PRIOR, WIDE, fly, noisy, once_a_turn, vehicle

WIDTH_s, RATE_rad_s, ACCELERATION_rad_s2 = 0.3, 4e-3, 0.1


@pytest.fixture(scope="module")
def clean():
    return noisy(fly(0.6), np.random.default_rng(3))


def with_noise(signals, rng, stated):
    """Rates and accelerations with noise of samples under a kernel, at ticks whose noise is uncorrelated."""
    n, joints = signals.q.shape
    fine_s = np.arange(-0.5 * WIDTH_s, n * signals.period_s + 0.5 * WIDTH_s, 0.5 * signals.period_s)
    window = SmoothingWindow(fine_s, signals.period_s * np.arange(n), WIDTH_s)
    samples = rng.standard_normal((len(fine_s), joints))
    wrong = [window.apply(samples, order).values for order in (1, 2)]
    sizes = [RATE_rad_s / wrong[0].std(), ACCELERATION_rad_s2 / wrong[1].std()]
    sigma = np.tile(np.array([[RATE_rad_s], [ACCELERATION_rad_s2]]), (n, 1, joints))
    seen = signals._replace(
        dq=signals.dq + sizes[0] * wrong[0],
        ddq=signals.ddq + sizes[1] * wrong[1],
        joint_sigma=sigma if stated else None,
    )
    return seen.coarser(round(uncorrelated_s(WIDTH_s) / signals.period_s))


def test_noise_of_rates_is_uncorrelated_after_that_time_and_not_before(rng):
    apart_s = uncorrelated_s(WIDTH_s)
    t = np.arange(0.0, 2.0, 0.001)
    at = 1.0 + apart_s * np.array([0.0, 0.5, 1.0])
    rates = SmoothingWindow(t, at, WIDTH_s).apply(rng.standard_normal((len(t), 3000)), 1).values
    correlation = np.corrcoef(rates)[0]
    assert correlation[1] > 0.4
    assert abs(correlation[2]) < 0.06


def test_a_payload_is_inside_its_interval_where_the_noise_of_the_joints_is_stated(clean, rng):
    """What is left is then the noise; without it the same run contradicts its IMU."""
    left = []
    for stated in (True, False):
        signals = with_noise(clean, np.random.default_rng(11), stated)
        found = TableFit(vehicle(), "imu_base", signals, WIDE, {}, PRIOR).near(_truth(signals))
        sigma = float(np.sqrt(found.payload.covariance[0, 0]))
        left.append((found.misfit, abs(found.payload.body.mass_kg - BOX.mass_kg) / sigma))
    assert left[0][0] == pytest.approx(1.0, abs=0.25)
    assert left[0][1] < 3.0
    assert left[1][0] > 2.0


def _truth(signals):
    motion_fit = TableFit(vehicle(), "imu_base", signals, WIDE, {}, PRIOR)
    x = motion_fit.start(PAYLOAD)
    x[motion_fit.layout.estimated("drag")] = [value for one in DRAGS for value in (one.viscous_N_s_m, one.coulomb_N)]
    return x


def test_a_cyclic_error_of_an_encoder_is_an_unknown_of_the_run(clean):
    """Joint 2 reads ``q + 0.006 cos q``; its multiple is found, and residuals fall by what it does."""
    functions = once_a_turn(clean.q[:, 1], clean.dq[:, 1], clean.ddq[:, 1])
    read = [getattr(clean, name).copy() for name in ("q", "dq", "ddq")]
    for order, motion in enumerate(read):
        motion[:, 1] += 0.006 * functions[:, order, 0]
    signals = clean._replace(q=read[0], dq=read[1], ddq=read[2], cyclic=functions).coarser(2)
    joint = vehicle().joints[1].name
    prior = PRIOR._replace(geometry=GeometryPrior(0.0, {joint: JointPrior(cyclic=((1.0, 0.006),))}))
    motion_fit = TableFit(vehicle(), "imu_base", signals, WIDE, {}, prior)
    plain = motion_fit.near(_truth(signals))
    corrected = joint_step(motion_fit, plain.fit)
    multiples = dict(zip(corrected.joints.names, corrected.joints.values, strict=True))
    assert list(multiples) == [f"cyclic_0_cos_{joint}", f"cyclic_0_sin_{joint}"]
    assert abs(multiples[f"cyclic_0_cos_{joint}"]) == pytest.approx(0.006, abs=3.5 * corrected.joints.sigma[0])
    body = motion_fit.found(corrected.fit).payload
    assert abs(body.body.mass_kg - BOX.mass_kg) < 3.5 * float(np.sqrt(body.covariance[0, 0]))
    assert corrected.fit.residual_sum < plain.fit.residual_sum - 100.0


def test_a_fit_that_begins_where_pucks_push_ends_where_they_drag(clean):
    motion_fit = TableFit(vehicle(), "imu_base", clean.coarser(2), WIDE, {}, PRIOR)
    x, truth = _truth(clean.coarser(2)), motion_fit.near(_truth(clean.coarser(2)))
    drag = motion_fit.layout.estimated("drag")
    x[drag[1::2]] *= -1.0
    found = motion_fit.near(x)
    assert found.fit.residual_sum == pytest.approx(truth.fit.residual_sum, rel=1e-3)
