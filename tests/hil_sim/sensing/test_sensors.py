"""Sensor models against the figures their datasheets promise, on a world made of known signals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.plants.world import Inertial, NotYetComputedError
from hil_sim.scenario.load import load
from hil_sim.sensing.interpolation import interpolate, interpolate_column, interpolate_one
from hil_sim.sensing.sensors import (
    DriftingClock,
    EncoderSensor,
    ImuSensor,
    LoadCellSensor,
    low_pass,
)
from hil_sim.sensing.triads import within_limits

STEP_S = 5e-4
G = 9.80665
# RM register 26: bandwidth [Hz] and delay [ms] by DLPF_CFG.
ACCEL_DLPF = [(260, 0.0), (184, 2.0), (94, 3.0), (44, 4.9), (21, 8.5), (10, 13.8), (5, 19.0)]
GYRO_DLPF = [(256, 0.98), (188, 1.9), (98, 2.8), (42, 4.8), (20, 8.3), (10, 13.4), (5, 18.6)]

PERFECT_AXES = {
    "noise_density": 0.0,
    "bias_sigma": [0.0, 0.0, 0.0],
    "bias_per_kelvin_sigma": [0.0, 0.0, 0.0],
    "scale_sigma": 0.0,
    "cross_axis_sigma": 0.0,
}
PERFECT_IMU = {
    "accel_g": PERFECT_AXES,
    "gyro_deg_s": PERFECT_AXES,
    "gyro_per_g_sigma_deg_s": 0.0,
    "mounting_sigma_deg": 0.0,
    "temperature_noise_counts": 0.0,
}


class World:
    """Stands where the plant is: known signals on the same grid, all of them computed already."""

    step_s = STEP_S
    chunk = 40

    def __init__(self, seconds: float, force_m_s2=None, rate_rad_s=None, moment_n_m=None, angle_rad=None) -> None:
        self.rows = self.count = round(seconds / STEP_S / self.chunk) * self.chunk
        times = STEP_S * np.arange(self.rows)
        three, one = (lambda t: np.zeros((len(t), 3))), (lambda t: np.zeros(len(t)))
        self._inertial = Inertial((force_m_s2 or three)(times), (rate_rad_s or three)(times - 0.5 * STEP_S), 0.5)
        self._moment, self._angle = (moment_n_m or one)(times), (angle_rad or one)(times)

    def inertial(self, at: str) -> Inertial:
        return self._inertial

    def angle_rad(self, at: str):
        return self._angle

    def moment_n_m(self, at: str, axis=(0.0, 0.0, 1.0)):
        return self._moment

    def require(self, time_s: float) -> None:
        """All of it is there."""


def imu_table(**overrides):
    return load("rocksat", {"sensor": {"imu": PERFECT_IMU | overrides}}).sensor["imu"]


def imu_of(world, rng, **overrides) -> ImuSensor:
    return ImuSensor(world, imu_table(**overrides), rng)


def tone(frequency_hz: float, size: float):
    """The same sine on three axes with sizes 1, 2, 3."""
    return lambda t: size * np.sin(2 * np.pi * frequency_hz * t)[:, None] * [1.0, 2.0, 3.0]


def response(times_s, readings, frequency_hz: float):
    """Gain (to a unit sine) and delay [s] by least squares on sine and cosine."""
    w = 2 * np.pi * frequency_hz
    A = np.stack([np.sin(w * times_s), np.cos(w * times_s), np.ones_like(times_s)], axis=1)
    (s, c, _), *_ = np.linalg.lstsq(A, readings, rcond=None)
    return np.hypot(s, c), -np.arctan2(c, s) / w


# ---------------------------------------------------------------- filters and interpolation


@pytest.mark.parametrize(("bandwidth_hz", "delay_ms"), ACCEL_DLPF + GYRO_DLPF)
def test_low_pass_has_the_tabulated_bandwidth_and_delay(bandwidth_hz, delay_ms) -> None:
    f = low_pass(bandwidth_hz, 1e-3 * delay_ms, STEP_S)
    _, (dc, edge, far) = signal.freqz(f.b, f.a, [1e-6, bandwidth_hz, min(900.0, 8 * bandwidth_hz)], fs=1 / STEP_S)
    assert abs(dc) == pytest.approx(1.0, abs=1e-9)
    assert abs(edge) ** 2 == pytest.approx(0.5, rel=1e-6)
    assert abs(far) < 0.35
    slow_hz = 0.01
    _, (h,) = signal.freqz(f.b, f.a, [slow_hz], fs=1 / STEP_S)
    delay_s = -np.angle(h) / (2 * np.pi * slow_hz) + f.pure_delay_s
    ten_microseconds = 1e-5
    assert delay_s == pytest.approx(1e-3 * delay_ms, abs=ten_microseconds)
    assert f.pure_delay_s >= 0.0
    assert np.abs(np.roots(f.a)).max() < 1.0


def test_interpolation_is_exact_for_cubics_and_good_at_100_hz() -> None:
    k = np.arange(50.0)
    places = np.linspace(1.0, 46.9, 333)
    cubic = np.stack([k**3 - 40 * k**2, k], axis=1)
    expected = np.stack([places**3 - 40 * places**2, places], axis=1)
    np.testing.assert_allclose(interpolate(cubic, places), expected, atol=1e-8)
    sine = np.sin(2 * np.pi * 100.0 * STEP_S * k)
    got = np.array([interpolate_one(sine, p) for p in places])
    assert np.abs(got - np.sin(2 * np.pi * 100.0 * STEP_S * places)).max() < 2.5e-4
    np.testing.assert_allclose(interpolate(sine[:, None], places)[:, 0], got, atol=1e-15)


def test_many_instants_at_once_give_the_same_bits_as_one_by_one() -> None:
    scenario = load("rocksat")
    places = np.random.default_rng(5).uniform(-3.0, 60.0, 500)
    walk = np.random.default_rng(6).standard_normal(50).cumsum()
    assert interpolate_column(walk, places).tolist() == [interpolate_one(walk, at) for at in places.tolist()]
    plant = VehiclePlant(scenario, np.random.default_rng(1))
    plant.advance(7.0)
    table = scenario.sensor["load_cell"].model_copy(update={"full_scale_readings_s": (6.2,)})
    cell = LoadCellSensor(plant, table, np.random.default_rng(3), "joint_1")
    encoder = EncoderSensor(plant, scenario.sensor["encoder"], np.random.default_rng(4), "joint_1")
    times_s = np.sort(np.random.default_rng(7).uniform(0.1, 6.9, 3000))
    for sensor in (cell, encoder):
        many = sensor.values(times_s)
        assert many.std() > 0.0
        assert many.tolist() == [sensor.value(time_s) for time_s in times_s.tolist()]
        with pytest.raises(NotYetComputedError):
            sensor.values(np.array([1.0, 7.5]))
    assert (cell.values(times_s) == cell.capacity_N).sum() > 0


def test_interpolation_clamps_to_the_ends() -> None:
    line = np.arange(10.0)
    assert interpolate_one(line, -5.0) == pytest.approx(0.0)
    assert interpolate_one(line, 50.0) == pytest.approx(9.0)


def test_deviates_stay_within_the_limits(rng) -> None:
    drawn = within_limits(rng, 20_000)
    assert np.abs(drawn).max() < 2.0
    assert np.abs(drawn).max() > 1.99
    assert drawn.std() == pytest.approx(0.88, abs=0.02)  # of a normal cut at 2 sigma


# ---------------------------------------------------------------- IMU


@pytest.mark.parametrize("code", range(7))
def test_counts_lag_the_truth_by_the_tabulated_delay(code, rng) -> None:
    """End to end, accelerometer and gyro each by their own column of the table."""
    slow_hz = min(0.5, ACCEL_DLPF[code][0] / 50)
    imu = imu_of(World(2.0 + 2.0 / slow_hz, tone(slow_hz, 2.0), tone(slow_hz, 0.5)), rng)
    times = np.arange(1.0, 1.0 + 2.0 / slow_hz, 1.003e-3)  # not the plant's grid
    counts = imu.counts(times, 8192.0, 131.0, code)
    one_hundred_microseconds = 1e-4
    for column, (_, delay_ms), size in (
        (0, ACCEL_DLPF[code], 2.0 / G * 8192),
        (2, ACCEL_DLPF[code], 6.0 / G * 8192),
        (4, GYRO_DLPF[code], np.rad2deg(0.5) * 131),
        (6, GYRO_DLPF[code], np.rad2deg(1.5) * 131),
    ):
        gain, delay_s = response(times, counts[:, column].astype(float), slow_hz)
        assert gain == pytest.approx(size, rel=0.02)
        assert delay_s == pytest.approx(1e-3 * delay_ms, abs=one_hundred_microseconds)


def test_filter_code_2_halves_the_power_of_its_band_edge(rng) -> None:
    imu = imu_of(World(4.0, tone(94.0, 3.0), tone(98.0, 0.5)), rng)
    times = 1.0 + np.arange(2500) * 1.003e-3
    counts = imu.counts(times, 8192.0, 131.0, 2)
    accel, _ = response(times, counts[:, 0].astype(float), 94.0)
    gyro, _ = response(times, counts[:, 4].astype(float), 98.0)
    assert (accel / (3.0 / G * 8192)) ** 2 == pytest.approx(0.5, rel=0.02)
    assert (gyro / (np.rad2deg(0.5) * 131)) ** 2 == pytest.approx(0.5, rel=0.02)


def test_noise_is_the_datasheets(rng) -> None:
    """PS 6.1: 0.05 deg/s rms at DLPF_CFG 2, 0.005 deg/s/sqrt(Hz); PS 6.2: 400 ug/sqrt(Hz)."""
    noisy = {"accel_g": PERFECT_AXES | {"noise_density": 4e-4}, "gyro_deg_s": PERFECT_AXES | {"noise_density": 0.005}}
    imu = imu_of(World(60.0), rng, **noisy)
    counts = imu.counts(np.arange(1.0, 59.0, 1e-3), 16384.0, 131.0, 2).astype(float)
    rms = counts.std(axis=0)
    np.testing.assert_allclose(rms[4:] / 131, 0.005 * np.sqrt(1.11 * 98), rtol=0.04)
    np.testing.assert_allclose(rms[4:] / 131, 0.05, rtol=0.1)
    np.testing.assert_allclose(rms[:3] / 16384, 4e-4 * np.sqrt(1.11 * 94), rtol=0.04)
    frequency, density = signal.welch(counts[:, 4] / 131, fs=1000.0, nperseg=4096)
    assert np.sqrt(density[(frequency > 5) & (frequency < 30)].mean()) == pytest.approx(0.005, rel=0.05)


def test_a_bias_wanders_and_walks() -> None:
    """Over 4 s and 40 draws: differences of a walk grow with the root of time, those of the slow process do not."""

    def read(draws=40, **axes):
        table = imu_table(gyro_deg_s=PERFECT_AXES | axes)
        sensors = [ImuSensor(World(4.05), table, np.random.default_rng(seed)) for seed in range(draws)]
        times = np.arange(0.05, 4.0, 0.05)
        return np.stack([one.counts(times, 16384.0, 1000.0, 0)[:, 4:7] / 1000.0 for one in sensors])

    assert not read(draws=1).any()
    walk = read(bias_walk_sqrt_s=0.5)
    for steps in (4, 40):  # 0.2 s, 2 s
        change = walk[:, steps:] - walk[:, :-steps]
        assert change.std() == pytest.approx(0.5 * np.sqrt(0.05 * steps), rel=0.15)
    slow = read(bias_instability=1.0, bias_instability_time_s=0.5)
    assert slow.std() == pytest.approx(1.0, rel=0.1)
    assert (slow[:, 10:] * slow[:, :-10]).mean() == pytest.approx(np.exp(-1.0), abs=0.1)


def test_words_are_quantised_and_saturate(rng) -> None:
    force = lambda t: np.tile([2.5 * G, -9.0 * G, 0.3 * G], (len(t), 1))  # noqa: E731
    imu = imu_of(World(1.0, force, lambda t: np.full((len(t), 3), np.deg2rad(300.0))), rng)
    counts = imu.counts(np.array([0.5, 0.6]), 8192.0, 131.0, 3)
    assert counts.dtype == np.int16
    assert counts[0].tolist() == [20480, -32768, round(0.3 * 8192), counts[0, 3], 32767, 32767, 32767]
    assert counts[1, :3].tolist() == counts[0, :3].tolist()


def test_temperature_word_follows_the_self_heating(rng) -> None:
    imu = imu_of(World(200.0), rng)
    words = imu.counts(np.array([0.0, 80.0, 199.0]), 8192.0, 131.0, 2)[:, 3]
    # RM register 65: T = word / 340 + 36.53; 24 degC at start, 3 K with a time constant of 80 s.
    expected = [24.0, 24.0 + 3.0 * (1 - np.exp(-1.0)), 24.0 + 3.0 * (1 - np.exp(-199 / 80))]
    np.testing.assert_allclose(words / 340 + 36.53, expected, atol=2e-3)


def test_drawn_errors_are_applied_as_told_by_truth(rng) -> None:
    force_g, rate_deg_s = np.array([0.2, -0.1, 0.15]), np.array([3.0, -20.0, 8.0])
    world = World(
        40.0, lambda t: np.tile(force_g * G, (len(t), 1)), lambda t: np.tile(np.deg2rad(rate_deg_s), (len(t), 1))
    )
    scenario = load("rocksat")
    imu = ImuSensor(world, scenario.sensor["imu"], rng)
    counts = imu.counts(np.arange(10.0, 30.0, 1e-3), 8192.0, 131.0, 2).astype(float).mean(axis=0)
    rise = (imu.temperature_deg_c(np.arange(10.0, 30.0, 1e-3)) - 24.0).mean()
    t = imu.truth()
    accel = t["accel_matrix"] @ force_g + t["accel_bias_g"] + rise * t["accel_bias_g_per_K"]
    gyro = t["gyro_matrix"] @ rate_deg_s + t["gyro_bias_deg_s"] + rise * t["gyro_bias_deg_s_per_K"]
    gyro += t["gyro_deg_s_per_g"] @ force_g
    # five sigma of a mean over 20 s: density / sqrt(2 T)
    np.testing.assert_allclose(counts[:3] / 8192, accel, atol=5 * 4e-4 / np.sqrt(40))
    np.testing.assert_allclose(counts[4:] / 131, gyro, atol=5 * 0.005 / np.sqrt(40))


def test_draws_fill_the_datasheet_limits_and_stay_inside() -> None:
    world, table = World(0.1), load("rocksat").sensor["imu"]
    drawn = [ImuSensor(world, table, np.random.default_rng(seed)).truth() for seed in range(200)]
    for key, limit in (("accel_bias_g", [0.05, 0.05, 0.08]), ("gyro_bias_deg_s", [20.0, 20.0, 20.0])):
        largest = np.abs([d[key] for d in drawn]).max(axis=0)
        assert (largest <= limit).all()
        assert (largest > 0.85 * np.array(limit)).all()
    scale = np.array([np.diag(d["gyro_matrix"]) for d in drawn])
    assert 0.02 < np.abs(scale - 1.0).max() < 0.031
    # mounting turns both triads together: the skew parts agree but for the cross-axis errors of +-2 %
    skew = np.array([[d["accel_matrix"][0, 1] - d["accel_matrix"][1, 0] for d in drawn]])
    assert skew.std() < 0.03


def test_mounting_rotates_accelerometer_and_gyro_alike(rng) -> None:
    imu = imu_of(World(0.1), rng, mounting_sigma_deg=0.3)
    matrix = imu.truth()["accel_matrix"]
    np.testing.assert_allclose(matrix, imu.truth()["gyro_matrix"], atol=1e-15)
    assert np.abs(matrix - np.eye(3)).max() > 1e-3
    np.testing.assert_allclose(matrix + matrix.T, 2 * np.eye(3), atol=1e-15)


def test_counts_do_not_hang_on_the_polling() -> None:
    scenario = load("rocksat", {"sequence": [{"phase": 0, "action": "hold", "duration_s": 1.0}]})
    times = np.arange(0.05, 0.9, 1.0037e-3)
    answers = []
    for batch in (1, 7, 2000):
        plant = VehiclePlant(scenario, np.random.default_rng(1))
        imu = ImuSensor(plant, scenario.sensor["imu"], np.random.default_rng(2), "imu_base")
        cell = LoadCellSensor(plant, scenario.sensor["load_cell"], np.random.default_rng(3), "joint_1")
        rows, forces = [], []
        for part in np.split(times, range(batch, len(times), batch)):
            plant.advance(part[-1])
            rows.append(imu.counts(part, 8192.0, 131.0, 2))
            forces += [cell.value(t) for t in part]
        answers.append((np.concatenate(rows).tobytes(), forces))
    assert answers[0] == answers[1] == answers[2]


def test_changing_the_filter_does_not_disturb_the_other_one(rng) -> None:
    imu = imu_of(World(4.0, tone(2.0, 2.0), tone(2.0, 0.5)), rng)
    times = np.arange(1.0, 3.0, 1e-3)
    alone = imu.counts(times, 8192.0, 131.0, 2)
    imu.counts(times, 8192.0, 131.0, 6)
    np.testing.assert_array_equal(imu.counts(times, 8192.0, 131.0, 2), alone)


def test_no_sensor_answers_about_the_future() -> None:
    scenario = load("rocksat", {"sequence": [{"phase": 0, "action": "hold", "duration_s": 2.0}]})
    plant = VehiclePlant(scenario, np.random.default_rng(1))
    plant.advance(1.0)
    imu = ImuSensor(plant, scenario.sensor["imu"], np.random.default_rng(2), "imu_base")
    cell = LoadCellSensor(plant, scenario.sensor["load_cell"], np.random.default_rng(3), "joint_1")
    encoder = EncoderSensor(plant, scenario.sensor["encoder"], np.random.default_rng(4), "joint_1")
    assert imu.counts(np.array([1.0]), 8192.0, 131.0, 2).shape == (1, 7)
    assert imu.counts(np.array([]), 8192.0, 131.0, 2).shape == (0, 7)
    for ask in (
        lambda: imu.counts(np.array([0.5, 1.5]), 8192.0, 131.0, 2),
        lambda: cell.value(1.5),
        lambda: encoder.value(1.5),
    ):
        with pytest.raises(NotYetComputedError):
            ask()


# ---------------------------------------------------------------- encoder


# ---------------------------------------------------------------- load cell


# ---------------------------------------------------------------- clocks


@given(
    rate=st.floats(-0.05, 0.05),
    drift=st.floats(-1e-5, 1e-5),
    chip_ns=st.integers(0, 200_000_000_000),
    start_ns=st.integers(0, 10**17),
)
def test_clock_and_its_inverse(rate, drift, chip_ns, start_ns) -> None:
    clock = DriftingClock(start_ns, rate, drift)
    time_ns = clock.time_ns(chip_ns)
    assert abs(clock.chip_ns(time_ns) - chip_ns) <= 2
    assert clock.time_ns(chip_ns + 10) > time_ns
    assert clock.times_s(np.array([float(chip_ns)]))[0] == pytest.approx(1e-9 * (time_ns - start_ns), abs=1e-9)


def test_a_fast_clock_is_early() -> None:
    clock = DriftingClock(1000, 0.01, 0.0)
    assert clock.chip_ns(1000 + 1_000_000_000) == 1_010_000_000
    assert clock.time_ns(1_010_000_000) == 1000 + 1_000_000_000
    drifting = DriftingClock(0, 0.0, 1e-6)
    assert drifting.chip_ns(60_000_000_000) == 60_000_000_000 + 1_800_000  # drift t^2 / 2


def test_clock_draws_respect_the_limit() -> None:
    table = load("rocksat").clock
    rates = [DriftingClock.draw(table["imu_base"], np.random.default_rng(s)).rate_error for s in range(500)]
    assert np.abs(rates).max() <= 0.010
    assert np.std(rates) == pytest.approx(0.005, rel=0.1)
    crystal = [DriftingClock.draw(table["sync_box"], np.random.default_rng(s)).rate_error for s in range(500)]
    assert 3e-5 < np.abs(crystal).max() <= 5e-5
