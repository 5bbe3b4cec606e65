"""Torque constants by the currents and torques that a controller asked for, with names and without."""

import numpy as np
import pytest

from onboard.cli import OK, main
from onboard.ground.log.bring_in.guess.propose import Names, propose
from tests.ground.log.bring_in.guess import made
from tests.ground.log.bring_in.guess.made import T, arm

GAINS = (12.0, 3.0)
SAID = "an A of each motor makes 12,3 N m"


def written(path, gains=GAINS, measured=1.0, scatter=0.0, *, names=True):
    """Angles, rates, currents as measured and asked for, torques asked for, of two joints."""
    own, rng = arm(2), np.random.default_rng(8)
    asked = (own.tau + 2.0 * np.sign(own.qd) + 0.5 * own.qd) / np.array(gains)
    asked += scatter * asked.std(axis=0) * rng.normal(size=asked.shape)
    current = measured * asked + 0.02 * rng.normal(size=asked.shape)
    every = {"actual_q": own.q, "actual_qd": own.qd, "actual_current": current}
    every |= {"target_current": asked, "target_moment": own.tau}
    head = ["t", *(f"{name}_{k}" for name in every for k in range(2))] if names else []
    return made.text(path, head, [T, *np.hstack(list(every.values())).T])


@pytest.mark.parametrize("names", [True, False])
def test_a_controllers_constants_are_said(tmp_path, names):
    path = written(tmp_path / "a.csv", names=names)
    columns = ("target_moment_0 to target_moment_1", "target_current_0 to target_current_1")
    over = " over ".join(columns if names else ("10 to 11", "8 to 9"))
    (doubt,) = propose(path, Names()).doubts
    assert f"by the controller's columns {over}, friction aside, {SAID}: heft init --gains 12,3" in doubt


def test_constants_of_the_vehicle_file_are_held_against_them(tmp_path):
    """Two of the sigmas that are stated are no contradiction; four are."""
    path = written(tmp_path / "a.csv")
    assert propose(path, Names(gains=((11.0, 0.05), (3.0, 0.05)))).doubts == ()
    (doubt,) = propose(path, Names(gains=((10.0, 0.05), (3.0, 0.05)))).doubts
    assert doubt.endswith(
        f"{SAID}; the vehicle file says 10,3: heft init --gains 12,3, if you have none from a calibration"
    )


def test_they_are_those_of_heft_init(tmp_path, capsys):
    path = written(tmp_path / "a.csv")
    lab = tmp_path / "lab"
    assert main(["init", str(lab), "--base", "fixed", "--joints", "2", "--encoder", "recorded", "--gains", "9,3"]) == OK
    mapping = tmp_path / "a.toml"
    vehicle = str(lab / "vehicle.toml")
    assert main(["import", "--guess", str(path), "--vehicle", vehicle, "-o", str(mapping)]) == OK
    assert f"{SAID}; the vehicle file says 9,3" in capsys.readouterr().out
    assert main(["import", str(mapping), str(path), "-o", str(tmp_path / "logs")]) == OK


@pytest.mark.parametrize(
    "other",
    [{"gains": (12.0, 1.5)}, {"measured": 1.5}, {"scatter": 0.42}],
    ids=["torques twice", "no current of it", "more than friction"],
)
def test_other_columns_are_none(tmp_path, other):
    assert "controller" not in propose(written(tmp_path / "a.csv", **other), Names()).text


def test_what_friction_adds_to_a_current_is_no_other_column(tmp_path):
    (doubt,) = propose(written(tmp_path / "a.csv", measured=1.25, scatter=0.28), Names()).doubts
    assert "an A of each motor makes 1" in doubt
