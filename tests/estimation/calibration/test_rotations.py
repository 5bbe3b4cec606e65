"""Rotation vectors and their matrices against SciPy's."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.estimation.calibration.rotations import rotation_vector, turn

AXES = [*np.eye(3), *-np.eye(3), [1.0, -2.0, 0.5], [-0.3, 0.1, -3.0]]


@pytest.mark.parametrize("angle", [1e-12, 1e-7, 0.3, 2.0, 2.3, 3.0, np.pi - 1e-9])
@pytest.mark.parametrize("axis", AXES)
def test_both_are_scipys(axis, angle):
    v = angle * np.array(axis) / np.linalg.norm(axis)
    M = Rotation.from_rotvec(v).as_matrix()
    np.testing.assert_allclose(turn(v), M, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(rotation_vector(M), v, rtol=1e-14, atol=2e-15)


def test_no_turn():
    np.testing.assert_array_equal(turn(np.zeros(3)), np.eye(3))
    np.testing.assert_array_equal(rotation_vector(np.eye(3)), np.zeros(3))
