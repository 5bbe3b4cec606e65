"""Bounds before the flight, against batch fits and plain least squares of the same motion."""

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.planned import default_plan
from onboard import config
from onboard.cli import main
from onboard.dynamics.free_flight import predict_base_from_rate
from onboard.dynamics.kinematics import link_motions
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.ticks import FlightSignals
from onboard.flight.estimate.problem.identification import build_exiddm, build_identifier
from onboard.flight.estimate.problem.priors import exiddm_prior
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.foreseen import render
from onboard.ground.before.foresee.plan import plan_of
from onboard.identification.exiddm.free_base import free_exiddm
from onboard.identification.exiddm.prediction.imu_errors import ImuPrior
from onboard.identification.standing import Level
from onboard.regressor.rows import standing

ARM = Path(__file__).resolve().parents[3] / "flight" / "own" / "planar_arm.urdf"
SCENARIO = '[[sequence]]\nphase = 1\naction = "swing"\nduration_s = 12.0\n'

_NO_ERROR = "position_m = 0.0\nzero_rad = 0.0\nscale = 0.0\ndelay_s = 0.0\n"
EXACT = (  # of a vehicle by heft init --base free --joints 2: joints and the IMU's place; nothing drifts or pushes
    ("[estimation.prior.link]", "[estimation.disturbance]\nforce_N = 0.0\n\n[estimation.prior.link]"),
    ("gyro_drift_rad_s2 = 8.7e-5", "gyro_drift_rad_s2 = 0.0\nposition_m = 0.0"),
    ("accelerometer_drift_m_s3 = 1e-3", "accelerometer_drift_m_s3 = 0.0"),
    (
        "[estimation.prior.link]",
        f"[estimation.prior.joint.joint_1]\n{_NO_ERROR}[estimation.prior.joint.joint_2]\n{_NO_ERROR}\n[estimation.prior.link]",
    ),
    ("noise_rad = 4e-6", "noise_rad = 1e-9"),
)


def made(directory, *init, edits=(), scenario=SCENARIO):
    """A vehicle by ``heft init``, its file edited, and the plan of its rehearsal."""
    assert main(["init", str(directory / "mine"), *init]) == 0
    path = directory / "mine" / "vehicle.toml"
    text = path.read_text()
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    (directory / "over.toml").write_text(scenario)
    vehicle = config.load(path)
    planned = default_plan(scenario_of(path, directory / "over.toml"), 1.0 / vehicle.file.estimation.row_rate_hz)
    return vehicle, plan_of(vehicle, planned)


def by_batch(vehicle, plan, parked=None):
    """Names, and sigmas by the information of all ticks at once, of which ``parked`` does not move in any."""
    identifier, model = build_exiddm(vehicle)
    q, dq, ddq = (np.array(part) for part in (plan.q, plan.dq, plan.ddq))
    for at in [k for k, joint in enumerate(model.joints) if joint.name == parked]:
        q[:, at], dq[:, at], ddq[:, at] = q[0, at], 0.0, 0.0
    links, imu_prior, payload_sigma = exiddm_prior(vehicle, model)
    period_s, nothing = 1.0 / vehicle.file.estimation.row_rate_hz, np.zeros((len(q), 3))
    noise = [np.full(3, sigma / np.sqrt(10.0)) for sigma in (1.95e-3, 0.088)]
    signals = FlightSignals(period_s, q, dq, ddq, nothing, nothing, *noise, 10)
    exiddm = free_exiddm(model, "imu_base", signals, payload_sigma, links, ImuPrior(**imu_prior._asdict()))
    chi = model.chi.copy()
    chi[model.payload_columns()] = standard_of(plan.payload)
    base = predict_base_from_rate(link_motions(model, q, dq, ddq), period_s, chi, plan.rate_rad_s, ())
    bound = exiddm.bound(exiddm.parameters(base.momentum[0], plan.payload))
    return identifier.quantity_names, np.sqrt(np.diag(bound.covariance))


def test_the_bound_of_a_free_flyer_is_that_of_a_batch_fit(tmp_path):
    """The filter's covariance along the motion against the information of all ticks at once; joints and place exact."""
    vehicle, plan = made(tmp_path, "--base", "free", "--joints", "2", edits=EXACT)
    found = {one.name: one for one in foresee(vehicle, plan).quantities}
    names, batch_sigma = by_batch(vehicle, plan)
    np.testing.assert_allclose([found[name].sigma for name in names], batch_sigma, rtol=0.03)


def test_the_bound_of_rows_is_that_of_weighted_least_squares(tmp_path):
    """Exact joints: what is left is noise and bias of the cell, and the prior."""
    edits = (
        ("noise_rad = 4e-6", "noise_rad = 1e-12\nzero_sigma_rad = 0.0"),
        ("scale_sigma = 0.0025", "scale_sigma = 0.0"),
        ("lever_sigma_m = 1e-4", "lever_sigma_m = 0.0"),
        ("delay_sigma_ms = 0.05", "delay_sigma_ms = 0.0"),
    )
    vehicle, plan = made(tmp_path, "--base", "fixed", "--joints", "2", "--load-cell", "cia404", edits=edits)
    found = foresee(vehicle, plan)
    identifier, model = build_identifier(vehicle)
    row_sigma = 0.0025 * np.sqrt(
        0.005 * vehicle.file.estimation.row_rate_hz
    )  # of the samples, 200 Hz, of a row's period
    motion = standing(model, len(plan.time_s))
    Y = identifier.model.regressor(plan.q, plan.dq, plan.ddq, motion, plan.held)[:, 0] @ _independent(identifier)
    information = Y.T @ Y / row_sigma**2 + np.linalg.inv(identifier.base.covariance(identifier.taken.prior_root))
    least = np.sqrt(np.diag(np.linalg.inv(information)))
    ratio = np.array([one.sigma for one in found.parameters]) / least
    np.testing.assert_allclose(ratio, 1.0, atol=0.02)


@pytest.mark.parametrize(("name", "sways"), [("rocksat", 8), ("capture", 0)])
def test_a_bound_is_the_same_by_every_second_tick(name: str, sways: int):
    """RockSat's sigmas of one draw of noise were 0.24 to 1.26 of each other."""
    vehicle = config.load(config.packaged(name))
    period_s = 1.0 / vehicle.file.estimation.row_rate_hz
    plan = plan_of(vehicle, default_plan(scenario_of(name), period_s))
    assert len(plan.bases) == sways
    half = plan.part(slice(None, None, 2))
    found = [
        {own.name: own.sigma for own in (*one.quantities, *one.parameters)}
        for one in (foresee(vehicle, plan), foresee(vehicle.with_row_rate(0.5 / period_s), half))
    ]
    assert len(found[0]) >= 10
    ratio = [found[1][name] / found[0][name] for name in found[0]]
    np.testing.assert_allclose(ratio, 1.0, atol=0.05)


def test_the_noise_of_differentiated_encoders_hides_no_slow_motion(tmp_path):
    """And coarse ticks, with which motions are searched, promise what the estimator's own do."""
    edits = (("scale_sigma = 0.0025", "scale_sigma = 0.0"), ("lever_sigma_m = 1e-4", "lever_sigma_m = 0.0"))
    edits += (("delay_sigma_ms = 0.05", "delay_sigma_ms = 0.0"),)
    sigmas = []
    for name, noise in (("white", 'row_noise = "white"'), ("by_frequency", 'row_noise = "by_frequency"')):
        own = (*edits, ('row_noise = "by_frequency"', noise))
        vehicle, plan = made(tmp_path / name, "--base", "fixed", "--joints", "2", "--load-cell", "cia404", edits=own)
        coarse = vehicle.with_row_rate(5.0)
        every = round(vehicle.file.estimation.row_rate_hz / 5.0)
        for one in (foresee(vehicle, plan), foresee(coarse, plan.part(slice(None, None, every)), coarse=True)):
            sigmas.append({own.name: own.sigma for own in one.parameters})
    white, _, filtered, few = sigmas
    for name in ("MX_payload_R", "XX_payload_R", "ZZ_payload_R"):
        assert filtered[name] < 0.3 * white[name]
        assert few[name] == pytest.approx(filtered[name], rel=0.3)


def _independent(identifier):
    return np.eye(len(identifier.model.names))[:, identifier.base.independent]


def test_a_planar_arm_at_rest_is_told_what_stays_weak_and_why(tmp_path):
    still = f"{SCENARIO}[release]\nrate_rad_s = 0.0\n"
    vehicle, plan = made(tmp_path, "--base", "free", "--urdf", str(ARM), scenario=still)
    found = foresee(vehicle, plan)
    weak = {one.name for one in found.quantities if one.level is Level.WEAK}
    assert {"I_xx_payload", "I_yy_payload", "I_zz_payload"} <= weak
    mass = next(one for one in found.quantities if one.name == "m_payload")
    assert mass.why == "its interval is as wide as 22% of it"
    assert "payload hardly turns about y" in " ".join(found.words)
    console = Console(width=80, record=True)
    console.print(render(found, "this motion"))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= 80
    assert "weak, " in text
    assert "converge" not in text


def test_a_noisier_imu_widens_what_is_expected(tmp_path):
    times = 3.0
    vehicle, plan = made(tmp_path / "a", "--base", "free", "--joints", "2")
    noisy = (("gyro_noise_rad_s = 1.95e-3", f"gyro_noise_rad_s = {times * 1.95e-3}"),)
    noisy += (("accel_noise_m_s2 = 0.088", f"accel_noise_m_s2 = {times * 0.088}"),)
    other, _ = made(tmp_path / "b", "--base", "free", "--joints", "2", edits=noisy)
    one, two = (np.array([q.sigma for q in foresee(which, plan).quantities]) for which in (vehicle, other))
    assert (two / one).min() > 1.0
    assert 1.5 < (two / one).max() < times
