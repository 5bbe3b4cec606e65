"""Faults of the CAN bus and the I2C bus."""

import errno

import numpy as np
import pytest

from hil_sim.buses.media import CanBus, I2cBus
from hil_sim.devices.can_bus.can_wire import Babbler, CanWire
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.faults import Fault
from tests.hil_sim.devices.twin_bench import MS, START_NS, RateClock
from tests.hil_sim.faults.fault_bench import S, errno_of, imu_with, of


class Link:
    """The flight computer's CAN interface as two lists."""

    listening = True

    def __init__(self):
        self.sent, self.frames, self.errors = [], [], []

    def take(self):
        sent, self.sent = self.sent, []
        return sent

    def give(self, frames):
        self.frames += frames

    def give_error(self, end_ns, classes):
        self.errors.append((end_ns, classes))


def can_with(*faults, until_ms=100):
    link = Link()
    bus = CanBus(link, latency_ns=0, jitter_ns=0)
    bus.add(SyncBox(RateClock(), START_NS))
    bus.inject(of(*faults))
    for ms in range(1, until_ms + 1):
        bus.advance(START_NS + ms * MS)
    return bus, link


def test_bus_off_cuts_both_ways_and_says_so():
    bus, link = can_with(Fault("bus_off", "x", 0.02, 0.06))
    assert len(link.frames) == 12
    assert bus.dropped == 8
    assert bus.heard[0x080] == 20
    assert link.errors == [(START_NS + 20 * MS, 0x040), (START_NS + 60 * MS, 0x100)]
    both = [can_with(*faults) for faults in ((Fault("bus_off", "x", 0.0, 9.0),), ())]
    for bus, link in both:
        link.sent.append((0x000, b"\x01\x00"))
        bus.advance(START_NS + 110 * MS)
    assert both[0][0].due_ns == both[1][0].due_ns


def test_error_frames_lose_nothing():
    bus, link = can_with(Fault("error_frames", "x", 0.02, 0.06, 0.01))
    assert link.errors == [(START_NS + ms * MS, 0x088) for ms in (20, 30, 40, 50)]
    assert len(link.frames) == 20
    assert bus.errors == 4


def test_a_bus_that_delays_keeps_the_order():
    _, link = can_with(Fault("delayed", "x", 0.02, 0.04, 0.012))
    assert [frame.data[0] for frame in link.frames] == list(range(1, 21))
    times = [frame.host_ns - START_NS - 5 * MS * k for k, frame in enumerate(link.frames)]
    assert [time // MS for time in times] == [0] * 4 + [12] * 4 + [7, 2] + [0] * 10


def test_a_loose_connector_of_the_flight_computer_loses_half():
    bus, link = can_with(Fault("intermittent", "x", 0.0, 0.1, 0.02))
    assert len(link.frames) == bus.dropped == 10


@pytest.mark.parametrize(("identifier", "heard"), [(0x001, 12), (0x7F0, 20)])
def test_a_flood_starves_what_has_less_priority_and_nothing_else(identifier, heard):
    bus, link = can_with(Fault("flood", "x", 0.019, 0.059, identifier))
    assert bus.heard[0x080] == heard + (identifier == 0x001)  # the newest of those that waited comes in the end
    assert bus.heard[identifier] > 0.85 * 40e6 / 250e3
    assert [f.identifier for f in link.frames if f.identifier == identifier and f.host_ns > START_NS + 61 * MS] == []


def test_a_babbler_leaves_no_room():
    wire = CanWire()
    wire.add(Babbler(0x123, START_NS, START_NS + S), lambda identifier: True)
    frames = wire.advance(START_NS + 100 * MS)
    steps = np.diff([frame.end_ns for frame in frames])
    assert set(steps.tolist()) == {steps[0]}
    assert wire.overwritten[0x123] <= 1


def test_i2c_bus_faults():
    bus = I2cBus()
    bus.add(imu_with())
    bus.inject(
        of(
            Fault("stuck_bus", "x", 0.0, 1.0),
            Fault("timeout", "x", 1.0, 2.0),
            Fault("intermittent", "x", 2.0, 3.0, 0.2),
        )
    )
    found = [errno_of(bus, START_NS + t * MS) for t in (500, 1500, 2050)]
    assert found == [errno.EBUSY, errno.ETIMEDOUT, errno.EREMOTEIO]
    assert bus.transfer(0x68, b"\x75", 1, START_NS + 2150 * MS) == b"\x68"
    assert bus.refused == 3
