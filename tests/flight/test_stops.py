"""The end of a flight: what a device sends before it has the request to end its stream is read."""

import numpy as np
import pytest

from drivers import transports
from tests.flight.mixed import MixedWorld, only, vehicle
from tests.hil_sim.devices.twin_bench import MS


@pytest.mark.parametrize(("device", "twin"), [("hand", "hand"), ("robot_8", "robot")])
def test_what_is_sent_before_the_stop_is_heard_is_read(tmp_path, monkeypatch, device, twin):
    with MixedWorld(tmp_path, only("imu_tip", device)) as world:
        waits = []

        def rest(seconds):
            waits.append(seconds)
            world.advance(round(1e9 * seconds))

        monkeypatch.setattr(transports, "rest", rest)
        heard = world.fly(world.open(vehicle(tmp_path, world.urls, only("imu_tip", device))), 1.0)
        world.advance(100 * MS)
        assert len(np.concatenate(heard[device])) == getattr(world, twin).produced > 100
        assert "gap" not in heard
        assert 0.0 < sum(waits) < 0.1


@pytest.mark.parametrize("device", ["hand", "robot_8", "finger", "elbow"])
def test_a_clock_that_stands_is_not_waited_for(tmp_path, monkeypatch, device):
    waits = []
    monkeypatch.setattr(transports, "rest", waits.append)
    with MixedWorld(tmp_path, only("imu_tip", device)) as world:
        world.fly(world.open(vehicle(tmp_path, world.urls, only("imu_tip", device))), 1.0)
    assert len(waits) == 1
