"""A run on an air-bearing table: a log of its encoders and base IMU, the truth MuJoCo's, through ``heft identify``."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.true_flights import planar_bed
from bench.true_flights.free_flyer import Body, JointMotion
from bench.true_flights.free_flyer_sensors import ImuErrors, SampledSignals, sample
from onboard import cli, config
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.urdf import with_bodies
from onboard.estimation.gates import GateReason
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.identify.identify import identify
from onboard.ground.identify.kinds.table_log import PlanarTickRecorder
from onboard.ground.identify.replay.feed import feed
from onboard.identification.standing import Level
from onboard.recording.reader import LogReader
from onboard.regressor.rows import BaseMotion
from onboard.regressor.signals import Signals
from tests.recording.logs import make_log, sampled_rows

PATH = config.packaged("dymaflex_air_bearing")
TEXT = PATH.read_text(encoding="utf-8")
VEHICLE = config.load(PATH)
BOX = Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08))
DRAGS = (planar_bed.Drag(0.03, 0.005), planar_bed.Drag(0.03, 0.004), planar_bed.Drag(3.4, 0.35))
ERRORS = ImuErrors(0.0087, 8.7e-5, 0.1, 1e-3, 0.003, 0.0035, 1e-4)
SWING = np.array([[1.0], [1.0], [1.0], [1.0], [3.0]])


def fly(
    rng: np.random.Generator, seconds: float, swing: float = 1.0, drags: tuple[planar_bed.Drag, ...] = DRAGS
) -> SampledSignals:
    motion = JointMotion.draw(rng)
    amplitude = swing * SWING * motion.amplitude_rad
    motion = replace(motion, start_rad=np.array([0.0, 1.2, 0.0, -1.2, 0.0]), amplitude_rad=amplitude)
    world = planar_bed.world(BOX, tilt_m_s2=(0.002, -0.001))
    return sample(planar_bed.fly(world, motion, (0.02, -0.01, 0.05), drags, seconds), ERRORS, rng)


def write(path: Path, read: SampledSignals, imu_until_s: float = np.inf) -> Path:
    rows = sampled_rows(read, 10.0)
    rows["imu_base"] = rows["imu_base"][read.time_s < imu_until_s]
    return make_log(path, rows, overwrite=True)


@pytest.fixture(scope="module")
def read() -> SampledSignals:
    return fly(np.random.default_rng(3), 8.0)


@pytest.fixture(scope="module")
def log(read: SampledSignals, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("table") / "table.mcap", read)


def test_payload_and_drag_with_their_verdict(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = tmp_path / "report.json"
    assert cli.main(["identify", "--vehicle", "dymaflex_air_bearing", str(log), "--json", str(report)]) == cli.OK
    told = json.loads(report.read_text())["logs"][0]
    said = [reason.partition(":")[0] for reason in told["verdict"]["reasons"] if "as wide as" in reason]
    assert told["verdict"]["level"] == "weak"  # of moments about axes that the table does not turn about
    assert said == ["I_xx_payload", "I_yy_payload"]
    assert len(told["verdict"]["reasons"]) == 2
    assert told["misfit"] == pytest.approx(1.0, abs=0.1)
    assert told["held_out"]["later_from_earlier"]["relative_error"] < 0.2
    found = {answer["name"]: answer for answer in told["quantities"]}
    centre = zip("xyz", BOX.centre_of_mass_m, strict=True)
    truth = {"m_payload": BOX.mass_kg, "I_zz_payload": BOX.inertia_kg_m2[2, 2], "Fc_puck_3": 0.35, "Fv_puck_3": 3.4}
    for name, value in {**truth, **{f"c_{axis}_payload": value for axis, value in centre}}.items():
        assert found[name]["supported"], name
        assert found[name]["low"] < value < found[name]["high"], name
        assert found[name]["bound"] <= found[name]["sigma"]
    assert found["Fv_puck_3"]["sigma"] < 0.2
    assert found["m_payload"]["sigma"] < 0.15
    assert "Fv_puck_3" in capsys.readouterr().out


def test_on_board_the_run_is_recorded_and_not_estimated(log: Path) -> None:
    made: dict[str, int] = {}
    measured = 0
    for channel, rows in feed(Estimator(VEHICLE), LogReader(log)):
        made[channel] = made.get(channel, 0) + len(rows)
        if channel == "row":
            measured += int(np.isfinite(rows["measured"]).all(axis=1).sum())
    assert measured > 550
    assert not {"estimate", "quantity"} & set(made)


@pytest.mark.campaign  # the fit: identification/table/test_air_bearing; a verdict of it: below
def test_a_fit_that_is_not_usable_says_why(tmp_path: Path) -> None:
    log = write(tmp_path / "table.mcap", fly(np.random.default_rng(3), 4.0))
    text = TEXT.replace("accel_noise_m_s2 = 0.062", "accel_noise_m_s2 = 0.02")
    (found,) = identify(config.parse(text, PATH), [log]).logs
    assert found.verdict.level is Level.DO_NOT_USE
    assert "IMU and joints contradict each other" in found.verdict.text
    assert found.answers
    assert not any(answer.supported for answer in found.answers)
    assert not found.usable


@pytest.mark.parametrize(
    ("imu_until_s", "why"),
    [pytest.param(2.02, "more", marks=pytest.mark.campaign), (2.0, "of which the IMU has no reading")],
)
def test_an_answer_that_half_of_the_run_cannot_check_is_weak(tmp_path: Path, imu_until_s: float, why: str) -> None:
    read = fly(np.random.default_rng(3), 4.0)
    (found,) = identify(VEHICLE, [write(tmp_path / "half.mcap", read, imu_until_s)]).logs
    assert found.verdict.level is Level.WEAK
    assert "not checked on motion that was not used" in found.verdict.text
    assert f"half of the run determines too little ({why}" in found.verdict.text
    left = np.array(list(found.residuals.values()))  # (6, ticks)
    assert np.isfinite(left).all(axis=0).sum() == found.rows_used // 6
    assert np.nanmean(left**2) == pytest.approx(1.0, abs=0.1)
    (mass,) = (answer for answer in found.answers if answer.name == "m_payload")
    assert mass.supported
    assert mass.low < BOX.mass_kg < mass.high


def test_an_arm_that_stands_still_shows_nothing(tmp_path: Path) -> None:
    (found,) = identify(VEHICLE, [write(tmp_path / "still.mcap", fly(np.random.default_rng(3), 2.5, 0.0))]).logs
    assert found.verdict.level is Level.DO_NOT_USE
    assert "not determine" in found.verdict.text
    assert not found.usable


def test_a_run_begins_where_the_base_is_let_go_and_not_after_a_gap() -> None:
    n = 100
    joints = np.zeros((n, 5))
    joints[60] = np.nan
    still = BaseMotion(*np.zeros((3, n, 3)))
    signals = Signals(0.01 * np.arange(n), joints, joints, joints, still, np.zeros((n, 6)), np.ones((n, 6)))
    recorder = PlanarTickRecorder("payload", 5)
    excluded = np.where(np.arange(n) < 20, int(GateReason.PHASE), 0)
    found = recorder.update(signals, np.arange(n) >= 10, excluded)
    assert (found[60] == GateReason.GAP).all()
    assert recorder.refused[GateReason.GAP] == 6
    assert recorder.begins_at(0.20)
    assert not recorder.begins_at(0.61)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("coulomb_sigma_N = 0.5", "coulomb_N = 0.5", "did you mean 'coulomb_sigma_N'"),
        (
            "tilt_sigma_m_s2 = 0.002",
            "tilt_m_s2 = 0.2",
            "unknown key 'planar.tilt_m_s2'; did you mean 'tilt_sigma_m_s2'",
        ),
        ('frame = "puck_2"', 'frame = "puck_1"', "two pucks are at puck_1; give each another frame"),
        ('base = "planar"', 'base = "free"', 'pucks and a table need base = "planar"'),
        ('method = "exiddm"', 'method = "rows"', 'base = "planar" needs method = "exiddm"'),
        (
            "[estimation.prior.link]",
            "[estimation.exiddm]\nheld_at_start = false\n[estimation.prior.link]",
            "give phases.payload_taken",
        ),
        (
            "[estimation.imu_prior]",
            "[estimation.gates]\njoint_rate_min_rad_s = 0.1\n[estimation.imu_prior]",
            "joint_rate_min_rad_s does not apply",
        ),
    ],
)
def test_mistakes_in_the_file_are_refused_with_their_line(old: str, new: str, expected: str) -> None:
    assert old in TEXT
    with pytest.raises(config.ConfigError, match=r"vehicle\.toml:[1-9][0-9]*: ") as caught:
        config.parse(TEXT.replace(old, new, 1), PATH)
    assert expected in str(caught.value)


def test_a_planar_base_needs_its_table() -> None:
    before, _, rest = TEXT.partition("[planar]")
    with pytest.raises(config.ConfigError, match=r"toml:8: .*needs a section: \[planar\] with an arm"):
        config.parse(before + rest[rest.index("[device.imu_base]") :], PATH)


def test_a_puck_at_a_frame_that_the_urdf_does_not_have(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "dymaflex.urdf").write_bytes(VEHICLE.urdf_path.read_bytes())
    path = tmp_path / "vehicle.toml"
    for frame, why in (("puck_9", "no link, joint or frame 'puck_9'"), ("link_3", "moves with a joint")):
        path.write_text(TEXT.replace('frame = "puck_2"', f'frame = "{frame}"'), encoding="utf-8")
        line = 1 + path.read_text().splitlines().index(f'frame = "{frame}"')
        assert cli.main(["identify", "--vehicle", str(path), str(log)]) == cli.BAD_INPUT
        said = " ".join(capsys.readouterr().err.split())
        assert f"vehicle.toml:{line}: " in said.replace("toml: ", "toml:")
        assert why in said


@pytest.mark.campaign  # heft predict: test_witness; drag: above
def test_what_the_predicted_yaw_leaves_is_drag(log: Path, tmp_path: Path) -> None:
    """``heft predict`` with the true payload: without drag it is the measured yaw, and one dragging puck shows."""
    urdf = tmp_path / "held.urdf"
    urdf.write_text(
        with_bodies(VEHICLE.urdf_text, {"payload": RigidBody(BOX.mass_kg, BOX.centre_of_mass_m, BOX.inertia_kg_m2)})
    )
    nothing = (planar_bed.Drag(0.0, 0.0),) * 3
    free = write(tmp_path / "free.mcap", fly(np.random.default_rng(3), 8.0, drags=nothing))
    errors = []
    for one in (free, log):
        report = tmp_path / f"{one.stem}.json"
        asked = ["--vehicle", "dymaflex_air_bearing", "--method", "generalized_jacobian", "--urdf", str(urdf)]
        assert cli.main(["predict", str(one), *asked, "--json", str(report)]) == cli.OK
        read = json.loads(report.read_text())
        assert read["swing_deg_s"][2] > 10.0
        errors.append(read["methods"]["generalized_jacobian"]["rms_deg_s"][2] / read["swing_deg_s"][2])
    assert errors[0] < 0.01
    assert errors[1] > 5.0 * errors[0]
