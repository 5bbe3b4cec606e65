"""The scenario file: its schema refuses what it does not know, and its tables are the datasheets'."""

import re

import numpy as np
import pytest

from hil_sim.plants.urdf_drawing import read
from hil_sim.plants.urdf_model import Places, UrdfModel, matrix_of
from hil_sim.scenario import load as scenarios
from hil_sim.scenario.sensor_tables import ImuTable


def test_packaged_scenario_loads() -> None:
    assert "rocksat" in scenarios.names()
    flown = scenarios.load("rocksat")
    assert flown.scenario.name == "rocksat"
    assert [step.phase for step in flown.sequence if step.phase] == [1, 2, 3, 4, 5, 3, 4, 1, 2, 9]


def test_geometry_and_masses_are_those_of_tables_4_5_and_4_6() -> None:
    flown = scenarios.load("rocksat")
    drawing = read(flown.vehicle.urdf, flown.vehicle.label)
    model = UrdfModel(drawing, "prescribed", (0.0, 0.0, 0.0), Places((), ()))
    at = {link: model.model.body(f"l.{link}").pos.tolist() for link in ("arm", "frame_4", "tip_mass")}
    assert at == {"arm": [0.1161, 0.0, 0.101], "frame_4": [0.1557, 0.0, 0.0], "tip_mass": [0.0164, 0.0, 0.0]}
    turned = matrix_of(model.model.body("l.frame_1").quat)
    assert np.rad2deg(np.arctan2(turned[1, 0], turned[0, 0])) == pytest.approx(-55.4)
    arm, tip = model.drawn["arm"], model.drawn["tip_mass"]
    assert (arm.mass_kg, arm.centre_of_mass_m.tolist()) == (0.23313, [0.03975, 0.00141, 0.005])
    elements = [[52080.3, 7130.97, -38230.98], [7130.97, 6.99e5, 1744.05], [-38230.98, 1744.05, 7.33e5]]
    np.testing.assert_allclose(arm.inertia_kg_m2, 1e-9 * np.array(elements), rtol=1e-6, atol=1e-14)
    assert (tip.mass_kg, tip.centre_of_mass_m.tolist()) == (0.06627, [0.0, -0.01391, 0.0])
    np.testing.assert_allclose(tip.inertia_kg_m2, 1e-9 * np.diag([5978.9, 4389.61, 5978.9]), rtol=1e-6, atol=1e-14)


def test_imu_filters_are_those_of_register_26() -> None:
    imu = scenarios.load("rocksat").sensor["imu"]
    assert isinstance(imu, ImuTable)
    assert imu.accel_g.bandwidth_Hz[:7] == (260, 184, 94, 44, 21, 10, 5)
    assert imu.accel_g.delay_ms[:7] == (0.0, 2.0, 3.0, 4.9, 8.5, 13.8, 19.0)
    assert imu.gyro_deg_s.bandwidth_Hz[:7] == (256, 188, 98, 42, 20, 10, 5)
    assert imu.gyro_deg_s.delay_ms[:7] == (0.98, 1.9, 2.8, 4.8, 8.3, 13.4, 18.6)


@pytest.mark.parametrize("name", scenarios.names())
def test_every_number_has_a_source_or_says_it_is_our_choice(name) -> None:
    """A section without any comment is a section nobody can check."""
    text = (scenarios.resources.files("hil_sim.scenario") / "packaged" / f"{name}.toml").read_text(encoding="utf-8")
    sections = re.split(r"^(?=\[(?!\[))", text, flags=re.MULTILINE)[1:]
    assert len(sections) > 10
    for section in sections:
        name = section.splitlines()[0]
        assert name.startswith("[scenario]") or "#" in section, name


def test_overrides_lie_over_the_file() -> None:
    flown = scenarios.load("rocksat", {"as_built": {"tip_mass": {"mass_factor": 0.75}}})
    assert flown.as_built["tip_mass"].mass_factor == 0.75
    assert flown.as_built["tip_mass"].centre_mm == 1.0


def test_a_path_is_read_as_a_file(tmp_path) -> None:
    text = (scenarios.resources.files("hil_sim.scenario") / "packaged" / "rocksat.toml").read_text(encoding="utf-8")
    path = tmp_path / "copy.toml"
    path.write_text(text.replace('name = "rocksat"', 'name = "copy"'), encoding="utf-8")
    assert scenarios.load(path).scenario.name == "copy"
    assert scenarios.load(str(path)).scenario.name == "copy"


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        ({"servo": {"joint_1": {"coulomb_mNm": 1.0}}}, "servo.joint_1.coulomb_mNm"),
        ({"servo": {"joint_1": {"coulomb_N_m": -1.0}}}, "servo.joint_1.coulomb_N_m"),
        ({"wind": {}}, "wind"),
        ({"as_built": {"arm": {"centre_mm": float("nan")}}}, "as_built.arm.centre_mm"),
        ({"sensor": {"imu": {"accel_g": {"delay_ms": [0.0]}}}}, "an entry for each of the 8 filter codes"),
        ({"sequence": [{"phase": 3, "action": "wave", "duration_s": 1.0}]}, "sequence.0"),
        ({"sequence": []}, "sequence"),
        ({"stop": [{"joint": "joint_1", "at_deg": 15.0}]}, "stop.0.end"),
        ({"air": {"growth_time_s": 0.0}}, "air.growth_time_s"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(overrides, named) -> None:
    with pytest.raises(scenarios.ScenarioError, match=re.escape(named)):
        scenarios.load("rocksat", overrides)


def test_a_missing_key_is_named() -> None:
    table = scenarios.load("rocksat").model_dump()
    del table["air"]["growth_time_s"]
    with pytest.raises(scenarios.ScenarioError, match=r"air\.growth_time_s: Field required"):
        scenarios.parse(table)


def test_no_such_scenario_lists_those_there_are(tmp_path) -> None:
    with pytest.raises(scenarios.ScenarioError, match=r"does not exist; packaged scenarios are .*rocksat"):
        scenarios.load("apollo")
    broken = tmp_path / "broken.toml"
    broken.write_text("[scenario", encoding="utf-8")
    with pytest.raises(scenarios.ScenarioError, match="is not TOML"):
        scenarios.load(broken)


def test_a_scenario_is_frozen() -> None:
    flown = scenarios.load("rocksat")
    with pytest.raises(ValueError, match="frozen"):
        flown.air.pressure_Pa = 1.0


# Based on another


def test_a_scenario_based_on_another_has_its_world_and_a_wiring_of_its_own() -> None:
    one, other = scenarios.load("rocksat"), scenarios.load("rocksat_serial")
    for table in ("vehicle", "physics", "as_built", "servo", "stop", "coning", "vibration", "air", "drag", "sequence"):
        assert getattr(one, table) == getattr(other, table)
    assert one.sensor.items() <= other.sensor.items()
    assert "can_0" not in other.bus
    assert "arm_phase" not in other.device
    assert "imu_base_rc" not in other.clock


def test_a_scenario_lies_over_the_one_it_is_based_on_key_by_key(tmp_path) -> None:
    path = tmp_path / "heavy.toml"
    path.write_text(
        """
        [scenario]
        name = "heavy"
        description = ""
        based_on = "rocksat"
        [as_built.tip_mass]
        mass_factor = 1.2
        [sensor.encoder]
        eccentricity_urad = 0.0
        """
    )
    flown, below = scenarios.load(path), scenarios.load("rocksat")
    assert flown.scenario.name == "heavy"
    assert flown.as_built["tip_mass"] == below.as_built["tip_mass"].model_copy(update={"mass_factor": 1.2})
    assert flown.sensor["encoder"] == below.sensor["encoder"].model_copy(update={"eccentricity_urad": 0.0})
    assert flown.device == below.device


@pytest.mark.parametrize(("base", "named"), [("apollo", "apollo does not exist"), ("SELF", "based on itself")])
def test_what_a_scenario_cannot_be_based_on_is_named(tmp_path, base, named) -> None:
    path = tmp_path / "self.toml"
    path.write_text(f'[scenario]\nbased_on = "{path if base == "SELF" else base}"\n')
    with pytest.raises(scenarios.ScenarioError, match=named):
        scenarios.load(path)
