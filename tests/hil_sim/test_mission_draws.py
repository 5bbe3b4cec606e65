"""What a mission's seed settles, and what nothing else changes: draws, bytes on the buses, truth."""

import numpy as np
import pytest

from hil_sim.mission import Mission
from hil_sim.scenario.load import load
from tests.hil_sim.built import AS_DRAWN
from tests.hil_sim.mission_ground import SHORT, Ground


def test_same_seed_same_bytes_and_another_seed_others() -> None:
    scenario = load("rocksat", SHORT)
    one, again, other = (Ground(scenario, seed, wake_imu=True) for seed in (5, 5, 6))
    assert one.frames == again.frames
    assert one.edges == again.edges
    assert one.words == again.words
    assert one.frames != other.frames
    assert str(one.truth) == str(again.truth)


def test_data_do_not_hang_on_the_step_of_the_clock() -> None:
    scenario = load("rocksat", SHORT)
    fine, coarse = (Ground(scenario, 5, step_ns=step) for step in (1_000_000, 50_000_000))
    assert fine.frames == coarse.frames
    assert fine.edges == coarse.edges
    assert len(fine.edges) > 10
    assert len(fine.of(0x281)) > 400


def test_nothing_hangs_on_how_far_the_plant_is_computed_ahead(monkeypatch) -> None:
    said = []
    for ahead_s in (0.0, 0.33):
        monkeypatch.setattr("hil_sim.mission._AHEAD_S", ahead_s)
        ground = Ground(load("rocksat", SHORT), wake_imu=True)
        said.append((ground.frames, ground.edges, ground.words))
        assert len(ground.words) > 100
    assert said[0] == said[1]


def test_physics_does_not_hang_on_the_start_time() -> None:
    scenario = load("rocksat", SHORT)
    missions = [Mission(scenario, 9) for _ in range(2)]
    for mission in missions:
        mission.plant.advance(1e9)
    readings = [[m.sensors["load_cell"].value(t) for t in np.arange(0.1, 2.5, 5e-3)] for m in missions]
    assert readings[0] == readings[1]
    assert missions[0].end_ns - missions[0].start_ns == 2_800_000_000


def test_every_draw_comes_from_the_seed_and_no_two_subsystems_share_numbers() -> None:
    scenario = load("rocksat", SHORT)
    one, same, other = (Mission(scenario, seed) for seed in (1, 1, 2))
    for path in (("imu_base", "accel_bias_g"), ("joint_1", "eccentricity_phase_rad"), ("load_cell", "gain")):
        a, b, c = (np.asarray(m.truth()[path[0]][path[1]]) for m in (one, same, other))
        np.testing.assert_array_equal(a, b)
        assert (a != c).all()
    for mission in (one, other):
        mission.plant.advance(1.0)
    forces = [mission.plant.inertial("imu_base").specific_force_m_s2[:2000] for mission in (one, other)]
    assert (forces[0] != forces[1]).all()
    clocks = one.truth()["clock"]
    in_sigmas = [clocks["imu_base"]["rate_error"] / 0.005, clocks["sync_box"]["rate_error"] / 20e-6]
    assert in_sigmas[0] != pytest.approx(in_sigmas[1], rel=1e-3)


def test_draws_are_those_of_every_version_before() -> None:
    """A seed names a flight for good: what was drawn for seed 3 before the wiring was a table."""
    truth = Mission(load("rocksat", SHORT), 3).truth()
    assert truth["imu_base"]["accel_bias_g"][0] == pytest.approx(-0.020524843874379306, rel=1e-12)
    assert truth["joint_1"]["eccentricity_phase_rad"] == pytest.approx(2.0037461697387426, rel=1e-12)
    assert truth["load_cell"]["zero_N"] == pytest.approx(-0.023739201883976768, rel=1e-12)
    assert truth["clock"]["imu_base"]["rate_error"] == pytest.approx(-0.0016510491311152729, rel=1e-12)
    assert truth["clock"]["sync_box"]["rate_error"] == pytest.approx(1.2285262187944695e-05, rel=1e-12)


def test_truth_is_the_hand_numbers() -> None:
    lighter = {"as_built": AS_DRAWN | {"tip_mass": AS_DRAWN["tip_mass"] | {"mass_factor": 0.9}}}
    truth = Mission(load("rocksat", lighter), 1).truth()
    arm, c = truth["links"]["arm"], truth["quantities"]
    assert arm["mass_kg"] == pytest.approx(0.23313)
    np.testing.assert_allclose(arm["mass_kg"] * arm["centre_of_mass_m"][:2], [9.26692e-3, 3.28713e-4], rtol=1e-5)
    assert c["m_tip_mass"] == pytest.approx(0.9 * 0.06627)
    seat_m = 0.1557 + 0.0164
    about_joint = c["I_zz_tip_mass"] + c["m_tip_mass"] * ((seat_m + c["c_x_tip_mass"]) ** 2 + c["c_y_tip_mass"] ** 2)
    assert about_joint == pytest.approx(0.9 * 1.981613e-3, rel=1e-6)
    assert truth["phases"][0] == {"code": 0, "action": "hold", "start_s": 0.0, "end_s": 5.0}
