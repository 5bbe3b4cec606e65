"""One parabola end to end: let go by hand, bumped, caught; cut out of the log by itself and identified."""

import json
from pathlib import Path

import pytest

from onboard.cli import main

SHORT = """
payload.mass_kg = [3.0, 3.0]
[parabolas]
strapped = false
pull_s = 1.5
change_s = 0.5
low_s = 12.0
release_s = [2.0, 2.4]
motion_at_s = 3.2
motion_s = 6.0
catch_s = [9.8, 10.2]
early = 0.0
bumps = 1.0
tip_m_s = [0.05, 0.1, 0.4]
strokes = [1, 1, 1]
[[parabolas.run]]
joints = "both"
speed = "fast"
"""


def test_a_run_is_cut_out_of_the_log_and_identified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    over, log, report = tmp_path / "over.toml", tmp_path / "log.mcap", tmp_path / "result.json"
    over.write_text(SHORT)
    asked = ["--scenario", str(over), "--seed", "3", "--log", str(log), "--json", str(report)]
    main(["hil", "parabolic", *asked])
    shown = capsys.readouterr().out
    result = json.loads(report.read_text())
    assert result["accounted"]
    (run,) = result["runs"]
    assert run["flown"] == "fast both"
    assert run["release_late_s"] == pytest.approx(0.0, abs=0.15)
    assert run["catch_early_s"] == pytest.approx(0.0, abs=0.25)
    assert len(run["bumps_s"]) == run["true_bumps"] == 1
    assert run["state"] != "refused", run["reason"]
    assert "fast both" in shown
    (mass,) = result["masses"]
    if mass["supported"]:
        assert abs(mass["value"] - mass["truth"]) < 3.3 * mass["sigma"]


def test_a_campaign_is_flown_in_virtual_time_only(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hil", "parabolic", "--campaign", "day1", "--realtime"]) == 2
    assert "--campaign flies its schedule in virtual time" in capsys.readouterr().err
    assert main(["hil", "capture", "--campaign", "day1"]) == 2
    assert "parabolic has day1, day2" in capsys.readouterr().err
