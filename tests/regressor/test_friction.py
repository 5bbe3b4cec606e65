"""Coulomb friction with a way to turn round."""

import numpy as np

from onboard.regressor.friction import presliding

LENGTH_rad = 0.01


def test_it_is_the_sign_of_the_motion_once_the_joint_has_turned_round():
    position = np.concatenate([np.linspace(0.0, 1.0, 2001), np.linspace(1.0, 0.0, 2001)])
    z = presliding(position, LENGTH_rad)
    np.testing.assert_allclose(z[[2000, -1]], [1.0, -1.0], atol=1e-12)
    assert np.abs(z).max() <= 1.0


def test_a_length_after_the_reversal_it_has_come_round_by_its_own_law():
    forth, back = np.linspace(0.0, 1.0, 1001), np.linspace(1.0, 0.9, 1001)
    z = presliding(np.concatenate([forth, back]), LENGTH_rad)
    away = 1.0 - back
    np.testing.assert_allclose(z[1001:], -1.0 + 2.0 * np.exp(-away / LENGTH_rad), atol=1e-9)


def test_a_joint_at_rest_keeps_its_friction():
    z = presliding(np.concatenate([np.linspace(0.0, 0.005, 50), np.full(50, 0.005)]), LENGTH_rad)
    np.testing.assert_array_equal(z[50:], z[49])
