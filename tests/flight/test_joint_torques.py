"""Joint torques of a free-flyer's drives are fused: friction and rotor as unknowns, a wrong one left out by name."""

from pathlib import Path
from typing import Any

import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import config
from onboard.cli import main
from onboard.flight import hil
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.identification import build_free_flyer, build_online
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.identify.mission import mission_table
from onboard.ground.identify.replay.feed import feed
from onboard.ground.identify.replay.replay import replay
from onboard.identification.free_flyer.online import MotionIdentifier
from tests.flight.missions import Result

OVER = """
[payload]
mass_kg = [4.0, 5.0]
[[sequence]]
phase = 1
action = "swing"
duration_s = {swing}
band_Hz = [0.2, 1.0]
"""


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> config.Vehicle:
    directory = tmp_path_factory.mktemp("torques") / "mine"
    assert main(["init", str(directory), "--base", "free", "--joints", "3", "--encoder", "cia402"]) == 0
    return config.load(directory / "vehicle.toml")


def changed(vehicle: config.Vehicle, changes: dict[str, Any]) -> config.Vehicle:
    return config.parse_tree(config.laid_over(vehicle.tree, changes), vehicle.path, config.Origin("test"))


def flight(vehicle: config.Vehicle, path: Path, changes: dict[str, Any], swing_s: float) -> Result:
    over = path.with_suffix(".toml")
    over.write_text(OVER.format(swing=swing_s))
    world, urls = open_in_process(scenario_of(vehicle.path, over), 4)
    with world:
        flown = hil.fly_simulated(changed(vehicle, changes), world, urls, path)
    return Result(path, flown, mission_table.result(flown))


@pytest.fixture(scope="module")
def flown(vehicle: config.Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Result:
    return flight(vehicle, tmp_path_factory.mktemp("healthy") / "flight.mcap", {}, 6.0)


def covered(result: Result) -> tuple[int, int]:
    rows = [row for key in ("masses", "centres", "inertias") for row in result.table[key] if row["supported"]]
    return sum(row["covered"] for row in rows), len(rows)


def test_the_answer_holds_the_truth_and_is_replayed_to_the_bit(flown: Result) -> None:
    assert flown.table["accounted"], flown.table["channels"]
    inside, told = covered(flown)
    assert told >= 8
    assert inside >= told - 1
    assert not flown.events("left_out")
    found = replay(flown.path)
    assert found.identical, found.summary


def test_friction_of_each_drive_is_found(vehicle: config.Vehicle, flown: Result) -> None:
    estimator = Estimator(vehicle)
    for _ in feed(estimator, flown.log, 1.0):
        pass
    assert isinstance(estimator.online, MotionIdentifier)
    ekf = estimator.online.ekf
    assert ekf.state is not None
    for joint in ("joint_1", "joint_2"):
        at = ekf.predictor.names.index(f"Fc_{joint}_torque")
        truth, sigma = flown.flown.truth["drives"][joint]["coulomb_n_m"], ekf.covariance[at, at] ** 0.5
        assert sigma < 0.1 * truth
        assert abs(ekf.state[at] - truth) < 4.0 * sigma


@pytest.mark.campaign  # a cell of a wrong scale: test_witness; of lines: test_fusion
def test_a_torque_that_reads_half_is_left_out_by_its_name(vehicle: config.Vehicle, tmp_path: Path) -> None:
    """The drive's rated torque is 10 N m."""
    found = flight(vehicle, tmp_path / "half.mcap", {"device": {"joint_2": {"rated_torque_N_m": 5.0}}}, 9.0)
    assert [text for text in found.events("left_out") if "joint_2_torque" in text]
    inside, told = covered(found)
    assert told >= 6
    assert inside >= told - 1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"estimation": {"prior": {"absolute": None}}}, "no sigma of bias_joint_1_torque, Fc_joint_1, Fv_joint_1, Ia"),
        ({"device": {"joint_2": {"torque_still_rad_s": 0.0}}}, "friction of joint_2 is not known at rest"),
    ],
)
def test_what_is_not_stated_is_asked_for(vehicle: config.Vehicle, changes: dict[str, Any], said: str) -> None:
    tree = config.laid_over(vehicle.tree, changes)
    if "estimation" in changes:
        del tree["estimation"]["prior"]["absolute"]
    with pytest.raises(config.ConfigError, match=said):
        build_online(config.parse_tree(tree, vehicle.path, config.Origin("test")))


def test_a_torque_is_drawn_as_one(vehicle: config.Vehicle) -> None:
    assert roles_of(vehicle).cells[0].titled == ("joint torque: joint_1_torque", "N m")


def test_a_torque_without_friction_has_none(vehicle: config.Vehicle) -> None:
    own = {f"joint_{n}": {"torque_friction": False, "torque_still_rad_s": 0.0} for n in (1, 3)}
    predictor = build_free_flyer(changed(vehicle, {"device": own}))[0].ekf.predictor
    told = {name: sigma for name, sigma in zip(predictor.names, predictor.sigma, strict=True) if "_torque" in name}
    told = {name: sigma for name, sigma in told.items() if not name.startswith("disturbance")}
    assert told == {
        "bias_joint_1_torque": 0.1,
        "scale_joint_1_torque": 0.01,
        "bias_joint_2_torque": 0.1,
        "bias_joint_3_torque": 0.1,
        "scale_joint_3_torque": 0.01,
        "scale_joint_2_torque": 0.01,
        "Fc_joint_2_torque": 0.5,
        "Fv_joint_2_torque": 0.5,
        "Ia_joint_2_torque": 0.1,
    }
