"""The free-flyer's wheels hold its attitude while it identifies what it caught: from bus bytes to the answer."""

import numpy as np
import pytest

from onboard import config
from onboard.flight.estimate.identification import build_exiddm
from onboard.offline.estimate_again.replay import replay
from tests.flight.missions import Result, fly
from tests.flight.test_dymaflex import SHORT

WHEELS = ("wheel_x", "wheel_y", "wheel_z")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return fly(tmp_path_factory.mktemp("wheels") / "flight.mcap", 21002, vehicle="dymaflex_wheels", **SHORT)


def test_every_sample_is_accounted_for_and_the_wheels_turn(flown: Result) -> None:
    assert flown.table["accounted"], flown.table["channels"]
    assert set(flown.table["channels"]) == set(config.load(config.packaged("dymaflex_wheels")).channels)
    for name in WHEELS:
        rows = flown.log.read(name)
        assert len(rows) == pytest.approx(500 * flown.flown.truth["duration_s"], rel=0.02)
        speed = rows["value_raw"] * rows["scale"]
        assert np.ptp(speed) > 5.0
        assert set(rows["unit"]) == {b"rad/s"}


def test_the_answer_holds_the_truth(flown: Result) -> None:
    assert len(flown.table["capture"]["said_s"]) == 1
    answers = [*flown.table["masses"], *flown.table["centres"], *flown.table["inertias"]]
    supported = [row for row in answers if row["supported"]]
    assert len(supported) >= 7
    assert sum(row["covered"] for row in supported) >= len(supported) - 1


def test_replay_gives_the_onboard_estimates_to_the_bit(flown: Result) -> None:
    found = replay(flown.path)
    assert found.identical, found.summary


def test_a_wheel_is_a_rotor_with_scale_and_delay_of_its_device() -> None:
    predictor = build_exiddm(config.load(config.packaged("dymaflex_wheels")))[0].exiddm.predictor
    own = {name: sigma for name, sigma in zip(predictor.names, predictor.sigma, strict=True) if "wheel" in name}
    expected = {f"{kind}_{wheel}": sigma for wheel in WHEELS for kind, sigma in (("scale", 5e-3), ("delay", 2e-4))}
    assert own == pytest.approx(expected)
