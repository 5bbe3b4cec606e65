"""Cyclic errors of several encoders, beside each other."""

import numpy as np

from onboard.flight.estimate.readings.cyclic import cyclic_functions, cyclic_of


def test_errors_of_channels_beside_each_other_are_those_of_each_alone() -> None:
    """The second of three has none; the first is two columns wide, and its angle the first of these."""
    ripples = ((100.0, 1e-5), (200.0, 2e-5)), (), ((50.0, 3e-5),)
    found = cyclic_of(ripples, (2, 1, 1))
    assert found.columns.tolist() == [0, 0, 3]
    assert found.periods.tolist() == [100.0, 200.0, 50.0]
    assert found.rms.tolist() == [1e-5, 2e-5, 3e-5]
    assert found.ends == [2, 2, 3]
    angles = np.linspace(0.0, 1.0, 8).reshape(2, 4)
    functions = cyclic_functions(angles[:, found.columns] * found.periods)
    assert functions.shape == (2, 6)
    for k, (column, periods) in enumerate(((0, 100.0), (0, 200.0), (3, 50.0))):
        turned = periods * angles[:, column]
        np.testing.assert_array_equal(functions[:, 2 * k : 2 * k + 2].T, [np.cos(turned), np.sin(turned)])
    assert not cyclic_of(((), ()), (1, 1)).columns.size
