"""Serial buses in real time: pseudo-terminals, opened by pyserial."""

import os
import time

import pytest
import serial

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import PtySerial
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.buses.serial_rig import Echo
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import MS, START_NS


@pytest.fixture
def pty(tmp_path):
    """A link and a bus with an echo in real time."""
    link = PtySerial(tmp_path / "by-id-echo")
    bus = SerialBus(link)
    bus.add(Echo(time.monotonic_ns()))
    with RealTime(bus):
        yield link, bus
    link.close()


@pytest.mark.realtime
def test_pyserial_on_a_pseudo_terminal(pty):
    link, _ = pty
    with serial.Serial(link.path, 115_200, timeout=1.0) as port:
        port.write(bytes(range(256)))
        assert port.read(256) == bytes(range(256))


@pytest.mark.realtime
@pytest.mark.parametrize("baud_rate", [9600, 57_600, 128_000, 230_400])
def test_the_speed_that_pyserial_sets_is_seen(pty, baud_rate):
    link, bus = pty
    with serial.Serial(link.path, baud_rate, timeout=0.3) as port:
        port.write(b"hello")
        assert port.read(5) != b"hello"
        assert link.line == LineFormat(baud_rate)
        port.baudrate = 115_200
        time.sleep(0.05)
        port.reset_input_buffer()
        port.write(b"hello")
        assert port.read(5) == b"hello"
    assert link.line is None
    assert bus.to_device == 10


def test_closing_a_terminal_sends_what_is_still_in_it():
    link, echo = PtySerial(), Echo()
    bus = SerialBus(link)
    bus.add(echo)
    with serial.Serial(link.path, 115_200) as port:
        bus.advance(START_NS)
        port.write(b"stop")
    for ms in range(5):
        bus.advance(START_NS + ms * MS)
    assert bytes(echo.heard) == b"stop"
    link.close()


@pytest.mark.realtime
def test_pulled_out_and_put_back(pty):
    link, bus = pty
    now_ns = time.monotonic_ns()
    with serial.Serial(link.path, 115_200, timeout=5.0) as port:
        bus.inject(FaultPlan([Fault("unplug", "line", 0.1, 0.6)], now_ns).of("line"))
        with pytest.raises(serial.SerialException):
            port.read(1)
    assert not os.path.lexists(link.path)
    with pytest.raises(serial.SerialException, match="No such file"):
        serial.Serial(link.path, 115_200)
    while not os.path.lexists(link.path):
        time.sleep(0.01)
    assert time.monotonic_ns() - now_ns > 590 * MS
    with serial.Serial(link.path, 115_200, timeout=1.0) as port:
        port.write(b"again")
        assert port.read(5) == b"again"


def test_a_terminal_that_nobody_opens_gives_and_takes_nothing():
    link = PtySerial()
    assert (link.line, link.take(), link.files) == (None, b"", [])
    link.give(b"into the void")
    assert link.take() == b""
    with serial.Serial(link.path, 9600, timeout=0.05) as port:
        assert link.files
        assert port.read(5) == b""
    link.unplug()
    assert (link.line, link.take(), link.files) == (None, b"", [])
    link.give(b"x")


def test_what_is_given_is_not_echoed_to_a_user_who_sets_nothing():
    link = PtySerial()
    user = os.open(link.path, os.O_RDWR | os.O_NOCTTY)
    link.give(b"a\x03\r\n\x04")
    assert os.read(user, 99) == b"a\x03\r\n\x04"
    assert link.take() == b""
    os.close(user)
    link.close()


def test_a_user_who_never_reads_loses_characters():
    link = PtySerial()
    with serial.Serial(link.path, 115_200):
        for _ in range(300):
            link.give(bytes(1000))
        assert link.overrun > 100_000
    link.close()
