"""What pushes a free base unknown on board, where vehicle.toml says nothing of it or states it."""

import numpy as np
import pytest

from onboard import config
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.problem.priors import disturbance_prior

DYMAFLEX = config.load(config.packaged("dymaflex"))


def told(**keys):
    estimation = DYMAFLEX.tree["estimation"] | ({"disturbance": keys} if keys else {})
    vehicle = config.parse_tree(DYMAFLEX.tree | {"estimation": estimation}, DYMAFLEX.path, config.Origin("a test"))
    return disturbance_prior(vehicle, build_model(vehicle))


def test_a_silent_file_has_one_in_proportion_to_the_vehicle():
    found = told()
    assert found.force_N == pytest.approx(0.4e-3 * 26.499)  # kg: base and links of the drawing
    gyration_m = np.sqrt((0.7170317 + 0.7165697 + 0.7808262) / 2.0 / 23.1)  # of the base about its frame's origin
    assert found.torque_N_m == pytest.approx(found.force_N * gyration_m)
    assert found.memory_s == 60.0


def test_a_key_that_is_stated_is_taken():
    assert told(force_N=0.0, torque_N_m=0.0)[:2] == (0.0, 0.0)
    assert told(force_N=0.5, torque_N_m=0.1, time_s=7.0) == (0.5, 0.1, 7.0)


def test_hands_and_a_tracker_leave_none():
    assert disturbance_prior(DYMAFLEX, build_model(DYMAFLEX), tracked=True)[:2] == (0.0, 0.0)
    parabolic = config.load(config.packaged("parabolic"))
    assert disturbance_prior(parabolic, build_model(parabolic))[:2] == (0.0, 0.0)
