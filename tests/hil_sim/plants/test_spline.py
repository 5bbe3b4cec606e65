"""The simulator's cubic splines against SciPy's."""

import numpy as np
import pytest
from scipy import interpolate

from hil_sim.plants.motions.spline import CubicSpline


@pytest.mark.parametrize("clamped", [False, True])
@pytest.mark.parametrize("columns", [(), (3,), (0,)])
@pytest.mark.parametrize("knots", [2, 3, 4, 5, 700])
def test_values_and_derivatives_are_those_of_scipy(
    knots: int, columns: tuple[int, ...], clamped: bool, rng: np.random.Generator
) -> None:
    """To the bit, at the knots, between and beyond them; a parabola through three to rounding."""
    x = np.cumsum(rng.uniform(0.5, 1.5, knots))
    values = rng.standard_normal((knots, *columns))
    ours = CubicSpline(x, values, clamped=clamped)
    theirs = interpolate.CubicSpline(x, values, bc_type="clamped" if clamped else "not-a-knot")
    at = np.concatenate([np.linspace(x[0] - 0.3, x[-1] + 0.3, 777), x])
    for derivative in range(3):
        made, expected = ours(at, derivative), theirs(at, derivative)
        assert made.shape == expected.shape == (len(at), *columns)
        if knots == 3 and not clamped:
            np.testing.assert_allclose(made, expected, rtol=1e-11, atol=1e-13)
        else:
            np.testing.assert_array_equal(made, expected)
    assert ours(float(x[0])).shape == columns
