"""A free-flyer whose joints have encoders of 12 bits: their noise made payloads light, by up to five sigmas."""

import json
from pathlib import Path

from onboard import cli

NEW = ("--base", "free", "--joints", "4", "--imu", "icm20948", "--encoder", "as5600")


def test_a_payload_is_as_heavy_as_it_is_said_to_be(tmp_path: Path) -> None:
    assert cli.main(["init", str(tmp_path / "it"), *NEW]) == cli.OK
    vehicle, said = tmp_path / "it" / "vehicle.toml", tmp_path / "said.json"
    flight = ["--seed", "10", "--log", str(tmp_path / "flight.mcap"), "--json", str(said)]
    assert cli.main(["hil", str(vehicle), *flight]) == cli.OK
    [mass] = json.loads(said.read_text())["masses"]
    assert mass["low"] < mass["truth"] < mass["high"]
    assert mass["sigma"] < 0.3 * mass["truth"]
