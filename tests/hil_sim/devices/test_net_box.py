"""A client of others against the simulated wrist sensor, over a real socket; what it says byte for byte."""

import contextlib
import itertools
import socket
import struct
import time

import NetFT
import pytest

from hil_sim.buses.network import NetworkBus
from hil_sim.buses.udp_ends import UdpEnd
from hil_sim.devices.network.net_box import HexBox, NetBox
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.network_bench import NetworkSession, sessions
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import START_NS, RateClock

COUNTS = [100, -200, 300, -40, 50, -60]
INPUTS = {k: (lambda time_s, counts=counts: (float(counts), False)) for k, counts in enumerate(COUNTS)}


def asked(command: int, records: int = 0) -> bytes:
    return struct.pack(">HHI", 0x1234, command, records)


START, STOP = asked(2), asked(0)


@contextlib.contextmanager
def served():
    """Its address, while a thread serves it on the real clock."""
    start_ns = time.monotonic_ns()
    end = UdpEnd()
    bus = NetworkBus(end)
    bus.add(NetBox(INPUTS, RateClock(start_ns=start_ns), start_ns))
    with contextlib.closing(end), RealTime(bus):
        yield end.address


def test_a_client_of_others_reads_it_once_and_as_a_stream():
    with served() as (host, port):
        client = NetFT.Sensor(host)
        client.sock.close()
        client.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # its port cannot be chosen
        client.sock.settimeout(5.0)
        client.sock.connect((host, port))
        assert client.getMeasurement() == COUNTS
        assert client.getForce() == COUNTS[:3]
        assert client.tare(10) == COUNTS
        client.startStreaming(handler=False)
        assert [client.receive() for _ in range(20)] == [[0.0] * 6] * 20
        client.stopStreaming()
        client.sock.close()


class Session(NetworkSession):
    """A client of the virtual network."""

    def __init__(self, faults=(), inputs=INPUTS, kind=NetBox, **how) -> None:
        def made(faults):
            return kind(inputs, RateClock(), START_NS, jitter_ns=0, faults=faults, **how)

        super().__init__(UdpEnd("here"), made, "wrist", faults)
        self.client()

    def client(self):
        """A client from another port from now on."""
        self.port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.port.setblocking(False)
        self.port.connect(socket.getaddrinfo("here", 49152)[0][4])

    def said(self, request: bytes = b"", ms: int = 2) -> list[tuple[int, ...]]:
        """Records within some ms of a request."""
        if request:
            self.port.send(request)
        found = []
        for _ in range(ms):
            self.pass_ms()
            with contextlib.suppress(BlockingIOError):
                while True:
                    found.append(struct.unpack(">III6i", self.port.recv(100)))
        return found

    def close(self):
        self.port.close()
        super().close()


@pytest.fixture
def session():
    yield from sessions(Session)


def test_a_stream_begins_at_1_at_its_rate_and_ends_when_it_is_told(session):
    one = session(rate_hz=500.0)
    assert one.said(ms=5) == []
    records = one.said(START, 42)
    assert [record[0] for record in records] == list(range(1, 21))
    assert [after[1] - before[1] for before, after in itertools.pairwise(records)] == [14] * 19  # of 7000 a second
    assert {record[2:] for record in records} == {(0, *COUNTS)}
    one.said(STOP)
    assert one.said(ms=10) == []
    again = one.said(START, 10)
    assert again[0][0] == 1
    assert again[0][1] > records[-1][1]
    assert one.twin.produced >= 20 + len(again)


def test_so_many_records_as_were_asked_for(session):
    one = session()
    assert len(one.said(asked(2, 1), 20)) == 1
    assert len(one.said(asked(2, 7), 20)) == 7


@pytest.mark.parametrize("request_", [b"", b"\x12\x34", START[::-1], START + b"\0", asked(0x42)])
def test_what_is_no_request_of_records_is_not_answered(session, request_):
    assert session().said(request_, 20) == []


def test_the_last_who_asked_has_it(session):
    one = session()
    assert one.said(START, 5)
    before = one.port
    one.client()
    assert [record[0] for record in one.said(START, 5)] == [1, 2, 3]
    with pytest.raises(BlockingIOError):
        before.recv(100)
    before.close()


def test_beyond_its_range_it_says_so(session):
    one = session(inputs={2: lambda time_s: (3e12, True)})
    assert {record[2:] for record in one.said(START, 5)} == {(0x8000_0000, 0, 0, 2**31 - 1, 0, 0, 0)}


def test_a_pulled_cable_loses_records_that_are_numbered_and_without_power_it_forgets(session):
    one = session(("unplug", "cable", 0.01, 0.02))
    numbers = [record[0] for record in one.said(START, 40)]
    assert numbers[:5] == [1, 2, 3, 4, 5]
    lost = set(range(1, numbers[-1] + 1)) - set(numbers)
    assert lost == set(range(8, 20))  # what was under way, too
    assert one.twin.produced == numbers[-1]
    two = session(("off", "wrist", 0.01, 0.02))
    before = two.said(START, 9)
    assert before
    assert two.said(ms=600) == []
    after = two.said(START, 10)
    assert after[0][0] == 1
    assert after[0][1] < 7000


def test_garbage_is_no_longer_and_no_shorter(session):
    one = session(("garbage", "wrist", 0.0, 1.0))
    records = one.said(START, 10)
    assert len({record[0] for record in records}) == len(records) > 5


def test_a_fault_that_it_cannot_have_is_refused():
    with pytest.raises(FaultError):
        NetBox(INPUTS, RateClock(), START_NS, faults=FaultPlan([Fault("nack", "w", 0.0, 1.0)], START_NS).of("w"))


def hex_box(session, *faults, **how):
    return session(*faults, kind=HexBox, **how)


def test_onrobot_s_box_has_the_rate_that_it_is_told_and_100_until_then(session):
    one = hex_box(session)
    assert 99 <= len(one.said(START, 1000)) <= 100
    one.said(STOP)
    one.said(asked(0x82, 2))
    one.said(asked(0x81, 4))
    records = one.said(START, 1000)
    assert 499 <= len(records) <= 500
    assert [after[1] - before[1] for before, after in itertools.pairwise(records)] == [2] * (
        len(records) - 1
    )  # of 1000 a second
    assert one.twin.filter == 4
    one.said(asked(0x82, 0))
    one.said(asked(0x81, 7))
    assert one.twin.filter == 4
    assert 499 <= len(one.said(START, 1000)) <= 500
    assert 1090 <= one.twin.produced <= 1110  # numbered anew by its new rate


def test_onrobot_s_bias_takes_off_what_is_read_and_gives_it_back(session):
    one = hex_box(session)
    one.said(asked(0x82, 1))
    assert one.said(START, 5)[-1][3:] == tuple(COUNTS)
    one.said(asked(0x42, 0xFF))
    assert one.said(ms=5)[-1][3:] == (0,) * 6
    one.said(asked(0x42, 0))
    assert one.said(ms=5)[-1][3:] == tuple(COUNTS)


def test_what_onrobot_s_box_was_told_it_forgets_without_power(session):
    one = hex_box(session, ("off", "wrist", 0.05, 0.06))
    one.said(asked(0x82, 1))
    one.said(asked(0x81, 4), 600)
    assert 99 <= len(one.said(START, 1000)) <= 100
    assert one.twin.filter == 0


def test_beyond_its_range_onrobot_s_status_is_not_0(session):
    one = hex_box(session, inputs={0: lambda time_s: (4e6, True)})
    assert {record[2] for record in one.said(START, 50)} == {1}
