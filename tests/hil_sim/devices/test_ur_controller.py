"""Clients of others against the simulated UR controller, over a real socket; what it says byte for byte."""

import contextlib
import importlib.util
import itertools
import struct
import subprocess
import sys
import time

import pytest

from hil_sim.buses.network import NetworkBus
from hil_sim.buses.tcp_ends import ListeningTcp, VirtualTcp
from hil_sim.devices.network.ur_controller import UrController, rate
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.network_bench import NetworkSession, sessions
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import START_NS, Analog, RateClock

SIX = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
INPUTS = {
    (output, place): (lambda t, value=value: value)
    for output in ("actual_q", "actual_current", "ft_raw_wrench")
    for place, value in enumerate(SIX)
}


@contextlib.contextmanager
def served(start_ns=None, port=0, **how):
    """Its port, while a thread serves it on the real clock."""
    start_ns = time.monotonic_ns() if start_ns is None else start_ns
    listener = ListeningTcp(port)
    bus = NetworkBus(listener)
    bus.add(UrController(INPUTS, RateClock(start_ns=start_ns), start_ns, **how))
    with contextlib.closing(listener), RealTime(bus):
        yield listener.address[1]


def test_universal_robots_own_client_reads_it():
    rtde = pytest.importorskip("openur.rtde.rtde", reason="not locked: math3d, which it requires, has no wheel")
    with served() as port:
        client = rtde.RTDE("127.0.0.1", port)
        client.connect()
        assert client.get_controller_version()[:2] == (5, 16)
        names = ["timestamp", "actual_q", "actual_current", "ft_raw_wrench", "robot_mode", "safety_status_bits"]
        types = ["DOUBLE", "VECTOR6D", "VECTOR6D", "VECTOR6D", "INT32", "UINT32"]
        assert client.send_output_setup(names, types, frequency=125)
        assert client.send_start()
        states = []
        while len(states) < 20:
            state = client.receive_buffered()
            states += [] if state is None else [state]
        assert client.send_pause()
        client.disconnect()
    for state in states:
        assert state.actual_q == state.actual_current == state.ft_raw_wrench == SIX
        assert (state.robot_mode, state.safety_status_bits) == (7, 1)
    steps = [after.timestamp - before.timestamp for before, after in itertools.pairwise(states)]
    assert steps == pytest.approx([0.008] * 19, abs=1e-9)


READ_BY_UR_RTDE = """
import rtde_receive

names = ["timestamp", "actual_q", "actual_current", "ft_raw_wrench", "robot_mode", "safety_status_bits"]
client, times = rtde_receive.RTDEReceiveInterface("127.0.0.1", 125.0, names), []
while len(times) < 50:
    if (now := client.getTimestamp()) not in times[-1:]:
        times.append(now)
values = client.getActualQ(), client.getActualCurrent(), client.getFtRawWrench(), client.getRobotMode()
print("read:", *values, *times, sep=";")
client.disconnect()
"""


def test_sdu_s_client_reads_it():
    """In a process of its own: it holds the interpreter while it waits; and its port is always the controller's."""
    if importlib.util.find_spec("rtde_receive") is None:
        pytest.skip("pip install ur_rtde==1.6.5")
    with served(port=30004):
        command = [sys.executable, "-c", READ_BY_UR_RTDE]
        said = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True).stdout
    _, q, current, wrench, mode, *times = next(line for line in said.splitlines() if "read:" in line).split(";")
    assert q == current == wrench == str(SIX)
    assert int(mode) == 7
    steps = [float(after) - float(before) for before, after in itertools.pairwise(times)]
    assert min(steps) == pytest.approx(0.008, abs=1e-9)
    assert all(step == pytest.approx(0.008 * round(step / 0.008), abs=1e-9) for step in steps)  # some may be missed


class Session(NetworkSession):
    """A client of the virtual network."""

    def __init__(self, faults=(), **how) -> None:
        def made(faults):
            return UrController(INPUTS, RateClock(), START_NS, jitter_ns=0, faults=faults, **how)

        super().__init__(VirtualTcp("here"), made, "arm", faults)
        self.port = self.end.connect()

    def said(self, letter: str = "", rest: bytes = b"", ms: int = 2) -> list[tuple[str, bytes]]:
        """What it says within some ms of a request."""
        if letter:
            self.port.send(struct.pack(">HB", 3 + len(rest), ord(letter)) + rest)
        for _ in range(ms):
            self.pass_ms()
        data, found = b"", []
        with contextlib.suppress(BlockingIOError):
            data = self.port.recv(100_000)
        while data:
            size = int.from_bytes(data[:2], "big")
            found.append((chr(data[2]), data[3:size]))
            data = data[size:]
        return found

    def times(self, ms: int) -> list[float]:
        """Time stamps of data that began with one."""
        return [struct.unpack_from(">d", rest, 1)[0] for letter, rest in self.said(ms=ms) if letter == "U"]


@pytest.fixture
def session():
    yield from sessions(Session)


def begun(session, names=b"timestamp", hz=125.0):
    assert session.said("V", b"\0\2") == [("V", b"\1")]
    session.said("O", struct.pack(">d", hz) + names)
    assert session.said("S") == [("S", b"\1")]
    return session


def test_each_request_is_answered_as_the_guide_says(session):
    here = session(lacks={"ft_raw_wrench": "IN_USE"})
    assert here.said("V", b"\0\1") == [("V", b"\0")]
    assert here.said("v") == [("v", struct.pack(">4I", 5, 16, 1, 0))]
    assert here.said("S") == [("S", b"\0")]  # nothing is set up
    rate = struct.pack(">d", 125.0)
    assert here.said("O", rate + b"timestamp,actual_q,robot_mode,") == [("O", b"\1DOUBLE,VECTOR6D,INT32")]
    assert here.said("O", rate + b"timestamp,nonsense") == [("O", b"\0DOUBLE,NOT_FOUND")]
    assert here.said("O", rate + b"ft_raw_wrench") == [("O", b"\0IN_USE")]
    assert here.said("O", rate + b"timestamp,actual_q,safety_status_bits")[0][1][0] == 1
    assert here.said("S") == [("S", b"\1")]
    data = here.said(ms=40)
    assert [letter for letter, _ in data] == ["U"] * 5
    first = data[0][1]
    assert struct.unpack(">B d 6d I", first)[2:] == (*SIX, 1)
    assert here.said("P")[-1] == ("P", b"\1")
    assert here.said(ms=40) == []


@pytest.mark.parametrize(("hz", "seen"), [(125.0, 125.0), (500.0, 500.0), (700.0, 500.0)])
def test_it_sends_at_the_rate_that_was_asked_for_and_it_can(session, hz, seen):
    times = begun(session(), hz=hz).times(200)
    assert len(times) == pytest.approx(0.2 * seen, abs=1)
    assert [b - a for a, b in itertools.pairwise(times)] == pytest.approx([1.0 / seen] * (len(times) - 1))


def test_a_request_in_pieces_is_one_and_a_new_client_begins_anew(session):
    here = session()
    for byte in struct.pack(">HBH", 5, ord("V"), 2):
        here.port.send(bytes([byte]))
        assert here.said(ms=1) == []
    assert here.said(ms=1) == [("V", b"\1")]
    begun(here)
    here.port = here.end.connect()
    assert here.said(ms=40) == []
    assert len(begun(here).times(80)) == 10


def test_a_pulled_cable_breaks_the_connection_and_what_it_had_to_say_is_counted(session):
    here = begun(session(("unplug", "cable", 0.1, 0.5)))
    before = len(here.times(100))
    assert here.port.recv(1) == b""
    with pytest.raises(BrokenPipeError):
        here.port.send(b"V")
    with pytest.raises(ConnectionRefusedError):
        here.end.connect()
    here.said(ms=400)
    here.port = here.end.connect()
    after = begun(here).times(80)
    assert here.twin.produced == pytest.approx(after[-1] / 0.008, abs=2)
    assert here.twin.produced > before + len(after) + 45
    assert after[0] > 0.5


def test_a_restarted_controller_counts_its_time_anew(session):
    here = begun(session(("reset", "arm", 0.1)))
    assert max(here.times(90)) > 0.08
    here.said(ms=900)
    with pytest.raises(ConnectionRefusedError):
        here.end.connect()  # it starts
    here.said(ms=200)
    here.port = here.end.connect()
    assert min(begun(here).times(80)) == pytest.approx(1.1, abs=0.05)


@pytest.mark.parametrize(
    ("kind", "bits", "mode"), [("trip", 1 << 2 | 1 << 10, 7), ("emergency_stop", 1 << 6 | 1 << 7 | 1 << 10, 3)]
)
def test_stops_are_in_its_status(session, kind, bits, mode):
    here = begun(session((kind, "arm", 0.1, 0.2)), b"timestamp,safety_status_bits,robot_mode")
    told = [struct.unpack(">BdIi", rest)[1:] for _, rest in here.said(ms=300)]
    for time_s, said_bits, said_mode in told:
        assert (said_bits, said_mode) == ((bits, mode) if 0.1 <= time_s < 0.2 else (1, 7))
    assert len(told) > 30


def test_tables_of_one_controller_are_one(session):
    here = session()
    plan = FaultPlan([Fault("trip", "wrist", 0.1, 0.2), Fault("off", "wrist", 0.2, 0.3)], START_NS)
    shown = {("target_moment", 0): lambda t: 7.0}
    other = UrController(shown, RateClock(), START_NS, faults=plan.of("wrist"))
    here.bus.add(other)
    names = b"timestamp,target_moment,actual_q,safety_status_bits"
    told = [struct.unpack(">Bd6d6dI", rest) for _, rest in begun(here, names).said(ms=150)]
    assert told[0][2:14] == (7.0, 0, 0, 0, 0, 0, *SIX)
    assert {one[-1] for one in told} == {1, 1 << 2 | 1 << 10}
    assert other.produced == here.twin.produced == len(told)
    here.said(ms=50)
    assert here.port.recv(1) == b""


def test_faults_that_it_cannot_have_are_refused(session):
    with pytest.raises(FaultError, match="arm cannot have the fault nack"):
        session(("nack", "arm", 0.1))
    with pytest.raises(FaultError, match="cable cannot have the fault byte_loss"):
        session(("byte_loss", "cable", 0.1, 0.2, 0.5))


def test_a_rate_is_that_of_the_angle():
    turning = rate(Analog(lambda t: 0.25 * t))
    assert turning(1.0) == pytest.approx(0.25)
    assert turning(0.0) == 0.0
