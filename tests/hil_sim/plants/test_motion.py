"""Commanded arm motion and prescribed rocket motion, against closed forms."""

import itertools

import numpy as np
import pytest

from hil_sim.plants.motion import STANDARD_GRAVITY, ArmProgram, base_motion
from hil_sim.scenario.load import load

STEP_S = 5e-4
NO_VIBRATION = {"broadband_mg": [0.0, 0.0, 0.0], "linear_mode_mg": [], "angular_mode_mrad_s": []}
NO_AIR = {"reference_deceleration_m_s2": 0.0}


def base(seconds: float, seed: int = 1, **overrides):
    return base_motion(load("rocksat", overrides), STEP_S, round(seconds / STEP_S), np.random.default_rng(seed))


def test_sequence_is_that_of_section_4_5_2() -> None:
    program = ArmProgram(load("rocksat"))
    assert [code for _, code in program.phase_changes] == [
        0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 3, 0, 4, 0, 1, 0, 2, 9,
    ]  # fmt: skip
    assert program.phase_changes[0][0] == 0.0
    for a, b in itertools.pairwise(program.spans):
        assert a.end_s == b.start_s
    assert 55.0 < program.duration_s < 65.0
    eject = next(span for span in program.spans if span.code == 5)
    assert program.ejection_s == eject.start_s


def test_a_sequence_without_ejection_has_no_ejection_time() -> None:
    program = ArmProgram(load("rocksat", {"sequence": [{"phase": 0, "action": "hold", "duration_s": 2.0}]}))
    assert program.ejection_s is None
    assert program.phase_changes == ((0.0, 0),)
    assert program.duration_s == 2.0


def test_sweeps_are_minimum_jerk_and_stay_inside_12_degrees() -> None:
    program = ArmProgram(load("rocksat"))
    # Largest acceleration of a minimum-jerk stroke: 10/sqrt(3) D / T^2; largest rate: 15/8 D / T.
    stroke = np.deg2rad(23.0)
    for code, stroke_s, strokes in ((3, 1.2, 8), (4, 0.6, 10)):
        spans = [span for span in program.spans if span.code == code]
        assert len(spans) == 2
        for span in spans:
            times = np.arange(span.start_s, span.end_s, 1e-4)
            motion = program.reference(times)
            assert np.rad2deg(np.abs(motion.angle_rad).max()) == pytest.approx(11.5)
            assert np.abs(motion.accel_rad_s2).max() == pytest.approx(10 / np.sqrt(3) * stroke / stroke_s**2, rel=1e-4)
            assert np.abs(motion.rate_rad_s).max() == pytest.approx(15 / 8 * stroke / stroke_s, rel=1e-4)
            peaks = np.count_nonzero(np.diff(np.sign(motion.angle_rad[np.abs(motion.angle_rad) > 0.19])) != 0)
            assert peaks == strokes  # sides reached one after the other, the first one by the transfer


def test_reference_rate_and_acceleration_are_derivatives_of_the_angle() -> None:
    program = ArmProgram(load("rocksat"))
    h = 1e-4
    times = np.arange(4.0, 40.0, h)
    motion = program.reference(times)
    np.testing.assert_allclose(np.gradient(motion.angle_rad, h)[1:-1], motion.rate_rad_s[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(motion.rate_rad_s, h)[1:-1], motion.accel_rad_s2[1:-1], atol=2e-2)


def test_reference_holds_before_and_after() -> None:
    program = ArmProgram(load("rocksat"))
    assert program.reference(np.array([-1.0, 1e3])).angle_rad.tolist() == [0.0, 0.0]


def test_spinning_body_alone_gives_centripetal_acceleration() -> None:
    motion = base(
        1.0,
        vibration=NO_VIBRATION,
        reentry=NO_AIR,
        rocket={
            "nutation_rate_rad_s": 0.0,
            "residual_rate_rad_s": [0.0, 0.0, 0.0],
            "spin_rad_s": 0.5,
            "centre_of_mass_to_plate_m": [0.02, 0.0, 1.0],
        },
    )
    np.testing.assert_allclose(motion.angular_rate_half_rad_s, np.tile([0.0, 0.0, 0.5], (2000, 1)), atol=1e-15)
    np.testing.assert_allclose(motion.origin_accel_m_s2, np.tile([-0.005, 0.0, 0.0], (2000, 1)), atol=1e-15)


def test_coning_keeps_angular_momentum() -> None:
    """Torque-free: dH/dt + w x H = 0 with H = (I w_x, I w_y, 0.06 I w_z); the transverse rate stays."""
    motion = base(30.0, vibration=NO_VIBRATION, reentry=NO_AIR, rocket={"residual_rate_rad_s": [0.0, 0.0, 0.0]})
    w = motion.angular_rate_half_rad_s + 0.5 * STEP_S * motion.angular_accel_rad_s2
    H = w * [1.0, 1.0, 0.06]
    dH = motion.angular_accel_rad_s2 * [1.0, 1.0, 0.06]
    assert np.hypot(w[:, 0], w[:, 1]) == pytest.approx(0.04, rel=1e-6)
    np.testing.assert_allclose(dH + np.cross(w, H), 0.0, atol=1e-9)
    assert np.ptp(w[:, 0]) > 0.07  # it does cone


def test_rate_differences_are_the_acceleration() -> None:
    motion = base(63.0)
    difference = np.diff(motion.angular_rate_half_rad_s, axis=0) / STEP_S
    np.testing.assert_allclose(difference, motion.angular_accel_rad_s2[:-1], atol=1e-9)


def test_vibration_has_the_stated_size_and_no_mean() -> None:
    quiet = base(60.0, reentry=NO_AIR, vibration=NO_VIBRATION)
    shaken = base(60.0, reentry=NO_AIR)
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
    program = ArmProgram(scenario)
    fourth = [span for span in program.spans if span.code == 4][1]
    assert scenario.reentry.reference_s == pytest.approx(fourth.start_s)
    motion = base(63.0, vibration=NO_VIBRATION)
    pressure = motion.dynamic_pressure_pa
    at = lambda t: pressure[round((t - 0.5) / STEP_S) : round((t + 0.5) / STEP_S)].mean()  # noqa: E731
    assert at(20.0) < 1e-3 * at(fourth.start_s)
    assert 5.0 < at(fourth.end_s) / at(fourth.start_s) < 40.0
    trend = np.exp((STEP_S * np.arange(len(pressure)) - 47.1) / 2.8) * 0.02 / 0.011
    assert (pressure / trend).std() == pytest.approx(0.15, rel=0.25)
    np.testing.assert_allclose(np.linalg.norm(motion.wind, axis=1), 1.0)
    rate = motion.angular_rate_half_rad_s
    change = np.linalg.norm(rate[round(fourth.end_s / STEP_S)] - rate[round(fourth.start_s / STEP_S)])
    assert change > np.deg2rad(1.0)  # the rate gyro sees it


def test_motion_is_drawn_from_the_seed() -> None:
    one, same, other = base(1.0, seed=1), base(1.0, seed=1), base(1.0, seed=2)
    for a, b, c in zip(one, same, other, strict=True):
        assert a.tobytes() == b.tobytes()
        assert a.tobytes() != c.tobytes()
