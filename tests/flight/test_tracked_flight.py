"""A flight before a tracker: its poses are fused, and lengths that are wrong from the start do not mislead."""

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import config
from onboard.channels import outer_ends
from onboard.cli import main
from onboard.flight import hil
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.campaign.instants import off_by
from onboard.ground.identify.mission import mission_table
from onboard.ground.identify.replay.feed import feed
from onboard.ground.identify.replay.replay import replay
from onboard.identification.standing import LEVELS, Level
from onboard.recording.reader import LogReader
from tests.flight.missions import Result
from tests.flight.test_pose_tracker import DEVICE

OVER = '[payload]\nmass_kg = [1.0, 2.0]\n[[sequence]]\nphase = 1\naction = "swing"\nduration_s = 13.0\n'
LENGTHS = 1.06


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> config.Vehicle:
    directory = tmp_path_factory.mktemp("tracked") / "mine"
    assert main(["init", str(directory), "--base", "free", "--joints", "3", "--encoder", "cia402"]) == 0
    path = directory / "vehicle.toml"
    device = "".join(f"{key} = {value!r}\n" for key, value in DEVICE.items())
    bus = '\n[bus.tty_tracker]\nurl = "serial:///dev/ttyUSB0?baud=230400"\n'
    path.write_text(f"{path.read_text()}{bus}[device.tracker]\n{device}")
    return config.load(path)


@pytest.fixture(scope="module")
def flown(vehicle: config.Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("healthy") / "flight.mcap"
    path.with_suffix(".toml").write_text(OVER)
    world, urls = open_in_process(scenario_of(vehicle.path, path.with_suffix(".toml")), 3)
    with world:
        flown = hil.fly_simulated(vehicle, world, urls, path)
    return Result(path, flown, mission_table.result(flown))


def answers(flown: Result, vehicle: config.Vehicle, lengths: float) -> tuple[list[float], list[float]]:
    """Errors of all good answers over their sides of their 99.9 % intervals, and the last ten of those of 95 %."""
    truth = flown.flown.truth["quantities"]
    estimator = Estimator(vehicle)
    process, off, widths = estimator.process, list[float](), list[float]()

    def spoilt(now_ns, batches, *rest):
        taken = dict(batches)
        if "tracker" in taken:
            taken["tracker"] = taken["tracker"].copy()
            taken["tracker"]["position_m"] *= lengths
        return process(now_ns, taken, *rest)

    estimator.process = spoilt
    for name, rows in feed(estimator, LogReader(flown.path)):
        for row in rows if name == "quantity" else ():
            if LEVELS[row["level"]] is Level.GOOD and (known := truth.get(row["name"].decode())) is not None:
                widths.append(0.5 * (row["high"] - row["low"]))
                off.append(float(off_by(row["value"], *outer_ends(row), known)))
    return off, widths[-10:]


def test_it_is_fused_and_replays_to_the_bit(flown: Result, vehicle: config.Vehicle) -> None:
    assert flown.table["accounted"], flown.table["channels"]
    assert not flown.events("left_out")
    assert replay(flown.path).identical
    assert Estimator(vehicle).online.exiddm.predictor.moving.size == 10


@pytest.mark.parametrize("lengths", [1.0, LENGTHS])
def test_no_answer_is_good_and_wrong_while_the_trackers_lengths_are_off(
    flown: Result, vehicle: config.Vehicle, lengths: float
) -> None:
    off, widths = answers(flown, vehicle, lengths)
    assert len(off) >= 100
    assert np.isfinite(widths).all()
    assert max(off) < 1.0
