"""A mapping of a recorded arm with a mistake, whose answer is refused: the mistake is named; torques by Pinocchio."""

import json

import numpy as np
import pinocchio as pin
import pytest

from onboard import config
from onboard.cli import OK, main
from onboard.ground.identify.kinds.misread_arm import misread_arm
from onboard.recording.reader import LogReader

_JOINTS = ("shoulder", "elbow", "wrist")
_NOISE_N_m = 0.02


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The directory of an arm that heft init writes."""
    lab = tmp_path_factory.mktemp("arm") / "lab"
    asked = ["--base", "fixed", "--joints", ",".join(_JOINTS), "--encoder", "recorded"]
    assert main(["init", str(lab), *asked]) == OK
    return lab


@pytest.fixture(scope="module")
def moved(lab):
    """Time (n,), angles and torques (n, 3) of the arm with 1 kg in its hand."""
    return _moved(lab, 1.0)


def _moved(lab, held_kg):
    model = pin.buildModelFromXML((lab / "vehicle.urdf").read_text())
    hand = model.frames[model.getFrameId("payload")]
    held = pin.Inertia(held_kg, np.array([0.02, 0.03, 0.05]), 2e-3 * held_kg * np.eye(3))
    model.appendBodyToJoint(hand.parentJoint, held, hand.placement)
    data, t = model.createData(), 0.01 * np.arange(1000)
    rate = 2.0 * np.pi * np.array([0.23, 0.31, 0.17])
    turns = rate * t[:, None] + [0.0, 1.0, 2.0]
    q, dq, ddq = 0.6 * np.sin(turns) + 0.3, 0.6 * rate * np.cos(turns), -0.6 * rate**2 * np.sin(turns)
    torque = np.array([pin.rnea(model, data, *one) for one in zip(q, dq, ddq, strict=True)])
    friction = 0.05 * np.tanh(dq / 0.01) + 0.02 * dq
    return t, q, torque + friction + np.random.default_rng(3).normal(0.0, _NOISE_N_m, torque.shape)


def _log(lab, directory, t, q, torque, name="run"):
    """Imported by the mapping that heft init writes."""
    table = directory / f"{name}.csv"
    names = ["t", *_JOINTS, *(f"{name}_torque" for name in _JOINTS)]
    np.savetxt(table, np.column_stack([t, q, torque]), "%.9f", ",", header=",".join(names), comments="")
    assert main(["import", str(lab / "import.toml"), str(table), "-o", str(directory)]) == OK
    return directory / f"{name}.mcap"


_MISTAKES = {
    "the angle of elbow counts the other way": lambda q, tau: (q * [1.0, -1.0, 1.0], tau),
    "the torque of elbow counts the other way": lambda q, tau: (q, tau * [1.0, -1.0, 1.0]),
    "angle and torque of elbow count the other way": lambda q, tau: (q * [1.0, -1.0, 1.0], tau * [1.0, -1.0, 1.0]),
    "all torques count the other way": lambda q, tau: (q, -tau),
    "all torques are thousandths of what they are read as": lambda q, tau: (q, 1e3 * tau),
    "the torques of shoulder and elbow are exchanged": lambda q, tau: (q, tau[:, [1, 0, 2]]),
    "the angles of shoulder and elbow are exchanged": lambda q, tau: (q[:, [1, 0, 2]], tau),
    "elbow is about -90 deg from what is read": lambda q, tau: (q + np.radians([0.0, 92.0, 0.0]), tau),
    "all angles are in deg": lambda q, tau: (np.degrees(q), tau),
}


_MORE = (  # a sign, an order and a unit: others of these
    "the torque of elbow counts the other way",
    "the angle of elbow counts the other way",
    "all torques count the other way",
    "the torques of shoulder and elbow are exchanged",
)


@pytest.mark.parametrize(
    "said", [pytest.param(one, marks=pytest.mark.campaign if one in _MORE else ()) for one in _MISTAKES]
)
def test_a_mistake_is_named(lab, moved, tmp_path, said):
    """Signs, order, units and a zero."""
    t, q, torque = moved
    log = LogReader(_log(lab, tmp_path, t, *_MISTAKES[said](q, torque)))
    assert f" if {said}:" in misread_arm(config.load(lab / "vehicle.toml"), log)


def test_of_a_recording_as_stated_nothing_is_said(lab, moved, tmp_path):
    """Nor of a gain that is 5 % off, or of a base that moves."""
    vehicle, (t, q, torque) = config.load(lab / "vehicle.toml"), moved
    for torques in (torque, torque * [1.05, 1.0, 0.95]):
        assert misread_arm(vehicle, LogReader(_log(lab, tmp_path, t, q, torques))) == ""
    assert misread_arm(config.load(config.packaged("tudelft")), LogReader(tmp_path / "run.mcap")) == ""


@pytest.mark.campaign  # the command says so of recordings merged in turn, below
def test_heft_identify_says_it_where_it_refuses(lab, moved, tmp_path):
    t, q, torque = moved
    log, answer = _log(lab, tmp_path, t, q, torque * [1.0, -1.0, 1.0]), tmp_path / "answer.json"
    assert main(["identify", "--vehicle", str(lab / "vehicle.toml"), str(log), "--json", str(answer)]) == 1
    (found,) = json.loads(answer.read_text())["logs"]
    assert found["verdict"]["reasons"][0].startswith("much less would be left over if the torque of elbow counts")


def _in_turn(lab, directory, *moved):
    """Reasons of heft identify for recordings that are merged in turn."""
    logs = [str(_log(lab, directory, *one, name=f"part_{k}")) for k, one in enumerate(moved)]
    both, answer = directory / "both.mcap", directory / "answer.json"
    assert main(["merge", "--in-turn", "recording", *logs, "-o", str(both)]) == OK
    assert main(["identify", "--vehicle", str(lab / "vehicle.toml"), str(both), "--json", str(answer)]) == 1
    (found,) = json.loads(answer.read_text())["logs"]
    return found["verdict"]["reasons"]


def test_a_payload_that_is_in_the_first_recording_is_named(lab, moved, tmp_path):
    """All torques were said to be thousandths of what they are read as."""
    said = "much less would be left over if what is held is in the recording before, and not in the other one"
    assert _in_turn(lab, tmp_path, moved, _moved(lab, 0.0))[0] == f"{said}: merge them in their order"


@pytest.mark.campaign  # recordings merged in turn: above; where nothing is to be said: as stated
def test_a_mistake_that_leaves_a_little_less_is_none(lab, tmp_path):
    """Nothing is held in either recording: a wrist that counts the other way was named."""
    empty = _moved(lab, 0.0)
    assert not [one for one in _in_turn(lab, tmp_path, empty, empty) if "left over if" in one]
