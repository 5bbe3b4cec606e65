"""docs/recordings.md: each recipe's commands, run as they stand on a recording made here, find what is true."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from bench import floating_bed
from onboard.cli import OK, main
from tests.dynamics.mujoco_twin import to_urdf
from tests.flight.test_recorded_arm import LOAD_kg, laboratory
from tests.ground.calibrate.weigh.wrist_bench import record, write
from tests.ground.log.bring_in import spherical_bench

PAGE = (Path(__file__).parents[4] / "docs" / "recordings.md").read_text(encoding="utf-8")
GAINS = np.array([12.5, 11.0, 9.5])  # N m/A, as on the page


def followed(title):
    """Run the commands under a heading; how many there were."""
    block = re.search(rf"## {title}\n.*?```sh\n(.*?)```", PAGE, re.DOTALL)
    commands = block[1].splitlines()
    for command in commands:
        assert main(shlex.split(command)[1:]) == OK, command
    return len(commands)


def test_every_recipe_is_tested():
    assert re.findall(r"^## (.*)$", PAGE, re.MULTILINE) == [
        "A tool by a wrist force-torque sensor",
        "An arm by its currents",
        "A thrown body",
        "A floating body by its thrusters",
        "A body on a spherical air bearing",
    ]
    assert PAGE.count("```sh") == 5


@pytest.mark.campaign  # by the same command: tests/ground/calibrate/weigh/test_weigh.py, of its own page
def test_a_tool(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one = record(6)
    write(tmp_path / "poses.csv", one.rows)
    assert followed("A tool by a wrist force-torque sensor") == 1
    mass = json.loads((tmp_path / "weighed.json").read_text())["quantities"][0]
    assert mass["low"] <= one.true.mass_kg <= mass["high"]


@pytest.mark.campaign  # such an arm by the same commands: tests/flight/test_recorded_arm.py
def test_an_arm(tmp_path, monkeypatch):
    """Three joints whose motors' constants are as stated; columns are called as a laboratory may call them."""
    monkeypatch.chdir(tmp_path)
    links, recordings = laboratory()
    (tmp_path / "arm.urdf").write_text(to_urdf(links).replace('effort="1"', 'effort="60"'))
    names = ["timestamp", *(f"{kind}_{k}" for kind in ("actual_q", "actual_current") for k in range(3))]
    for name, (t, q, torque) in recordings.items():
        rows = np.column_stack([1000.0 + t, q, torque / GAINS])
        np.savetxt(f"{name}.csv", rows, delimiter=",", header=",".join(names), comments="", fmt="%.9f")
    assert followed("An arm by its currents") == 6
    assert "# doubtful" not in (tmp_path / "arm.toml").read_text()
    told = json.loads((tmp_path / "both.json").read_text())["logs"][0]
    mass = next(one for one in told["quantities"] if one["name"] == "m_payload")
    assert mass["low"] <= LOAD_kg <= mass["high"]
    assert mass["sigma"] < 0.05 * LOAD_kg


def throw(path, moments, seed):
    """A body with these principal moments about the board's axes, kg m^2; its wheel spins up and brakes in free fall.

    Euler's equations about the centre of mass by fourth-order Runge-Kutta; raw counts by the board's axes and scales.
    """
    rng = np.random.default_rng(seed)
    inertia, wheel, centre = np.diag(moments), 1.68698e-6, np.array([0.004, 0.003, 0.006])
    period_s, axis = 248e-6, np.array([0.0, 0.0, -1.0])
    t = period_s * np.arange(3200)

    def speed(s):
        return np.interp(s, [0.0, 0.2, 0.45, 0.6, 0.75, 1.0], [0.0, 0.0, 1250.0, 1250.0, 250.0, 210.0])

    def change(s, w):
        torque = wheel * axis * (speed(s + 1e-5) - speed(s - 1e-5)) / 2e-5
        return np.linalg.solve(inertia, -np.cross(w, inertia @ w + wheel * speed(s) * axis) - torque)

    rates, changes, w = [], [], np.array([5.0, 1.5, 4.0])
    for s in t:
        rates.append(w)
        changes.append(change(s, w))
        k1 = changes[-1]
        k2 = change(s + period_s / 2, w + period_s / 2 * k1)
        k3 = change(s + period_s / 2, w + period_s / 2 * k2)
        w = w + period_s / 6 * (k1 + 2 * k2 + 2 * k3 + change(s + period_s, w + period_s * k3))
    rates, changes = np.array(rates), np.array(changes)
    force = -np.cross(changes, centre) - np.cross(rates, np.cross(rates, centre))
    gyro = np.rint(16.384 * np.rad2deg(rates + 0.01 * rng.normal(size=rates.shape)))
    accel = np.rint(2048 / 9.81 * (force + 0.3 * rng.normal(size=force.shape)))
    raw = [np.column_stack([one[:, 1], -one[:, 0], one[:, 2]]).astype(np.int16) for one in (gyro, accel)]
    erpm = np.rint(speed(t) * 60 / (2 * np.pi) * 7 / 100).astype(np.int32)
    np.savez(path, time_us=(1_000_000 + np.arange(3200) * 248), gyro_raw=raw[0], acc_raw=raw[1], erpm_raw=erpm)


def test_a_thrown_body(tmp_path, monkeypatch):
    """The moments of the whole are those of the load of the data set, with the carrier on its axes."""
    monkeypatch.chdir(tmp_path)
    moments = np.array([1.60e-3, 0.24e-3, 1.66e-3])
    throw("throw_config_a.npz", moments, 1)
    assert followed("A thrown body") == 2
    told = json.loads(Path("throw.json").read_text())["logs"][0]
    found = {one["name"]: one for one in told["quantities"]}
    for name, truth in zip(("I_xx", "I_yy", "I_zz"), moments, strict=True):
        assert found[name]["low"] <= truth <= found[name]["high"], name
        assert found[name]["value"] == pytest.approx(truth, rel=0.05)


@pytest.mark.campaign  # such a body by the same commands: tests/ground/identify/kinds/test_body.py
def test_a_floating_body(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bed = floating_bed.fly(62)
    floating_bed.write(bed, tmp_path)
    assert followed("A floating body by its thrusters") == 3
    told = json.loads((tmp_path / "body.json").read_text())["logs"][0]
    found = {one["name"]: one for one in told["quantities"]}
    for name in ("mass", "I_zz", "com_x", "com_y", "delay"):
        assert found[name]["low"] <= bed.truth[name] <= found[name]["high"], found[name]
    assert found["I_zz"]["sigma"] < 0.06 * bed.inertia_kg_m2  # a common force error of 5 %
    assert told["verdict"]["level"] == "weak"
    assert "weigh the body" in told["verdict"]["text"]


def test_a_body_on_a_spherical_bearing(tmp_path, monkeypatch):
    """Its drawing leaves out what balances it; its wheels are numbered."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    (tmp_path / "body.urdf").write_text(spherical_bench.urdf())
    for name, proof in (("without", False), ("with", True)):
        spherical_bench.write(f"{name}.csv", spherical_bench.run(rng, proof), "wheel1_rpm,wheel2_rpm,wheel3_rpm")
    assert followed("A body on a spherical air bearing") == 6
    assert "# doubtful" not in (tmp_path / "body.toml").read_text()
    told = json.loads((tmp_path / "body.json").read_text())["logs"][0]
    assert told["verdict"]["level"] == "good", told["verdict"]["text"]
    found = {one["name"]: one for one in told["quantities"]}
    true = dict(zip(("com_x", "com_y", "com_z"), spherical_bench.COM_m, strict=True))
    true |= dict(zip(("I_xx", "I_yy", "I_zz"), np.diag(spherical_bench.INERTIA), strict=True))
    for name, value in true.items():
        assert found[name]["low"] <= value <= found[name]["high"], name
    assert found["I_zz"]["sigma"] < 0.01 * true["I_zz"]
    assert found["com_x"]["sigma"] < 1e-5
