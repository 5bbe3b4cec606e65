"""A PPS source whose ioctl is answered here: struct pps_fdata laid out again, by ctypes, from linux/pps.h."""

import ctypes
import errno
import fcntl
import os

import pytest

from drivers.sync_pulse import SyncPulse
from drivers.transports import open_pulse, pps
from tests.drivers.batches import of, whole

S = 1_000_000_000


class Ktime(ctypes.Structure):
    _fields_ = [("sec", ctypes.c_int64), ("nsec", ctypes.c_int32), ("flags", ctypes.c_uint32)]


class Fdata(ctypes.Structure):
    _fields_ = [
        ("assert_sequence", ctypes.c_uint32),
        ("clear_sequence", ctypes.c_uint32),
        ("assert_tu", Ktime),
        ("clear_tu", Ktime),
        ("current_mode", ctypes.c_int),
        ("timeout", Ktime),
    ]


class Source:
    """The kernel's side: ``waits`` are what happens while a fetch waits."""

    def __init__(self):
        self.sequence, self.realtime_ns = 41, 0
        self.timeouts_ns = []
        self.waits = []
        self.error = 0

    def ioctl(self, fd, request, data):
        assert request == (0xC00870A4 if ctypes.sizeof(ctypes.c_void_p) == 8 else 0xC00470A4)
        assert len(data) == ctypes.sizeof(Fdata)
        if self.error:
            raise OSError(self.error, os.strerror(self.error))
        asked = Fdata.from_buffer(data)
        assert asked.timeout.flags == 0, "a fetch that may wait for ever"
        timeout_ns = asked.timeout.sec * S + asked.timeout.nsec
        self.timeouts_ns.append(timeout_ns)
        if timeout_ns:
            happens = self.waits.pop(0) if self.waits else errno.ETIMEDOUT
            if isinstance(happens, int):
                raise OSError(happens, os.strerror(happens))
            happens()
        asked.assert_sequence, asked.clear_sequence = self.sequence, 7
        asked.assert_tu.sec, asked.assert_tu.nsec = divmod(self.realtime_ns, S)
        asked.clear_tu.sec = 99
        return 0

    def edge(self, realtime_ns, steps=1):
        self.sequence, self.realtime_ns = (self.sequence + steps) % (1 << 32), realtime_ns


@pytest.fixture
def source(monkeypatch):
    source = Source()
    monkeypatch.setattr(fcntl, "ioctl", source.ioctl)
    return source


@pytest.fixture
def port(source, monkeypatch, clock):
    """Wall clock 1.7e9 s ahead of the monotonic one."""
    monkeypatch.setattr(pps, "realtime_minus_monotonic", lambda given: 1_700_000_000 * S)
    port = open_pulse("pps:///dev/null", clock)
    yield port
    port.close()


def test_an_edge_is_moved_to_the_monotonic_clock_and_given_once(port, source, clock):
    clock.now_ns = 6 * S
    assert port.receive(0.0) == [], "the edge from before the port was opened is nobody's"
    source.edge(1_700_000_005 * S + 123_456_789)
    assert port.receive(0.5) == [(5 * S + 123_456_789, 6 * S, 42)]
    assert source.timeouts_ns == [0, 0, 0], "an edge that is there is not waited for"
    assert port.receive(0.0) == []


def test_it_waits_for_the_next_edge(port, source):
    source.waits = [lambda: source.edge(1_700_000_001 * S)]
    assert port.receive(1.25)[0].line_sequence == 42
    assert source.timeouts_ns[-1] == 1_250_000_000


@pytest.mark.parametrize("happens", [errno.ETIMEDOUT, errno.EINTR, lambda: None])
def test_a_wait_that_ends_without_an_assert_edge_is_nothing(port, source, happens):
    source.waits = [happens]
    assert port.receive(0.1) == []


def test_a_wait_shorter_than_a_tick_of_the_kernel_is_one_tick(port, source):
    assert port.receive(1e-6) == []
    assert source.timeouts_ns[-1] == 10_000_000


def test_edges_that_were_overwritten_are_a_jump_that_the_device_names(port, source, clock):
    device = SyncPulse("pulse", port)
    batches = device.start(clock())
    source.sequence = 0xFFFF_FFFE
    for number, steps in enumerate((1, 3, 1)):
        source.edge((1_700_000_002 + number) * S, steps)
        batches += device.pump(clock(), 0.1)
    rows = whole(batches, "pulse")
    assert rows["line_sequence"].tolist() == [0xFFFF_FFFF, 2, 3]
    (gap,) = of(batches, "gap")
    assert (gap["first_missing"], gap["last_missing"], gap["cause"]) == (1, 2, b"edge_lost")


@pytest.mark.parametrize("code", [errno.ENODEV, errno.EIO])
def test_a_source_that_is_gone_is_an_os_error(port, source, code):
    source.error = code
    with pytest.raises(OSError, match=r".") as caught:
        port.receive(0.1)
    assert caught.value.errno == code


def test_what_is_no_pps_source_is_not_left_open(source, clock, monkeypatch):
    source.error = errno.ENOTTY
    closed = []
    monkeypatch.setattr(pps.os, "close", closed.append)
    with pytest.raises(OSError, match=r".") as caught:
        open_pulse("pps:///dev/null", clock)
    monkeypatch.undo()
    assert caught.value.errno == errno.ENOTTY
    (fd,) = closed
    os.close(fd)


def test_a_file_that_is_no_pps_source_says_so(clock):
    """The real ioctl of a real kernel, on something else."""
    with pytest.raises(OSError, match=r".") as caught:
        open_pulse("pps:///dev/null", clock)
    assert caught.value.errno in {errno.ENOTTY, errno.EINVAL}
