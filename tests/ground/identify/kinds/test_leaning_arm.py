"""An arm by its torques whose base leans by a degree: gravity turns, of what it holds too; torques by Pinocchio."""

import json

import numpy as np
import pinocchio as pin
import pytest

from onboard import config
from onboard.cli import OK, main
from onboard.flight.estimate.problem.priors import level_root
from onboard.flight.estimate.readings.roles import roles_of

_JOINTS, _HELD_kg, _CENTRE_m, _G = ("shoulder", "elbow", "wrist"), 1.0, np.array([0.02, 0.03, 0.05]), 9.80665
_LEAN_rad = np.radians([1.0, -1.0])
_KEY = 'row_noise = "by_frequency"'


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The directory of an arm that heft init writes."""
    lab = tmp_path_factory.mktemp("arm") / "lab"
    assert main(["init", str(lab), "--base", "fixed", "--joints", ",".join(_JOINTS), "--encoder", "recorded"]) == OK
    return lab


def _recorded(lab, directory, held_kg, lean_rad, name):
    """A log of 12 s, of a base that leans about x and y, (2,)."""
    model = pin.buildModelFromXML((lab / "vehicle.urdf").read_text())
    model.gravity.linear = pin.rpy.rpyToMatrix(*lean_rad, 0.0).T @ [0.0, 0.0, -_G]
    hand, rng = model.frames[model.getFrameId("payload")], np.random.default_rng(len(name))
    model.appendBodyToJoint(
        hand.parentJoint, pin.Inertia(held_kg, _CENTRE_m, 2e-3 * held_kg * np.eye(3)), hand.placement
    )
    data, t = model.createData(), 0.02 * np.arange(600)
    rate, begin = 2.0 * np.pi * rng.uniform(0.1, 0.4, (3, 3)), rng.uniform(0.0, 6.3, (3, 3))
    turns = rate[:, None] * t[:, None] + begin[:, None]  # (3, n, joints)
    q, dq = 0.4 * np.sin(turns).sum(axis=0), 0.4 * (rate[:, None] * np.cos(turns)).sum(axis=0)
    ddq = -0.4 * (rate[:, None] ** 2 * np.sin(turns)).sum(axis=0)
    torque = np.array([pin.rnea(model, data, *one) for one in zip(q, dq, ddq, strict=True)])
    torque += 0.05 * np.tanh(dq / 0.01) + 0.02 * dq + rng.normal(0.0, 0.02, torque.shape)
    table = directory / f"{name}.csv"
    names = ["t", *_JOINTS, *(f"{joint}_torque" for joint in _JOINTS)]
    np.savetxt(table, np.column_stack([t, q, torque]), "%.9f", ",", header=",".join(names), comments="")
    assert main(["import", str(lab / "import.toml"), str(table), "-o", str(directory)]) == OK
    return str(directory / f"{name}.mcap")


def _identified(lab, directory, lean_rad, key=""):
    """Each quantity by its name."""
    (directory / "vehicle.urdf").write_text((lab / "vehicle.urdf").read_text())
    vehicle, both, answer = directory / "vehicle.toml", directory / "both.mcap", directory / "answer.json"
    vehicle.write_text((lab / "vehicle.toml").read_text().replace(_KEY, f"{key}\n{_KEY}"))
    logs = [_recorded(lab, directory, kg, lean_rad, name) for kg, name in ((1e-9, "empty"), (_HELD_kg, "loaded"))]
    assert main(["merge", "--in-turn", "recording", *logs, "-o", str(both)]) == OK
    assert main(["identify", "--vehicle", str(vehicle), str(both), "--json", str(answer)]) == OK
    return {one["name"]: one for one in json.loads(answer.read_text())["logs"][0]["quantities"]}


def _missed_mm(found):
    """How far the centre of mass of what is held is from its truth, (3,)."""
    return 1e3 * (np.array([found[f"c_{axis}_payload"]["value"] for axis in "xyz"]) - _CENTRE_m)


def test_what_a_leaning_arm_holds_is_where_it_is(lab, tmp_path):
    """A degree about x and y."""
    found = _identified(lab, tmp_path, _LEAN_rad)
    force = np.array([found[f"zero_force_{axis}"]["value"] for axis in "xyz"])
    assert force == pytest.approx([-0.171, -0.171, 0.0], abs=0.02)  # of 9.81 m/s^2
    assert np.abs(_missed_mm(found)[1:]).max() < 2.5  # along y and z, which these three joints tell; 6.5 level


def test_how_far_a_base_leans_where_the_file_is_silent(lab, tmp_path):
    """A degree, and the gravity of a place that nobody states."""

    def root(directory):
        vehicle = config.load(directory / "vehicle.toml")
        return level_root(vehicle, roles_of(vehicle))

    assert root(lab) == pytest.approx(_G * np.diag([0.0175, 0.0175, 1.5e-3]))
    (tmp_path / "vehicle.urdf").write_text((lab / "vehicle.urdf").read_text())
    for key, expected in (("level_sigma_rad = 0.0", None), ("level_sigma_rad = 0.1", 0.1 * _G)):
        (tmp_path / "vehicle.toml").write_text((lab / "vehicle.toml").read_text().replace(_KEY, f"{key}\n{_KEY}"))
        found = root(tmp_path)
        assert found is None if expected is None else found[0, 0] == pytest.approx(expected)
    for other in ("rocksat", "workshop", "tudelft"):  # cells or an IMU measure, or the base moves
        vehicle = config.named(other)
        assert level_root(vehicle, roles_of(vehicle)) is None
