"""Somebody's recorded arm: ``heft init --encoder recorded``, import, an empty and a loaded recording, its payload."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onboard import cli
from tests.dynamics.mujoco_twin import inverse_dynamics, random_vehicle, to_mujoco, to_urdf

COULOMB, VISCOUS, ROTOR = (np.array(v) for v in ([3.0, 2.0, 1.0], [4.0, 2.0, 1.5], [1.0, 0.5, 0.3]))
RATE_HZ, END_s, NOISE_N_m = 200.0, 16.0, 0.2
LOAD_kg, CENTRE_m = 2.7, np.array([0.05, -0.03, 0.08])


def with_load(links: list) -> list:
    """A small ball of lead at the last link."""
    last, mass = links[-1], LOAD_kg
    total = last.mass + mass
    centre = (last.mass * last.com + mass * CENTRE_m) / total
    inertia = np.zeros((3, 3))
    for m, c, own in ((last.mass, last.com, last.inertia), (mass, CENTRE_m, 1e-3 * np.eye(3))):
        d = c - centre
        inertia += own + m * (d @ d * np.eye(3) - np.outer(d, d))
    return [*links[:-1], replace(last, mass=total, com=centre, inertia=inertia)]


def write_csv(path: Path, links: list, rng: np.random.Generator, began_s: float) -> Path:
    """Time, angles and torques of sines; the columns are called as the laboratory calls them."""
    t = np.arange(0.0, END_s, 1.0 / RATE_HZ)
    w, a, p = rng.uniform(0.5, 4.0, (8, 3)), rng.uniform(0.1, 0.3, (8, 3)), rng.uniform(0, 6.3, (8, 3))
    phase = w * t[:, None, None] + p
    q, dq, ddq = ((f * a * w**k).sum(axis=1) for k, f in enumerate((np.sin(phase), np.cos(phase), -np.sin(phase))))
    model, still = to_mujoco(links), np.zeros(3)
    model.opt.gravity[:] = (0, 0, -9.80665)
    ticks = zip(q, dq, ddq, strict=True)
    torque = np.array([inverse_dynamics(model, *tick, still, still, still, still)[2] for tick in ticks])
    torque += COULOMB * np.sign(dq) + VISCOUS * dq + ROTOR * ddq + NOISE_N_m * rng.normal(size=torque.shape)
    header = "time," + ",".join(f"q{k}" for k in (1, 2, 3)) + "," + ",".join(f"tau{k}" for k in (1, 2, 3))
    np.savetxt(path, np.column_stack([began_s + t, q, torque]), delimiter=",", header=header, comments="", fmt="%.9f")
    return path


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with ``v/``, as init made it, and the two recordings as logs."""
    root = tmp_path_factory.mktemp("lab")
    rng = np.random.default_rng(20261122)
    links = random_vehicle(rng, ["revolute"] * 3)
    (root / "arm.urdf").write_text(to_urdf(links).replace('effort="1"', 'effort="60"'))
    made = ["init", str(root / "v"), "--base", "fixed", "--urdf", str(root / "arm.urdf"), "--encoder", "recorded"]
    assert cli.main(made) == cli.OK
    mapping = (root / "v" / "import.toml").read_text().replace('column = "t"', 'column = "time"')
    mapping = re.sub(r'column = "joint_link_(\d)_torque"', r'column = "tau\1"', mapping)
    (root / "v" / "import.toml").write_text(re.sub(r'column = "joint_link_(\d)"', r'column = "q\1"', mapping))
    for name, arm, began_s in (("empty", links, 100.0), ("loaded", with_load(links), 7.0)):
        path = write_csv(root / f"{name}.csv", arm, rng, began_s)
        assert cli.main(["import", str(root / "v" / "import.toml"), str(path), "-o", str(root / "logs")]) == cli.OK
    return root


def test_what_it_holds_is_weighed_by_an_empty_and_a_loaded_recording(lab: Path) -> None:
    empty, loaded, both = (str(lab / "logs" / f"{name}.mcap") for name in ("empty", "loaded", "both"))
    assert cli.main(["merge", "--in-turn", "recording", empty, loaded, "-o", both]) == cli.OK
    text = (lab / "v" / "vehicle.toml").read_text()
    begin, end = text.index("# [device.recording]"), text.index("\n[estimation]")
    hint = re.sub(r"^# ", "", text[begin:end], flags=re.MULTILINE)
    (lab / "v" / "both.toml").write_text(text[:begin] + hint + text[end:])
    report = lab / "both.json"
    given = ["identify", "--vehicle", str(lab / "v" / "both.toml"), both, "--json", str(report)]
    assert cli.main(given) == cli.OK
    told = json.loads(report.read_text())["logs"][0]
    assert told["verdict"]["level"] != "do not use"
    found = {answer["name"]: answer for answer in told["quantities"]}
    truth = {"m_payload": LOAD_kg, **{f"c_{axis}_payload": c for axis, c in zip("xyz", CENTRE_m, strict=True)}}
    for name, value in truth.items():
        assert found[name]["supported"], name
        assert found[name]["low"] <= value <= found[name]["high"], name
    assert found["m_payload"]["sigma"] < 0.1


def test_recordings_that_do_not_follow_each_other_are_refused(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty, loaded = (str(lab / "logs" / f"{name}.mcap") for name in ("empty", "loaded"))
    out = ["-o", str(tmp_path / "out.mcap")]
    for logs, more, said in (
        ([empty], ["--in-turn", "recording"], "two recordings or more"),
        ([empty, loaded], ["--in-turn", "joint_link_1"], "has a channel 'joint_link_1' already"),
        ([empty, loaded], ["--in-turn", "recording", "--rename"], "leave the others out"),
    ):
        assert cli.main(["merge", *logs, *more, *out]) == cli.BAD_INPUT
        assert said in capsys.readouterr().err
        assert not (tmp_path / "out.mcap").exists()


def test_what_is_recorded_in_part_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for given in (["--encoder", "recorded", "--imu", "nimu"], ["--load-cell", "recorded"]):
        assert cli.main(["init", str(tmp_path / "v"), "--base", "prescribed", *given]) == cli.BAD_INPUT
        assert "give recorded for each device" in capsys.readouterr().err
