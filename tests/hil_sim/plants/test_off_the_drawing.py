"""DYMAFLEX's world: frames off their drawing, the posture and the payload of a seed, and what is not there."""

import re

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import Mission
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.plants.world import NotYetComputedError
from hil_sim.scenario.tables import ScenarioError

SWING = {"phase": 1, "action": "swing", "duration_s": 2.5, "ramp_s": 1.2, "swing": 0.27}
SHORT = {
    "sequence": [{"phase": 0, "action": "hold", "duration_s": 0.3}, SWING],
    "capture": {"earliest_s": 1.2, "latest_s": 1.6, "velocity_sigma_m_s": 0.03, "rate_sigma_rad_s": 0.05},
}
FRAMES = ("link_1", "link_2", "link_3", "link_4", "link_5", "imu_base", "imu_2")
STEP_s = 5e-4


def flown(seed=5, **changes):
    """A plant that is computed to its end, its scenario with other tables."""
    scenario = scenario_of("dymaflex", SHORT)
    made = VehiclePlant(scenario.model_copy(update=changes), np.random.default_rng(seed))
    made.advance(made.program.duration_s + 1.0)
    return made


@pytest.fixture(scope="module")
def plant():
    return flown()


def test_a_frame_that_is_off_is_as_one_that_is_drawn_there(plant):
    """Joints in the axes of the link before, IMUs in the base's: the drawing is written again with these places."""
    scenario = scenario_of("dymaflex", SHORT)
    urdf = scenario.vehicle.urdf
    for link in FRAMES:
        joint = re.search(rf'<child link="{link}"/>\s*<origin xyz="([^"]*)"', urdf)
        there = np.array(joint[1].split(), np.float64) + plant.off_m[link]
        urdf = urdf[: joint.start(1)] + " ".join(map(repr, there.tolist())) + urdf[joint.end(1) :]
    told = {name: table.model_copy(update={"place_mm": 0.0}) for name, table in scenario.as_built.items()}
    drawn = flown(
        vehicle=scenario.vehicle.model_copy(update={"urdf": urdf}),
        as_built={name: table for name, table in told.items() if "imu" not in name},
    )
    assert not drawn.off_m
    assert min(np.abs(off).max() for off in plant.off_m.values()) > 1e-4
    np.testing.assert_allclose(plant.rows_true.sensors, drawn.rows_true.sensors, rtol=0, atol=1e-9)
    as_drawn = flown(as_built={name: table for name, table in told.items() if "imu" not in name})
    np.testing.assert_array_equal(plant.rows_true.joints, as_drawn.rows_true.joints)  # no other draw is another
    assert np.abs(plant.rows_true.sensors - as_drawn.rows_true.sensors).max() > 1e-3


def test_a_grid_step_of_the_integration_does_not_matter(plant):
    fine = flown(physics=scenario_of("dymaflex").physics.model_copy(update={"integration_steps": 4}))
    before = slice(100, round(1.2 / STEP_s))  # the capture falls on a step
    for at, of_noise in (("imu_base", 1e-4), ("imu_2", 1e-4)):
        for one, other in zip(plant.inertial(at)[:2], fine.inertial(at)[:2], strict=True):
            np.testing.assert_allclose(one[before], other[before], rtol=0, atol=of_noise)


def test_every_seed_has_its_own_posture_about_the_one_that_is_told(plant):
    told = np.array(list(scenario_of("dymaflex").motion.posture.values()))
    postures = np.array([plant.program.posture, flown(6).program.posture])
    assert (np.abs(postures - told) <= 0.297).all()
    assert np.abs(postures[0] - postures[1]).min() > 1e-3
    assert np.abs(postures - told).max() > 0.05


def test_truth_names_what_was_caught(plant):
    truth = plant.truth()
    quantities = truth["quantities"]
    assert quantities["m_payload"] == pytest.approx(5.0, rel=1e-12)
    assert [quantities[f"c_{axis}_payload"] for axis in "xyz"] == pytest.approx([0.03, -0.02, 0.08])
    tensor = np.array([[quantities[f"I_{min(a, b)}{max(a, b)}_payload"] for b in "xyz"] for a in "xyz"])
    box = 5.0 / 12.0 * np.array([0.16**2 + 0.14**2, 0.2**2 + 0.14**2, 0.2**2 + 0.16**2])
    np.testing.assert_allclose(np.linalg.eigvalsh(tensor), np.sort(box), rtol=1e-12)
    assert np.abs(tensor[0, 1]) > 1e-5
    assert 1.2 <= truth["capture_s"] <= 1.6


def test_no_sensor_sees_what_is_to_come():
    mission = Mission(scenario_of("dymaflex", SHORT), 1)
    mission.plant.advance(1.0)
    assert mission.sensors["joint_3"].value(1.0) != 0.0
    for name in ("joint_3", "load_cell"):
        with pytest.raises(NotYetComputedError):
            mission.sensors[name].value(1.5)


@pytest.mark.parametrize(
    ("tables", "named"),
    [
        ({"as_built": {"base": {"place_mm": 1.0}}}, "base: place_mm is of a link that hangs on another"),
        ({"as_built": {"link_9": {"place_mm": 1.0}}}, "link_9"),
        ({"as_built": {"imu_2": {"place_mm": 0.0}}}, "imu_2"),
        ({"motion": {"posture": {"joint_2": 3.0}, "posture_spread": 3.0}}, "joint_2"),
        ({"device": {"joint_1": {"at": "joint_6"}}}, "'joint_6'"),
        ({"sequence": [SWING | {"swing_deg": 20.0}]}, "swing_deg"),
        ({"attitude": {"spring_N_m_rad": 0.1, "damper_N_m_s": 0.5, "torque_N_m": 0.1}}, "no reaction wheel"),
    ],
)
def test_what_cannot_be_flown_is_refused_by_name(tables, named):
    with pytest.raises(ScenarioError, match=named):
        Mission(scenario_of("dymaflex", SHORT | tables), 1)
