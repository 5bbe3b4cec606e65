"""What holds of every driver on a serial line or a network: a fault at any call of its port, the sum of its rows."""

from collections.abc import Callable
from typing import NamedTuple

import pytest

from tests.conftest import VirtualClock
from tests.drivers import (
    node_flight,
    qsb_flight,
    rtde_flight,
    test_bota_ft,
    test_dsc,
    test_dynamixel_device,
    test_modbus_device,
    test_net_ft,
    test_nimu_device,
    test_pose_tracker,
    test_robotous_rft,
)
from tests.drivers.batches import whole
from tests.drivers.serial_script import SerialFlight, fault_at_any_call


class Line(NamedTuple):
    """A device on its line.

    Attributes:
        make: Its driver and the other end, not started.
        fly: What is flown with a fault at each call.
        on: What follows.
        calls: Fewest of the first part.
        rows: Fewest of each channel in the end.
    """

    make: Callable[[], SerialFlight]
    fly: Callable[[SerialFlight], object]
    on: Callable[[SerialFlight], object]
    calls: int
    rows: int


def flown(make, first, then, calls, rows):
    """Of a flight that is given a clock and flies so many pumps."""
    return Line(
        lambda: make(VirtualClock()), lambda flight: flight.fly(first), lambda flight: flight.fly(then), calls, rows
    )


def described(flight):
    flight.descend()
    flight.fly(100)


LINES = {
    "bota_ft": Line(test_bota_ft.Flight, lambda one: one.frames(26), lambda one: one.frames(400), 40, 11),
    "robotous_rft": Line(test_robotous_rft.Flight, lambda one: one.packets(40), lambda one: one.packets(300), 60, 11),
    "net_ft": Line(test_net_ft.Flight, lambda one: one.records(6), lambda one: one.records(20), 14, 11),
    "onrobot_hex": Line(test_net_ft.hex_flight, lambda one: one.records(9), lambda one: one.records(20), 20, 9),
    "ur_rtde": Line(rtde_flight.Flight, lambda one: one.packages(6), lambda one: one.packages(20), 20, 11),
    "pose_tracker": Line(test_pose_tracker.flight_closed, test_pose_tracker.fly, test_pose_tracker.fly_on, 20, 40),
    "node_frame": Line(lambda: node_flight.Flight(VirtualClock()), described, described, 20, 80),
    "dsc": flown(test_dsc.Flight, 30, 50, 20, 11),
    "dynamixel": flown(test_dynamixel_device.Flight, 80, 80, 50, 4),
    "modbus": flown(test_modbus_device.Flight, 60, 60, 50, 11),
    "nimu": flown(test_nimu_device.Flight, 30, 10, 30, 91),
    "qsb": flown(qsb_flight.Flight, 30, 15, 60, 121),
}


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_a_fault_at_any_call_is_told_and_loses_no_count(line):
    for flight in fault_at_any_call(line.make, line.fly, line.on, line.calls):
        for channel in flight.device.channels:
            if not channel.endswith("_mark"):
                assert len(whole(flight.batches, channel)) >= line.rows
