"""Serial lines: a pty whose other end hangs up, and the kernel's own slcan driver on our simulated adapter.

PPS_FETCH on the kernel's timer source: what a flight computer without a GPIO line has for a sync pulse.
"""

import fcntl
import itertools
import os
import struct
import termios
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import network
import pytest
import serial

from drivers.ports import CanFrame
from drivers.transports import open_can, open_pulse, open_serial
from drivers.transports.clock import realtime_minus_monotonic
from hil_sim.buses.can.slcan import SlcanAdapter
from onboard.config.telemetry import Telemetry
from onboard.telemetry.process import sending
from onboard.telemetry.stream import Series, Splitter
from tests.telemetry.test_process import Line, flight

PPS_FETCH = 0xC008_70A4  # linux/pps.h, _IOWR('p', 0xa4, struct pps_fdata *)
FDATA = struct.Struct("=IIqiIqiIi4xqiI")  # two sequences, assert and clear stamps, mode; the timeout


class Edge(NamedTuple):
    sequence: int
    realtime_ns: int


@pytest.fixture
def pps() -> Iterator[int]:
    source = os.open("/dev/pps0", os.O_RDWR)
    yield source
    os.close(source)


def fetch(source: int, timeout_s: float) -> Edge:
    """The next edge."""
    seconds = int(timeout_s)
    timeout = (seconds, int((timeout_s - seconds) * 1e9), 0)
    raw = bytearray(FDATA.pack(*[0] * 9, *timeout))
    fcntl.ioctl(source, PPS_FETCH, raw)
    sequence, _, sec, nsec, *_ = FDATA.unpack(raw)
    return Edge(sequence, sec * 1_000_000_000 + nsec)


def test_edges_are_numbered_and_a_second_apart(pps: int) -> None:
    edges = [fetch(pps, 5.0) for _ in range(3)]
    assert [edge.sequence - edges[0].sequence for edge in edges] == [0, 1, 2]
    for one, two in itertools.pairwise(edges):
        period_s = (two.realtime_ns - one.realtime_ns) * 1e-9
        assert 1.0 <= period_s < 1.2  # pps-ktimer re-arms itself a tick or more late (HZ = 100)


def test_a_stamp_moves_to_the_monotonic_clock(pps: int) -> None:
    before_ns = time.monotonic_ns()
    edge = fetch(pps, 5.0)
    after_ns = time.monotonic_ns()
    edge_ns = edge.realtime_ns - realtime_minus_monotonic(time.monotonic_ns)
    assert before_ns < edge_ns < after_ns


def test_sysfs_says_the_same(pps: int) -> None:
    edge = fetch(pps, 5.0)
    stamp, sequence = Path("/sys/class/pps/pps0/assert").read_text(encoding="ascii").strip().split("#")
    seconds, nanoseconds = stamp.split(".")
    assert int(sequence) == edge.sequence
    assert int(seconds) * 1_000_000_000 + int(nanoseconds) == edge.realtime_ns


def test_no_edge_in_time_is_an_error(pps: int) -> None:
    fetch(pps, 5.0)
    with pytest.raises(TimeoutError):
        fetch(pps, 0.1)


def test_the_port_gives_each_edge_once_in_monotonic_time() -> None:
    port = open_pulse("pps:///dev/pps0", time.monotonic_ns)
    assert port.receive(0.0) == []  # the edge from before it was opened is nobody's
    edges = []
    while len(edges) < 3:
        before_ns = time.monotonic_ns()
        got = port.receive(2.0)
        after_ns = time.monotonic_ns()
        assert len(got) == 1
        assert before_ns < got[0].edge_ns < got[0].host_ns < after_ns
        edges += got
        assert port.receive(0.0) == []
    assert [edge.line_sequence - edges[0].line_sequence for edge in edges] == [0, 1, 2]
    assert port.receive(0.05) == []
    port.close()


def test_the_port_says_which_edges_it_could_not_keep() -> None:
    port = open_pulse("pps:///dev/pps0", time.monotonic_ns)
    (one,) = port.receive(2.0)
    time.sleep(2.5)  # two edges, of which the kernel keeps the last
    (two,) = port.receive(2.0)
    assert two.line_sequence - one.line_sequence == 2
    port.close()


def test_this_kernel_has_no_gpio_and_says_so() -> None:
    with pytest.raises(FileNotFoundError):
        open_pulse("gpio:///dev/gpiochip0?line=17", time.monotonic_ns)


TIOCSETD = 0x5423  # asm-generic/ioctls.h
N_SLCAN = 17  # linux/tty.h


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    yield master, os.ttyname(slave)
    os.close(slave)


def test_bytes_go_both_ways_untouched(pty: tuple[int, str]) -> None:
    master, path = pty
    port = open_serial(f"serial://{path}?baud=230400")
    everything = bytes(range(256))
    os.write(master, everything)
    received = b""
    deadline = time.monotonic() + 5.0
    while len(received) < 256 and time.monotonic() < deadline:
        received += port.read(512)
    assert received == everything  # no CR, XON or 0x04 was taken for a command
    assert port.write(everything) == 256
    assert os.read(master, 512) == everything
    port.close()
    os.close(master)


def test_an_unplugged_adapter_is_an_error_and_not_silence(pty: tuple[int, str]) -> None:
    master, path = pty
    port = open_serial(f"serial://{path}?baud=115200&timeout_s=1")
    os.close(master)
    with pytest.raises(serial.SerialException):
        port.read(1)
    port.close()


def test_the_port_is_ours_alone(pty: tuple[int, str]) -> None:
    master, path = pty
    port = open_serial(f"serial://{path}?baud=115200")
    with pytest.raises(OSError, match="lock"):
        open_serial(f"serial://{path}?baud=115200")
    port.close()
    os.close(master)


@pytest.fixture
def slcan() -> Iterator[tuple[SlcanAdapter, str]]:
    """Our adapter at 500 kbit/s, open, with the kernel's line discipline at its other end; the interface's name."""
    adapter = SlcanAdapter(500_000)
    tty = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY)
    os.write(tty, b"S6\rO\r")  # as slcand does
    assert adapter.take() == []
    assert adapter.is_open
    assert os.read(tty, 16) == b"\r\r"
    before = set(os.listdir("/sys/class/net"))
    fcntl.ioctl(tty, TIOCSETD, struct.pack("=i", N_SLCAN))
    (name,) = set(os.listdir("/sys/class/net")) - before
    network.set_up(name)
    yield adapter, name
    network.set_up(name, False)
    os.close(tty)
    adapter.close()


def test_the_kernels_slcan_driver_understands_our_adapter(slcan: tuple[SlcanAdapter, str]) -> None:
    adapter, name = slcan
    port = open_can(f"can+socketcan://{name}?bitrate=500000", time.monotonic_ns)
    sent = [CanFrame(0, 0x080, b"\x17"), CanFrame(0, 0x7FF, bytes(range(8))), CanFrame(0, 0x181, b"")]
    adapter.give(sent)
    frames: list[CanFrame] = []
    deadline = time.monotonic() + 5.0
    while len(frames) < len(sent) and time.monotonic() < deadline:
        frames += port.receive(0.1)
    port.close()
    assert [(frame.identifier, frame.data) for frame in frames] == [(frame.identifier, frame.data) for frame in sent]


def test_our_adapter_understands_the_kernels_slcan_driver(slcan: tuple[SlcanAdapter, str]) -> None:
    adapter, name = slcan
    port = open_can(f"can+socketcan://{name}?bitrate=500000", time.monotonic_ns)
    sent = [(0x000, b"\x01\x00"), (0x601, bytes.fromhex("4000100000000000")), (0x7FF, b"")]
    taken: list[tuple[int, bytes]] = []
    for identifier, data in sent:
        port.send(identifier, data)
    deadline = time.monotonic() + 5.0
    while len(taken) < len(sent) and time.monotonic() < deadline:
        taken += adapter.take()
        time.sleep(0.01)
    port.close()
    assert taken == sent
    statistics = Path("/sys/class/net", name, "statistics")
    assert (statistics / "tx_packets").read_text(encoding="ascii") == "3\n"
    assert (statistics / "tx_errors").read_text(encoding="ascii") == "0\n"


def test_a_downlink_over_this_kernel_s_line_at_19200_baud(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No more bytes than the line carries, every packet whole and none missing; the line is set as the link says."""
    monkeypatch.setenv("HEFT_RINGS", str(tmp_path / "rings"))
    log, path = tmp_path / "flight.mcap", tmp_path / "tty"
    line, number, flood = Line(path), 0, Telemetry(bytes_s=50_000, answers_hz=10)
    with flight(log) as flown, sending(log, f"serial://{path}?baud=19200", flood):
        began, got = time.monotonic(), 0
        while time.monotonic() < began + 10.0:
            number += 1
            flown.second(number)
            time.sleep(0.02)
            if not got and line.data:
                began, got = time.monotonic(), len(line.data)
        carried = (len(line.data) - got) / (time.monotonic() - began)
        tty = os.open(path, os.O_RDWR | os.O_NOCTTY)
        speeds = termios.tcgetattr(tty)[4:6]
        os.close(tty)
    line.pull()
    assert speeds == [termios.B19200, termios.B19200]
    assert 0.5 * 1920 < carried <= 0.95 * 1920 + 100
    stream, series = Splitter(flood.apids), Series()
    found = stream.feed(line.data) + stream.finish()
    assert len(found) > 50
    assert all(series.place(packet) == (True, 0) for packet in found)
    assert (stream.skipped, stream.refused) == (0, {})
