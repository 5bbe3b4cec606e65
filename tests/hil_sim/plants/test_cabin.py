"""A vehicle between hands in an aircraft: what its IMU shows when held, and conservation of momentum when let go."""

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import Mission
from hil_sim.plants.vehicle_plant import VehiclePlant

SHORT = """
[parabolas]
strapped = false
pull_s = 1.5
change_s = 0.5
low_s = 5.5
release_s = [2.0, 2.4]
motion_at_s = 3.2
motion_s = 1.2
catch_s = [4.8, 5.2]
early = 0.0
bumps = 1.0
[[parabolas.run]]
joints = "yaw"
speed = "fast"
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    over = tmp_path_factory.mktemp("parabola") / "over.toml"
    over.write_text(SHORT)
    scenario = scenario_of("parabolic", over)
    plant = Mission(scenario, 7).plant
    assert isinstance(plant, VehiclePlant)
    return plant


def during(plant, first_s, last_s):
    rows = slice(round(first_s / plant.step_s), round(last_s / plant.step_s))
    shown = plant.inertial("imu_base")
    return shown.specific_force_m_s2[rows], shown.rate_rad_s[rows]


def test_the_floor_pushes_with_so_many_g_and_hands_tremble(plant):
    force, _ = during(plant, 0.2, 1.4)
    assert np.linalg.norm(force, axis=1).mean() == pytest.approx(17.65, abs=0.2)
    held, _ = during(plant, 2.2, 3.5)
    assert 0.05 < np.linalg.norm(held, axis=1).mean() < 1.0


def test_what_is_let_go_keeps_its_momentum_until_it_is_bumped(plant):
    (run,) = plant.cabin.runs
    force, rate = during(plant, run.release_s + 0.01, run.release_s + 0.5)
    assert np.abs(rate - rate[0]).max() < 0.05 * np.abs(rate[0]).max()
    r = np.linalg.norm(force, axis=1).max()
    assert (
        r < 1.5 * np.linalg.norm(rate[0]) ** 2 * 0.5
    )  # centripetal only, half a metre from the centre of mass at most
    (bump,) = run.bumps
    masses = [body.mass_kg for body in plant.bodies.values()]
    total_kg = sum(masses) + plant.payload.mass_kg
    pushed, turn = during(plant, bump.at_s - 0.01, bump.at_s + 0.07)
    assert np.abs(pushed).max() > 0.3 * np.linalg.norm(bump.impulse_N_s) / total_kg / 0.06
    assert np.abs(turn[-1] - turn[0]).max() > 1e-3


def test_truth_says_when(plant):
    (told,) = plant.truth()["parabolas"]
    (run,) = plant.cabin.runs
    assert told["flown"] == "fast yaw"
    assert 4.0 < told["release_s"] == run.release_s < 4.4
    assert 6.8 < told["catch_s"] < 7.2
    assert told["bumps_s"] == [run.bumps[0].at_s]
