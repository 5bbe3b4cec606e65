"""An arm on a bench: it weighs what its gripper holds by its wrist cell, on board and by ``heft identify``."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.identification.workshop import payload
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.body import Solid
from hil_sim.plants.vehicle_plant import VehiclePlant
from onboard import cli, config
from onboard.dynamics.model.inertia import elements
from onboard.identification.quantities import BODY
from tests.flight.missions import Result, fly

TOOL = Solid.box(0.30, (0.22, 0.05, 0.03), (0.02, 0.06, 0.01))
TRUTH = [TOOL.mass_kg, *TOOL.centre_of_mass_m, *elements(TOOL.inertia_kg_m2)]
_SWING = {"action": "swing", "swing": 0.5}
SHORT = [
    {"phase": 0, "action": "hold", "duration_s": 1.0},
    _SWING | {"phase": 1, "duration_s": 4.0},
    _SWING | {"phase": 2, "duration_s": 6.0},
    {"phase": 9, "action": "hold", "duration_s": 0.5},
]
CELLS = [f"wrist_{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz"]


def flown(directory: Path, **over: Any) -> Result:
    """The tool's mission, shorter than the packaged one."""
    over = {"sequence": SHORT} | over
    return fly(directory / "bench.mcap", vehicle="workshop", payload=payload(TOOL), **over)


def identified(run: Result, directory: Path) -> tuple[int, dict[str, Any]]:
    """Exit code, and what the JSON of ``heft identify`` says of the log."""
    report = directory / "report.json"
    code = cli.main(["identify", str(run.path), "--json", str(report)])
    return code, json.loads(report.read_text())["logs"][0]


def test_a_tool_is_weighed_on_board_and_from_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = flown(tmp_path)
    assert run.table["accounted"]
    answered_ns = np.unique(run.log.read("quantity")["host_ns"])
    assert set(np.diff(answered_ns[:-1])) == {100_000_000}  # of steps of 50 ms
    on_board = {row["quantity"]: row for key in ("masses", "centres", "inertias") for row in run.table[key]}
    code, told = identified(run, tmp_path)
    assert code == cli.OK
    assert told["verdict"]["level"] == "weak"
    assert told["verdict"]["reasons"] == ["I_xx_tool: its interval is as wide as 30% of it"]  # about its long axis
    found = {answer["name"]: answer for answer in told["quantities"] if answer["unit"]}
    assert list(found) == [f"{name}_tool" for name in BODY]
    shown = capsys.readouterr().out
    assert run.table["capture"] == {"true_s": 5.0, "said_s": [], "told": True}
    tolerance = [0.003, *[5e-4] * 3, *[5e-5] * 6]  # kg, m, kg m^2
    for (name, answer), value, close in zip(found.items(), TRUTH, tolerance, strict=True):
        for one in (answer, on_board[name]):
            assert one["supported"]
            assert abs(one["value"] - value) < close
            assert one["low"] - one["sigma"] < value < one["high"] + one["sigma"]
        assert on_board[name]["truth"] == pytest.approx(value, rel=1e-6, abs=1e-9)
        assert answer["bound"] <= answer["sigma"]
        assert name in shown


@pytest.mark.campaign  # of rows: test_suspects; of one cell: test_honesty
def test_a_cell_that_reads_three_times_too_much_weighs_nothing(tmp_path: Path) -> None:
    """The gripper was weighed: it cannot be three times as heavy."""
    wrong = [{"kind": "wrong", "device": name, "value": 2.0, "start_s": 0.0} for name in CELLS]
    first, empty, held, last = SHORT
    shorter = [first, empty | {"duration_s": 4.0}, held | {"duration_s": 4.0}, last]
    run = flown(tmp_path, fault=wrong, sequence=shorter)
    code, told = identified(run, tmp_path)
    assert code == cli.FAILED
    assert told["verdict"]["level"] == "do not use"
    assert "all cells is farther from what is stated than any error that is estimated" in told["verdict"]["text"]
    assert not any(answer["supported"] for answer in told["quantities"] if answer["unit"])
    assert not any(row["supported"] for row in run.table["masses"])


def test_at_rest_the_wrist_carries_the_weight_where_it_is() -> None:
    """Force and moment of gripper and tool about the cell's frame, by hand, in its axes."""
    exact = {"mass_relative": 0.0, "centre_mm": 0.0, "inertia_relative": 0.0}
    still = [{"phase": phase, "action": "hold", "duration_s": 0.5} for phase in (1, 2)]
    over = {"as_built": {"gripper": exact}, "payload": payload(TOOL), "sequence": still}
    upright = {"posture": dict.fromkeys([f"joint_{k}" for k in range(1, 6)], 0.0), "posture_spread": 0.0}
    scenario = scenario_of("workshop", {**over, "motion": upright})
    plant = VehiclePlant(scenario, np.random.default_rng(1))
    g = 9.80665
    gripper, mass = np.array([0.003, -0.002, 0.040]), 0.45  # workshop.urdf
    alone = np.cross(gripper, [0, 0, mass * g])
    held = alone + np.cross(TOOL.centre_of_mass_m + np.array([0.0, 0.0, 0.120]), [0, 0, TOOL.mass_kg * g])
    force = plant.force_n("wrist")
    moment = np.stack([plant.moment_n_m("wrist", axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))], 1)
    np.testing.assert_allclose(force[100], [0, 0, mass * g], atol=1e-9)
    np.testing.assert_allclose(force[-100], [0, 0, (mass + TOOL.mass_kg) * g], atol=1e-9)
    np.testing.assert_allclose(moment[100], alone, atol=1e-9)
    np.testing.assert_allclose(moment[-100], held, atol=1e-9)


def test_a_base_that_moves_needs_an_imu(tmp_path: Path) -> None:
    text = config.packaged("workshop").read_text().replace('base = "fixed"', 'base = "free"')
    (tmp_path / "vehicle.toml").write_text(text)
    with pytest.raises(config.ConfigError, match="no device is an IMU"):
        config.load(tmp_path / "vehicle.toml")
