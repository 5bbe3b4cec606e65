"""PPS_FETCH on the kernel's timer source: what a flight computer without a GPIO line has for a sync pulse."""

import fcntl
import itertools
import os
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from drivers.transports import open_pulse
from drivers.transports.clock import realtime_minus_monotonic

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
