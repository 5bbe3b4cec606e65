"""An arm on a bench: a log of its encoders and wrist cell, the truth MuJoCo's, through ``heft identify``."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.records import SCALAR, Rows
from hil_sim.plants import fixed_arm
from hil_sim.plants.free_flyer import Body, JointMotion
from onboard import cli, config
from onboard.recording.writer import LogWriter

TOOL = Body.box(0.30, (0.22, 0.05, 0.03), (0.02, 0.06, 0.01))
GRASP_S, END_S = 4.0, 16.0
AXES = [f"wrist_{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz"]


def rows(time_s: np.ndarray, values: np.ndarray, scale: float, unit: bytes) -> Rows:
    made = np.zeros(len(time_s), SCALAR)
    made["sequence"], made["host_ns"] = np.arange(len(time_s)), np.rint(1e9 * (10.0 + time_s))
    made["value_raw"], made["scale"], made["unit"] = np.rint(values / scale), scale, unit
    return made


def write(path: Path, rng: np.random.Generator) -> Path:
    flown = fixed_arm.run(TOOL, JointMotion.draw(rng, 0.5), GRASP_S, END_S)
    read = fixed_arm.read(flown, fixed_arm.WristErrors(), rng)
    told_s = np.arange(0.0, END_S, 0.1)
    channels = {f"joint_{k + 1}": rows(read.time_s, read.angle_rad[:, k], 1e-7, b"rad") for k in range(5)}
    channels |= {
        name: rows(read.time_s, read.wrench[:, k], 1e-6, b"N" if k < 3 else b"N m") for k, name in enumerate(AXES)
    }
    channels["phase"] = rows(told_s, np.where(told_s < GRASP_S, 1.0, 2.0), 1.0, b"1")
    with LogWriter.create(path, durable=False, overwrite=True) as writer:
        for name, batch in channels.items():
            writer.register(name, SCALAR)
            writer.write(name, batch)
    return path


def test_a_tool_is_weighed_from_a_log(tmp_path: Path, rng: np.random.Generator) -> None:
    log, report = write(tmp_path / "bench.mcap", rng), tmp_path / "report.json"
    assert cli.main(["identify", "--vehicle", "workshop", str(log), "--json", str(report)]) == cli.OK
    told = json.loads(report.read_text())["logs"][0]
    found = {answer["name"]: answer for answer in told["quantities"]}
    first = zip(("MX_tool", "MY_tool", "MZ_tool"), TOOL.mass_kg * TOOL.centre_of_mass_m, strict=True)
    truth = {"M_tool": TOOL.mass_kg, **dict(first)}
    for name, value in truth.items():
        assert found[name]["supported"]
        assert abs(found[name]["value"] - value) < (0.003 if name == "M_tool" else 3e-4)
        assert found[name]["low"] - found[name]["sigma"] < value < found[name]["high"] + found[name]["sigma"]


def test_a_base_that_moves_needs_an_imu(tmp_path: Path) -> None:
    text = config.packaged("workshop").read_text().replace('base = "fixed"', 'base = "free"')
    (tmp_path / "vehicle.toml").write_text(text)
    with pytest.raises(config.ConfigError, match="no device is an IMU"):
        config.load(tmp_path / "vehicle.toml")
