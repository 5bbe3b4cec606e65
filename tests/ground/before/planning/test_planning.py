"""Planned motions: limits are kept, the bound is the flight's own, and the files fly."""

import json
import sys

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import rehearsal
from hil_sim.plants.planned import default_plan, room_for_motion
from onboard import config
from onboard.cli import main
from onboard.config import ConfigError
from onboard.dynamics.kinematics import link_motions
from onboard.flight.estimate.problem.model import build_model
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.plan import plan_of
from onboard.ground.before.planning import limits
from onboard.ground.before.planning.bound import TICK_HZ, RowsBound
from onboard.ground.before.planning.criteria import Criterion, cost, weakest
from onboard.ground.before.planning.planning import Wanted, plan_motion, told_by
from onboard.ground.before.planning.splines import Splines

SCENARIO = """
[capture]
earliest_s = 1.0
latest_s = 1.4
[[sequence]]
phase = 0
action = "hold"
duration_s = 2.0
[[sequence]]
phase = 1
action = "swing"
duration_s = 9.0
[[sequence]]
phase = 9
action = "hold"
duration_s = 0.5
"""


@pytest.fixture(scope="module")
def flyer(tmp_path_factory):
    """A free-flyer with two joints, and a scenario with little in it."""
    directory = tmp_path_factory.mktemp("flyer")
    assert main(["init", str(directory / "mine"), "--base", "free", "--joints", "2"]) == 0
    (directory / "over.toml").write_text(SCENARIO)
    return directory


@pytest.fixture(scope="module")
def planned(flyer):
    """By the command line."""
    (flyer / "limits.toml").write_text("base_rate_rad_s = 0.25\nbase_turn_rad = 0.6\njoint.joint_1.rate = 0.7\n")
    asked = ["plan", str(flyer / "mine" / "vehicle.toml"), "--scenario", str(flyer / "over.toml"), "--seconds", "8"]
    few = ["--starts", "2", "--iterations", "2", "--limits", str(flyer / "limits.toml")]
    assert main([*asked, *few, "-o", str(flyer / "plan"), "--json", str(flyer / "told.json")]) == 0
    told, written = (json.loads(path.read_text()) for path in (flyer / "told.json", flyer / "plan" / "plan.json"))
    assert [one["name"] for one in told["expected"]] == [one["name"] for one in written["expected"]] != []
    assert told["weakest"] == written["weakest"]
    assert str(flyer / "plan" / "motion.csv") in told["files"]
    return flyer / "plan"


def motion(directory):
    table = np.genfromtxt(directory / "motion.csv", delimiter=",", names=True)
    return table["time_s"], np.column_stack([table[name] for name in table.dtype.names[1:]])


def test_the_motion_keeps_its_limits(planned):
    """Rates by differences of the file; the base's turn by the momentum of its own plant would need a flight."""
    time_s, q = motion(planned)
    rate = np.gradient(q, time_s, axis=0)
    assert np.abs(rate[:, 0]).max() < 0.705
    assert np.abs(rate).max() > 0.2  # and uses them


def test_the_scenario_flies_the_motion(planned, flyer):
    scenario = rehearsal(flyer / "mine" / "vehicle.toml", planned / "scenario.toml")
    flown = default_plan(scenario, 0.01)
    _, q = motion(planned)
    assert sum(step.duration_s for step in scenario.sequence) == pytest.approx(10.5)
    assert (scenario.capture.earliest_s, scenario.capture.latest_s) == (1.0, 1.4)
    np.testing.assert_allclose(flown.q[: len(q)], q, atol=1e-6)


def test_what_is_promised_is_the_bound_of_the_motion_as_flown(planned, flyer):
    vehicle = config.load(flyer / "mine" / "vehicle.toml")
    scenario = rehearsal(vehicle.path, planned / "scenario.toml")
    flown = foresee(vehicle, plan_of(vehicle, default_plan(scenario, 0.01)))
    said = json.loads((planned / "plan.json").read_text())
    for one, told in zip(flown.quantities, said["expected"], strict=True):
        assert told["name"] == one.name
        assert told["sigma"] == pytest.approx(one.sigma, rel=0.02)
    # the search's coarse ticks see the same bound
    coarse = {name: sigma[-1] for name, sigma in said["along"]["sigma"].items()}
    for one in flown.quantities:
        assert coarse[one.name] == pytest.approx(one.sigma, rel=0.3)


def test_the_search_finds_better_than_it_began_with_and_the_same_again(flyer):
    vehicle = config.load(flyer / "mine" / "vehicle.toml")
    room = room_for_motion(rehearsal(vehicle.path, flyer / "over.toml"), 8.0)
    wanted = Wanted(room.start_s, room.end_s, ("mass",), starts=1, iterations=2)
    done = []
    one, two = (plan_motion(vehicle, lambda p: default_plan(room.scenario, p), wanted, done.append) for _ in range(2))
    assert one.found.cost < one.found.start_cost - 0.01
    np.testing.assert_array_equal(one.q, two.q)
    assert done[-1] == 1.0
    assert one.weakest.startswith("known least: m_payload")


def test_a_spline_rests_at_both_ends_in_its_posture():
    splines = Splines(np.array([0.3, -1.0]), 5.0, 7)
    coefficients = np.random.default_rng(3).uniform(-0.5, 0.5, (splines.size, 2))
    q, dq, ddq = splines.move(splines.basis(np.linspace(0.0, 5.0, 501)), coefficients)
    np.testing.assert_allclose(q[[0, -1]], [[0.3, -1.0]] * 2, atol=1e-12)
    for still in (dq, ddq):
        np.testing.assert_allclose(still[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(dq[1:-1], np.gradient(q, 0.01, axis=0)[1:-1], atol=2e-3)
    assert np.abs(q - [0.3, -1.0]).max() <= np.abs(coefficients).max()  # its convex hull


def test_criteria_of_a_known_ellipsoid():
    covariance, scales = np.diag([4.0, 0.01]), np.array([2.0, 0.1])  # sigmas of 1 of each size
    for criterion in Criterion:
        assert cost(covariance, scales, criterion) == pytest.approx(0.0)
    assert cost(np.diag([16.0, 0.01]), scales, Criterion.WORST) == pytest.approx(np.log(2.0))
    assert cost(np.diag([16.0, 0.01]), scales, Criterion.D) == pytest.approx(0.5 * np.log(2.0))
    assert weakest(np.diag([16.0, 0.01]), scales, ("a", "b")) == "known least: a, to 2e+02 % of its size (1 sigma)"


def test_spheres_keep_links_apart(flyer):
    model = build_model(config.load(flyer / "mine" / "vehicle.toml"))
    at = [limits.Sphere(frame=name, radius_m=0.2) for name in ("base", model.links[-1])]
    kept = limits.MotionLimits(model, limits.LimitsFile(sphere=at), None)
    q = np.zeros((2, len(model.joints)))
    still = np.zeros((2, 3))
    moved = np.stack([q, q, q])
    base = limits.BaseMotion(still, still, still)
    found = kept.excess(moved, base, 0.1)[:, kept.names.index("clearance 1")]
    tip = link_motions(model, *moved)[-1].p  # by heft's own chain; the limits' is Pinocchio's
    np.testing.assert_allclose(found, 1.0 - np.linalg.norm(tip, axis=1) / 0.4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("joint.elbow.rate = 1.0", "limits of joint elbow; the joints are joint_1, joint_2"),
        ("[[sphere]]\nframe = 'head'\nradius_m = 0.1", "sphere: "),
        ("rate = 3", "bad.toml:1: unknown key 'rate'; "),
        ("joint.joint_1.rate = -1", "bad.toml:1: 'joint.joint_1.rate': 1e-12 or more is wanted here (given: -1)"),
        ("joint.joint_1 = {low = 2.0, high = 3.0}", "joint_1 starts at"),
        ("base_rate_rad_s = 1e-6", "at rest in its posture the vehicle breaks: base's rate"),
        ("joint.joint_1 = {low = 0.5, high = -0.5}", "low 0.5 is not below -0.5"),
        ("joint.joint_1.acceleration = 1e-9", "the smallest motion breaks: joint_1 acceleration"),
        ("share = [", "TOML"),
    ],
)
def test_limits_that_cannot_be_kept_are_refused(flyer, capsys, text, said):
    (flyer / "bad.toml").write_text(text)
    asked = ["plan", str(flyer / "mine" / "vehicle.toml"), "--scenario", str(flyer / "over.toml")]
    few = ["--starts", "1", "--iterations", "1", "--limits", str(flyer / "bad.toml")]
    assert main([*asked, *few, "-o", str(flyer / "none")]) == 2
    assert said in capsys.readouterr().err
    assert not (flyer / "none").exists()


def test_what_is_no_quantity_or_no_motion_is_refused(flyer, capsys):
    vehicle = str(flyer / "mine" / "vehicle.toml")
    assert main(["plan", vehicle, "--scenario", str(flyer / "over.toml"), "--for", "colour"]) == 2
    assert "mass, centre, inertia" in capsys.readouterr().err
    assert main(["plan", vehicle, "--seconds", "nan"]) == 2
    (flyer / "still.toml").write_text('[[sequence]]\nphase = 0\naction = "hold"\nduration_s = 4.0\n')
    assert main(["plan", vehicle, "--scenario", str(flyer / "still.toml")]) == 2
    assert "add it" in capsys.readouterr().err


def test_without_the_simulator_it_says_what_is_missing(flyer, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "hil_sim.plants.planned", None)  # as if it were not there
    assert main(["plan", str(flyer / "mine" / "vehicle.toml")]) == 2
    assert "the simulator's, which is not installed" in capsys.readouterr().err


def test_an_arm_that_stands_is_planned_by_its_rows(tmp_path):
    assert main(["init", str(tmp_path / "arm"), "--base", "fixed", "--joints", "2", "--load-cell", "cia404"]) == 0
    (tmp_path / "over.toml").write_text('[[sequence]]\nphase = 1\naction = "swing"\nduration_s = 6.0\n')
    asked = ["plan", str(tmp_path / "arm" / "vehicle.toml"), "--scenario", str(tmp_path / "over.toml")]
    assert main([*asked, "--starts", "2", "--iterations", "1", "-o", str(tmp_path / "plan")]) == 0
    said = json.loads((tmp_path / "plan" / "plan.json").read_text())
    assert all(np.isfinite(one["sigma"]) for one in said["expected"])
    with pytest.raises(ConfigError, match="joint_9"):
        limits.MotionLimits(
            build_model(config.load(tmp_path / "arm" / "vehicle.toml")),
            limits.LimitsFile(joint={"joint_9": limits.JointLimit()}),
            None,
        )


def test_a_sketched_arm_of_three_joints_can_hold_itself(tmp_path):
    assert main(["init", str(tmp_path / "arm"), "--base", "fixed", "--joints", "3", "--load-cell", "cia404"]) == 0
    (tmp_path / "over.toml").write_text('[[sequence]]\nphase = 1\naction = "swing"\nduration_s = 6.0\n')
    asked = ["plan", str(tmp_path / "arm" / "vehicle.toml"), "--scenario", str(tmp_path / "over.toml")]
    assert main([*asked, "--starts", "1", "--iterations", "1", "-o", str(tmp_path / "plan")]) == 0


def test_a_planar_base_is_planned_for_what_its_motions_can_tell(tmp_path, capsys):
    assert main(["init", str(tmp_path / "bed"), "--base", "planar", "--joints", "2"]) == 0
    (tmp_path / "over.toml").write_text('[[sequence]]\nphase = 1\naction = "swing"\nduration_s = 6.0\n')
    asked = ["plan", str(tmp_path / "bed" / "vehicle.toml"), "--scenario", str(tmp_path / "over.toml")]
    asked += ["--starts", "1", "--iterations", "1", "-o", str(tmp_path / "plan")]
    assert main([*asked, "--for", "I_xx_payload"]) == 2
    assert "no motion of" in (said := capsys.readouterr().err)
    assert said.rstrip().endswith("tells I_xx_payload")
    vehicle = config.load(tmp_path / "bed" / "vehicle.toml").with_row_rate(TICK_HZ)
    scenario = rehearsal(vehicle.path, tmp_path / "over.toml")
    plan = plan_of(vehicle, default_plan(scenario, 1.0 / TICK_HZ))
    bound = RowsBound(vehicle, plan, slice(0, len(plan.time_s)))
    told = told_by(bound, np.stack([plan.q, plan.dq, plan.ddq]))
    assert np.array(bound.names)[told].tolist() == ["m_payload", "c_x_payload", "c_y_payload", "I_zz_payload"]


def test_what_nothing_determines_at_rest_is_told_by_a_motion_that_does():
    """A cell in a wrist whose zero is not known: at rest no number is given, of the mass either."""
    vehicle = config.named("lab_ur").with_row_rate(TICK_HZ)
    plan = plan_of(vehicle, default_plan(rehearsal(vehicle.path), 1.0 / TICK_HZ))
    bound = RowsBound(vehicle, plan, slice(0, len(plan.time_s)))
    told = told_by(bound, np.stack([plan.q, plan.dq, plan.ddq]))
    assert {"m_payload", "c_x_payload", "c_y_payload", "c_z_payload"} <= set(np.array(bound.names)[told])
    assert "I_xx_payload" in bound.names
