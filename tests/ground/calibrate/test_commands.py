"""``heft calibrate`` against simulated benches: the commands of docs/calibration.md, and what they do to the file."""

import json
import re
import shlex
from pathlib import Path

import pytest

from hil_sim.bench import BenchMission
from hil_sim.devices.vehicle_file import scenario_of
from onboard import config
from onboard.cli import BAD_INPUT, FAILED, OK, main
from onboard.flight.estimate.problem.model import build_model

PAGE = (Path(__file__).parents[3] / "docs" / "calibration.md").read_text(encoding="utf-8")
COMMANDS = [line.removeprefix("heft ") for line in re.search(r"```sh\n(.*?)```", PAGE, re.S)[1].splitlines()]
SLOWER = (("sample_rate_hz = 1000", "sample_rate_hz = 200"), ("poll_period_ms = 20", "poll_period_ms = 100"))


def comments(text):
    return re.findall(r"#[^\n]*?(?=; \+-| \(was|\n)", text)


# The last two are of swings and of a balance: of their readings test_calibrate, the latter's command test_supports
@pytest.fixture(scope="module", params=[5, pytest.param(len(COMMANDS), marks=pytest.mark.campaign)])
def calibrated(tmp_path_factory, request):
    """So many commands of the page, in its order, in a directory of their own; texts of the file after each."""
    directory = tmp_path_factory.mktemp("calibrate")
    (directory / "rig.toml").write_text(re.search(r"```toml\n(.*?)```", PAGE, re.S)[1], encoding="utf-8")
    texts = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(directory)
        for command in COMMANDS[: request.param]:
            told = ["--json", f"{len(texts)}.json"] if command.startswith("calibrate") else []
            assert main(shlex.split(command) + told) == OK, command
            file = Path("mine/vehicle.toml")
            text = file.read_text(encoding="utf-8")
            if not texts:  # an IMU at a fifth of its rate is simulated in a fifth of the time
                for old, new in SLOWER:
                    text = text.replace(old, new)
                file.write_text(text, encoding="utf-8")
            texts.append(text)
    return directory, texts


def found(directory, number):
    told = json.loads((directory / f"{number}.json").read_text(encoding="utf-8"))
    return {one["name"]: one for one in told["found"]}


def truth(kind, settings):
    return BenchMission(kind, scenario_of("dymaflex"), 1, settings).truth()


def off(one, true):
    return abs(one["value"] - true) / one["sigma"]


def test_the_page_shows_every_kind():
    assert {command.split()[1] for command in COMMANDS[1:]} == {"imu", "load-cell", "encoder", "bifilar", "balance"}


def test_a_dry_run_changes_nothing_and_a_run_keeps_comments_and_order(calibrated):
    _, texts = calibrated
    assert texts[0] == texts[1]
    assert len(set(texts[1:])) == len(texts) - 1
    kept = iter(comments(texts[-1]))
    assert all(one in kept for one in comments(texts[0]))  # in their order
    keys = re.findall(r"^(\w+) =", texts[0], re.M)
    rest = iter(re.findall(r"^(\w+) =", texts[-1], re.M))
    assert all(key in rest for key in keys)
    assert texts[-1].count("calibrated = ") == min(len(texts) - 2, 4)  # IMU, cell, encoder, a link by two commands
    assert re.search(r'calibrated = "\d{4}-\d\d-\d\d, dymaflex-imu-001.mcap, heft calibrate imu"', texts[-1])


def test_what_was_drawn_is_found(calibrated):
    directory, texts = calibrated
    chip = truth("imu", {})["imu_base"]
    imu = found(directory, 2)
    for index, axis in enumerate("xyz"):
        assert off(imu[f"gyro matrix {axis * 2}"], chip["gyro_matrix"][index, index]) < 4.0
        assert off(imu[f"accelerometer matrix {axis * 2}"], chip["accel_matrix"][index, index]) < 4.0
        assert imu[f"gyro matrix {axis * 2}"]["sigma"] < 3e-4
    cell = truth("load-cell", {"masses_kg": [0.0], "sigma_kg": 0.0, "arm_m": None})["load_cell"]
    assert off(found(directory, 3)["gain"], cell["gain"]) < 4.0
    zero_rad = truth("encoder", {"angles_rad": [0.0]})["joint_2"]["zero_rad"]
    assert off(found(directory, 4)["zero count"], 1_000_000 + zero_rad * 500_000 / 6.283185) < 4.0
    if len(texts) < len(COMMANDS):
        return
    base = truth("bifilar", {"spacing_m": 0.4, "length_m": 1.8, "swing_s": 1.0})
    swings = found(directory, 5)
    for index, axis in enumerate("XYZ"):
        true = base["inertia_kg_m2"][index, index]
        assert abs(swings[f"I {axis * 2} of base"]["value"] / true - 1.0) < 5e-3
        assert off(swings[f"I {axis * 2} of base"], true) < 4.0
    assert off(found(directory, 6)["mass of base"], base["mass_kg"]) < 4.0


def test_the_file_is_a_vehicle_that_uses_it(calibrated):
    directory, texts = calibrated
    vehicle = config.load(directory / "mine/vehicle.toml")
    assert vehicle.file.estimation.imu_prior.gyro_scale < 3e-4
    assert vehicle.file.device["imu_base"].gyro_matrix[0][0] != 1.0
    if len(texts) < len(COMMANDS):
        return
    swings, balance = found(directory, 5), found(directory, 6)
    model = build_model(vehicle)
    at = 10 * model.links.index("base")
    mass = model.chi[at]
    assert mass == pytest.approx(swings["mass of base"]["value"], abs=1e-3)  # known better than by the balance
    assert model.chi[at + 1] / mass == pytest.approx(balance["centre of mass of base x"]["value"], abs=1e-5)


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "mine", "--from", "dymaflex"]) == OK
    return tmp_path / "mine/vehicle.toml"


def refused(capsys, arguments, code, *why):
    capsys.readouterr()
    assert main(["calibrate", *map(str, arguments)]) == code
    said = capsys.readouterr().err
    assert all(one in said for one in why), said


def test_bad_runs_leave_the_file(calibrated, mine, capsys, tmp_path):
    directory, texts = calibrated
    logs = {kind: directory / f"flights/dymaflex-{kind}-001.mcap" for kind in ("imu", "load-cell")}
    before = mine.read_text(encoding="utf-8")
    cell = ["load-cell", mine, "--log", logs["load-cell"]]
    refused(capsys, [*cell, "--masses-kg", "0,0.5,1,2.5"], FAILED, "sigmas off the line", "is as it was")
    refused(capsys, [*cell, "--masses-kg", "0,1"], FAILED, "4 steady readings in the log, 2 masses")
    refused(capsys, ["imu", mine, "--log", logs["load-cell"]], FAILED, "has no readings of imu_base")
    bifilar = ["bifilar", mine, "--log", logs["imu"]]
    refused(capsys, bifilar, BAD_INPUT, "give --mass-kg, --spacing-m, --length-m")
    if len(texts) == len(COMMANDS):
        swings = directory / "flights/dymaflex-bifilar-001.mcap"
        refused(capsys, ["imu", mine, "--log", swings], FAILED, "is as it was")
    refused(capsys, ["imu", mine, "--log", tmp_path / "none.mcap"], BAD_INPUT, "none.mcap")
    refused(capsys, [*cell, "--masses-kg", "0,1", "--at", "1:2"], BAD_INPUT, "write 2-12,15-25")
    refused(capsys, [*cell, "--masses-kg", "0,1", "--device", "cell"], BAD_INPUT, "no device 'cell'")
    refused(capsys, ["encoder", mine, "--log", logs["imu"]], BAD_INPUT, "which device? give --device")
    refused(capsys, ["imu", mine], BAD_INPUT, "run it on a terminal, or give --log or --hil")
    assert mine.read_text(encoding="utf-8") == before
    mine.write_text(before.replace('name = "dymaflex"', 'name = "other"', 1), encoding="utf-8")
    refused(capsys, ["imu", mine, "--log", logs["imu"]], FAILED, "is a log of vehicle 'dymaflex', not of 'other'")


def test_a_file_that_is_not_to_be_written_is_left(calibrated, mine, capsys):
    directory, _ = calibrated
    log = ["--log", directory / "flights/dymaflex-load-cell-001.mcap", "--masses-kg", "0,0.5,1,2"]
    refused(capsys, ["load-cell", "dymaflex", *log], BAD_INPUT, "comes with heft and is not written to")
    mine.chmod(0o444)
    refused(capsys, ["load-cell", mine, *log], BAD_INPUT, "read-only; get permission")
    mine.chmod(0o640)
    assert main(["calibrate", "load-cell", str(mine), *map(str, log)]) == OK
    assert mine.stat().st_mode & 0o777 == 0o640
    once = mine.read_text(encoding="utf-8")
    assert main(["calibrate", "load-cell", str(mine), *map(str, log)]) == OK
    assert mine.read_text(encoding="utf-8") == once  # a second time adds nothing
    assert sorted(path.name for path in mine.parent.iterdir()) == [
        "dymaflex.urdf",
        "vehicle.schema.json",
        "vehicle.toml",
    ]
