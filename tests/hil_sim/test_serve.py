"""Tier T1: the adapter's protocol, the I2C socket, the real-time loop, and the process."""

import contextlib
import errno
import io
import itertools
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path

import can
import minimalmodbus
import numpy as np
import pytest
import serial

from hil_sim.buses.i2c_socket import I2cSocket
from hil_sim.buses.media import I2cBus
from hil_sim.buses.realtime import MissionServer
from hil_sim.buses.slcan import SlcanAdapter
from hil_sim.devices.canopen.can_wire import WireFrame
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.serve import _Leash, open_sockets
from tests.hil_sim.devices.twin_bench import BUSES, MS, START_NS, FlatImu, RateClock, SmallMission

ROOT = Path(__file__).resolve().parents[2]
SERIAL_PORTS = {"imu_port": 115_200, "joint_port": 230_400, "cell_port": 115_200, "arm_port": 115_200}


# The Lawicel protocol


class Terminal:
    """A client of the adapter that writes and reads raw lines."""

    def __init__(self):
        self.adapter = SlcanAdapter()
        self.fd = os.open(self.adapter.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def say(self, text):
        os.write(self.fd, text)
        sent = self.adapter.take()
        return self.hear(), sent

    def hear(self):
        heard = b""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self.fd, 4096):
                heard += data
        return heard

    def close(self):
        os.close(self.fd)
        self.adapter.close()


@pytest.fixture
def terminal():
    terminal = Terminal()
    yield terminal
    terminal.close()


@pytest.mark.parametrize(
    ("said", "heard"),
    [
        (b"V\r", b"V1013\r"),
        (b"v\r", b"v0107\r"),
        (b"N\r", b"NHIL0\r"),
        (b"\r\r", b"\r\r"),
        (b"O\r", b"\a"),  # no bit rate yet
        (b"S6\rO\r", b"\r\r"),
        (b"S6\rO\rO\r", b"\r\r\a"),
        (b"S6\rO\rS5\r", b"\r\r\a"),
        (b"S6\rO\rC\rC\r", b"\r\r\r\a"),
        (b"S9\r", b"\a"),
        (b"Sx\r", b"\a"),
        (b"s001C\rO\r", b"\r\r"),
        (b"F\r", b"\a"),
        (b"S6\rL\rF\r", b"\r\rF00\r"),
        (b"Z1\rZ0\rM00000000\rmFFFFFFFF\r", b"\r\r\r\r"),
        (b"Q\r", b"\a"),
        (b"t1230\r", b"\a"),  # closed
        (b"S6\rO\rt1232\r", b"\r\r\a"),  # data missing
        (b"S6\rO\rt12311\r", b"\r\r\a"),  # half a byte
        (b"S6\rO\rt1239000000000000000000\r", b"\r\r\a"),
        (b"S6\rO\rtxyz0\r", b"\r\r\a"),
        (b"S6\rO\rR000001230\rT000001231AA\r", b"\r\rZ\rZ\r"),
        (b"S6\rL\rt1230\r", b"\r\r\a"),
    ],
)
def test_commands(terminal, said, heard):
    assert terminal.say(said) == (heard, [])


def test_a_remote_frame_asks_for_so_many_bytes(terminal):
    terminal.say(b"S6\rO\r")
    assert terminal.say(b"r7011\r") == (b"z\r", [(0x701, 1)])


def test_a_frame_in_one_piece_and_in_single_bytes(terminal):
    terminal.say(b"S6\rO\r")
    assert terminal.say(b"t601840001000aB02Cd04\r") == (b"z\r", [(0x601, bytes.fromhex("40001000AB02CD04"))])
    got = []
    for byte in b"t0002010A\r":
        got += terminal.say(bytes([byte]))[1]
    assert got == [(0, b"\x01\x0a")]


def test_a_line_that_never_ends_is_forgotten(terminal):
    terminal.say(b"x" * 5000)
    assert terminal.say(b"\rV\r")[0] == b"\rV1013\r"


def test_frames_are_written_as_lines_with_stamps_when_asked(terminal):
    terminal.say(b"S6\rO\r")
    frame = WireFrame(61_234_000_000, 0x0A1, b"\x0f\xf0")
    terminal.adapter.give([frame])
    assert terminal.hear() == b"t0A120FF0\r"
    terminal.say(b"Z1\r")
    terminal.adapter.give([frame])
    assert terminal.hear() == b"t0A120FF004D2\r"  # 61,234 ms modulo 60,000


def test_a_client_that_does_not_read_loses_frames_and_is_told(terminal):
    terminal.say(b"S6\rO\r")
    for _ in range(20_000):
        terminal.adapter.give([WireFrame(0, 0x281, bytes(4))])
    assert terminal.adapter.lost > 1000
    lines = b""
    while data := terminal.hear():
        lines += data
        terminal.adapter.give([])
        terminal.adapter.take()
    assert set(lines.split(b"\r")) == {b"t281400000000", b""}  # whole lines only
    assert lines.count(b"\r") == 20_000 - terminal.adapter.lost
    assert terminal.say(b"F\rF\r")[0] == b"F01\rF00\r"


# The I2C socket


class SocketBench:
    def __init__(self, directory, bit_rate=400_000):
        self.bus = I2cBus()
        self.chip = Mpu6050Twin(FlatImu([0x0102] * 7), RateClock(), START_NS)
        self.bus.add(self.chip)
        path = directory / "i2c.sock"
        self.server = I2cSocket(path, self.bus, bit_rate)
        self.client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.client.connect(str(path))
        self.client.setblocking(False)
        self.now_ns = START_NS

    def send(self, operation, address, write=b"", count=0):
        self.client.sendall(struct.pack("<BBHH", operation, address, len(write), count) + write)

    def reply_after(self, ns):
        self.now_ns += ns
        self.server.advance(self.now_ns)
        try:
            reply = self.client.recv(65536)
        except BlockingIOError:
            return None
        code, count = struct.unpack_from("<HH", reply)
        assert len(reply) == 4 + count
        return code, reply[4:]

    def close(self):
        self.client.close()
        self.server.close()


@pytest.fixture
def wires(tmp_path):
    bench = SocketBench(tmp_path)
    yield bench
    bench.close()


def test_write_and_write_read(wires):
    wires.send(1, 0x68, b"\x75", 1)
    assert wires.reply_after(0) is None
    assert wires.reply_after(1 * MS) == (0, b"\x68")
    wires.send(0, 0x68, b"\x19\x07")
    wires.reply_after(0)
    assert wires.reply_after(1 * MS) == (0, b"")
    wires.send(1, 0x68, b"\x19", 1)
    wires.reply_after(0)
    assert wires.reply_after(1 * MS) == (0, b"\x07")


def test_a_reply_takes_as_long_as_the_wires_would(wires):
    wires.send(1, 0x68, b"\x3b", 14)
    assert wires.reply_after(0) is None
    assert 350_000 < wires.server.due_ns - wires.now_ns < 420_000  # 14 bytes at 400 kHz
    assert wires.reply_after(wires.server.due_ns - wires.now_ns - 1) is None
    assert wires.reply_after(1) == (0, bytes(14))


def test_errors_are_the_errno(wires):
    wires.send(1, 0x69, b"\x75", 1)
    wires.reply_after(0)
    assert wires.reply_after(MS) == (errno.EREMOTEIO, b"")
    wires.send(7, 0x68)
    assert wires.reply_after(0) == (errno.EINVAL, b"")


def test_requests_in_pieces_and_in_a_row(wires):
    request = struct.pack("<BBHH", 1, 0x68, 1, 1) + b"\x75"
    for byte in request:
        wires.client.sendall(bytes([byte]))
        assert wires.reply_after(0) is None
    assert wires.reply_after(MS) == (0, b"\x68")
    wires.client.sendall(request * 3)
    wires.reply_after(0)
    wires.now_ns += MS
    wires.server.advance(wires.now_ns)
    assert wires.client.recv(64) == b"\x00\x00\x01\x00\x68" * 3


def test_one_transfer_is_on_the_wires_at_a_time(wires, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.connect(str(tmp_path / "i2c.sock"))
        request = struct.pack("<BBHH", 1, 0x68, 1, 14) + b"\x3b"
        wires.client.sendall(request)
        other.sendall(request)
        wires.server.advance(wires.now_ns)
        first = wires.server.due_ns - wires.now_ns
        wires.server.advance(wires.now_ns + first)
        assert wires.server.due_ns - wires.now_ns == 2 * first


def test_a_client_may_leave_and_another_come(wires, tmp_path):
    wires.send(1, 0x68, b"\x75", 1)
    wires.client.close()
    wires.server.advance(wires.now_ns)
    wires.server.advance(wires.now_ns + MS)
    assert len(wires.server.files) == 1
    wires.client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    wires.client.connect(str(tmp_path / "i2c.sock"))
    wires.client.setblocking(False)
    wires.send(1, 0x68, b"\x75", 1)
    wires.reply_after(0)
    assert wires.reply_after(2 * MS) == (0, b"\x68")


def test_a_client_that_takes_no_replies_is_left(wires):
    request = struct.pack("<BBHH", 1, 0x68, 1, 8000) + b"\x74"
    for _ in range(200):
        with contextlib.suppress(BrokenPipeError):
            wires.client.sendall(request)
        wires.now_ns += 1_000 * MS
        wires.server.advance(wires.now_ns)
        wires.server.advance(wires.now_ns + 200 * MS)
    assert len(wires.server.files) == 1


# The loop in real time


class Client(threading.Thread):
    """A flight computer in a thread: polls the FIFO (200 Hz: 365 ms fit), listens to CAN and to the pulse line."""

    def __init__(self, urls, stop):
        super().__init__()
        self.urls, self.stop = urls, stop
        self.fifo, self.frames, self.edges, self.polls_ms = b"", [], [], []

    def run(self):
        with (
            socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as i2c,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as edges,
            can.Bus(
                self.urls["can_0"].removeprefix("can+slcan://").split("?")[0],
                interface="slcan",
                bitrate=500_000,
                sleep_after_open=0,
            ) as bus,
        ):
            i2c.connect(self.urls["i2c_1"].removeprefix("i2c+unix://"))
            edges.bind(self.urls["sync_line"].removeprefix("gpio+unix://"))
            edges.setblocking(False)

            def transfer(write, count=0):
                i2c.sendall(struct.pack("<BBHH", 1 if count else 0, 0x68, len(write), count) + write)
                code, n = struct.unpack("<HH", i2c.recv(4, socket.MSG_WAITALL))
                assert code == 0
                return i2c.recv(n, socket.MSG_WAITALL) if n else b""

            for write in (b"\x6b\x01", b"\x19\x04\x0a", b"\x23\xf8", b"\x6a\x04", b"\x6a\x40"):
                transfer(write)
            started = False
            while not self.stop.is_set():
                begin = time.monotonic()
                self.fifo += transfer(b"\x74", n) if (n := int.from_bytes(transfer(b"\x72", 2), "big")) else b""
                self.polls_ms.append(1e3 * (time.monotonic() - begin))
                while (message := bus.recv(0)) is not None:
                    self.frames.append((message.arbitration_id, bytes(message.data)))
                    if not started and message.arbitration_id == 0x702:
                        bus.send(can.Message(arbitration_id=0, data=b"\x01\x00", is_extended_id=False))
                        started = True
                with contextlib.suppress(BlockingIOError):
                    while True:
                        self.edges.append(struct.unpack("<qI", edges.recv(64)))
                time.sleep(0.01)


@pytest.mark.realtime
def test_the_loop_keeps_real_time(tmp_path):
    mission, stop = SmallMission(3.0), threading.Event()
    with open_sockets(BUSES, tmp_path / "buses", seed=1) as ports:
        server = MissionServer(ports, time.monotonic_ns)
        assert set(ports.urls) == {"i2c_1", "can_0", "sync_line"}
        client = Client(ports.urls, stop)
        start_ns = time.monotonic_ns()
        mission.plug(ports.buses, start_ns)
        client.start()
        stopper = threading.Timer(2.5, stop.set)
        stopper.start()
        server.run(mission)
        client.join()
        stopper.join()
        assert mission.finished
        assert 0 <= time.monotonic_ns() - mission.end_ns < 200 * MS
        summary = server.summary()
    samples = np.frombuffer(client.fifo, ">i2").reshape(-1, 7)
    assert 400 < len(samples) <= mission.produced()["imu_base"]
    assert (samples[:, 2] == 8192).all()
    counters = [data[0] for identifier, data in client.frames if identifier == 0x080]
    assert len(counters) > 400
    assert all((b - a) % 240 == 1 for a, b in itertools.pairwise(counters))
    positions = [struct.unpack("<I", data)[0] for identifier, data in client.frames if identifier == 0x281]
    assert len(positions) > 300
    assert positions == sorted(positions)
    assert [sequence for _, sequence in client.edges] == [*range(client.edges[0][1], client.edges[-1][1] + 1)]
    marks = np.flatnonzero(np.diff(samples[:, 3] & 1, prepend=0) == 1)  # a pulse that straddles a sample marks two
    assert abs(len(marks) - len(client.edges)) <= 2
    assert summary["can_0"]["frames_lost_in_adapter"] == 0
    assert summary["i2c_1"]["refused"] == 0
    assert np.median(client.polls_ms) > 0.2  # wire time is there
    assert json.dumps(summary)


def test_the_loop_stops_when_told(tmp_path):
    mission = SmallMission(60.0)
    with open_sockets(BUSES, tmp_path) as ports:
        mission.plug(ports.buses, time.monotonic_ns())
        begin = time.monotonic()
        MissionServer(ports, time.monotonic_ns).run(mission, lambda: time.monotonic() - begin > 0.2)
    assert time.monotonic() - begin < 1.0
    assert not mission.finished


def test_an_absent_client_costs_no_processor(tmp_path):
    mission = SmallMission(1.0)
    with open_sockets(BUSES, tmp_path) as ports:
        server = MissionServer(ports, time.monotonic_ns)
        can_bus = ports.buses["can_0"]
        fd = os.open(ports.urls["can_0"].removeprefix("can+slcan://").split("?")[0], os.O_RDWR | os.O_NOCTTY)
        os.write(fd, b"S6\rO\r")
        can_bus.advance(0)
        termios.tcflush(fd, termios.TCIOFLUSH)
        os.close(fd)  # the terminal hangs up: always "readable" from now on
        mission.plug(ports.buses, time.monotonic_ns())
        server.run(mission)
        assert server.turns < 2000


# The process


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_process_says_where_and_then_what(tmp_path, number):
    command = [sys.executable, "-m", "hil_sim.serve", "rocksat", "--seed", "7", "--directory", str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        ready = json.loads(process.stdout.readline())
        assert set(ready) == {"i2c_1", "can_0", "sync_line", "start_ns", "duration_s"}
        assert abs(time.monotonic_ns() - ready["start_ns"]) < 2_000 * MS
        stop = threading.Event()
        client = Client(ready, stop)
        client.start()
        time.sleep(3.0)
        stop.set()
        client.join()
        process.send_signal(number)
        report = json.loads(process.stdout.readline())
        assert process.wait(10) == 0
    assert set(report) == {"produced", "truth", "server"}
    assert len(client.fifo) // 14 <= report["produced"]["imu_base"]
    assert len(client.fifo) // 14 > 400
    assert report["server"]["can_0"]["frames_lost_in_adapter"] == 0


@pytest.mark.realtime
def test_serial_devices_are_served_on_terminals(tmp_path):
    command = [sys.executable, "-m", "hil_sim.serve", "rocksat_serial", "--seed", "7", "--directory", str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        ready = json.loads(process.stdout.readline())
        assert set(ready) == {*SERIAL_PORTS, "sync_line", "start_ns", "duration_s"}
        urls = {name: ready[name].removeprefix("serial://").split("?baud=") for name in SERIAL_PORTS}
        assert {name: int(baud) for name, (_, baud) in urls.items()} == SERIAL_PORTS
        with contextlib.ExitStack() as stack:
            imu, joint, arm = (
                stack.enter_context(serial.Serial(path, int(baud), timeout=0.02))
                for path, baud in (urls[name] for name in ("imu_port", "joint_port", "arm_port"))
            )
            cell = minimalmodbus.Instrument(urls["cell_port"][0], 1)
            stack.callback(cell.serial.close)
            cell.serial.baudrate, cell.serial.timeout = 115_200, 0.1
            said, answers, weights = b"", b"", []
            deadline = time.monotonic() + 3.0
            while time.monotonic() < deadline:
                said += imu.read(4096)
                if ready["start_ns"] + 600 * MS < time.monotonic_ns():
                    weights.append(cell.read_long(7))
                joint.write(b"R14\r\n")
                answers += joint.read(4096)
            frames = arm.read(65_536).split(b"\0")
            imu.timeout = 0
            said += imu.read(4096)
            imu.close()
        process.send_signal(signal.SIGTERM)
        report = json.loads(process.stdout.readline())
        assert process.wait(10) == 0
    produced, packets = report["produced"], said.count(b"\xff\xff\xff\xff\x26\x00\x14")
    assert packets > 300
    # one that came after the last read, or was read as the port opened: a pty does not tell of either
    assert abs(produced["imu_base"] - packets) <= 1
    assert produced["load_cell"] == len(weights) > 20
    assert max(weights) < 1000  # N/1000: nothing presses on it yet
    assert b"r 14 13FA600E" in answers
    assert produced["joint_1"] == 0  # nobody asked for its stream
    assert sum(frame[1:2] == b"\x10" for frame in frames) > 400
    assert report["server"]["imu_port"]["characters_to_host"] >= len(said)


def test_an_unknown_scenario_is_a_sentence_and_a_status(tmp_path):
    command = [sys.executable, "-m", "hil_sim.serve", "no-such-flight", "--directory", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "no-such-flight" in done.stderr


def test_lines_after_the_start_ask_for_segments(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("start\nask s1\nnothing\nask mass_2kg\n"))
    stops = []
    leash = _Leash(stops)
    leash.wait()
    for _ in range(100):
        if stops:
            break
        time.sleep(0.01)
    assert stops == [signal.SIGHUP]  # the end of stdin
    assert list(leash.asked) == ["s1", "mass_2kg"]
