"""What a mission keeps of its truth: old rows are given back, and nothing that is read changes by it."""

import numpy as np
import pytest

from hil_sim import arrays, mission
from hil_sim.arrays import Deviates, Track
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import Mission
from hil_sim.plants import vehicle_plant
from hil_sim.plants.world import ForgottenError

HELD = {"phase": 0, "action": "hold", "duration_s": 1.5}
SHORT = {"sequence": [HELD], "capture": {"earliest_s": 0.4, "latest_s": 0.6}}
SETTINGS = (16384.0, 131.0, 2)
PAGE = 4096


@pytest.fixture
def small(monkeypatch):
    """Memory given back a page at a time, after 0.3 s."""
    monkeypatch.setattr(arrays, "_LEAST", PAGE)
    monkeypatch.setattr(mission, "_KEPT_S", 0.3)


def test_deviates_drawn_in_blocks_are_those_of_one_draw(monkeypatch) -> None:
    monkeypatch.setattr(arrays, "_LEAST", 7 * 8 * 3)  # blocks of seven rows
    once, blocks = np.random.default_rng(4), np.random.default_rng(4)
    whole, drawn = once.standard_normal((100, 3)), Deviates(blocks, 100, 3)
    np.testing.assert_array_equal(np.concatenate([drawn.take(n) for n in (1, 59, 0, 40)]), whole)
    assert once.bit_generator.state == blocks.bit_generator.state


def test_a_track_gives_back_whole_pages_of_what_is_forgotten(monkeypatch) -> None:
    monkeypatch.setattr(arrays, "_LEAST", PAGE)
    track = Track(2000, 2)
    track.values[:] = 1.0
    track.forget(1000)
    kept = np.flatnonzero(track.values[:, 0])
    a_page = PAGE // 16
    assert 1000 - a_page < kept[0] <= 1000
    assert len(kept) == 2000 - kept[0]


def read(scenario, seed: int, until_s: float) -> list[np.ndarray]:
    """What IMU, joint and cell say every 20 ms."""
    flying = Mission(scenario, seed)
    said = []
    for time_s in np.arange(0.02, until_s, 0.02):
        flying.now_ns = flying.start_ns + round(1e9 * time_s)
        flying.forget()
        flying.plant.advance(time_s)
        words = flying.sensors["imu_base"].counts(time_s - 1e-3 * np.arange(20)[::-1], *SETTINGS)
        said.append(
            np.concatenate([words.ravel(), [flying.sensors[name].value(time_s) for name in ("joint_1", "load_cell")]])
        )
    return said


@pytest.mark.usefixtures("small")
def test_what_is_kept_changes_nothing_that_is_read(monkeypatch) -> None:
    whole = {name: getattr(vehicle_plant, name) for name in ("_AT_ONCE_S", "_BLOCK")}
    monkeypatch.setattr(vehicle_plant, "_AT_ONCE_S", 0.1)  # as of a long mission
    monkeypatch.setattr(vehicle_plant, "_BLOCK", 3)
    forgetful = read(scenario_of("dymaflex", SHORT), 3, 1.4)
    monkeypatch.setattr(mission, "_KEPT_S", 60.0)
    for name, value in whole.items():
        monkeypatch.setattr(vehicle_plant, name, value)
    np.testing.assert_array_equal(forgetful, read(scenario_of("dymaflex", SHORT), 3, 1.4))


def test_a_long_mission_is_computed_as_time_advances(monkeypatch) -> None:
    scenario = scenario_of("dymaflex", SHORT | {"sequence": [HELD | {"duration_s": 4.0}]})
    whole = Mission(scenario, 3).plant
    whole.advance(1e9)
    monkeypatch.setattr(vehicle_plant, "_WHOLE_S", 0.1)
    plant, ahead, parts = Mission(scenario, 3).plant, [], []
    while plant.count < plant.rows:
        plant.advance(plant.step_s * (plant.count - 2))  # by a chunk
        ahead.append(plant.done * plant.every - plant.count)
        parts.append(sum(part.rows for part in plant.parts))
    assert len(ahead) == plant.rows // plant.chunk > 4 * vehicle_plant.PART
    assert max(ahead) <= (vehicle_plant.PART + 1) * plant.chunk
    assert max(parts) <= (vehicle_plant.PART + 1) * plant.chunk
    assert plant.truth()["capture_s"] == whole.truth()["capture_s"] > 0.0
    for own, other in zip(plant.rows_true, whole.rows_true, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-5, atol=1e-5 * np.abs(other).max())


@pytest.mark.usefixtures("small")
def test_a_time_that_is_not_kept_is_an_error_and_a_delayed_input_keeps_more() -> None:
    for fault, kept in ((), False), (({"kind": "delayed", "device": "joint_1", "start_s": 0.1, "value": 1.0},), True):
        flying = Mission(scenario_of("dymaflex", SHORT | {"fault": fault}), 3)
        flying.now_ns = flying.start_ns + 1_200_000_000
        flying.plant.advance(1.2)
        flying.forget()
        if kept:
            assert flying.sensors["joint_1"].value(0.3) != 0.0
        else:
            with pytest.raises(ForgottenError, match="not kept any more"):
                flying.sensors["joint_1"].value(0.3)
