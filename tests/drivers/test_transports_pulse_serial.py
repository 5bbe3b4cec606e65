"""Pulse and serial ports: a libgpiod request of the test's own, datagrams, ptys."""

import contextlib
import errno
import os
import pty
import socket
import struct
import tty
from types import SimpleNamespace

import gpiod
import pytest
from gpiod.line import Clock, Direction, Edge

from drivers.transports import open_pulse, open_pulse_output, open_serial


class Chip:
    """libgpiod on a chip that can be unplugged: every request of before then fails for ever."""

    def __init__(self):
        self.present, self.tries, self.requests = True, 0, []

    def request_lines(self, path, config, **named):
        self.tries += 1
        if not self.present:
            raise FileNotFoundError(errno.ENOENT, "No such file", path)
        self.requests.append(Request(self))
        return self.requests[-1]

    def unplug(self):
        self.present = False
        for request in self.requests:
            request.dead = True


class Request:
    def __init__(self, chip):
        self.chip, self.dead, self.released, self.driven = chip, False, False, []

    def wait_edge_events(self, timeout_s):
        return True

    def read_edge_events(self, most):
        self._alive()
        return [SimpleNamespace(timestamp_ns=5, line_seqno=1)]

    def set_value(self, line, value):
        self._alive()
        self.driven.append(value)

    def release(self):
        self.released = True

    def _alive(self):
        if self.dead:
            raise OSError(errno.ENODEV, "No such device")


@pytest.mark.parametrize("output", [False, True])
def test_a_gpio_chip_that_was_unplugged_is_opened_again_with_back_off(monkeypatch, clock, output):
    chip = Chip()
    monkeypatch.setattr(gpiod, "request_lines", chip.request_lines)
    open_port = open_pulse_output if output else open_pulse
    port = open_port(f"gpio{'-out' if output else ''}:///dev/gpiochip0?line=4", clock)
    use = (lambda: port.drive(True)) if output else (lambda: port.receive(0.0))
    use()
    chip.unplug()
    with pytest.raises(OSError, match="No such device"):
        use()
    assert chip.requests[0].released
    chip.tries = 0
    for _ in range(100):  # 1 s in steps of 10 ms
        clock.now_ns += 10_000_000
        with pytest.raises(OSError, match="sync line is gone"):
            use()
    assert 4 <= chip.tries <= 7, "after 20, 40, 80 ms and so on"
    chip.present = True
    clock.now_ns += 1_000_000_000
    if output:
        port.wait_until(clock())
    assert use()
    assert (port.reopened, len(chip.requests)) == (1, 2)
    port.close()
    assert chip.requests[1].released
    clock.now_ns += 10_000_000_000
    with pytest.raises(OSError, match="sync line is gone"):
        use()  # closed for good


def test_a_gpio_line_is_asked_for_rising_edges_in_monotonic_time(monkeypatch, clock):
    asked = {}
    events = [
        [SimpleNamespace(timestamp_ns=100, line_seqno=7), SimpleNamespace(timestamp_ns=250, line_seqno=9)],
    ]

    class Request:
        released = False

        def wait_edge_events(self, timeout_s):
            asked["timeout_s"] = timeout_s
            return bool(events)

        def read_edge_events(self, most):
            return events.pop(0)

        def release(self):
            Request.released = True

    def request_lines(path, config, **named):
        asked.update(path=path, config=config, **named)
        return Request()

    monkeypatch.setattr(gpiod, "request_lines", request_lines)
    port = open_pulse("gpio:///dev/gpiochip3?line=17", clock)
    (settings,) = asked["config"].values()
    assert (asked["path"], list(asked["config"])) == ("/dev/gpiochip3", [17])
    assert settings.direction is Direction.INPUT
    assert settings.edge_detection is Edge.RISING
    assert settings.event_clock is Clock.MONOTONIC
    assert asked["event_buffer_size"] >= 64
    clock.now_ns = 999
    assert port.receive(0.25) == [(100, 999, 7), (250, 999, 9)]
    assert asked["timeout_s"] == 0.25
    assert port.receive(0.0) == []
    port.close()
    assert Request.released


@pytest.fixture
def line(tmp_path, clock):
    path = tmp_path / "edges.sock"
    port = open_pulse(f"gpio+unix://{path}", clock)
    sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    sender.connect(str(path))
    yield port, sender, path
    sender.close()
    port.close()


def test_edges_come_as_datagrams(line, clock):
    port, sender, _ = line
    assert port.receive(0.0) == port.receive(0.01) == []
    sender.send(struct.pack("<qI", -5, 1))
    sender.send(b"junk")
    sender.send(struct.pack("<qI", 7_000_000_000, 0xFFFF_FFFF))
    assert port.receive(1.0) == [(-5, clock(), 1), (7_000_000_000, clock(), 0xFFFF_FFFF)]
    assert port.damaged == 1


def test_the_socket_of_a_dead_run_is_replaced_and_a_file_is_not(tmp_path, clock):
    path = tmp_path / "edges.sock"
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    dead.bind(str(path))
    dead.close()
    port = open_pulse(f"gpio+unix://{path}", clock)
    port.close()
    assert not path.exists()
    path.write_text("precious")
    with pytest.raises(OSError, match="in use"):
        open_pulse(f"gpio+unix://{path}", clock)
    assert path.read_text() == "precious"


def test_a_serial_port_reads_what_is_there_and_does_not_wait():
    master, slave = pty.openpty()
    tty.setraw(slave)
    port = open_serial(f"serial://{os.ttyname(slave)}?baud=230400&parity=E&stop_bits=2")
    assert port.read(10) == b""
    os.write(master, b"hello")
    data = b""
    while len(data) < 5:
        data += port.read(max(port.in_waiting, 1))
    assert data == b"hello"
    assert port.write(b"S0E\r") == 4
    assert os.read(master, 10) == b"S0E\r"
    assert (port.baudrate, port.parity, port.stopbits) == (230_400, "E", 2)
    port.close()
    os.close(slave)
    os.close(master)


def test_a_serial_port_pulled_out_is_an_os_error():
    master, slave = pty.openpty()
    port = open_serial(f"serial://{os.ttyname(slave)}?baud=115200&timeout_s=0.05")
    os.close(slave)
    os.close(master)
    with pytest.raises(OSError, match=r"."):
        port.read(1)
    port.close()


def test_a_line_driven_into_a_socket_is_seen_by_whoever_bound_it(tmp_path, clock):
    path = tmp_path / "loop.sock"
    output = open_pulse_output(f"gpio-out+unix://{path}", clock)
    clock.now_ns = 100
    assert output.drive(True) == (100, 100)  # nobody looks yet
    assert output.untaken == 1
    with contextlib.closing(open_pulse(f"gpio+unix://{path}", clock)) as line:
        output.drive(True)  # high already: no edge
        output.drive(False)
        assert line.receive(0.0) == []
        clock.now_ns = 300
        output.drive(True)
        assert line.receive(0.0) == [(300, 300, 2)]
    output.close()
