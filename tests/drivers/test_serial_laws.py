"""What holds of every driver on a serial line or a network: a fault at any call of its port, the sum of its rows."""

from collections.abc import Callable
from functools import partial
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
from tests.drivers.batches import codes, whole
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
    "robotous_rft": Line(test_robotous_rft.Flight, lambda one: one.packets(40), lambda one: one.packets(60), 60, 11),
    "net_ft": Line(test_net_ft.Flight, lambda one: one.records(6), lambda one: one.records(20), 14, 11),
    "onrobot_hex": Line(test_net_ft.hex_flight, lambda one: one.records(9), lambda one: one.records(20), 20, 9),
    "ur_rtde": Line(rtde_flight.Flight, lambda one: one.packages(6), lambda one: one.packages(20), 20, 11),
    "pose_tracker": Line(test_pose_tracker.flight_closed, test_pose_tracker.fly, test_pose_tracker.fly_on, 20, 40),
    "node_frame": Line(lambda: node_flight.Flight(VirtualClock()), described, described, 20, 80),
    "dsc": flown(test_dsc.Flight, 30, 50, 20, 11),
    "dynamixel": flown(test_dynamixel_device.Flight, 80, 40, 50, 4),
    "modbus": flown(test_modbus_device.Flight, 60, 60, 50, 11),
    "nimu": flown(test_nimu_device.Flight, 30, 10, 30, 91),
    "qsb": flown(qsb_flight.Flight, 30, 15, 60, 121),
}


@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.campaign)])  # calls between those of the other
@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_a_fault_at_any_call_is_told_and_loses_no_count(line, every):
    for flight in fault_at_any_call(line.make, line.fly, line.on, line.calls, every):
        for channel in flight.device.channels:
            if not channel.endswith("_mark"):
                assert len(whole(flight.batches, channel)) >= line.rows


@pytest.mark.parametrize("most", [1, 4, 5])
@pytest.mark.parametrize(
    ("flight_of", "pumps", "said"),
    [
        (test_dsc.Flight, 100, ["started"]),
        (test_modbus_device.Flight, 300, ["scale", "started"]),
        (partial(test_dynamixel_device.Flight, timeout_ms=200.0), 2000, None),
    ],
    ids=["dsc", "modbus", "dynamixel"],
)
def test_an_answer_in_pieces_is_put_together(clock, flight_of, pumps, said, most):
    flight = flight_of(clock)
    flight.port.most = most
    flight.start()
    flight.fly(pumps)
    assert all(len(whole(flight.batches, channel)) > 5 for channel in flight.device.channels)
    assert said in (None, codes(flight.batches))
    assert "bad_frame" not in codes(flight.batches)


@pytest.mark.parametrize(
    ("flight_of", "pumps", "rows"),
    [(partial(test_modbus_device.Flight, echo=True), 50, 20), (test_dynamixel_device.Flight, 100, 15)],
    ids=["modbus", "dynamixel"],
)
def test_an_adapter_that_hears_itself(clock, flight_of, pumps, rows):
    flight = flight_of(clock, delay_ns=0)
    receive = flight.model.receive
    flight.model.receive = lambda request: request + receive(request)
    flight.start()
    flight.fly(pumps)
    assert all(len(whole(flight.batches, channel)) > rows for channel in flight.device.channels)
    assert "bad_frame" not in codes(flight.batches)
