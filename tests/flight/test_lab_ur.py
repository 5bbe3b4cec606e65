"""A UR5e that weighs what its flange holds by its own wrist sensor, all by RTDE, or by one with a box of its own."""

import re
from pathlib import Path

import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import config
from onboard.flight import hil
from onboard.ground.identify.mission import mission_table as table
from tests.flight.missions import fly

SHORT = [
    {"phase": 0, "action": "hold", "duration_s": 1.0},
    {"phase": 1, "action": "swing", "duration_s": 11.0, "swing": 0.7},
    {"phase": 9, "action": "hold", "duration_s": 0.5},
]
HELD = {"mass_kg": [2.0, 2.0], "size_mm": [100, 80, 80], "centre_of_mass_mm": [10, -15, 40]}


@pytest.mark.campaign  # by RTDE: test_ur_arm; by a wrist sensor: test_workshop
def test_two_kilograms_are_told_within_two_per_cent(tmp_path: Path) -> None:
    """The packaged mission, shorter: the sensor's zeros are off by newtons, and its table leans."""
    run = fly(tmp_path / "arm.mcap", vehicle="lab_ur", payload=HELD, sequence=SHORT)
    assert run.table["accounted"]
    rows = {row["quantity"]: row for row in run.table["parameters"]}
    mass = rows["M_payload"]
    assert mass["truth"] == 2.0
    assert mass["low"] < 2.0 < mass["high"]
    assert abs(mass["value"] / 2.0 - 1.0) < 0.02
    assert 0.01 < mass["high"] - mass["low"] < 0.08
    told = [row for row in rows.values() if row["value"] is not None]
    assert len([row for row in told if row["quantity"].endswith("_payload")]) == 10


@pytest.mark.campaign  # weighing by a wrist sensor: test_workshop; what a line lost is counted: test_wrist_box
def test_a_sensor_with_its_own_box_weighs_as_well_and_what_its_cable_lost_is_counted(tmp_path: Path) -> None:
    """The same arm; the box by UDP, its own oscillator and rate, 0.4 s of it lost."""
    arm = tmp_path / "lab_ur"
    arm.mkdir()
    for file in config.packaged("lab_ur").parent.iterdir():
        (arm / file.name).write_bytes(file.read_bytes())
    wrench, box = 'kind = "ur_wrench"\nbus = "robot"', 'kind = "net_ft"\nbus = "box"'
    text = (arm / "vehicle.toml").read_text().replace(wrench, box)
    text = re.sub(r'(bus = "box"\ncomponent = \d\nrate_hz = )125', r"\g<1>500", text)
    (arm / "vehicle.toml").write_text(text + '\n[bus.box]\nurl = "udp://192.168.1.1:49152"\n')
    pulled = {"kind": "unplug", "device": "box", "start_s": 5.0, "end_s": 5.4}
    overrides = {"payload": HELD, "sequence": SHORT, "fault": [pulled]}
    world, urls = open_in_process(scenario_of(str(arm / "vehicle.toml"), overrides), seed=5)
    with world:
        told = table.result(hil.fly_simulated(config.load(arm / "vehicle.toml"), world, urls, tmp_path / "box.mcap"))
    assert told["accounted"]
    assert 190 < told["channels"]["fz"]["missing"] < 210
    (mass,) = (row for row in told["parameters"] if row["quantity"] == "M_payload")
    assert mass["low"] < 2.0 < mass["high"]
    assert 0.01 < mass["high"] - mass["low"] < 0.08
