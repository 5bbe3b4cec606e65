"""A body without joints on a table: what its thrusters and its tracked pose tell, and what they do not let pass."""

import json

import pytest

from onboard.cli import OK, main
from tests.offline.estimate_again.floating_bed import THRUSTERS, fly, write

STATED = {
    "# mass_sigma": "mass_sigma",
    "scale_sigma = 0.05 ": "scale_sigma = 0.02 ",
    "position_noise_m = 5e-4": "position_noise_m = 3e-4",
    "yaw_noise_rad = 1e-3": "yaw_noise_rad = 6e-4",
}


def identified(directory, bed, stated=STATED):
    """The answers of ``heft identify`` by the files that ``heft init`` writes, as JSON."""
    write(bed, directory)
    lab, names = directory / "lab", ",".join(THRUSTERS)
    urdf = ["--urdf", str(directory / "body.urdf"), "--marker", "marker"]
    assert main(["init", str(lab), "--base", "planar", *urdf, "--thrusters", names, "--force", "0.6"]) == OK
    text = (lab / "vehicle.toml").read_text()
    for old, new in stated.items():
        assert old in text
        text = text.replace(old, new)
    (lab / "vehicle.toml").write_text(text)
    assert main(["import", str(lab / "import.toml"), str(directory / "run.csv"), "-o", str(directory / "logs")]) == OK
    out = directory / "told.json"
    code = main(
        ["identify", "--vehicle", str(lab / "vehicle.toml"), str(directory / "logs" / "run.mcap"), "--json", str(out)]
    )
    told = json.loads(out.read_text())["logs"][0]
    assert (code == OK) == (told["verdict"]["level"] != "do not use")
    return told


def test_mass_centre_and_inertia_are_told(tmp_path):
    bed = fly(51)
    told = identified(tmp_path, bed)
    assert told["verdict"]["level"] == "good", told["verdict"]
    found = {one["name"]: one for one in told["quantities"]}
    assert found["I_zz"]["value"] == pytest.approx(bed.inertia_kg_m2, rel=0.03)
    for name, true in bed.truth.items():
        assert abs(found[name]["value"] - true) < 3.0 * found[name]["sigma"], name
    assert found["I_zz"]["sigma"] < 0.01 * bed.inertia_kg_m2
