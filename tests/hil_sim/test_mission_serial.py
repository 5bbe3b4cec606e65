"""Missions whose devices are on serial lines, or mixed, on the same world."""

import contextlib
import socket

import numpy as np
import pytest
import serial
from cobs import cobs

from hil_sim.faults import FaultError
from hil_sim.mission import Mission, open_in_process
from hil_sim.scenario.load import ScenarioError, load
from tests.hil_sim.mission_ground import SHORT

BRIEF = {"sequence": [*SHORT["sequence"][1:3], {"phase": 9, "action": "hold", "duration_s": 0.2}]}


def serial_bytes(seed: int) -> dict[str, bytes]:
    """What every device of rocksat_serial says by itself, and the QSB's answer to a question."""
    mission, urls = open_in_process(load("rocksat_serial", BRIEF), seed)
    with mission, contextlib.ExitStack() as stack:
        ports = {}
        for name, url in urls.items():
            if url.startswith("serial://"):
                path, baud = url.removeprefix("serial://").split("?baud=")
                ports[name] = stack.enter_context(serial.Serial(path, int(baud), timeout=0))
        said = dict.fromkeys(ports, b"")
        while not mission.finished:
            if mission.now_ns == mission.start_ns + 1_000_000_000:
                ports["joint_port"].write(b"R14\r\n")
                ports["cell_port"].write(bytes.fromhex("01 03 00 07 00 02 75 ca"))  # 40008, two registers
            mission.advance(mission.now_ns + 5_000_000)
            for name, port in ports.items():
                said[name] += port.read(10_000)
        assert mission.produced()["load_cell"] == 1
        return said


def test_serial_devices_say_the_same_for_the_same_seed() -> None:
    said, again, other = (serial_bytes(seed) for seed in (5, 5, 6))
    assert said == again
    assert said["imu_port"] != other["imu_port"]
    packets = [said["imu_port"][k : k + 38] for k in range(0, len(said["imu_port"]) - 37, 38)]
    assert len(packets) > 200
    assert {packet[:7] for packet in packets} == {b"\xff\xff\xff\xff\x26\x00\x14"}
    assert b"r 14 13FA600E" in said["joint_port"]
    assert said["cell_port"].startswith(b"\x01\x03\x04")
    assert said["arm_port"].count(b"\0") > 300


@pytest.mark.parametrize("name", ["rocksat_serial", "rocksat_mixed"])
def test_other_devices_fly_on_the_same_world_with_the_same_draws(name) -> None:
    """Random numbers go by the name of the signal: another kind of device of the same name finds the same ones."""
    one, other = Mission(load("rocksat", BRIEF), 5), Mission(load(name, BRIEF), 5)
    for mission in (one, other):
        mission.plant.advance(1.0)
    moments = [mission.plant.moment_n_m("joint_1")[:2000] for mission in (one, other)]
    np.testing.assert_array_equal(*moments)
    times_s = np.linspace(0.0, 0.9, 50)
    for signal in ("joint_1", "load_cell"):
        assert [one.sensors[signal].value(t) for t in times_s] == [other.sensors[signal].value(t) for t in times_s]
        assert one.truth()[signal] == other.truth()[signal]


def test_a_pulse_reaches_every_device_that_has_an_input_for_it() -> None:
    mission, urls = open_in_process(load("rocksat_serial", BRIEF), 5)
    with mission, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(urls["sync_line"].removeprefix("gpio+unix://"))
        path, baud = urls["arm_port"].removeprefix("serial://").split("?baud=")
        with serial.Serial(path, int(baud), timeout=0) as port:
            while not mission.finished:
                mission.advance(mission.now_ns + 5_000_000)
            frames = [frame for frame in port.read(65_536).split(b"\0") if frame[1:2] == b"\x10"]
        pulses = mission.produced()["pulse"]
    assert pulses > 8
    last = cobs.decode(frames[-1])
    assert int.from_bytes(last[12:16], "little") == pulses - 1  # the first came while the node was starting


def test_samples_count_while_the_port_is_open() -> None:
    """A device that talks to nobody produces nothing for the log."""
    mission, urls = open_in_process(load("rocksat_serial", BRIEF), 5)
    with mission:
        path = urls["imu_port"].removeprefix("serial://").split("?")[0]
        mission.advance(mission.start_ns + 500_000_000)
        assert mission.produced()["imu_base"] == 0
        read = b""
        with serial.Serial(path, 115_200, timeout=0) as port:
            for _ in range(100):
                mission.advance(mission.now_ns + 3_000_000)
                read += port.read(10_000)
        for _ in range(10):
            mission.advance(mission.now_ns + 30_000_000)
        made = mission.produced()
    assert made["imu_base"] == made["imu_base_mag_z"] == len(read) // 38
    assert 40 < made["imu_base"] < 50


def test_what_is_under_way_is_not_there_yet() -> None:
    """A packet takes 3.3 ms: a count at any instant is that of the packets whose end has come."""
    mission, urls = open_in_process(load("rocksat_serial", BRIEF), 5)
    with mission:
        path = urls["imu_port"].removeprefix("serial://").split("?")[0]
        read = b""
        with serial.Serial(path, 115_200, timeout=0) as port:
            for _ in range(1000):
                mission.advance(mission.now_ns + 700_000)
                read += port.read(10_000)
                assert mission.produced()["imu_base"] == len(read) // 38


def test_a_line_is_there_with_its_exclamation_mark() -> None:
    """CR and LF after it are for the eye; whoever reads a line does not wait for them."""
    mission, urls = open_in_process(load("rocksat_serial", BRIEF), 5)
    with mission:
        path = urls["joint_port"].removeprefix("serial://").split("?")[0]
        with serial.Serial(path, 230_400, timeout=0) as port:
            mission.advance(mission.start_ns + 200_000_000)
            port.write(b"W0C1\r\nS0E\r\n")
            read = b""
            for _ in range(1000):
                mission.advance(mission.now_ns + 1_013_000)
                read += port.read(10_000)
                assert mission.produced()["joint_1"] == sum(b"!" in line for line in read.split(b"s 0E")[1:])
    assert mission.produced()["joint_1"] > 400


@pytest.mark.parametrize(
    ("kind", "device", "value"),
    [("silent", "imu_base", 0.0), ("unplug", "imu_port", 0.0), ("byte_loss", "imu_port", 0.2)],
)
def test_faults_reach_serial_devices_and_lines(kind, device, value) -> None:
    fault = {"kind": kind, "device": device, "start_s": 0.6, "end_s": 0.9, "value": value}
    mission, urls = open_in_process(load("rocksat_serial", BRIEF | {"fault": [fault]}), 5)
    with mission:
        path = urls["imu_port"].removeprefix("serial://").split("?")[0]
        port: serial.Serial | None = None
        read = []
        for _ in range(300):
            with contextlib.suppress(serial.SerialException):
                port = port or serial.Serial(path, 115_200, timeout=0)
            mission.advance(mission.now_ns + 5_000_000)
            try:
                read.append(len(port.read(10_000)) if port else 0)
            except serial.SerialException:
                port = None
        made = mission.produced()["imu_base"]
    before, during, after = sum(read[80:120]), sum(read[122:162]), sum(read[200:240])
    assert before == pytest.approx(after, rel=0.1)
    assert during == pytest.approx(0.8 * before if kind == "byte_loss" else 0, rel=0.1)
    assert made == pytest.approx(1.25 * 150, abs=3), "what could not be heard was made all the same"


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        ({"kind": "nack", "device": "imu_port", "start_s": 1.0}, "imu_port cannot have the fault nack"),
        ({"kind": "byte_loss", "device": "joint_1", "start_s": 1.0, "value": 0.1}, "joint_1 cannot have the fault"),
        ({"kind": "who_am_i", "device": "load_cell", "start_s": 1.0, "value": 1}, "load_cell cannot have the fault"),
        ({"kind": "off", "device": "can_0", "start_s": 1.0}, "No device is called can_0"),
    ],
)
def test_a_fault_of_a_serial_scenario_that_cannot_be_is_refused(fault, named) -> None:
    with pytest.raises(FaultError, match=named):
        open_in_process(load("rocksat_serial", BRIEF | {"fault": [fault]}), 1)


def test_a_device_that_its_line_is_too_slow_for_is_refused_by_name() -> None:
    scenario = load("rocksat_serial", BRIEF | {"bus": {"imu_port": {"baud_rate": 9600}}})
    with pytest.raises(ScenarioError, match=r"device\.imu_base: 150 packets of 38 bytes .* Correct its table"):
        open_in_process(scenario, 1)
    again, _ = open_in_process("rocksat_serial", 1)  # nothing was left open
    again.close()
