"""IMU, load cell, encoder, balance: values with sigmas that cover, and runs that are refused."""

import numpy as np
import pytest

from onboard.estimation.calibration.imu import rest_bias, six_positions, turns
from onboard.estimation.calibration.linear import balance, encoder, line
from onboard.estimation.errors import CalibrationError

G = 9.81
FACES = np.vstack([np.eye(3), -np.eye(3)])


def triad(rng):
    E = np.eye(3) + np.diag(rng.normal(0, 0.02, 3)) + rng.normal(0, 0.01, (3, 3)) * (1 - np.eye(3))
    return E, rng.normal(0, 0.3, 3)


def test_six_positions_cover(rng):
    inside = count = 0
    for _ in range(100):
        E, bias = triad(rng)
        held = FACES + 5e-4 * rng.standard_normal((6, 3))
        held /= np.linalg.norm(held, axis=1, keepdims=True)
        found = six_positions(G * held @ E.T + bias + 1e-3 * rng.standard_normal((6, 3)), FACES, G, 5e-4, 1e-3)
        inside += np.count_nonzero(np.abs(found.bias - bias) < 1.96 * found.bias_sigma)
        inside += np.count_nonzero(np.abs(found.matrix - E) < 1.96 * found.matrix_sigma)
        count += 3 + 9
        assert np.diag(found.matrix_sigma).max() < 0.3 * found.matrix_sigma[0, 1]  # askew acts across, not along
    assert inside / count > 0.93


def test_misalignment_is_a_rotation():
    turn = np.array([0.004, -0.003, 0.002])
    x, y, z = turn
    R = np.eye(3) - np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    found = six_positions(G * FACES @ R.T, FACES, G, 1e-3, 1e-3)
    np.testing.assert_allclose(found.matrix, R, atol=1e-12)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f[:3], FACES[:3]), "not determined"),
        (lambda f: (f[:, [1, 0, 2]], FACES), "check axes"),
        (lambda f: (-f, FACES), "check axes"),
        (lambda f: (f / G, FACES), "check axes"),
        (lambda f: (np.vstack([f, f[0] + [0.5, 0, 0]]), np.vstack([FACES, FACES[:1]])), "sigmas off"),
        (lambda f: (np.where(np.arange(6)[:, None] == 2, np.nan, f), FACES), "finite"),
    ],
)
def test_six_positions_that_are_wrong_are_refused(rng, spoil, message):
    E, bias = triad(rng)
    with pytest.raises(CalibrationError, match=message):
        six_positions(*spoil(G * FACES @ E.T + bias), G, 1e-3, 1e-3)


def test_turns_give_the_scales_and_rests_the_bias(rng):
    E, bias = triad(rng)
    bias *= 0.01
    angle = 2.0 * np.pi * np.array([1, 1, 1, -1])
    axis = np.vstack([np.eye(3), [1, 0, 0]])
    read = (angle[:, None] * axis) @ E.T
    found = turns(angle, axis, read, 1e-3, 1e-3)
    np.testing.assert_allclose(found.matrix, E, atol=1e-10)
    with pytest.raises(CalibrationError, match="not determined"):
        turns(angle[:2], axis[:2], read[:2], 1e-3, 1e-3)
    with pytest.raises(CalibrationError, match=r"turn [14] is"):
        turns(angle, axis, read + 0.05 * np.eye(4)[3][:, None], 1e-3, 1e-3)
    per_g = 1e-3 * rng.standard_normal((3, 3))
    rest = rest_bias(FACES @ per_g.T + bias, FACES, 1e-5)
    np.testing.assert_allclose(rest.bias_rad_s, bias, atol=1e-12)
    np.testing.assert_allclose(rest.per_g_rad_s, per_g, atol=1e-12)
    with pytest.raises(CalibrationError, match="not determined"):
        rest_bias(FACES[:3], FACES[:3], 1e-5)


def test_turns_cover(rng):
    inside = 0
    axis = np.vstack([np.eye(3), np.eye(3)])
    for _ in range(100):
        E, _ = triad(rng)
        held = axis + 1e-3 * rng.standard_normal((6, 3))
        angle = np.array([1, 1, 1, -1, -1, -1]) * 2.0 * np.pi
        true = (angle + 1e-3 * rng.standard_normal(6))[:, None] * held / np.linalg.norm(held, axis=1, keepdims=True)
        found = turns(angle, axis, true @ E.T, 1e-3, 1e-3)
        inside += np.count_nonzero(np.abs(found.matrix - E) < 1.96 * found.matrix_sigma)
    assert inside / 900 > 0.93


def test_a_load_cell_by_known_masses_covers(rng):
    inside = 0
    for _ in range(200):
        masses, sigma = np.array([0.0, 0.5, 1.0, 2.0]), np.array([0.0, 1e-4, 1e-4, 2e-4])
        truth = 1.013
        true = masses + sigma * rng.standard_normal(4)
        found = line(masses * G, truth * true * G + 0.2 + 0.002 * rng.standard_normal(4), sigma * G, np.full(4, 0.002))
        inside += abs(found.slope - truth) < 1.96 * found.slope_sigma
    assert 180 <= inside <= 199


def test_a_touching_cable_and_a_single_mass_are_refused():
    x = np.array([0.0, 5.0, 10.0, 20.0])
    with pytest.raises(CalibrationError, match="point 4"):
        line(x, np.array([0.2, 5.2, 10.2, 19.2]), np.full(4, 1e-3), np.full(4, 2e-3))
    with pytest.raises(CalibrationError, match="add a larger value"):
        line(x[:1], x[:1], np.zeros(1), np.ones(1))
    with pytest.raises(CalibrationError, match="state a sigma"):
        line(x, x, np.zeros(4), np.zeros(4))


def test_an_encoder_at_its_stops():
    counts = 0.3 / (2 * np.pi) * -4096 + np.array([100.0, 100.0 - 1000.0])
    angle = np.array([0.3, 0.3 + 1000.0 * 2 * np.pi / 4096])
    found = encoder(angle, counts, 1e-4)
    assert found.counts_per_revolution == pytest.approx(-4096)
    assert found.zero_count == pytest.approx(100.0)
    assert found.counts_sigma > 0.0


def test_balance_finds_mass_and_centre():
    m, c = 4.2, np.array([0.03, -0.05, 0.12])
    gravity, pivot, hinge, support, push, force = ([] for _ in range(6))
    for up, h in (("z", [1, 0, 0]), ("z", [0, 1, 0]), ("x", [0, 1, 0]), ("y", [1, 0, 0]), ("z", [0, 0, 0])):
        u = np.eye(3)["xyz".index(up)]
        p, s = np.zeros(3), 0.4 * (np.cross(np.array(h, float), u) if any(h) else u)
        gravity.append(-G * u)
        pivot.append(p), hinge.append(np.array(h, float)), support.append(s), push.append(u)
        if any(h):
            lever = np.dot(h, np.cross(s - p, u))
            force.append(-np.dot(h, np.cross(c - p, -m * G * u)) / lever)
        else:
            force.append(m * G)
    found = balance(*map(np.array, (gravity, pivot, hinge, support, push, force)), 0.01)
    assert found.mass_kg == pytest.approx(m)
    np.testing.assert_allclose(found.centre_of_mass_m, c, atol=1e-9)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.01 / G, rel=0.1)
    with pytest.raises(CalibrationError, match="turn the body"):
        balance(*(np.array(v)[:3] for v in (gravity, pivot, hinge, support, push, force)), 0.01)
    with pytest.raises(CalibrationError, match="check the cell's sign"):
        balance(*map(np.array, (gravity, pivot, hinge, support, push, [-f for f in force])), 0.01)
