"""Bounds before the flight, against batch fits and plain least squares of the same motion.

What a loss leaves: never more than there was, nothing without a row or a motion, and the bound of a batch fit.

What is expected of a prescribed base, whose sway nobody knows beforehand: over motions that are all as likely.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants import planned
from hil_sim.plants.planned import default_plan
from hil_sim.scenario.vehicle_tables import Scenario
from onboard import config
from onboard.cli import main
from onboard.dynamics.free_flight import predict_base_from_rate
from onboard.dynamics.kinematics import link_motions
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.smoothing import SmoothingWindow
from onboard.flight.estimate.problem.identification import build_free_flyer, build_identifier
from onboard.flight.estimate.problem.priors import free_flyer_prior
from onboard.flight.estimate.readings.cyclic import cyclic_functions
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import kernel_of
from onboard.ground.before.foresee import rows
from onboard.ground.before.foresee.contingency import foresee_without
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.foreseen import render
from onboard.ground.before.foresee.plan import MotionNoise, MotionPlan, plan_of
from onboard.ground.before.foresee.rows import StatedNoise
from onboard.ground.before.init.vehicle import NewVehicle, make
from onboard.identification.free_flyer.batch import FreeBase, MotionFit
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.identification.standing import Level
from onboard.regressor.rows import standing

HZ = 20.0
STILL = "[base_motion]\nrate_rad_s = 0.0\nacceleration_m_s2 = 0.0\n"


def plan(directory: Path, base: str, over: str = "") -> tuple[config.Vehicle, MotionPlan]:
    directory.mkdir(exist_ok=True)
    make(NewVehicle("it", base, ("shoulder", "elbow"), load_cell="cia404"), directory / "it")  # type: ignore[arg-type]
    (directory / "over.toml").write_text(over)
    scenario: Scenario = scenario_of(str(directory / "it" / "vehicle.toml"), directory / "over.toml")
    vehicle = config.load(directory / "it" / "vehicle.toml").with_row_rate(HZ)
    return vehicle, plan_of(vehicle, default_plan(scenario, 1.0 / HZ))


def test_a_sigma_is_the_rms_over_the_sways(tmp_path: Path) -> None:
    vehicle, whole = plan(tmp_path, "prescribed")
    assert len(whole.bases) == 8
    each = np.array([[one.sigma for one in foresee(vehicle, part).parameters] for part in whole.by_base()])
    found = foresee(vehicle, whole).parameters
    np.testing.assert_allclose([one.sigma for one in found], np.sqrt(np.mean(each**2, axis=0)), rtol=1e-9)
    told = [name for name in (one.name for one in found) if name.startswith("MX_payload")]
    spread = each[:, [one.name for one in found].index(told[0])]
    assert spread.max() > 1.5 * spread.min()  # so it matters which one is taken


@pytest.mark.parametrize(("base", "over", "count"), [("prescribed", STILL, 1), ("fixed", "", 0)])
def test_a_base_that_does_not_sway_is_computed_once(base: str, over: str, count: int, tmp_path: Path) -> None:
    _, whole = plan(tmp_path, base, over)
    assert len(whole.bases) == count
    assert len(whole.by_base()) == 1


def test_a_long_motion_is_taken_in_parts_and_by_fewer_sways(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, whole = plan(tmp_path, "prescribed")
    n, one = len(whole.time_s), whole.by_base()[0]
    [found] = rows.foresee_rows(vehicle, [one])
    at_once = [parameter.sigma for parameter in found.parameters]
    monkeypatch.setattr(rows, "_MOST_TICKS", n // 3)
    taken = []
    made = StatedNoise.signals
    monkeypatch.setattr(StatedNoise, "signals", lambda *given: taken.append(len(given[1].q)) or made(*given))
    [found] = rows.foresee_rows(vehicle, [one])
    parts = [parameter.sigma for parameter in found.parameters]
    assert sum(taken) == n
    assert max(taken) <= n // 3
    np.testing.assert_allclose(parts, at_once, rtol=1e-3)  # rates of readings at the edges of parts are one-sided
    monkeypatch.setattr(planned, "_MOST_ROWS", n)
    assert len(plan(tmp_path / "again", "prescribed")[1].bases) == 2


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
    identifier, model = build_free_flyer(vehicle)
    q, dq, ddq = (np.array(part) for part in (plan.q, plan.dq, plan.ddq))
    for at in [k for k, joint in enumerate(model.joints) if joint.name == parked]:
        q[:, at], dq[:, at], ddq[:, at] = q[0, at], 0.0, 0.0
    links, imu_prior, payload_sigma = free_flyer_prior(vehicle, model)
    period_s, nothing = 1.0 / vehicle.file.estimation.row_rate_hz, np.zeros((len(q), 3))
    noise = [np.full(3, sigma / np.sqrt(10.0)) for sigma in (1.95e-3, 0.088)]
    signals = FlightSignals(period_s, q, dq, ddq, nothing, nothing, *noise, 10)
    motion_fit = MotionFit(FreeBase(model, signals), "imu_base", payload_sigma, links, ImuPrior(**imu_prior._asdict()))
    chi = model.chi.copy()
    chi[model.payload_columns()] = standard_of(plan.payload)
    base = predict_base_from_rate(link_motions(model, q, dq, ddq), period_s, chi, plan.rate_rad_s, ())
    bound = motion_fit.bound(motion_fit.parameters(base.momentum[0], plan.payload))
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
        ("delay_sigma_ms = 0.05", "delay_sigma_ms = 0.0\nzero_drift_N_s = 1e-12"),
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
    assert (ratio > 0.98).all()
    assert (ratio < 1.05).all()  # that the cell may be wrong, with a probability of 0.01, is in the interval


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


FREE = ("--base", "free", "--joints", "2")
EXACT_GEAR = {"eccentricity_rad": 0.0, "transmission_error_rad": 0.0}


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    return made(tmp_path_factory.mktemp("free"), *FREE)


def test_a_lost_joint_costs_as_much_as_a_batch_fit_of_the_parked_motion_says(tmp_path):
    """The filter's bound without joint_2 against the information of all ticks at once, joints and place exact."""
    vehicle, plan = made(tmp_path, *FREE, edits=EXACT)
    found = foresee_without(vehicle, plan, ["joint_2"])
    names, batch_sigma = by_batch(vehicle, plan, parked="joint_2")
    left = {one.name: one for one in found.left.quantities}
    sigma = np.array([left[name].sigma for name in names])
    whole = np.array([one.sigma for one, _ in found.pairs()])
    assert (sigma / whole).max() > 1.5  # it is a loss
    np.testing.assert_allclose(sigma, batch_sigma, rtol=0.03)


@pytest.mark.parametrize("lost", ["joint_1", "joint_2", "pulse"])
def test_nothing_is_known_better_without(free, lost):
    pairs = foresee_without(*free, [lost]).pairs()
    assert len(pairs) == 10
    ratios = np.array([left.sigma / whole.sigma for whole, left in pairs])
    assert ratios.min() > 1.0 - 1e-6
    assert (ratios.max() > 1.05) == lost.startswith("joint")


def test_a_free_flyer_knows_less_without_what_its_filter_fuses():
    """DYMAFLEX: a wrist cell, a second IMU, and cyclic errors of the gears as unknowns."""
    vehicle = config.load(config.packaged("dymaflex"))
    plan = plan_of(vehicle, default_plan(scenario_of(vehicle.path), 1.0 / vehicle.file.estimation.row_rate_hz))
    plan = plan.part(slice(0, round(plan.held.argmax() + 4.0 * vehicle.file.estimation.row_rate_hz)))
    of_cell, of_imu = (foresee_without(vehicle, plan, [lost]).pairs() for lost in ("load_cell", "imu_2"))
    wider = np.array([[left.sigma / whole.sigma for whole, left in pairs] for pairs in (of_cell, of_imu)])
    assert wider.min() > 1.0
    assert wider[0, 0] > 1.3
    assert wider[1].max() > 1.03
    exact = {
        name: device.model_copy(update=EXACT_GEAR) for name, device in vehicle.file.device.items() if "joint" in name
    }
    other = vehicle.model_copy(
        update={"file": vehicle.file.model_copy(update={"device": {**vehicle.file.device, **exact}})}
    )
    known = [one.sigma for one in foresee(other, plan).quantities]
    assert np.max([whole.sigma / own for (whole, _), own in zip(of_cell, known, strict=True)]) > 1.02


def test_without_any_joint_only_the_spin_is_left_and_nothing_is_good(free):
    found = foresee_without(*free, ["joint_1", "joint_2"])
    assert found.words[1].startswith("joint_2 is parked at")
    assert all(left.level is not Level.GOOD for _, left in found.pairs() if left.name.startswith(("m_", "I_")))


def test_without_what_measures_the_base_there_is_nothing(free):
    found = foresee_without(*free, ["imu_base"])
    assert found.left is None
    assert "no IMU is left, and the base moves" in found.why
    assert not found.useful


def test_the_command_says_what_is_left_and_fails_where_nothing_is(tmp_path, capsys):
    assert main(["checkout", "rocksat", "--without", "load_cell"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "nothing can be determined: no load cell, torque or base wrench is left to make a row of" in said
    report = tmp_path / "left.json"
    assert main(["checkout", "rocksat", "--without", "pulse", "--json", str(report)]) == 0
    assert "no pulse: times by arrival, 1 sigma imu_base 2.9 ms" in " ".join(capsys.readouterr().out.split())
    read = {one["name"]: one for one in json.loads(report.read_text())["quantities"]}
    assert read["m_tip_mass"]["level_without"] == "good"
    assert read["XX_arm_R"]["sigma"] is None
    assert main(["checkout", "rocksat", "--without", "joint_9"]) == 2
    assert "there are joint_1, imu_base" in capsys.readouterr().err


def test_cyclic_errors_of_a_plan_are_smoothed_as_in_flight():
    """Of a joint at a steady rate: the flight's kernel over its samples against its frequency response."""
    vehicle = config.load(config.packaged("dymaflex"))
    _, model = build_free_flyer(vehicle)
    role = next(joint for joint in roles_of(vehicle).joints if joint.joint == "joint_2")
    signal = roles_of(vehicle).signals[role.channel]
    width_s, rate_rad_s = vehicle.file.estimation.smoothing_ms * 1e-3, -0.13
    times_s = np.arange(-200, 201) * signal.period_s
    window = SmoothingWindow(times_s, [0.0], width_s, 3.5 * signal.period_s, kernel_of(vehicle))
    functions = cyclic_functions(np.outer(0.4 + rate_rad_s * times_s, [periods for periods, _ in signal.ripple]))
    wanted = np.stack([window.apply(functions, order).values[0] for order in range(3)])
    at = [joint.name for joint in model.joints].index("joint_2")
    q, dq = np.zeros((2, 1, len(model.joints)))
    q[0, at], dq[0, at] = 0.4, rate_rad_s
    width = wanted.shape[1]
    found = MotionNoise(vehicle, model).cyclic(q, dq)[0, :, width * at : width * at + width]
    assert np.abs(wanted).max(axis=1).min() > 0.05
    assert (np.abs(found - wanted).max(axis=1) < 0.01 * np.abs(wanted).max(axis=1)).all()
