"""``heft mechanics`` from the command line: tables, JSON, figures, and input that cannot be used."""

import json

import numpy as np
import pytest

from onboard import cli

AT = ["--at", "joint_2=34.4", "--at", "joint_4=45.8"]


def test_tables_json_and_figures(tmp_path, capsys):
    path = tmp_path / "found.json"
    asked = ["--line=-0.06,0.08,-0.05", "--seconds", "2", "--map", "joint_2", "joint_4", "--turn=1,-2,3"]
    code = cli.main(["mechanics", "dymaflex", *AT, *asked, "--json", str(path), "--figures", str(tmp_path)])
    shown = capsys.readouterr().out
    assert code == cli.OK
    found = json.loads(path.read_text())
    assert found["mass_kg"] == pytest.approx(26.499)
    assert np.shape(found["generalized_jacobian"]) == (6, 5)
    assert found["line"]["error_m"] < 1e-5
    assert found["turn"]["error_rad"] < 1e-4
    low, high = found["workspace"]["reachable_m"]
    assert 0.0 < low < high < 1.0
    assert found["workspace"]["path_dependent_m"]
    assert found["base_parameters"]["free"] == "45 = 10 + 7 x 5"
    assert "virtual manipulator" in shown
    drawn = sorted(tmp_path.glob("*.svg"))
    assert [one.name for one in drawn] == ["dymaflex_line.svg", "dymaflex_workspace.svg"]
    assert all(one.stat().st_size > 5000 for one in drawn)


def test_a_line_that_the_tip_leaves_is_a_failure(tmp_path, capsys):
    """With the arm stretched out the tip ends 9 mm off: the numbers are shown, and are no result."""
    path = tmp_path / "found.json"
    assert cli.main(["mechanics", "dymaflex", "--line=-0.06,0.08,-0.05", "--json", str(path)]) == cli.FAILED
    said = capsys.readouterr()
    assert "cannot follow this line: it is up to 9.2 mm off" in said.err
    assert "within 9.2 mm" in said.out
    assert json.loads(path.read_text())["line"]["error_m"] > 5e-3


def test_80_columns_are_enough(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["mechanics", "dymaflex", *AT]) == cli.OK
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["dymaflex", "--tip", "nowhere"], "no link, joint or frame 'nowhere'"),
        (["dymaflex", "--tip", "imu_base"], "fixed in the base"),
        (["dymaflex", "--at", "joint_9=1"], "no moving joint 'joint_9'"),
        (["dymaflex", "--at", "joint_1"], "write JOINT=DEGREES"),
        (["dymaflex", "--at", "joint_1=nan"], "write JOINT=DEGREES"),
        (["dymaflex", "--line", "1,2"], "write three numbers"),
        (["dymaflex", "--line=inf,0,0"], "write three numbers"),
        (["dymaflex", "--line=0.1,0,0", "--seconds", "0"], "give a positive number"),
        (["dymaflex", "--turn=300,0,0"], "shorter than pi"),
        (["dymaflex", "--map", "joint_1", "joint_1"], "name two joints"),
        (["tudelft"], "name the tip with --tip"),
    ],
)
def test_bad_input_is_refused_with_the_remedy(arguments, message, capsys):
    assert cli.main(["mechanics", *arguments]) == cli.BAD_INPUT
    assert message in capsys.readouterr().err
