"""Commanded arm motion and prescribed rocket motion, against closed forms."""

import itertools
from typing import Any, NamedTuple

import numpy as np
import pytest

from hil_sim.plants.motions import carrier
from hil_sim.plants.motions.carrier import CarrierMaker, carried, turned
from hil_sim.plants.motions.joint_swings import JointSwings
from hil_sim.plants.motions.motion import STANDARD_GRAVITY, dynamic_pressure
from hil_sim.plants.urdf_drawing import read
from hil_sim.scenario.load import load
from tests.hil_sim.plants.rocket import NO_AIR, NO_VIBRATION

STEP_S = 5e-4


class Base(NamedTuple):
    """The plate's motion in its own axes."""

    angular_accel_rad_s2: np.ndarray
    angular_rate_half_rad_s: np.ndarray
    origin_accel_m_s2: np.ndarray
    dynamic_pressure_pa: np.ndarray
    wind: np.ndarray


def base(seconds: float, seed: int = 1, **overrides: Any) -> Base:
    scenario = load("rocksat", overrides)
    motion = carried(scenario, STEP_S, round(seconds / STEP_S), np.random.default_rng(seed))
    own = turned(motion.pose[:, 3:] * [1.0, -1.0, -1.0, -1.0], motion.acceleration[:, :3])
    return Base(motion.acceleration[:, 3:], motion.before[:, 3:], own, motion.pressure_pa, motion.wind)


def program(**overrides: Any) -> JointSwings:
    scenario = load("rocksat", overrides)
    joints = tuple(read(scenario.vehicle.urdf, scenario.vehicle.label).joints.values())
    return JointSwings(scenario, joints, np.random.default_rng(1))


def test_sequence_is_that_of_section_4_5_2() -> None:
    arm = program()
    assert [code for _, code in arm.phase_changes] == [
        0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 3, 0, 4, 0, 1, 0, 2, 9,
    ]  # fmt: skip
    assert arm.phase_changes[0][0] == 0.0
    for a, b in itertools.pairwise(arm.spans):
        assert a.end_s == b.start_s
    assert 55.0 < arm.duration_s < 65.0
    flight = load("rocksat")
    assert flight.start_of(flight.ejection.phase) == next(span.start_s for span in arm.spans if span.code == 5)


def test_a_sequence_of_one_step_has_one_phase() -> None:
    arm = program(sequence=[{"phase": 0, "action": "hold", "duration_s": 2.0}])
    assert arm.phase_changes == ((0.0, 0),)
    assert arm.duration_s == 2.0


def test_sweeps_are_minimum_jerk_and_stay_inside_12_degrees() -> None:
    arm = program()
    # Largest acceleration of a minimum-jerk stroke: 10/sqrt(3) D / T^2; largest rate: 15/8 D / T.
    stroke = np.deg2rad(23.0)
    for code, stroke_s, strokes in ((3, 1.2, 8), (4, 0.6, 10)):
        spans = [span for span in arm.spans if span.code == code]
        assert len(spans) == 2
        for span in spans:
            times = np.arange(span.start_s, span.end_s, 1e-4)
            angle, rate, accel = (of[:, 0] for of in arm.at(times))
            assert np.rad2deg(np.abs(angle).max()) == pytest.approx(11.5)
            assert np.abs(accel).max() == pytest.approx(10 / np.sqrt(3) * stroke / stroke_s**2, rel=1e-4)
            assert np.abs(rate).max() == pytest.approx(15 / 8 * stroke / stroke_s, rel=1e-4)
            peaks = np.count_nonzero(np.diff(np.sign(angle[np.abs(angle) > 0.19])) != 0)
            assert peaks == strokes  # sides reached one after the other, the first one by the transfer


def test_reference_rate_and_acceleration_are_derivatives_of_the_angle() -> None:
    arm = program()
    h = 1e-4
    times = np.arange(4.0, 40.0, h)
    angle, rate, accel = (of[:, 0] for of in arm.at(times))
    np.testing.assert_allclose(np.gradient(angle, h)[1:-1], rate[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(rate, h)[1:-1], accel[1:-1], atol=2e-2)


def test_reference_holds_before_and_after() -> None:
    arm = program()
    assert arm.at(np.array([-1.0, 1e3]))[0].tolist() == [[0.0], [0.0]]


def test_spinning_body_alone_gives_centripetal_acceleration() -> None:
    motion = base(
        1.0,
        **NO_VIBRATION | NO_AIR,
        coning={
            "nutation_rate_rad_s": 0.0,
            "residual_rate_rad_s": [0.0, 0.0, 0.0],
            "spin_rad_s": 0.5,
            "centre_of_mass_to_base_m": [0.02, 0.0, 1.0],
        },
    )
    np.testing.assert_allclose(motion.angular_rate_half_rad_s, np.tile([0.0, 0.0, 0.5], (2000, 1)), atol=1e-15)
    np.testing.assert_allclose(motion.origin_accel_m_s2, np.tile([-0.005, 0.0, 0.0], (2000, 1)), atol=1e-15)


def test_coning_keeps_angular_momentum() -> None:
    """Torque-free: dH/dt + w x H = 0 with H = (I w_x, I w_y, 0.06 I w_z); the transverse rate stays."""
    motion = base(30.0, **NO_VIBRATION | NO_AIR, coning={"residual_rate_rad_s": [0.0, 0.0, 0.0]})
    w = motion.angular_rate_half_rad_s + 0.5 * STEP_S * motion.angular_accel_rad_s2
    H = w * [1.0, 1.0, 0.06]
    dH = motion.angular_accel_rad_s2 * [1.0, 1.0, 0.06]
    assert np.hypot(w[:, 0], w[:, 1]) == pytest.approx(0.04, rel=1e-6)
    np.testing.assert_allclose(dH + np.cross(w, H), 0.0, atol=1e-9)
    assert np.ptp(w[:, 0]) > 0.07  # it does cone


def test_rate_differences_are_the_acceleration() -> None:
    motion = base(21.0)
    difference = np.diff(motion.angular_rate_half_rad_s, axis=0) / STEP_S
    np.testing.assert_allclose(difference, motion.angular_accel_rad_s2[:-1], atol=1e-9)


def test_vibration_has_the_stated_size_and_no_mean() -> None:
    quiet = base(60.0, **NO_AIR | NO_VIBRATION)
    shaken = base(60.0, **NO_AIR)
    shake = (shaken.origin_accel_m_s2 - quiet.origin_accel_m_s2) / (1e-3 * STANDARD_GRAVITY)
    # Root sum of squares of the scenario's broadband and its three modes, mg.
    expected = [np.sqrt(2**2 + 3**2 + 2**2 + 2**2), np.sqrt(2**2 + 2**2 + 4**2 + 2**2), np.sqrt(3**2 + 1 + 2**2 + 6**2)]
    np.testing.assert_allclose(shake.std(axis=0), expected, rtol=0.1)
    assert np.abs(shake.mean(axis=0)).max() < 0.01
    turn = 1e3 * (shaken.angular_rate_half_rad_s - quiet.angular_rate_half_rad_s)
    np.testing.assert_allclose(
        turn.std(axis=0), [np.hypot(0.5, 0.3), np.hypot(0.5, 0.3), np.hypot(0.3, 0.5)], rtol=0.12
    )
    spectrum = np.abs(np.fft.rfft(shake[:, 2])) ** 2
    frequency = np.fft.rfftfreq(len(shake), STEP_S)
    assert frequency[spectrum.argmax()] == pytest.approx(88.0, abs=4.0)


def test_air_takes_hold_in_the_fourth_sweep_and_is_gusty() -> None:
    scenario = load("rocksat")
    arm = program()
    fourth = [span for span in arm.spans if span.code == 4][1]
    assert scenario.air.reference_s == pytest.approx(fourth.start_s)
    motion = base(63.0, **NO_VIBRATION)
    pressure = motion.dynamic_pressure_pa
    at = lambda t: pressure[round((t - 0.5) / STEP_S) : round((t + 0.5) / STEP_S)].mean()  # noqa: E731
    assert at(20.0) < 1e-3 * at(fourth.start_s)
    assert 5.0 < at(fourth.end_s) / at(fourth.start_s) < 40.0
    trend = np.exp((STEP_S * np.arange(len(pressure)) - 47.1) / 2.8) * 1.81818
    assert (pressure / trend).std() == pytest.approx(0.15, rel=0.25)
    np.testing.assert_allclose(np.linalg.norm(motion.wind, axis=1), 1.0)
    rate = motion.angular_rate_half_rad_s
    change = np.linalg.norm(rate[round(fourth.end_s / STEP_S)] - rate[round(fourth.start_s / STEP_S)])
    assert change > np.deg2rad(1.0)  # the rate gyro sees it


@pytest.mark.parametrize("area", [0.0, 0.011, 0.05])
@pytest.mark.parametrize("pressure_pa", [0.0, 1.81818])
def test_the_air_of_an_hour_is_finite_and_carries_what_falls_in_it(area: float, pressure_pa: float) -> None:
    scenario = load("rocksat", {})
    assert scenario.air is not None
    air = scenario.air.model_copy(update={"carrier_area_over_mass_m2_kg": area, "pressure_Pa": pressure_pa})
    times = np.arange(0.0, 3600.0, 0.1)
    pressure = dynamic_pressure(air, times, np.zeros(len(times)))
    assert np.isfinite(pressure).all()
    early = times < 62.0  # the packaged missions
    np.testing.assert_allclose(pressure[early], pressure_pa * np.exp((times[early] - 47.1) / 2.8))
    if area and pressure_pa:
        assert pressure[-1] * area == pytest.approx(STANDARD_GRAVITY)
        assert pressure.max() * area == pytest.approx(7000.0 / (2.0 * np.e * 2.8**2), rel=0.05)


def test_an_hour_s_attitudes_are_unit_quaternions() -> None:
    scenario = load("rocksat", NO_VIBRATION)
    path = carried(scenario, 0.01, 360_000, np.random.default_rng(1))
    np.testing.assert_allclose(np.linalg.norm(path.pose[:, 3:], axis=1), 1.0)


@pytest.mark.parametrize(
    "sways",
    [
        pytest.param({}, marks=pytest.mark.campaign),  # part of the other
        {"base_motion": {"rate_rad_s": 0.05, "acceleration_m_s2": 0.1, "still_s": 0.5}},
    ],
)
def test_a_motion_is_the_same_wherever_it_is_cut_and_only_what_comes_next_is_kept(monkeypatch, sways) -> None:
    scenario, count = load("rocksat", sways), 12 * carrier.CHUNK + 7
    path, kept = CarrierMaker(scenario, STEP_S, count, np.random.default_rng(3)), []
    parts = [path.rows(first, min(first + 40, count)) for first in range(0, count, 40) if not kept.append(path.kept)]
    assert max(kept) <= carrier.CHUNK + 40
    monkeypatch.setattr(carrier, "CHUNK", 64 * count)
    whole = carried(scenario, STEP_S, count, np.random.default_rng(3))
    for name, own in zip(whole._fields, whole, strict=True):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]), own)


def test_motion_is_drawn_from_the_seed() -> None:
    one, same, other = base(1.0, seed=1), base(1.0, seed=1), base(1.0, seed=2)
    for a, b, c in zip(one, same, other, strict=True):
        assert a.tobytes() == b.tobytes()
        assert a.tobytes() != c.tobytes()
