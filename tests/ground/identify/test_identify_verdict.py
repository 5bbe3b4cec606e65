"""What ``heft identify`` says of logs that are good, and of logs that no number should be taken from.

What ``heft identify`` says of a link beside the answers.
"""

import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from rich.console import Console

from drivers.records import Rows, SampleStatus
from onboard import cli, config
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.ground.identify import identify_view
from onboard.ground.identify.identify import Identification, identify
from onboard.ground.identify.kinds.identified import Identified
from onboard.identification.rows.standard import link_estimate
from onboard.identification.standing import Level
from onboard.identification.verdict import Verdict
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.ground.identify import throws
from tests.ground.identify.test_identify import LOAD, TUDELFT, TUMBLES, vehicle_file, with_carrier

MEAN = standard_of(RigidBody(1.2, np.array([0.1, 0.0, 0.02]), np.diag([0.01, 0.02, 0.02])))


@pytest.mark.parametrize(("sigma_kg", "apart"), [(0.01, True), (0.9, False)])
def test_the_mass_of_a_link_has_its_interval_and_one_that_is_not_determined_says_so(sigma_kg: float, apart: bool):
    link = link_estimate("tool", MEAN, np.diag([sigma_kg, *[1e-3] * 3, *[1e-4] * 6]) ** 2)
    log = Identified(Path("run.mcap"), "rows", (), 100, {}, (), Verdict(Level.GOOD, (), ()), links=(link,))
    out = io.StringIO()
    Console(file=out, width=80).print(
        identify_view.render(Identification(config.load(config.packaged("workshop")), (log,), None))
    )
    said = " ".join(out.getvalue().split())
    assert ("1.200 ± 0.020 kg, centre of mass 100.0 ± 2.3" if apart else "1.2 ± 1.8 kg, centre of mass 100") in said
    assert ("do not tell its mass apart" in said) != apart


WHOLE = with_carrier(LOAD)


def throw(directory: Path, w0: list[float], rng: np.random.Generator) -> Path:
    return throws.write(directory / "config_a.mcap", WHOLE.inertia_kg_m2, WHOLE.centre_of_mass_m, w0, rng)


def altered(log: Path, change: Callable[[str, Rows], None]) -> Path:
    """The log with its rows changed in place."""
    reader = LogReader(log)
    rows = {name: reader.read(name).copy() for name in reader.channels}
    with LogWriter.create(log, durable=False, overwrite=True) as writer:
        for name, dtype in reader.channels.items():
            writer.register(name, dtype)
            change(name, rows[name])
            writer.write(name, rows[name])
    return log


def said(log: Path) -> Identified:
    (found,) = identify(TUDELFT, [log]).logs
    return found


def test_a_tumbling_throw_is_answered(tmp_path: Path, rng: np.random.Generator) -> None:
    found = said(throw(tmp_path, TUMBLES[0], rng))
    assert found.verdict.level is not Level.DO_NOT_USE
    assert all("as wide as" in reason for reason in found.verdict.reasons)  # half a second, and a gyro stated to 2 %
    assert found.held_out is not None
    assert found.held_out.worst.relative_error < 0.2
    assert found.observability is not None
    assert found.observability.determined == 9  # of the whole: first moments and inertia; its mass is weighed
    assert len(found.answers) >= 9
    assert all(0.0 < answer.bound <= 1.001 * answer.sigma for answer in found.answers)


def test_a_throw_that_only_the_wheel_turns_is_weak_about_the_other_axes(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    log = throw(tmp_path, [0.0, 0.0, 0.0], rng)
    assert cli.main(["identify", "--vehicle", "tudelft", str(log)]) == cli.FAILED
    assert "weak in these directions:" in capsys.readouterr().out
    found = said(log)
    assert found.verdict.level is Level.WEAK
    assert {"I_xx", "I_yy", "com_z"} <= set(found.verdict.weak)
    assert "I_zz" not in found.verdict.weak


@pytest.mark.parametrize("axis", [0, *(pytest.param(other, marks=pytest.mark.campaign) for other in (1, 2))])
def test_a_gyro_axis_of_the_wrong_sign_contradicts_the_wheel(
    tmp_path: Path, rng: np.random.Generator, axis: int, capsys: pytest.CaptureFixture[str]
) -> None:
    def flip(name: str, rows: Rows) -> None:
        if name == "imu_base":
            rows["gyro_raw"][:, axis] *= -1

    log = altered(throw(tmp_path, TUMBLES[0], rng), flip)
    report, urdf = tmp_path / "report.json", tmp_path / "out.urdf"
    arguments = ["identify", "--vehicle", "tudelft", str(log), "--json", str(report), "--urdf", str(urdf)]
    assert cli.main(arguments) == cli.FAILED
    assert "do not use" in capsys.readouterr().out
    told = json.loads(report.read_text())["logs"][0]["verdict"]
    assert told["level"] == "do not use"
    assert any("no body explains what was measured" in reason for reason in told["reasons"])
    assert not urdf.exists()


def test_a_wheel_of_the_wrong_sign_makes_a_body_that_cannot_exist(tmp_path: Path, rng: np.random.Generator) -> None:
    """It fits to the last digit, with the inertia below zero."""

    def flip(name: str, rows: Rows) -> None:
        if name == "wheel_rate":
            rows["value_raw"] *= -1

    found = said(altered(throw(tmp_path, TUMBLES[0], rng), flip))
    assert found.verdict.level is Level.DO_NOT_USE
    assert "sigmas from any body" in found.verdict.text


def test_a_throw_cut_short_gives_no_answer_and_no_urdf(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its moments are tested against the wide prior, and not against zero."""
    log = throw(tmp_path, TUMBLES[0], rng)
    reader = LogReader(log)
    rows = {name: reader.read(name) for name in reader.channels}
    begin_ns = int(rows["imu_base"]["host_ns"][0]) + 250_000_000
    with LogWriter.create(log, durable=False, overwrite=True) as writer:
        for name, dtype in reader.channels.items():
            writer.register(name, dtype)
            after_s = (rows[name]["host_ns"].astype(np.int64) - begin_ns) * 1e-9
            writer.write(name, rows[name][(after_s >= 0.0) & (after_s < 0.15)])
    urdf = tmp_path / "out.urdf"
    assert cli.main(["identify", "--vehicle", "tudelft", str(log), "--urdf", str(urdf)]) == cli.FAILED
    assert "good" not in capsys.readouterr().out
    assert not urdf.exists()


GENTLE = [4.0, 3.0, -3.0]  # rad/s: noise and the stated errors of the equations hide much of it


@pytest.mark.parametrize(
    ("order", "said_of"),
    [
        ([0, 2, 1], "y and z are exchanged"),
        pytest.param([1, 0, 2], "x and y are exchanged", marks=pytest.mark.campaign),
        pytest.param([2, 1, 0], "x and z are exchanged", marks=pytest.mark.campaign),
    ],
)
def test_exchanged_axes_of_the_accelerometer_are_named_of_a_gentle_throw(
    tmp_path: Path, rng: np.random.Generator, order: list[int], said_of: str
) -> None:
    def exchange(name: str, rows: Rows) -> None:
        if name == "imu_base":
            rows["accel_raw"] = rows["accel_raw"][:, order]

    found = said(altered(throw(tmp_path, GENTLE, rng), exchange))
    assert found.verdict.level is Level.DO_NOT_USE
    assert said_of in found.verdict.text


def test_a_gyro_axis_ten_per_cent_off_is_named_of_a_gentle_throw(tmp_path: Path, rng: np.random.Generator) -> None:
    """The noise is a quarter of what is stated of the equations: errors are held against what the rows show of it."""

    def scale(name: str, rows: Rows) -> None:
        if name == "imu_base":
            rows["gyro_raw"][:, 0] = np.rint(1.1 * rows["gyro_raw"][:, 0])

    found = said(altered(throw(tmp_path, TUMBLES[0], rng), scale))
    assert "gyro along x had to be corrected" in found.verdict.text


@pytest.mark.parametrize("factor", [pytest.param(0.75, marks=pytest.mark.campaign), 0.85])
def test_a_gyro_that_reads_another_scale_than_it_was_calibrated_to_is_not_good(
    tmp_path: Path, rng: np.random.Generator, factor: float
) -> None:
    def scale(name: str, rows: Rows) -> None:
        if name == "imu_base":
            rows["gyro_raw"] = np.clip(np.rint(factor * rows["gyro_raw"]), -32768, 32767)

    found = said(altered(throw(tmp_path, TUMBLES[0], rng), scale))
    assert found.verdict.level is not Level.GOOD
    assert re.search("gyro( along [xyz])? had to be corrected by", found.verdict.text)


def test_the_interval_of_a_throw_carries_the_scale_of_the_wheels_rate(tmp_path: Path, rng: np.random.Generator) -> None:
    """A yardstick that nothing checks: 10 % stated is 10 % of every moment."""
    log = throw(tmp_path, TUMBLES[0], rng)
    exact = vehicle_file(tmp_path, scale_sigma="0.0")
    (narrow,) = identify(exact, [log]).logs
    (wide,) = identify(vehicle_file(tmp_path, scale_sigma="0.1"), [log]).logs
    assert narrow.throw is not None
    assert wide.throw is not None
    assert narrow.throw.principal is not None
    assert wide.throw.principal is not None
    added = np.sqrt(wide.throw.principal.sigma**2 - narrow.throw.principal.sigma**2)
    np.testing.assert_allclose(added[1:], 0.1 * narrow.throw.principal.moments[1:], rtol=0.15)


def test_samples_that_are_not_valid_leave_no_row(tmp_path: Path, rng: np.random.Generator) -> None:
    def spoil(name: str, rows: Rows) -> None:
        if name == "imu_base":
            rows["status"] = SampleStatus.NOT_VALID

    found = said(altered(throw(tmp_path, TUMBLES[0], rng), spoil))
    assert found.verdict.level is Level.DO_NOT_USE
    assert "no row could be used" in found.verdict.text
    assert found.rows_used == 0
    assert not any(answer.supported for answer in found.answers)


def test_the_json_holds_all_of_it_and_the_urdf_the_same_body(tmp_path: Path, rng: np.random.Generator) -> None:
    log = throw(tmp_path, TUMBLES[0], rng)
    report, urdf = tmp_path / "report.json", tmp_path / "out.urdf"
    arguments = ["identify", "--vehicle", "tudelft", str(log), "--json", str(report), "--urdf", str(urdf)]
    page = tmp_path / "page.html"
    arguments += ["--report", str(page)]
    assert cli.main(arguments) == cli.OK
    text = page.read_text()
    assert text.count("<figure") == 1  # the residuals
    assert "correlation, next tick" in text
    told = json.loads(report.read_text())["logs"][0]
    verdict = told["verdict"]
    assert (verdict["level"], verdict["weak"]) == ("weak", [])
    assert verdict["text"] == f"weak: {'; '.join(verdict['reasons'])}"
    assert told["observable"]["condition"] > 1.0
    assert set(told["held_out"]) == {"later_from_earlier", "earlier_from_later", "all_from_all"}
    (link,) = told["links"]
    covariance = np.array(link["covariance"])
    assert covariance.shape == (10, 10)
    assert np.linalg.eigvalsh(covariance)[0] > -1e-15
    model = pin.buildModelFromXML(urdf.read_text(), pin.JointModelFreeFlyer())
    data = model.createData()
    whole = pin.centerOfMass(model, data, pin.neutral(model))
    np.testing.assert_allclose(whole, link["body"]["centre_of_mass_m"], atol=1e-9)
    pin.ccrba(model, data, pin.neutral(model), np.zeros(model.nv))
    xx, xy, yy, xz, yz, zz = link["body"]["inertia_kg_m2"]
    np.testing.assert_allclose(data.Ig.inertia, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], atol=1e-12)


@pytest.mark.parametrize(
    ("vehicle", "old", "new", "remedy"),
    [
        (
            "rocksat",
            '<mass value="0.06627"/>',
            '<mass value="-0.06627"/>',
            "rocksat.urdf:54: link 'tip_mass' weighs -0.0",
        ),
        (
            "rocksat",
            'payload_link = "tip_mass"',
            'payload_link = "tip_mas"',
            "'tip_mas' is not in the URDF; did you mean",
        ),
        ("rocksat", "tip_mass = 1.0, plate", "tip_mass = -1.0, plate", "0 or more"),
        ("rocksat", 'frame = "joint_1"', 'frame = "joint_9"', "frame 'joint_9' is not in the URDF; its links are"),
    ],
)
def test_a_vehicle_that_cannot_be_is_refused_with_the_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], vehicle: str, old: str, new: str, remedy: str
) -> None:
    packaged = config.load(config.packaged(vehicle))
    urdf = packaged.urdf_path.read_text()
    assert packaged.text.count(old) + urdf.count(old) == 1
    (tmp_path / packaged.urdf_path.name).write_text(urdf.replace(old, new))
    (tmp_path / "vehicle.toml").write_text(packaged.text.replace(old, new))
    arguments = ["identify", "--vehicle", str(tmp_path / "vehicle.toml"), "--parameters"]
    assert cli.main(arguments) == cli.BAD_INPUT
    error = capsys.readouterr().err
    assert str(tmp_path) in error
    assert remedy in error
