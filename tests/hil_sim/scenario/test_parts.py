"""Parts of a world that a scenario names: what each needs, said where it is missing."""

from typing import Any

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import rehearsal
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.scenario.tables import ScenarioError
from onboard import config
from tests.hil_sim.plants.rocket import HOLD, SWEEP, push, scenario

STOP = {"joint": "joint_1", "end": "upper", "at_deg": 15.0}
SERVO = {"servo": {"default": {}}}
AIR = {"air": {"pressure_Pa": 1.0, "growth_time_s": 2.0}}


def of(vehicle: str, tables: dict[str, Any]):
    return rehearsal(config.packaged(vehicle), tables)


@pytest.mark.parametrize(
    ("vehicle", "tables", "said"),
    [
        ("rocksat", {"stop": [STOP]}, r"stop: joints that move as planned do not give way; add \[servo.default\]"),
        (
            "rocksat",
            AIR | {"drag": [{"link": "arm", "area_m2": 1.0, "centre_of_pressure_mm": [0, 0, 0]}]},
            "drag: join",
        ),
        ("rocksat", {"sequence": [push(17.0)]}, 'action = "push": joints that move as planned'),
        (
            "rocksat",
            {"ejection": {"phase": 5, "duration_ms": 6.0}},
            "ejection.duration_ms: joints that move as planned",
        ),
        (
            "rocksat",
            SERVO | {"drag": [{"link": "arm", "area_m2": 1.0, "centre_of_pressure_mm": [0, 0, 0]}]},
            "needs the air",
        ),
        ("fixed_arm", SERVO | {"flexibility": {}}, "leave flexibility"),
        ("rocksat", {"vibration": {"broadband_mg": [1.0, 1.0, 1.0]}}, "fewer integration_steps"),
        ("rocksat", {"vibration": {"broadband_band_Hz": [50.0, 5.0]}}, "broadband_band_Hz must rise"),
        ("rocksat", {"sequence": [SWEEP | {"duration_s": 9.0}]}, "its parts last 3.15 s together"),
        ("rocksat", {"sequence": [HOLD | {"amplitude": {"joint_1": 0.1}}]}, "amplitude and action"),
        ("rocksat", {"sequence": [{"phase": 1, "action": "push"}]}, "to and action"),
        ("rocksat", {"air": {"pressure_Pa": -1.0, "growth_time_s": 2.0}}, "air.pressure_Pa"),
        ("dymaflex", SERVO, 'joints have servos with base = "prescribed" or "fixed"'),
        ("dymaflex", {"coning": {"spin_rad_s": 0.1}}, 'coning: of what carries a base = "prescribed"'),
        ("fixed_arm", AIR, 'air: of what carries a base = "prescribed"'),
    ],
)
def test_what_a_part_needs_is_said(vehicle, tables, said) -> None:
    with pytest.raises(ScenarioError, match=said):
        of(vehicle, tables)


@pytest.mark.parametrize(
    ("vehicle", "tables", "said"),
    [
        ("rocksat", {"servo": {"joint_9": {}}}, "servo, stop: joint_9: the joints are joint_1"),
        ("rocksat", SERVO | {"stop": [STOP | {"joint": "elbow"}]}, "servo, stop: elbow: the joints are joint_1"),
        ("fixed_arm", {"servo": {"a1": {}}}, r"a2, a3.*has none; add \[servo.default\]"),
        ("rocksat", {"sequence": [SWEEP | {"amplitude": {"joint_1": 0.5}}]}, "beyond the URDF's limits"),
        ("rocksat", {"sequence": [SWEEP | {"amplitude": {"elbow": 0.1}}]}, "sequence.strokes names elbow"),
        (
            "rocksat",
            SERVO | AIR | {"drag": [{"link": "sail", "area_m2": 1.0, "centre_of_pressure_mm": [0, 0, 0]}]},
            "drag: sail: the links are plate",
        ),
    ],
)
def test_a_part_of_what_is_not_there_is_refused(vehicle, tables, said) -> None:
    with pytest.raises(ScenarioError, match=said):
        VehiclePlant(of(vehicle, tables), np.random.default_rng(1))


def test_strokes_and_pushes_last_as_long_as_their_parts() -> None:
    steps = scenario(sequence=[HOLD, SWEEP, push(10.0)]).sequence
    assert [step.duration_s for step in steps] == [1.0, 3.15, 3.0]


def test_an_ejection_whose_phase_does_not_come_does_not_happen() -> None:
    flown = VehiclePlant(of("rocksat", {"sequence": [HOLD], "ejection": {"phase": 77}}), np.random.default_rng(1))
    assert "ejection" not in flown.events_s
    assert flown.truth()["ejection_s"] is None
