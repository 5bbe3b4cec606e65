"""A free-flyer whose joints have encoders of 12 bits: their noise made payloads light, by up to five sigmas.

Behind the smoothing that ``heft init`` writes for them; behind one of 100 ms the mass is not determined.
"""

import json
from pathlib import Path

from onboard import cli

NEW = ("--base", "free", "--joints", "3", "--imu", "icm20948", "--encoder", "as5600")

OVER = """
[[sequence]]
phase = 1
action = "hold"
duration_s = 2.0
[[sequence]]
phase = 1
action = "swing"
duration_s = 6.0
band_Hz = [0.2, 1.0]
"""


def test_a_payload_is_as_heavy_as_it_is_said_to_be(tmp_path: Path) -> None:
    assert cli.main(["init", str(tmp_path / "it"), *NEW]) == cli.OK
    vehicle, said = tmp_path / "it" / "vehicle.toml", tmp_path / "said.json"
    over = tmp_path / "over.toml"
    over.write_text(OVER)
    flight = ["--scenario", str(over), "--seed", "2", "--log", str(tmp_path / "flight.mcap"), "--json", str(said)]
    assert cli.main(["hil", str(vehicle), *flight]) == cli.OK
    [mass] = json.loads(said.read_text())["masses"]
    assert mass["low"] < mass["truth"] < mass["high"]
    assert mass["sigma"] < 0.3 * mass["truth"]
