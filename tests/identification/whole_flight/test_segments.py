"""Windows of a flight in which the push on the base is another one in each."""

import numpy as np
import pytest

from onboard.identification.free_flyer.prediction.further import DisturbancePrior
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.whole_flight.segments import Segment, others_in, pushed
from onboard.identification.windows import WINDOW_s
from tests.identification.free_flyer.recorded_flights import PRIOR
from tests.identification.whole_flight.flights import segments


def disturbed(predictor, force_N, torque_N_m, memory_s):
    push = DisturbancePrior(force_N, torque_N_m, memory_s)
    return ImuPredictor(predictor.vehicle, "imu_base", predictor.period_s, 5, {}, PRIOR, disturbance=push)


def test_where_nothing_pushes_the_flight_stays_whole(ticks, predictor):
    whole = segments(ticks)
    assert pushed(predictor, whole) == (whole, [])


@pytest.mark.parametrize("memory_s", [3.0, 60.0])
def test_from_window_to_window_the_push_changes_as_its_process_does(ticks, predictor, memory_s):
    pusher = disturbed(predictor, 0.01, 0.002, memory_s)
    windows, changed = pushed(pusher, [Segment(ticks, held=True)])
    assert len(windows) == len(changed) + 1 > 2
    assert sum(len(one.ticks.time_s) for one in windows) == len(ticks.time_s)
    assert max(np.ptp(one.ticks.time_s) for one in windows) <= WINDOW_s
    names, along = others_in(windows, changed, len(pusher.names))
    assert len(names) == 6 * len(changed)
    apart_s = windows[1].ticks.time_s[0] - windows[0].ticks.time_s[0]
    share = np.sqrt(2.0 * (1.0 - np.exp(-apart_s / memory_s)))
    x = pusher.names.index("disturbance_force_x")
    assert along[0, x, 0] == 0.0
    np.testing.assert_allclose(along[1:, x, 0], 0.01 * share)
    np.testing.assert_allclose(along[1:, pusher.names.index("disturbance_torque_z"), 5], 0.002 * share)
