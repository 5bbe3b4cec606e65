"""An arm by its motor currents: MuJoCo's torques, friction, rotors, a coupled wrist; and two recorded arms."""

import json
from pathlib import Path

import numpy as np
import pytest

from bench import arms
from drivers.records import SCALAR, Batch
from onboard import cli, config
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.identify.replay.feed import feed
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.conftest import SEED
from tests.dynamics.mujoco_twin import random_vehicle, swung, to_urdf

JOINTS = [f"joint_link_{k}" for k in (1, 2, 3)]
GAIN_N_m_A, OFF = 40.0, 1.02  # what the file says, and by how much it is wrong
COULOMB, VISCOUS, ROTOR, OFFSET = (
    np.array(v) for v in ([3.0, 2.0, 1.0], [4.0, 2.0, 1.5], [1.0, 0.5, 0.3], [1, -2, 0.5])
)
WRIST = (0.8, 0.6, 0.2)  # Coulomb, viscous, rotor of the motor that turns with joints 2 and 3
RATE_HZ, END_S, NOISE_N_m = 200.0, 12.0, 0.3

HEAD = """
[vehicle]
name = "lab_arm"
urdf = "arm.urdf"
base = "fixed"
base_link = "base"
gravity_m_s2 = [0.0, 0.0, -9.81]

[estimation]
row_rate_hz = 50
smoothing_ms = 100
motor.wrist.ratios = { joint_link_2 = 1.0, joint_link_3 = 1.0 }

[estimation.prior.relative]
base = 1.0
link_1 = 1.0
link_2 = 1.0
link_3 = 1.0

[estimation.prior.absolute]
"""


def vehicle_toml(directory: Path, urdf: str, scale_sigma: float, extra: str = "") -> Path:
    text = HEAD
    for motor in [*JOINTS, "wrist"]:
        text += f"Ia_{motor} = 5.0\nFv_{motor} = 20.0\nFc_{motor} = 20.0\n"
    text += "".join(f"bias_current_{k} = 20.0\n" for k in range(3))
    for k, joint in enumerate(JOINTS):
        text += f'[device.joint_{k}]\nkind = "recorded_angle"\njoint = "{joint}"\nperiod_ms = 5\nnoise_rad = 1e-6\n'
        text += f'[device.current_{k}]\nkind = "recorded_torque"\njoint = "{joint}"\nperiod_ms = 5\nsigma_N_m = 0.1\n'
        text += f"gain_N_m_A = {GAIN_N_m_A}\nscale_sigma = {scale_sigma}\nstill_rad_s = 0.05\n{extra}"
    (directory / "drawing.urdf").write_text(urdf)
    (directory / "vehicle.toml").write_text(text)
    return directory / "vehicle.toml"


def recorded(directory: Path, links: list, rng: np.random.Generator) -> Path:
    """Eight sines a joint; torques by MuJoCo; friction, rotors and the wrist's motor on top; all of it in amperes."""
    t = np.arange(0.0, END_S, 1.0 / RATE_HZ)
    q, dq, ddq, torque = swung(links, rng, t, 9.81)
    torque += COULOMB * np.sign(dq) + VISCOUS * dq + ROTOR * ddq + OFFSET
    rate, up = dq[:, 1] + dq[:, 2], ddq[:, 1] + ddq[:, 2]
    torque[:, 1:] += (WRIST[0] * np.sign(rate) + WRIST[1] * rate + WRIST[2] * up)[:, None]
    current = OFF * (torque + NOISE_N_m * rng.normal(size=torque.shape)) / GAIN_N_m_A
    with LogWriter.create(directory / "run.mcap", durable=False, overwrite=True) as writer:
        for k in range(3):
            for name, values, scale, unit in ((f"joint_{k}", q, 1e-8, b"rad"), (f"current_{k}", current, 1e-7, b"A")):
                rows = np.zeros(len(t), SCALAR)
                rows["sequence"], rows["host_ns"] = np.arange(len(t)), np.rint(1e9 * (5.0 + t))
                rows["value_raw"], rows["scale"], rows["unit"] = np.rint(values[:, k] / scale), scale, unit
                writer.register(name, SCALAR)
                writer.write(name, rows)
    return directory / "run.mcap"


TRUTH = {
    **{f"Fc_{j}": v for j, v in zip(JOINTS, COULOMB, strict=True)},
    **{f"Fv_{j}": v for j, v in zip(JOINTS, VISCOUS, strict=True)},
    **{f"bias_current_{k}": v for k, v in enumerate(OFFSET)},
    "Fc_wrist": WRIST[0],
    "Fv_wrist": WRIST[1],
    "Ia_wrist": WRIST[2],
}


def identify(directory: Path, vehicle: Path, log: Path, *more: str) -> tuple[int, dict]:
    report, urdf = directory / "report.json", directory / "drawing.urdf"
    given = ["--vehicle", str(vehicle), "--urdf-in", str(urdf), "--json", str(report), *more]
    code = cli.main(["identify", *given, str(log)])
    return code, json.loads(report.read_text())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[list, Path]:
    """The arm, and the log of its motion."""
    rng = np.random.default_rng(SEED)
    links = random_vehicle(rng, ["revolute"] * 3)
    return links, recorded(tmp_path_factory.mktemp("run"), links, rng)


def test_friction_rotors_and_a_coupled_wrist_come_out_of_currents(tmp_path: Path, run: tuple[list, Path]) -> None:
    links, log = run
    vehicle = vehicle_toml(tmp_path, to_urdf(links), 0.02)
    code, report = identify(tmp_path, vehicle, log, "--predict", str(log))
    told = report["logs"][0]
    assert code == cli.OK
    left = report["predicted"][str(log)]["relative_error"]  # of the log itself: what its own fit leaves
    assert left == pytest.approx(told["held_out"]["all_from_all"]["relative_error"], rel=1e-6)
    assert 0.0 < left < 0.05
    assert told["verdict"]["level"] != "do not use"
    assert told["refused"]["still"] > 0
    found = {answer["name"].removesuffix("_R"): answer for answer in told["quantities"]}
    inside = [found[name]["low"] <= value <= found[name]["high"] for name, value in TRUTH.items()]
    assert sum(inside) >= len(TRUTH) - 1
    for name in ("Fc_joint_link_1", "Fv_joint_link_1", "Fv_wrist"):
        assert abs(found[name]["value"] / (OFF * TRUTH[name]) - 1.0) < 0.03  # all scale with the gain
        assert found[name]["sigma"] > 0.015 * TRUTH[name]  # and its 2 % is in the interval


def test_answers_of_the_last_step_are_those_of_every_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.flight.test_lab_arm.END_S", 3.0)
    rng = np.random.default_rng(SEED)
    links = random_vehicle(rng, ["revolute"] * 3)
    log = LogReader(recorded(tmp_path, links, rng))
    vehicle = config.load(vehicle_toml(tmp_path, to_urdf(links), 0.02), urdf=tmp_path / "drawing.urdf")
    made: list[list[Batch]] = []
    for at_the_end in (False, True):
        estimator = Estimator(vehicle, at_the_end=at_the_end)
        made.append([one for one in feed(estimator, log) if one.channel in ("quantity", "estimate")])
    every, last = made
    assert len(every) > 30
    assert [one.channel for one in last] == ["estimate", "quantity"]
    every[-1].rows["sequence"] = last[-1].rows["sequence"]
    assert every[-1].rows.tobytes() == last[-1].rows.tobytes()
    assert every[-2].rows["mean"].tobytes() == last[-2].rows["mean"].tobytes()
    assert last[-1].rows["supported"].any()


def test_currents_without_a_gain_are_refused(
    tmp_path: Path, run: tuple[list, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    links, log = run
    vehicle = vehicle_toml(tmp_path, to_urdf(links), 0.0)
    vehicle.write_text(vehicle.read_text().replace(f"gain_N_m_A = {GAIN_N_m_A}\n", ""))
    urdf = str(tmp_path / "drawing.urdf")
    assert cli.main(["identify", "--vehicle", str(vehicle), "--urdf-in", urdf, str(log)]) == cli.BAD_INPUT
    assert "currents need gain_N_m_A" in capsys.readouterr().err


def test_a_motor_of_an_unknown_joint_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    links = random_vehicle(np.random.default_rng(0), ["revolute"] * 3)
    vehicle = vehicle_toml(tmp_path, to_urdf(links), 0.0)
    vehicle.write_text(vehicle.read_text().replace("{ joint_link_2 = 1.0", "{ elbow = 1.0"))
    urdf = str(tmp_path / "drawing.urdf")
    assert cli.main(["identify", "--vehicle", str(vehicle), "--urdf-in", urdf, "--parameters"]) == cli.BAD_INPUT
    assert "turns with 'elbow'" in capsys.readouterr().err


def test_a_vehicle_whose_urdf_is_elsewhere_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["identify", "--vehicle", "staubli_tx40", "--parameters"]) == cli.BAD_INPUT
    assert "--urdf-in" in capsys.readouterr().err


def test_the_tx40s_published_parameters(datasets: Path, tmp_path: Path) -> None:
    ols, wls = arms.tx40(datasets / "staubli_tx40", tmp_path)
    assert ols.size == wls.size == 19
    assert np.median(ols) < 0.0060
    assert np.median(wls) < 0.0079


@pytest.mark.campaign  # another run predicted: test_friction_rotors_and_a_coupled_wrist; a recorded arm: the TX40
def test_the_lwr4s_other_run(datasets: Path, tmp_path: Path) -> None:
    for number in (1, 2):
        source = datasets / "kuka_lwr4" / f"HW_measurements_{number}.npz"
        assert cli.main(["import", "kuka_lwr4", str(source), "-o", str(tmp_path)]) == cli.OK
    one, two = (str(tmp_path / f"HW_measurements_{number}.mcap") for number in (1, 2))
    given = ["--urdf-in", str(datasets / "kuka_lwr4" / "kuka_lwr4.urdf"), "--json", str(tmp_path / "report.json")]
    assert cli.main(["identify", "--vehicle", "kuka_lwr4", *given, one, "--predict", two]) == cli.OK
    told = json.loads((tmp_path / "report.json").read_text())
    assert told["predicted"][two]["relative_error"] < 0.0195
    assert told["logs"][0]["held_out"]["later_from_earlier"]["relative_error"] < 0.03
