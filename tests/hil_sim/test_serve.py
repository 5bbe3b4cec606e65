"""Tier T1: the adapter's protocol, the I2C socket, the real-time loop, and the process."""

import contextlib
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

from hil_sim.buses.realtime import MissionServer
from hil_sim.serve import Leash, open_sockets
from tests.hil_sim.devices.twin_bench import BUSES, MS, SmallMission

ROOT = Path(__file__).resolve().parents[2]
SERIAL_PORTS = {"imu_port": 115_200, "joint_port": 230_400, "cell_port": 115_200, "arm_port": 115_200}


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
    leash = Leash(stops)
    leash.wait()
    for _ in range(100):
        if stops:
            break
        time.sleep(0.01)
    assert stops == [signal.SIGHUP]  # the end of stdin
    assert list(leash.asked) == ["s1", "mass_2kg"]
