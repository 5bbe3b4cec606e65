"""What is stated of a bias that drifts grows with the flight's length."""

import numpy as np
import pytest

from onboard.identification.free_flyer.innovation import stated_after
from tests.identification.free_flyer.recorded_flights import PRIOR, online


@pytest.mark.parametrize(("time_s", "drifted_s"), [(0.0, 20.0), (20.0, 20.0), (3600.0, 3600.0)])
def test_a_bias_may_be_what_its_drift_makes_of_it(held, time_s, drifted_s):
    predictor = online(held, imu_prior=PRIOR).predictor
    stated, biases = stated_after(predictor, time_s), [at for at, _ in predictor.biases]
    assert biases
    for bias, drift in predictor.biases:
        assert stated[bias] == pytest.approx(np.hypot(predictor.sigma[bias], drifted_s * predictor.sigma[drift]))
    others = np.setdiff1d(np.arange(len(stated)), biases)
    np.testing.assert_array_equal(stated[others], predictor.stated[others])
