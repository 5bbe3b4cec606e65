"""``--fit-drawing``: the arm's links as one recording found them, for others; gains that differ between recordings."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard import cli, config
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_jacobian, body_of, standard_of
from onboard.flight.estimate.problem.model import build_model
from onboard.identification.rows.fitted_drawing import fitted_drawing
from onboard.identification.rows.standard import Posterior, link_estimate
from tests.dynamics.mujoco_twin import random_vehicle, to_urdf
from tests.flight import test_recorded_arm as bench

LINKS = ("base", "link_1", "tool")
LOAD_kg = 1.4  # of the second pair of recordings


def body_covariance(body: RigidBody, one: Any) -> np.ndarray:
    """What a vehicle file states of a link, (10, 10), of its standard parameters."""
    half_trace = 0.5 * np.trace(body.inertia_kg_m2)
    sigma = np.array([one.mass_relative * body.mass_kg, *[one.centre_m] * 3, *[one.inertia_relative * half_trace] * 6])
    back = np.linalg.inv(body_jacobian(standard_of(body)))
    return back @ np.diag(sigma**2) @ back.T


def test_nothing_is_stated_to_be_known_better_than_it_was_found(rng: np.random.Generator) -> None:
    """Correlated errors of two links; the third is not estimated, and stays as it is."""
    for _ in range(5):
        bodies = [
            RigidBody(float(rng.uniform(1, 9)), rng.uniform(-0.2, 0.2, 3), np.diag(rng.uniform(0.05, 0.06, 3)))
            for _ in LINKS
        ]
        mean = np.concatenate([standard_of(body) for body in bodies])
        root = rng.normal(size=(30, 12)) * 0.01 * np.abs(mean).max()
        P = root @ root.T
        links = [
            link_estimate(LINKS[k], mean[10 * k : 10 * k + 10], P[10 * k : 10 * k + 10, 10 * k : 10 * k + 10])
            for k in (1, 2)
        ]
        made = fitted_drawing(LINKS, Posterior(mean, P, LINKS[1:], np.eye(len(mean))), links)
        assert [one.link for one in made] == ["link_1", "tool"]
        D = np.zeros((20, 20))
        for k, one in enumerate(made):
            D[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = body_covariance(one.body, one)
        unit = np.sqrt(np.diag(D))
        least = np.linalg.eigvalsh((D - P[10:, 10:]) / np.outer(unit, unit))[0]
        assert least > -1e-9
        tight = np.linalg.eigvalsh((0.9 * D - P[10:, 10:]) / np.outer(unit, unit))[0]
        assert tight < 0.0  # and not much worse


def recordings(root: Path, seed: int, load_kg: float, warmer: float = 1.0) -> str:
    """An empty and a loaded recording of the laboratory's arm as one log; one gain differs by ``warmer``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "END_s", 12.0)
        patch.setattr(bench, "LOAD_kg", load_kg)
        links, rng = arm(), np.random.default_rng(seed)
        for name, of, gains in (
            ("empty", links, np.ones(3)),
            ("loaded", bench.with_load(links), np.array([1, warmer, 1])),
        ):
            path = bench.write_csv(root / f"{name}_{seed}.csv", bench.moved(of, rng), 3.0, gains)
            assert cli.main(["import", str(root / "v" / "import.toml"), str(path), "-o", str(root / "logs")]) == cli.OK
    logs = [str(root / "logs" / f"{name}_{seed}.mcap") for name in ("empty", "loaded", "both")]
    assert cli.main(["merge", "--in-turn", "recording", *logs[:2], "-o", logs[2]]) == cli.OK
    return logs[2]


def arm() -> list:
    return random_vehicle(np.random.default_rng(20261122), ["revolute"] * 3)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``v/`` by heft init of a URDF whose masses are 20 and 30 % off."""
    root = tmp_path_factory.mktemp("fitted")
    links = arm()
    plan = [
        links[0],
        *(bench.replace(one, mass=k * one.mass) for one, k in zip(links[1:], (1.2, 0.7, 1.2), strict=True)),
    ]
    (root / "arm.urdf").write_text(to_urdf(plan).replace('effort="1"', 'effort="60"'))
    made = ["init", str(root / "v"), "--base", "fixed", "--urdf", str(root / "arm.urdf"), "--encoder", "recorded"]
    assert cli.main(made) == cli.OK
    mapping = (root / "v" / "import.toml").read_text().replace('column = "t"', 'column = "time"')
    mapping = re.sub(r'column = "joint_link_(\d)_torque"', r'column = "tau\1"', mapping)
    (root / "v" / "import.toml").write_text(re.sub(r'column = "joint_link_(\d)"', r'column = "q\1"', mapping))
    text = (root / "v" / "vehicle.toml").read_text().replace("# smoothing_ms = 100", "smoothing_ms = 100")
    text = text.replace(
        "[estimation]\n", "[estimation]\nlevel_sigma_rad = 0  # it was levelled: else link_1 is not told\n"
    )
    text += f"\n[link.link_2]\nmass_kg = {0.7 * links[2].mass}  # in place of the URDF's\n"
    (root / "v" / "vehicle.toml").write_text(text)
    return root


def identified(root: Path, vehicle: Path, log: str, *more: str) -> tuple[int, dict[str, Any]]:
    told = root / "told.json"
    code = cli.main(["identify", "--vehicle", str(vehicle), log, "--json", str(told), *more])
    return code, json.loads(told.read_text())["logs"][0]


def mass_of(told: dict[str, Any]) -> dict[str, Any]:
    return next(one for one in told["quantities"] if one["name"] == "m_payload")


@pytest.fixture(scope="module")
def fitted(lab: Path) -> Path:
    code, told = identified(lab, lab / "v" / "vehicle.toml", recordings(lab, 1, 2.7), "--fit-drawing", str(lab / "f"))
    assert code == cli.OK
    assert [one["link"] for one in told["drawing"]] == ["link_1", "link_2", "link_3"]  # not what is held
    return lab / "f" / "vehicle.toml"


def test_the_fitted_drawing_serves_another_recording_of_the_arm(lab: Path, fitted: Path) -> None:
    vehicle, drawn = config.load(fitted), config.load(lab / "v" / "vehicle.toml")
    text = fitted.read_text()
    assert text.startswith(
        '# Links as estimated by heft identify from "both_1.mcap": by this file that log counts twice.'
    )
    assert "link_2" not in vehicle.file.link  # it would stand in place of the URDF's
    prior = vehicle.file.estimation.prior
    assert prior.link["base"] == drawn.file.estimation.prior.link["base"]
    assert prior.relative == {"payload": 1.0}
    told = identified(lab, fitted, recordings(lab, 2, LOAD_kg))[1]
    mass = mass_of(told)
    assert mass["supported"]
    assert mass["low"] <= LOAD_kg <= mass["high"]
    assert "contradict" not in told["verdict"]["text"]
    model, links = build_model(vehicle), {one.name: one for one in arm()}
    for name in ("link_1", "link_2", "link_3"):
        first = 10 * model.links.index(name)
        body, sigma = body_of(model.chi[first : first + 10]), prior.link[name]
        assert abs(body.mass_kg / links[name].mass - 1.0) < 3.0 * sigma.mass_relative
        assert np.abs(body.centre_of_mass_m - links[name].com).max() < 3.0 * sigma.centre_m
        assert sigma.mass_relative < 0.3  # as it was stated


def test_what_is_no_fitted_drawing_is_refused(lab: Path, fitted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = str(lab / "logs" / "both_1.mcap")
    for vehicle, logs, said in (
        (str(fitted), [log], "is there already"),
        (str(fitted), [log, log], "fitted to a single log"),
        ("tudelft", [log], "links of an arm"),
        ("dymaflex", [log], "links of an arm"),
        ("rocksat", [log], "[estimation.masses]"),
    ):
        assert cli.main(["identify", "--vehicle", vehicle, *logs, "--fit-drawing", str(fitted.parent)]) == cli.BAD_INPUT
        assert said in capsys.readouterr().err


def test_a_gain_that_differs_between_recordings_as_stated_is_in_the_interval(lab: Path, fitted: Path) -> None:
    log = recordings(lab, 3, LOAD_kg, warmer=1.06)
    stated = fitted.with_name("warm.toml")
    line = "still_rad_s = 0.02 "
    stated.write_text(fitted.read_text().replace(line, f"between_recordings_sigma = 0.04\n{line}"))
    silent, told = (identified(lab, vehicle, log)[1] for vehicle in (fitted, stated))
    assert "have changed between the recordings" in silent["verdict"]["text"]
    assert re.search(
        r"recording with the payload, from \S+ s on, reads .*joint_link_2_torque \+6%", told["verdict"]["text"]
    )
    assert "within what is stated between recordings" in told["verdict"]["text"]
    mass = mass_of(told)
    assert mass["supported"]
    assert mass["low"] <= LOAD_kg <= mass["high"]
    assert any("between_recordings_sigma" in part["cause"] for part in told["budget"]["m_payload"])
