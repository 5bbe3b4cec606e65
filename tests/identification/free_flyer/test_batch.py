"""The payload from a flight's encoders and IMU, with MuJoCo's truth."""

import numpy as np
import pytest

from bench.true_flights.free_flyer_sensors import ImuErrors
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.dynamics.model.payload import numbers_of, standard_covariance, standard_of
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.ticks import tick_signals
from onboard.estimation.errors import ConvergenceError
from onboard.identification.free_flyer.batch import FreeBase, MotionFit
from onboard.identification.free_flyer.prediction.imu_errors import CERTAIN, ImuPrior
from onboard.regressor.free_rows import measured_base, rough_payload, zero_wrench_rows
from tests.dynamics.free_flyer_twin import PAYLOAD, URDF, twin

WIDE = np.array([50.0, *[20.0] * 3, *[10.0] * 6])
ERRORS = ImuErrors(0.01, 1e-4, 0.1, 1e-3, 0.003, 0.0035, 1e-4)
PRIOR = ImuPrior(0.01, 1e-4, 0.003, 0.0035, 0.1, 1e-3, 0.003, 0.0035, 1e-4)


@pytest.fixture(scope="module")
def flown():
    return twin(6.0)


def ticks(samples):
    return tick_signals(*samples[:4], samples[4:], 5, 0.1)


def test_without_noise_the_payload_is_the_truth(flown, rng):
    found = MotionFit(FreeBase(flown.vehicle, ticks(flown.samples(rng, noise=False))), "imu_base", WIDE, {}).fit()
    assert found.payload.body.mass_kg == pytest.approx(5.0, rel=1e-5)
    np.testing.assert_allclose(numbers_of(found.payload.body), numbers_of(PAYLOAD), atol=5e-5)


def test_with_datasheet_noise_the_error_is_what_the_covariance_says(flown, rng):
    signals = ticks(flown.samples(rng))
    motion_fit = MotionFit(FreeBase(flown.vehicle, signals), "imu_base", WIDE, {})
    found = motion_fit.fit()
    error = numbers_of(found.payload.body) - numbers_of(PAYLOAD)
    chi_squared = error @ np.linalg.solve(found.payload.covariance, error)
    assert chi_squared < 29.6  # 99.9 % of chi-squared with ten degrees
    assert found.misfit == pytest.approx(1.0, abs=0.06)
    R, _ = flown.vehicle.pose_in_base("imu_base")
    first = round(0.05 / 0.002) + 4
    momentum = flown.momentum(signals.q[0], signals.dq[0], R @ flown.flight.rate_rad_s[first])
    bound = motion_fit.bound(motion_fit.parameters(momentum, PAYLOAD))
    np.testing.assert_allclose(np.diag(bound.covariance), np.diag(found.payload.covariance), rtol=0.3)


def test_plain_least_squares_is_biased_where_this_is_not(flown, rng):
    signals = ticks(flown.samples(rng))
    base = measured_base(flown.vehicle, "imu_base", signals, 0.2)
    Y, y = zero_wrench_rows(flown.vehicle, signals.q, signals.dq, signals.ddq, base)
    whole = np.isfinite(y).all(axis=1)
    plain = np.linalg.lstsq(Y[whole].reshape(-1, 10), y[whole].ravel())[0]
    found = MotionFit(FreeBase(flown.vehicle, signals), "imu_base", WIDE, {}).fit()
    assert plain[0] < 0.98 * 5.0
    assert abs(found.payload.body.mass_kg - 5.0) < 0.1 * abs(plain[0] - 5.0)


def test_the_rough_start_knows_the_accelerometers_zero(flown, rng):
    signals = ticks(flown.samples(rng, noise=False))
    signals.specific_force[:] += [0.3, -0.2, 0.1]
    rough = rough_payload(flown.vehicle, "imu_base", signals, 0.3, WIDE)
    assert rough.mass_kg == pytest.approx(5.0, rel=0.02)
    np.testing.assert_allclose(rough.centre_of_mass_m, PAYLOAD.centre_of_mass_m, atol=0.01)


def test_uncertain_sensor_and_links_widen_the_interval_and_it_still_holds(flown, rng):
    signals = ticks(flown.samples(rng, ERRORS))
    certain = MotionFit(FreeBase(flown.vehicle, signals), "imu_base", WIDE, {}).fit()
    links = {
        name: standard_covariance(flown.vehicle.chi[10 * k : 10 * k + 10], 0.01, 1e-3, 0.01)
        for k, name in enumerate(flown.vehicle.links[:-1])
    }
    uncertain = MotionFit(FreeBase(flown.vehicle, signals), "imu_base", WIDE, links, PRIOR)
    found = uncertain.fit()
    error = numbers_of(found.payload.body) - numbers_of(PAYLOAD)
    assert error @ np.linalg.solve(found.payload.covariance, error) < 29.6
    assert found.misfit == pytest.approx(1.0, abs=0.06)
    assert certain.misfit > 1.2  # a model that is too sure shows it
    ratio = np.sqrt(np.diag(found.payload.covariance) / np.diag(certain.payload.covariance))
    assert ratio.min() > 1.0


def test_derivatives_are_finite_differences(flown, rng):
    links = {"link_5": standard_covariance(flown.vehicle.chi[50:60], 0.01, 1e-3, 0.01)}
    imu_prior = PRIOR._replace(clock_rate_error=1e-4)
    motion_fit = MotionFit(FreeBase(flown.vehicle, ticks(flown.samples(rng))), "imu_base", WIDE, links, imu_prior)
    x = motion_fit.parameters(np.array([0.1, -0.2, 0.3]), PAYLOAD)
    x[13:] = 1e-3 * rng.normal(size=x.size - 13)
    x[-2:] = 1e-5, 1e-6  # s, 1: how the other columns feel delay and clock rate error is left out of them
    _, J = motion_fit.residuals(x, 60)
    for k, name in enumerate(motion_fit.names):
        step = 1e-6 * np.eye(x.size)[k]
        slope = (motion_fit.residuals(x + step, 60)[0] - motion_fit.residuals(x - step, 60)[0]) / 2e-6
        assert np.abs(J[:, k] - slope).max() < 1e-3 * np.abs(slope).max(), name


def test_ticks_without_an_imu_are_left_out(flown, rng):
    signals = ticks(flown.samples(rng))
    for hole in (slice(100, 220), slice(400, 401)):
        signals.rate[hole] = np.nan
    motion_fit = MotionFit(FreeBase(flown.vehicle, signals), "imu_base", WIDE, {})
    found = motion_fit.fit()
    assert len(motion_fit.residuals(found.fit.x)[0]) == 6 * (len(signals.q) - 121)
    assert abs(found.payload.body.mass_kg - 5.0) < 4.0 * np.sqrt(found.payload.covariance[0, 0])


def test_swapped_axes_are_an_error_or_a_misfit_never_a_number(flown, rng):
    samples = flown.samples(rng)
    wrong = samples._replace(rate_rad_s=samples.rate_rad_s[:, [1, 0, 2]])
    try:
        found = MotionFit(FreeBase(flown.vehicle, ticks(wrong)), "imu_base", WIDE, {}).fit()
    except (ConvergenceError, SignalError):
        return
    assert found.misfit > 2.0


@pytest.mark.parametrize(
    ("payload", "imu", "links", "message"),
    [
        (None, "imu_base", {}, "no payload link"),
        ("payload", "imu_tip", {}, "imu_tip"),
        ("payload", "link_2", {}, "moves with a joint"),
        ("payload", "imu_base", {"payload": np.eye(10)}, "other than the payload"),
        ("payload", "imu_base", {"wheel": np.eye(10)}, "wheel"),
    ],
)
def test_names_that_do_not_fit_are_refused(flown, rng, payload, imu, links, message):
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", payload))
    with pytest.raises(UnknownFrameError, match=message):
        MotionFit(FreeBase(vehicle, ticks(flown.samples(rng))), imu, WIDE, links, CERTAIN)


def test_samples_off_their_grid_are_refused(flown, rng):
    samples = flown.samples(rng)
    late = samples.time_s.copy()
    late[100:] += 0.02
    with pytest.raises(SignalError, match="evenly"):
        ticks(samples._replace(time_s=late))
    with pytest.raises(SignalError, match="odd"):
        tick_signals(*samples[:4], samples[4:], 4, 0.1)


def test_standard_parameters_of_the_box(flown):
    np.testing.assert_allclose(flown.chi[flown.vehicle.payload_columns()], standard_of(PAYLOAD))
