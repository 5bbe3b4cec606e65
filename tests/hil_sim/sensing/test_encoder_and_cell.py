"""Simulated encoder and load cell against the figures of their data sheets."""

import numpy as np
import pytest

from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.scenario.load import load
from hil_sim.sensing.sensors import (
    EncoderSensor,
    LoadCellSensor,
)
from tests.hil_sim.sensing.test_sensors import World, response

PERFECT_CELL = {
    "lever_sigma_mm": 0.0,
    "scale_sigma": 0.0,
    "nonlinearity_of_rated_output": 0.0,
    "creep_fraction": 0.0,
    "zero_sigma_N": 0.0,
    "zero_drift_sigma_N_s": 0.0,
    "zero_walk_N_sqrt_s": 0.0,
    "noise_rms_N": 0.0,
    "full_scale_readings_s": [],
}


def cell_table(**overrides):
    return load("rocksat", {"sensor": {"load_cell": PERFECT_CELL | overrides}}).sensor["load_cell"]


def cell_of(world, rng, **overrides) -> LoadCellSensor:
    return LoadCellSensor(world, cell_table(**overrides), rng)


def test_encoder_gives_whole_counts_of_500000_a_turn(rng) -> None:
    world = World(1.0, angle_rad=lambda t: 0.2 * np.sin(6.0 * t))
    perfect = {"eccentricity_urad": 0.0, "transmission_error_urad": 0.0, "zero_sigma_mrad": 0.0}
    table = load("rocksat", {"sensor": {"encoder": perfect}}).sensor["encoder"]
    encoder = EncoderSensor(world, table, rng)
    step = 2 * np.pi / 500_000
    for t in np.linspace(0.01, 0.98, 200):
        counts = encoder.value(t) / step
        assert counts == pytest.approx(round(counts), abs=1e-6)
        assert 0.0 <= 0.2 * np.sin(6.0 * t) - encoder.value(t) + 1e-12 < step * 1.001


def test_encoder_errors_are_cyclic_in_the_motor(rng) -> None:
    """Once and twice per motor turn, 100 motor turns to one of the joint; 23 and 70 urad."""
    world = World(4.0, angle_rad=lambda t: 0.05 * t)
    encoder = EncoderSensor(world, load("rocksat").sensor["encoder"], rng)
    times = np.linspace(0.5, 0.5 + 2 * np.pi / 100 / 0.05 * 2, 400, endpoint=False)  # two motor turns
    error = np.array([encoder.analog_rad(t) - 0.05 * t for t in times])
    size = 2 * np.abs(np.fft.rfft(error)) / len(error)
    assert size[2] == pytest.approx(23e-6, rel=1e-3)
    assert size[4] == pytest.approx(70e-6, rel=1e-3)
    assert np.delete(size, [0, 2, 4]).max() < 1e-8
    assert np.mean(error) == pytest.approx(encoder.truth()["zero_rad"], abs=1e-8)
    assert 1e-5 < abs(encoder.truth()["zero_rad"]) < 2e-3


def test_perfect_cell_reads_moment_over_40_mm_2_ms_late(rng) -> None:
    slow_hz = 1.0
    cell = cell_of(World(6.0, moment_n_m=lambda t: 0.02 * np.sin(2 * np.pi * slow_hz * t)), rng)
    times = 1.0 + np.arange(800) * 5.0021e-3
    gain, delay_s = response(times, np.array([cell.value(t) for t in times]), slow_hz)
    assert gain == pytest.approx(0.5, rel=1e-3)
    assert delay_s == pytest.approx(2e-3, abs=2e-5)


def test_cell_filter_is_second_order_at_112_hz(rng) -> None:
    edge_hz = np.sqrt(2) / (2 * np.pi * 2e-3)
    cell = cell_of(World(4.0, moment_n_m=lambda t: 0.04 * np.sin(2 * np.pi * edge_hz * t)), rng)
    times = 1.0 + np.arange(1500) * 1.003e-3
    gain, _ = response(times, np.array([cell.value(t) for t in times]), edge_hz)
    assert gain**2 == pytest.approx(0.5, rel=0.02)


def test_cell_noise_and_zero(rng) -> None:
    cell = cell_of(World(60.0), rng, noise_rms_N=0.0025, zero_sigma_N=0.03)
    readings = np.array([cell.value(t) for t in np.arange(1.0, 59.0, 5e-3)])
    assert readings.std() == pytest.approx(0.0025, rel=0.03)
    assert readings.mean() == pytest.approx(cell.truth()["zero_N"], abs=1e-4)


def test_cell_drift_walk_and_creep(rng) -> None:
    drifting = cell_of(World(60.0), rng, zero_drift_sigma_N_s=1e-3)
    rise = drifting.value(55.0) - drifting.value(5.0)
    assert rise == pytest.approx(50.0 * drifting.truth()["drift_N_s"], rel=1e-6)
    assert rise != 0.0
    table = cell_table(zero_walk_N_sqrt_s=1e-3)
    walks = [LoadCellSensor(World(4.1), table, np.random.default_rng(s)).value(4.0) for s in range(200)]
    assert np.std(walks) == pytest.approx(2e-3, rel=0.15)
    creeping = cell_of(World(60.0, moment_n_m=lambda t: np.full(len(t), 0.4)), rng, creep_fraction=1e-3)
    assert creeping.value(0.1) == pytest.approx(10.0, rel=2e-5)
    assert creeping.value(8.0) == pytest.approx(10.0 * (1 + 1e-3 * (1 - np.exp(-1))), rel=1e-5)


def test_cell_scale_lever_and_nonlinearity_are_those_of_truth(rng) -> None:
    moments = lambda t: np.where(t < 1.0, 0.008, np.where(t < 2.0, 1.6, -1.6))  # noqa: E731
    cell = cell_of(
        World(3.0, moment_n_m=moments),
        rng,
        scale_sigma=0.0025,
        lever_sigma_mm=0.1,
        nonlinearity_of_rated_output=0.001,
    )
    t = cell.truth()
    assert cell.value(0.9) == pytest.approx(0.008 / t["moment_Nm_per_N"], rel=1e-5)
    for time_s, moment in ((1.9, 1.6), (2.9, -1.6)):
        force = moment / t["lever_m"]
        bent = force + t["nonlinearity_of_rated_output"] * 50.0 * (force / 50.0) ** 3
        assert cell.value(time_s) == pytest.approx(t["gain"] * bent, rel=1e-9)
    assert t["lever_m"] != 0.040
    assert t["gain"] != 1.0
    assert 0.0 < abs(t["nonlinearity_of_rated_output"]) <= 0.001


def test_cell_calibration_draws_have_the_stated_sigma() -> None:
    world, table = World(0.1), load("rocksat").sensor["load_cell"].model_copy(update={"delay_sigma_ms": 0.2})
    drawn = [LoadCellSensor(world, table, np.random.default_rng(seed)).truth() for seed in range(600)]
    assert np.std([d["gain"] for d in drawn]) == pytest.approx(0.0025, rel=0.1)
    assert np.std([d["lever_m"] for d in drawn]) == pytest.approx(1e-4, rel=0.1)
    assert np.std([d["zero_N"] for d in drawn]) == pytest.approx(0.03, rel=0.1)
    assert np.std([d["delay_s"] for d in drawn]) == pytest.approx(2e-4, rel=0.1)


def test_cell_is_clipped_at_its_capacity(rng) -> None:
    cell = cell_of(World(2.0, moment_n_m=lambda t: np.where(t < 1.0, 2.4, -2.4)), rng)
    assert cell.value(0.9) == 50.0
    assert cell.value(1.9) == -50.0


def test_two_single_samples_read_full_scale(rng) -> None:
    cell = cell_of(World(3.0), rng, full_scale_readings_s=[1.002, 2.003], zero_sigma_N=0.03)
    readings = np.array([cell.value(t) for t in np.arange(1, 590) * 5.0001e-3])
    assert np.flatnonzero(readings == 50.0).tolist() == [200, 400]
    assert np.abs(np.delete(readings, [200, 400])).max() < 0.2


def test_flight_has_its_two_full_scale_readings_in_the_middle_of_sweeps() -> None:
    scenario = load("rocksat")
    plant = VehiclePlant(scenario, np.random.default_rng(0))
    sweeps = [span for span in plant.program.spans if span.action == "strokes"]
    assert len(scenario.sensor["load_cell"].full_scale_readings_s) == 2
    for start in scenario.sensor["load_cell"].full_scale_readings_s:
        assert any(span.start_s + 1.0 < start < span.end_s - 1.0 for span in sweeps)
