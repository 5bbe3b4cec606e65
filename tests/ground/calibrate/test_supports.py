"""A part on knife edges, two scales or three supports: what is found, what is refused, what is written."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import Mission
from hil_sim.plants import bench
from hil_sim.plants.body import Solid
from onboard.cli import BAD_INPUT, FAILED, OK, main
from onboard.cli.common import load_vehicle
from onboard.estimation.errors import CalibrationError
from onboard.ground.calibrate.supports import KnifeEdge, PartRig, Scales, balance_part

PAGE = (Path(__file__).parents[3] / "docs" / "calibration.md").read_text(encoding="utf-8")
RIGS = re.findall(r"```toml\n(.*?)```", PAGE.split("## A part")[1], re.S)
BODY = Solid(0.0667, np.array([0.0008, -0.0131, -0.0007]), np.diag([6e-6, 4.4e-6, 6e-6]))
Z, X = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
EDGES = [
    {"up": Z, "edge": (0.0, 1.0, 0.0), "point_m": (0.0, 0.0, -0.02)},
    {"up": Z, "edge": X, "point_m": (0.0, 0.0, -0.02)},
    {"up": X, "edge": (0.0, 1.0, 0.0), "point_m": (-0.02, 0.0, 0.0)},
]
SCALES = [
    {"up": Z, "supports_m": [(-0.05, -0.04, -0.02), (0.05, -0.04, -0.02), (0.0, 0.03, -0.02)], "read_kg": None},
    {"up": X, "supports_m": [(-0.02, -0.014, -0.05), (-0.02, -0.014, 0.05)], "read_kg": None},
]
SIGMAS = {"place_sigma_m": 1e-4, "read_sigma_kg": 2e-5, "scale_relative": 3e-4}


@pytest.fixture(scope="module")
def rocksat():
    return load_vehicle("rocksat")


def read(seed, edges=(), scales=(), body=BODY, **others):
    """A rig with what the simulated supports read."""
    rig = SIGMAS | others
    found = bench.part(np.random.default_rng(seed), body, rig | {"edge": list(edges), "scales": list(scales)})
    return PartRig(
        edge=[KnifeEdge(**one) for one in found["edge"]], scales=[Scales(**one) for one in found["scales"]], **rig
    )


def numbers(found):
    return {one.name: one for one in found.found}


@pytest.mark.parametrize("rig", [{"edges": EDGES}, {"scales": SCALES}, {"edges": EDGES[1:], "scales": SCALES}])
def test_the_centre_lies_in_its_sigmas(rocksat, rig):
    off = []
    for seed in range(40):
        found = numbers(balance_part(rocksat, "tip_mass", read(seed, **rig)))
        for axis, true in zip("xyz", BODY.centre_of_mass_m, strict=True):
            one = found[f"centre of mass of tip_mass {axis}"]
            assert one.sigma < 2e-4
            off.append((one.value - true) / one.sigma)
        if "scales" in rig:
            off.append((found["mass of tip_mass"].value - BODY.mass_kg) / found["mass of tip_mass"].sigma)
    assert np.mean(np.abs(off) < 1.96) > 0.93
    assert 0.4 < np.std(off) < 1.1  # places are met to half of what is stated


def test_what_is_not_measured_stays_the_drawings(rocksat):
    found = balance_part(rocksat, "tip_mass", read(1, EDGES[:1]))
    one = numbers(found)
    assert one["centre of mass of tip_mass x"].sigma == pytest.approx(1e-4)
    assert one["centre of mass of tip_mass y"].value == pytest.approx(-0.01391)
    assert one["centre of mass of tip_mass y"].sigma == pytest.approx(0.00115)
    changes = {change.key: change.value for change in found.changes}
    assert changes["centre_m"] == pytest.approx(0.0012, abs=1e-4)
    assert "mass_kg" not in changes
    assert any(note.startswith("y, z of the centre was not measured") for note in found.notes)


@pytest.mark.parametrize(
    ("rig", "said"),
    [
        (lambda: read(1, [{**EDGES[0], "edge": Z}]), r"edge 1: the edge is to be level"),
        (
            lambda: read(1, EDGES).model_copy(update={"edge": [KnifeEdge(up=Z, edge=X, point_m=(0.0, 13.9, 0.0))]}),
            "unit",
        ),
        (
            lambda: read(1, EDGES).model_copy(update={"edge": [KnifeEdge(up=Z, edge=X, point_m=(0.0, 0.0139, 0.0))]}),
            "sign",
        ),
        (
            lambda: read(1, EDGES).model_copy(update={"edge": [KnifeEdge(up=(0, 0, 0), edge=X, point_m=Z)]}),
            "no direction",
        ),
        (lambda: PartRig(scales=[Scales(**SCALES[0])]), "scales 1: give read_kg"),
        (lambda: PartRig(scales=[Scales(**SCALES[1] | {"read_kg": [-0.05, -0.02]})]), "tare it"),
        (lambda: PartRig(scales=[Scales(**SCALES[1] | {"supports_m": [X, (0.5, 0, 0)], "read_kg": [1, 1]})]), "above"),
        (
            lambda: PartRig(edge=[KnifeEdge(**EDGES[1])] * 2 + [KnifeEdge(up=Z, edge=X, point_m=(0, -0.012, 0))]),
            "edge 3 contra",
        ),
    ],
)
def test_what_contradicts_is_refused(rocksat, rig, said):
    with pytest.raises(CalibrationError, match=said):
        balance_part(rocksat, "tip_mass", rig())


def test_two_weighings_of_different_parts_are_refused(rocksat):
    one, other = read(1, scales=SCALES[:1]), read(2, scales=SCALES[1:], body=replace(BODY, mass_kg=0.07))
    rig = one.model_copy(update={"scales": [*one.scales, *other.scales]})
    with pytest.raises(CalibrationError, match=r"scales \d weighs 0\.\d+ kg, all together"):
        balance_part(rocksat, "tip_mass", rig)


@pytest.mark.parametrize(("rig", "keys"), [(0, 3), (1, 5)])
def test_the_rigs_of_the_page_on_the_part_that_flies(tmp_path, monkeypatch, rig, keys):
    monkeypatch.chdir(tmp_path)
    Path("part.toml").write_text(RIGS[rig], encoding="utf-8")
    assert main(["init", "mine", "--from", "rocksat"]) == OK
    command = "calibrate balance mine/vehicle.toml --link tip_mass --rig part.toml --hil --seed 4 --json found.json"
    assert main(command.split()) == OK
    told = json.loads(Path("found.json").read_text(encoding="utf-8"))
    assert len(told["changes"]) == keys
    true = Mission(scenario_of("rocksat"), 4).plant.payload
    found = {one["name"]: one for one in told["found"]}
    for axis, value in zip("xyz", true.centre_of_mass_m, strict=True):
        one = found[f"centre of mass of tip_mass {axis}"]
        assert abs(one["value"] - value) < 4.0 * one["sigma"]
    again = load_vehicle("mine/vehicle.toml")
    assert again.file.estimation.masses.drawing["tip_mass"].centre_m < 3e-4
    assert again.file.link["tip_mass"].centre_of_mass_m is not None
    assert main(command.split()) == OK  # again, from the file that it wrote: nothing is counted twice
    twice = json.loads(Path("found.json").read_text(encoding="utf-8"))
    assert [one["sigma"] for one in twice["found"]] == [one["sigma"] for one in told["found"]]


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        ("", BAD_INPUT, "say which by --link"),
        ("--link tip", BAD_INPUT, "no link 'tip' with inertia"),
        ("--link [b]tip", BAD_INPUT, "no link '[b]tip' with inertia"),
        ("--link tip_mass --at 1-2", BAD_INPUT, "--at"),
        ("--link tip_mass", FAILED, "from its drawing"),
    ],
)
def test_options_that_do_not_fit(tmp_path, monkeypatch, capsys, options, code, said):
    monkeypatch.chdir(tmp_path)
    Path("part.toml").write_text(RIGS[0], encoding="utf-8")
    main(["init", "mine", "--from", "rocksat"])
    before = Path("mine/vehicle.toml").read_text(encoding="utf-8")
    assert main(["calibrate", "balance", "mine/vehicle.toml", "--rig", "part.toml", *options.split()]) == code
    assert said in " ".join(capsys.readouterr().err.split())
    assert Path("mine/vehicle.toml").read_text(encoding="utf-8") == before
