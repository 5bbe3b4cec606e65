"""The demand of a drive's servo between set points."""

import numpy as np
import pytest

from hil_sim.devices.canopen.servo_loop import ServoLoop
from hil_sim.plants.drives.servo_axis import STEP_S, ServoAxis

PERIOD_S = 0.005
RATE = 0.6  # rad/s


@pytest.mark.parametrize("behind", [0, 2, 5], ids="{} steps behind".format)
@pytest.mark.parametrize("phase_s", [0.0001, 0.0005, 0.00095])
def test_the_demand_is_a_line_through_even_set_points(phase_s, behind):
    """Wherever in a step a set point comes, and however far the loop is behind the bus."""
    loop, demand = ServoLoop(ServoAxis(), lambda time_s: 0.0), []
    for step in range(100):
        now_s = step * STEP_S
        if step % 5 == 1:
            loop.go_to(now_s - phase_s, RATE * (now_s - phase_s + PERIOD_S))
        loop.follow_line(now_s - behind * STEP_S, PERIOD_S)
        demand.append(loop.demand)
    assert np.diff(demand)[20:] == pytest.approx(RATE * STEP_S, rel=1e-6)


def test_a_line_after_a_ramp_begins_where_the_ramp_ended():
    loop = ServoLoop(ServoAxis(), lambda time_s: 0.0)
    loop.go_to(0.0, 0.1)
    for step in range(1, 4):
        loop.follow_line(step * STEP_S, PERIOD_S)
    for _ in range(100):
        loop.slow_down(300.0)
    stood = loop.demand
    loop.go_to(0.2, stood + 0.01)
    loop.follow_line(0.2 + 0.5 * PERIOD_S, PERIOD_S)
    assert stood > 0.06
    assert loop.demand == pytest.approx(stood + 0.005)
