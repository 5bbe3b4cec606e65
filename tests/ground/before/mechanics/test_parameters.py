"""``heft identify --parameters``: the groupings of a vehicle file, for people and for programs."""

import json
from pathlib import Path

import pytest

from onboard import cli


def test_a_free_flyers_groupings_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    report = tmp_path / "parameters.json"
    vehicle = ["--vehicle", "dymaflex_parabolic", "--parameters"]
    assert cli.main(["identify", *vehicle, "--json", str(report)]) == cli.OK
    said = " ".join(capsys.readouterr().out.split())
    assert "55 base parameters of 70 standard ones" in said
    assert "XX0R = XX0 + YY1 + 2 L1 MZ1 + M1 L1^2 + (M2 + M3 + M4 + M5) (L1 + L2)^2" in said
    assert "L3 = 0.26 m to joint_3, along z" in said
    read = json.loads(report.read_text())
    assert len(read["base_parameters"]) == 55
    assert "free base wrench 45 = 10 + 7 x 5 45" in said
    assert [(one["base"], one["closed_form"]["parameters"], one["numerical"]) for one in read["counts"]] == [
        *(("fixed", 29, 29), ("free", 45, 45), ("planar", 34, 34))
    ]
    grouping = {"name": "MY_link_1_R", "short": "MY1R", "grouping": "MY1 + MY2"}
    assert grouping in read["base_parameters"]


def test_a_prescribed_base_shows_what_its_own_rows_tell(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["identify", "--vehicle", "rocksat", "--parameters"]) == cli.OK
    said = capsys.readouterr().out
    assert "rows: load_cell" in said
    assert "links: 0 plate, 1 arm, tip_mass" in said


def test_neither_a_log_nor_parameters(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["identify", "--vehicle", "rocksat"]) == cli.BAD_INPUT
    assert "no log to identify from" in capsys.readouterr().err
    assert cli.main(["identify", "--vehicle", "rocksat", "--parameters", "a.mcap"]) == cli.BAD_INPUT
    assert "leave the logs out" in capsys.readouterr().err


def test_a_bench_without_inertia_has_no_count_in_flight(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["identify", "--vehicle", "workshop", "--parameters"]) == cli.OK
    said = " ".join(capsys.readouterr().out.split())
    assert "fixed joint torques 29 = 7 x 5 - 4 x 1 - 2 29" in said
    assert "base wrench" not in said
