"""An arm on a bench: a log of its encoders and wrist cell, the truth MuJoCo's, through ``heft identify``."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.identification.workshop import write
from hil_sim.plants import fixed_arm
from hil_sim.plants.free_flyer import Body, JointMotion
from onboard import cli, config
from onboard.dynamics.inertia import elements
from onboard.identification.quantities import BODY

TOOL = Body.box(0.30, (0.22, 0.05, 0.03), (0.02, 0.06, 0.01))
GRASP_S, END_S = 4.0, 16.0


def readings(rng: np.random.Generator) -> fixed_arm.Readings:
    flown = fixed_arm.run(TOOL, JointMotion.draw(rng, 0.5), GRASP_S, END_S)
    return fixed_arm.read(flown, fixed_arm.WristErrors(), rng)


def weigh(directory: Path, read: fixed_arm.Readings) -> tuple[int, dict[str, Any]]:
    """Exit code, and what the JSON says of the one log."""
    log, report = write(directory / "bench.mcap", read, GRASP_S), directory / "report.json"
    code = cli.main(["identify", "--vehicle", "workshop", str(log), "--json", str(report)])
    return code, json.loads(report.read_text())["logs"][0]


def test_a_tool_is_weighed_from_a_log(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    code, told = weigh(tmp_path, readings(rng))
    assert code == cli.OK
    assert told["verdict"]["level"] == "good"
    found = {answer["name"]: answer for answer in told["quantities"] if answer["unit"]}
    truth = [TOOL.mass_kg, *TOOL.centre_of_mass_m, *elements(TOOL.inertia_kg_m2)]
    tolerance = [0.003, *[5e-4] * 3, *[5e-5] * 6]  # kg, m, kg m^2
    assert list(found) == [f"{name}_tool" for name in BODY]
    shown = capsys.readouterr().out
    for (name, answer), value, close in zip(found.items(), truth, tolerance, strict=True):
        assert answer["supported"]
        assert abs(answer["value"] - value) < close
        assert answer["low"] - answer["sigma"] < value < answer["high"] + answer["sigma"]
        assert answer["bound"] <= answer["sigma"]
        assert name in shown


def test_a_cell_that_reads_three_times_too_much_weighs_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    """The gripper was weighed: it cannot be three times as heavy."""
    read = readings(rng)
    code, told = weigh(tmp_path, read._replace(wrench=3.0 * read.wrench))
    assert code == cli.FAILED
    assert told["verdict"]["level"] == "do not use"
    assert "contradict what was known" in told["verdict"]["text"]
    assert not any(answer["supported"] for answer in told["quantities"] if answer["unit"])


def test_a_base_that_moves_needs_an_imu(tmp_path: Path) -> None:
    text = config.packaged("workshop").read_text().replace('base = "fixed"', 'base = "free"')
    (tmp_path / "vehicle.toml").write_text(text)
    with pytest.raises(config.ConfigError, match="no device is an IMU"):
        config.load(tmp_path / "vehicle.toml")
