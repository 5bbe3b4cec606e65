"""Coulomb friction with a way to turn round, of motors that turn with one joint or two."""

import numpy as np
import pytest

from onboard.dynamics.model.errors import UnknownFrameError
from onboard.regressor.friction import CoulombFriction, Motor

LENGTH_rad = 0.01
JOINTS = ["a", "b"]


def dahl(position, parts=1):
    friction = CoulombFriction([Motor("a", (("a", 1.0),), LENGTH_rad)], JOINTS)
    q = np.column_stack([position, np.zeros(len(position))])
    return np.concatenate([friction.follow(part, 0.0 * part) for part in np.array_split(q, parts)])[:, 0]


def test_it_is_the_sign_of_the_motion_once_the_joint_has_turned_round():
    position = np.concatenate([np.linspace(0.0, 1.0, 2001), np.linspace(1.0, 0.0, 2001)])
    z = dahl(position)
    np.testing.assert_allclose(z[[2000, -1]], [1.0, -1.0], atol=1e-12)
    assert np.isnan(z[:100]).all()  # a twentieth of the way: nobody knows how it began
    assert np.abs(z[101:]).max() <= 1.0
    np.testing.assert_array_equal(dahl(position, parts=37), z)


def test_a_length_after_the_reversal_it_has_come_round_by_its_own_law():
    forth, back = np.linspace(0.0, 1.0, 1001), np.linspace(1.0, 0.9, 1001)
    z = dahl(np.concatenate([forth, back]))
    np.testing.assert_allclose(z[1001:], -1.0 + 2.0 * np.exp(-(1.0 - back) / LENGTH_rad), atol=1e-9)


def test_a_joint_at_rest_and_a_gap_keep_it():
    position = np.concatenate([np.linspace(1.0, 0.0, 500), np.linspace(0.0, 0.005, 50), np.full(50, 0.005)])
    z = dahl(position)
    np.testing.assert_array_equal(z[550:], z[549])
    position[560:570] = np.nan
    np.testing.assert_array_equal(dahl(position), z)


def test_a_motor_of_two_joints_stops_where_they_cancel():
    friction = CoulombFriction([Motor("a", (("a", 1.0),)), Motor("m", (("a", 1.0), ("b", -2.0)))], JOINTS)
    q, dq = np.zeros((3, 2)), np.array([[1.0, 1.0], [3.0, 1.0], [2.0, 1.0]])
    np.testing.assert_array_equal(friction.follow(q, dq), [[1.0, -1.0], [1.0, 1.0], [1.0, 0.0]])
    with pytest.raises(UnknownFrameError, match="turns with 'c'; joints are a, b"):
        CoulombFriction([Motor("m", (("c", 1.0),))], JOINTS)
