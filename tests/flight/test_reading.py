"""What is read out of a whole mission's log: phases, aligned signals."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from onboard import cli
from onboard.ground.log.export.aligned import dump_aligned
from onboard.ground.log.export.dump import dump
from onboard.ground.log.tables.selection import Selection
from onboard.ground.log.tables.vehicle_file import attached_vehicle
from tests.flight.missions import Result


def test_aligned_signals_lie_where_the_estimator_saw_them(mission: Result, tmp_path: Path) -> None:
    dump_aligned(mission.log, tmp_path, 100.0, kind="npz")
    with np.load(tmp_path / "aligned.npz") as table:
        at_ns, angle = table["vehicle_ns"], table["joint_1.value"]
        assert np.allclose(np.diff(table["time_s"]), 0.01, atol=1e-9)
        assert set(table["units"]) >= {"ns", "rad", "N", "m/s^2", "rad/s"}
        force = table["load_cell.value"]
    assert (np.diff(at_ns) == 10_000_000).all()
    rows = mission.log.read("row")
    used = rows[rows["gate"][:, 0] == 0]
    _, here, there = np.intersect1d(at_ns, used["vehicle_ns"], return_indices=True)
    assert len(here) > 2000
    used = used[there]
    # smoothing shrinks the motion, and what it takes has the shape of the acceleration; a shift has that of the rate
    assert abs(shift_s(angle[here] - used["joint_rad"][:, 0], used["joint_rad_s"][:, 0])) < 20e-6
    rate = np.gradient(used["measured"][:, 0], 0.01)
    steady = np.gradient(used["vehicle_ns"]) == 10_000_000
    assert abs(shift_s((force[here] - used["measured"][:, 0])[steady], rate[steady])) < 100e-6


def test_a_dump_says_when_each_sample_was_taken_and_a_joint_at_zero_reads_zero(mission: Result, tmp_path: Path) -> None:
    dump(mission.log, tmp_path, Selection(("joint_1", "imu_base")), kind="npz")
    recorded = mission.log.read("joint_1")
    with np.load(tmp_path / "joint_1.npz") as table:
        time_s, angle, raw = table["time_s"], table["value"], table["value_raw"]
    assert np.array_equal(raw, recorded["value_raw"])
    assert np.array_equal(angle, (raw - 1_000_000) * recorded["scale"])
    used = mission.log.read("row")
    used = used[used["gate"][:, 0] == 0]
    start_ns = min(int(rows["host_ns"].min()) for _, rows in mission.log.batches())
    there = np.interp((used["vehicle_ns"] - start_ns) * 1e-9, time_s, angle)
    assert len(used) > 2000
    assert abs(shift_s(there - used["joint_rad"][:, 0], used["joint_rad_s"][:, 0])) < 20e-6
    with np.load(tmp_path / "imu_base.npz") as table:
        assert {"gyro_imu_base_z", "accel_imu_base_x", "gyro_raw_z"} <= set(table.files)
        steps_s = np.diff(table["time_s"][5000:])
        assert (np.abs(steps_s - 1e-3) < 3e-5).mean() > 0.999  # as its clock ticks; arrivals come by tens
    legend = (tmp_path / "README.txt").read_text()
    assert "angle of joint joint_1; zero count 1000000 is subtracted from the value" in legend
    assert "2.8 ms" in legend


def shift_s(difference: np.ndarray, rate: np.ndarray) -> float:
    """The shift in time that explains most of ``difference``."""
    return float(np.sum(difference * rate) / np.sum(rate * rate))


def test_a_phase_by_name_and_by_code(mission: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    phase = mission.log.read("arm_phase")
    changes = phase[np.flatnonzero(np.diff(phase["value_raw"], prepend=-1))]
    first = int(np.flatnonzero(changes["value_raw"] == 3)[0])
    start_ns, end_ns = int(changes["host_ns"][first]), int(changes["host_ns"][first + 1])
    dump(mission.log, tmp_path, Selection(("joint_1",), phases=("sweep 1",)), kind="npz")
    with np.load(tmp_path / "joint_1.npz") as table:
        at_ns = table["host_ns"]
    every = mission.log.read("joint_1")["host_ns"]
    assert np.array_equal(at_ns, every[(every >= start_ns) & (every < end_ns)])
    both = dump(mission.log, tmp_path / "both", Selection(("joint_1",), phases=("3",))).rows["joint_1"]
    assert both > 1.9 * len(at_ns)
    code = cli.main(["dump", str(mission.path), "--to", "csv", str(tmp_path), "--phase", "sweep 9"])
    assert code == cli.BAD_INPUT
    assert "it has phase 0, phase 1, phase 2, sweep 1" in capsys.readouterr().err


def test_a_phase_of_the_aligned_table_is_cut_out_of_the_whole(short_mission: Result, tmp_path: Path) -> None:
    log = short_mission.log
    dump_aligned(log, tmp_path / "whole", 50.0, kind="npz")
    cut = ["--aligned", "50", "--phase", "sweep 1", "--channel", "joint_1", "--channel", "load_cell"]
    assert cli.main(["dump", str(short_mission.path), "--to", "npz", str(tmp_path / "cut"), *cut]) == cli.OK
    with np.load(tmp_path / "whole" / "aligned.npz") as whole, np.load(tmp_path / "cut" / "aligned.npz") as part:
        assert "imu_base.gyro_imu_base_x" not in part
        [window] = Selection(phases=("sweep 1",)).windows(log, attached_vehicle(log)) or []
        chosen = (whole["vehicle_ns"] >= window[0]) & (whole["vehicle_ns"] < window[1])
        assert 100 < chosen.sum() < len(chosen)
        for name in ("vehicle_ns", "joint_1.value", "load_cell.value"):
            np.testing.assert_array_equal(part[name], whole[name][chosen])


def test_info_tells_clocks_delays_and_answers(
    mission: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, told = tmp_path / "clocks.png", tmp_path / "info.json"
    assert cli.main(["info", str(mission.path), "--clocks", str(picture), "--json", str(told)]) == cli.OK
    shown = capsys.readouterr().out
    assert len(shown.splitlines()) <= 50  # one screen
    about = json.loads(told.read_text())
    assert {name: clock["state"] for name, clock in about["clocks"].items()} == {
        "imu_base": "locked", "can_sync": "locked"
    }  # fmt: skip
    assert {delay["channel"] for delay in about["delays"]} >= {"imu_base", "load_cell"}
    assert len(mission.table["masses"]) == 3
    for mass in mission.table["masses"]:
        assert about["answers"][mass["quantity"]]["value"] == mass["value"]
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    for red, green, blue in ((31, 102, 176), (47, 158, 91)):  # a line, the strip of a locked clock
        assert (np.abs(pixels.astype(int) - (red, green, blue)).max(axis=1) < 8).sum() > 100


def test_what_reads_a_log_answers_in_json_alone_on_stdout(
    short_mission: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, joined = str(short_mission.path), str(tmp_path / "joined.mcap")
    found = {}
    for command in (["replay", log], ["recover", log, "-o", joined], ["info", joined]):
        assert cli.main([*command, "--json", "-"]) == cli.OK, command
        found[command[0]] = json.loads(capsys.readouterr().out)
    assert found["replay"]["identical"] is True
    assert found["recover"]["rows"]["imu_base"] == len(short_mission.log.read("imu_base"))
    assert found["info"]["answers"]["m_tip_mass"]["value"] == short_mission.mass("m_tip_mass")["value"]


def test_the_same_settings_make_the_same_answers_and_others_are_shown(
    short_mission: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings, told = tmp_path / "other.toml", tmp_path / "told.json"
    arguments = ["replay", str(short_mission.path), "--with", str(settings), "--json", str(told)]
    settings.write_text("[estimation]\nsmoothing_ms = 250\n")
    assert cli.main(arguments) == cli.OK
    same = json.loads(told.read_text())
    assert same["changes"] == []
    assert same["now"]["answers"] == same["flown"]["answers"]
    assert same["now"]["rows"] == same["flown"]["rows"]
    settings.write_text("[estimation.gates]\njoint_limits_deg = [-5.0, 5.0]\n")
    assert cli.main(arguments) == cli.OK
    other = json.loads(told.read_text())
    assert other["changes"] == [
        {"key": "estimation.gates.joint_limits_deg", "flown": "(-13.0, 13.0)", "now": "(-5.0, 5.0)"}
    ]
    assert other["now"]["rows"]["used"] < other["flown"]["rows"]["used"]
    assert other["now"]["rows"]["refused"]["contact"] > other["flown"]["rows"]["refused"]["contact"]
    assert other["flown"] == same["flown"]
    assert "estimation.gates.joint_limits_deg (-13.0, 13.0) -> (-5.0, 5.0)" in capsys.readouterr().out.replace("\n", "")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[estimation]\nsmothing_ms = 3\n", "did you mean 'smoothing_ms'"),
        ("[estimation\n", "not TOML"),
        ("[device.load_cell]\nkind = 'cia406'\n", "load_cell"),
        ("[estimation.prior.relative]\nnose = 0.1\n", "nose is none of"),
    ],
)
def test_settings_that_do_not_fit_are_told_under_their_own_name(
    short_mission: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    settings = tmp_path / "other.toml"
    settings.write_text(text)
    assert cli.main(["replay", str(short_mission.path), "--with", str(settings)]) == cli.BAD_INPUT
    error = capsys.readouterr().err
    assert said in error
    assert "other.toml" in error
    assert "Traceback" not in error
