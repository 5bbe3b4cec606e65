"""A UR5e that weighs what its flange holds by its own wrist sensor, all by RTDE; flown in virtual time."""

from pathlib import Path

from tests.flight.missions import fly

SHORT = [
    {"phase": 0, "action": "hold", "duration_s": 1.0},
    {"phase": 1, "action": "swing", "duration_s": 16.0, "swing": 0.7},
    {"phase": 9, "action": "hold", "duration_s": 0.5},
]
HELD = {"mass_kg": [2.0, 2.0], "size_mm": [100, 80, 80], "centre_of_mass_mm": [10, -15, 40]}


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
