"""A mission on its buses, seen by a flight computer written here with smbus2 and python-can alone.

COB-IDs, mappings and units are those of the published bus layout: SYNC 0x080, encoder TPDO2 0x281 (u32 position),
load cell TPDO1 0x182 (i32 at 0.1 mN, u8 status), arm controller TPDO1 0x183 (u8 phase, u8 event counter).
"""

import contextlib
import errno
import re
import socket
import struct
from pathlib import Path

import can
import numpy as np
import pytest
import serial
import smbus2
from cobs import cobs

from hil_sim.faults import FaultError
from hil_sim.mission import Mission, open_in_process
from hil_sim.scenario.load import ScenarioError, load
from tests.hil_sim.built import AS_DRAWN

SHORT = {
    "sequence": [
        {"phase": 0, "action": "hold", "duration_s": 0.5},
        {
            "phase": 4,
            "action": "sweep",
            "amplitude_deg": 11.5,
            "stroke_s": 0.6,
            "strokes": 1,
            "pause_s": 0.0,
            "transfer_s": 0.6,
        },
        {"phase": 5, "action": "eject", "duration_s": 0.3},
        {"phase": 9, "action": "hold", "duration_s": 0.2},
    ],
    "sensor": {"load_cell": {"full_scale_readings_s": [1.203, 1.607]}},
}
START_NMT = bytes([0x01, 0x00])


class Ground:
    """Flies a mission and keeps what the buses said."""

    def __init__(self, scenario, seed: int = 5, step_ns: int = 10_000_000, wake_imu: bool = False) -> None:
        self.mission, urls = open_in_process(scenario, seed)
        mission = self.mission
        self.frames: list[tuple[int, int, bytes]] = []
        self.edges: list[tuple[int, int]] = []
        channel = re.fullmatch(r"can\+virtual://([^?]+)\?timestamps=monotonic", urls["can_0"]).group(1)
        pulse_path = urls["sync_line"].removeprefix("gpio+unix://")
        with (
            mission,
            can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) as bus,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as pulses,
            smbus2.SMBus(urls["i2c_1"].removeprefix("i2c://")) as i2c,
        ):
            pulses.bind(pulse_path)
            pulses.setblocking(False)
            mission.advance(mission.start_ns + 100_000_000)
            if wake_imu:
                for register, value in (
                    (0x6B, 1),
                    (0x19, 0),
                    (0x1A, 2),
                    (0x1B, 0),
                    (0x1C, 8),
                    (0x23, 0xF8),
                    (0x6A, 0x40),
                ):
                    i2c.write_byte_data(0x68, register, value)
            bus.send(can.Message(arbitration_id=0x000, data=START_NMT, is_extended_id=False))
            self.words: list[tuple[int, tuple[int, ...]]] = []
            while not mission.finished:
                mission.advance(min(mission.now_ns + step_ns, mission.end_ns))
                while (message := bus.recv(0)) is not None:
                    self.frames.append((round(message.timestamp * 1e9), message.arbitration_id, bytes(message.data)))
                self._drain(pulses)
                if wake_imu:
                    burst = bytes(i2c.read_i2c_block_data(0x68, 0x3B, 14))
                    self.words.append((mission.now_ns, struct.unpack(">7h", burst)))
            self.produced = mission.produced()
            self.truth = mission.truth()

    def _drain(self, pulses: socket.socket) -> None:
        while True:
            try:
                self.edges.append(struct.unpack("<qI", pulses.recv(64)))
            except BlockingIOError:
                return

    def of(self, cob_id: int) -> list[tuple[int, bytes]]:
        return [(stamp, data) for stamp, identifier, data in self.frames if identifier == cob_id]

    def seconds(self, stamp_ns: int) -> float:
        return 1e-9 * (stamp_ns - self.mission.start_ns)


@pytest.fixture(scope="module")
def ground() -> Ground:
    return Ground(load("rocksat", SHORT), wake_imu=True)


def test_every_channel_is_produced_and_counted(ground) -> None:
    made = ground.produced
    assert set(made) == {"imu_base", "joint_1", "load_cell", "arm_phase", "can_sync", "pulse"}
    assert made["joint_1"] == len(ground.of(0x281)) > 400
    assert made["load_cell"] == len(ground.of(0x182)) > 400
    assert made["arm_phase"] == len(ground.of(0x183))
    assert made["pulse"] == len(ground.edges)
    assert made["can_sync"] - len(ground.of(0x080)) in range(22)  # those of the first 100 ms: bus opened at once
    # 2.8 s at 1 kHz, the chip's clock up to 1 % off, awake from 0.1 s on
    assert made["imu_base"] == pytest.approx(2700, rel=0.012)


def test_syncs_are_5_ms_of_the_box_clock_apart(ground) -> None:
    stamps = np.array([stamp for stamp, _ in ground.of(0x080)])
    counters = np.array([data[0] for _, data in ground.of(0x080)])
    assert set(np.diff(counters) % 240) == {1}
    rate = 1.0 + ground.truth["clock"]["sync_box"]["rate_error"]
    assert (stamps[-1] - stamps[0]) / (len(stamps) - 1) * rate == pytest.approx(5e6, rel=2e-5)


def test_load_cell_tells_the_moment_2_ms_ago_through_its_errors(ground) -> None:
    mission = ground.mission
    t = ground.truth["load_cell"]
    step = mission.plant.step_s
    judged = 0
    for stamp, data in ground.of(0x182)[20:]:
        counts, status = struct.unpack("<iB", data)
        assert status == 0
        if counts == 500_000:
            continue
        # Sampled on SYNC, which was at most 1 ms before the frame had come.
        row = round((ground.seconds(stamp) - 0.0026) / step)
        near = mission.plant.history.moment_n_m[row - 4 : row + 5] / t["moment_Nm_per_N"] + t["zero_N"]
        if ground.seconds(stamp) < ground.truth["ejection_s"]:
            margin = 5 * 0.0025 + 0.03  # N: noise, and what the 112 Hz filter takes from the vibration
            assert near.min() - margin < 1e-4 * counts < near.max() + margin
            judged += 1
    assert judged > 250


def test_two_load_cell_samples_are_full_scale(ground) -> None:
    counts = [struct.unpack("<iB", data)[0] for _, data in ground.of(0x182)]
    assert counts.count(500_000) == 2


def test_encoder_tells_the_joint_angle(ground) -> None:
    mission = ground.mission
    assert len(ground.of(0x281)) > 400
    zero_rad = mission.truth()["joint_1"]["zero_rad"]
    for stamp, data in ground.of(0x281):
        angle = (struct.unpack("<I", data)[0] - 1_000_000) * 2 * np.pi / 500_000 - zero_rad
        row = round((ground.seconds(stamp) - 0.0006) / mission.plant.step_s)
        near = mission.plant.history.angle_rad[row - 2 : row + 3]
        cyclic_and_count = 110e-6
        assert near.min() - cyclic_and_count < angle < near.max() + cyclic_and_count
    largest = max(struct.unpack("<I", data)[0] for _, data in ground.of(0x281))
    assert largest - 1_000_000 == pytest.approx(11.5 / 360 * 500_000, rel=0.01)


def test_arm_controller_announces_the_phases(ground) -> None:
    phases = [(data[0], ground.seconds(stamp)) for stamp, data in ground.of(0x183)]
    wanted = [(4, 0.5), (5, 2.3), (9, 2.6)]
    assert [code for code, _ in phases][-3:] == [code for code, _ in wanted]
    for (_, seen), (_, at) in zip(phases[-3:], wanted, strict=True):
        assert 0.0 < seen - at < 2e-3
    assert ground.truth["ejection_s"] == 2.3


def test_imu_words_are_specific_force_and_rate(ground) -> None:
    t, history = ground.truth["imu_base"], ground.mission.plant.history
    words = np.array([word for _, word in ground.words], dtype=float)
    accel_g, gyro = words[:, 0:3] / 8192, words[:, 4:7] / 131
    rows = np.array([round(ground.seconds(at) / 5e-4) for at, _ in ground.words])
    # 3 ms filters and 1 ms sampling: compare means over the flight.
    force_g = history.specific_force_imu_m_s2[rows].mean(axis=0) / 9.80665
    rate = np.rad2deg(history.rate_half_imu_rad_s[rows]).mean(axis=0)
    np.testing.assert_allclose(accel_g.mean(axis=0), t["accel_matrix"] @ force_g + t["accel_bias_g"], atol=2e-3)
    np.testing.assert_allclose(gyro.mean(axis=0), t["gyro_matrix"] @ rate + t["gyro_bias_deg_s"], atol=0.05)


def test_pulses_rise_in_the_first_millisecond_of_a_sync_period(ground) -> None:
    syncs = np.array([stamp for stamp, _ in ground.of(0x080)])
    # A one-byte frame takes at least 55 bits at 2 us; stamps of frames and edges are some us late.
    starts = syncs - 110_000
    late = np.array([edge - starts[starts < edge + 50_000].max() for edge, _ in ground.edges])
    assert (late > -50_000).all()
    assert (late < 1_050_000).all()
    steps = late / 31_250
    assert len(set(np.rint(steps).tolist())) >= 3  # the code's dither, in steps of 1/32 ms
    assert [number for _, number in ground.edges] == list(range(ground.edges[0][1], ground.edges[-1][1] + 1))


def test_same_seed_same_bytes_and_another_seed_others() -> None:
    scenario = load("rocksat", SHORT)
    one, again, other = (Ground(scenario, seed, wake_imu=True) for seed in (5, 5, 6))
    assert one.frames == again.frames
    assert one.edges == again.edges
    assert one.words == again.words
    assert one.frames != other.frames
    assert str(one.truth) == str(again.truth)


def test_data_do_not_hang_on_the_step_of_the_clock() -> None:
    scenario = load("rocksat", SHORT)
    fine, coarse = (Ground(scenario, 5, step_ns=step) for step in (1_000_000, 50_000_000))
    for cob_id in (0x080, 0x182, 0x281, 0x183):
        assert [data for _, data in fine.of(cob_id)][-300:] == [data for _, data in coarse.of(cob_id)][-300:]


def test_nothing_hangs_on_how_far_the_plant_is_computed_ahead(monkeypatch) -> None:
    said = []
    for ahead_s in (0.0, 0.33):
        monkeypatch.setattr("hil_sim.mission._AHEAD_S", ahead_s)
        ground = Ground(load("rocksat", SHORT), wake_imu=True)
        said.append((ground.frames, ground.edges, ground.words))
        assert len(ground.words) > 100
    assert said[0] == said[1]


def test_physics_does_not_hang_on_the_start_time() -> None:
    scenario = load("rocksat", SHORT)
    missions = [Mission(scenario, 9) for _ in range(2)]
    for mission in missions:
        mission.plant.advance(1e9)
    readings = [[m.sensors["load_cell"].value(t) for t in np.arange(0.1, 2.5, 5e-3)] for m in missions]
    assert readings[0] == readings[1]
    assert missions[0].end_ns - missions[0].start_ns == 2_800_000_000


def test_every_draw_comes_from_the_seed_and_no_two_subsystems_share_numbers() -> None:
    scenario = load("rocksat", SHORT)
    one, same, other = (Mission(scenario, seed) for seed in (1, 1, 2))
    for path in (("imu_base", "accel_bias_g"), ("joint_1", "eccentricity_phase_rad"), ("load_cell", "gain")):
        a, b, c = (np.asarray(m.truth()[path[0]][path[1]]) for m in (one, same, other))
        np.testing.assert_array_equal(a, b)
        assert (a != c).all()
    assert (one.plant.base.origin_accel_m_s2 != other.plant.base.origin_accel_m_s2).all()
    clocks = one.truth()["clock"]
    in_sigmas = [clocks["imu_base"]["rate_error"] / 0.005, clocks["sync_box"]["rate_error"] / 20e-6]
    assert in_sigmas[0] != pytest.approx(in_sigmas[1], rel=1e-3)


def test_draws_are_those_of_every_version_before() -> None:
    """A seed names a flight for good: what was drawn for seed 3 before the wiring was a table."""
    truth = Mission(load("rocksat", SHORT), 3).truth()
    assert truth["imu_base"]["accel_bias_g"][0] == pytest.approx(-0.020524843874379306, rel=1e-12)
    assert truth["joint_1"]["eccentricity_phase_rad"] == pytest.approx(2.0037461697387426, rel=1e-12)
    assert truth["load_cell"]["zero_N"] == pytest.approx(-0.023739201883976768, rel=1e-12)
    assert truth["clock"]["imu_base"]["rate_error"] == pytest.approx(-0.0016510491311152729, rel=1e-12)
    assert truth["clock"]["sync_box"]["rate_error"] == pytest.approx(1.2285262187944695e-05, rel=1e-12)


def test_truth_is_the_hand_numbers() -> None:
    lighter = {"body": {"tip_mass": {"as_built_factor": 0.9}}, "as_built": AS_DRAWN}
    truth = Mission(load("rocksat", lighter), 1).truth()
    assert truth["m4_kg"] == pytest.approx(0.23313)
    assert truth["m5_kg"] == pytest.approx(0.9 * 0.06627)
    assert truth["m4_plus_m5_kg"] == pytest.approx(0.23313 + 0.9 * 0.06627)
    assert truth["ZZ_without_tip_kg_m2"] == pytest.approx(1.101823e-3, rel=1e-6)
    assert truth["ZZ_with_tip_kg_m2"] == pytest.approx(1.101823e-3 + 0.9 * 1.981613e-3, rel=1e-6)
    np.testing.assert_allclose(truth["first_moment_without_tip_kg_m"][:2], [9.26692e-3, 3.28713e-4], rtol=1e-5)
    assert truth["phases"][0] == {"code": 0, "action": "hold", "start_s": 0.0, "end_s": 5.0}


def test_faults_of_the_scenario_reach_their_devices() -> None:
    fault = {"kind": "silent", "device": "load_cell", "start_s": 1.0, "end_s": 2.0}
    heard = Ground(load("rocksat", SHORT | {"fault": [fault]}))
    seconds = [heard.seconds(stamp) for stamp, _ in heard.of(0x182)]
    assert min(seconds) < 1.0
    assert max(seconds) > 2.5
    assert not [s for s in seconds if 1.001 < s < 1.999]
    assert heard.truth["faults"][0]["device"] == "load_cell"


@pytest.mark.parametrize(
    ("fault", "error", "named"),
    [
        ({"kind": "off", "device": "imu_base", "time_s": 1.0}, ScenarioError, "time_s"),
        ({"kind": "off", "device": "imu_base"}, ScenarioError, "start_s"),
        ({"kind": "meteor", "device": "imu_base", "start_s": 1.0}, FaultError, "meteor"),
        ({"kind": "off", "device": "camera", "start_s": 1.0}, FaultError, "camera"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(fault, error, named) -> None:
    with pytest.raises(error, match=named):
        open_in_process(load("rocksat", SHORT | {"fault": [fault]}), 1)


def test_a_mission_is_attached_once_and_before_it_flies() -> None:
    mission = Mission(load("rocksat", SHORT), 1)
    with pytest.raises(RuntimeError, match=r"Mission\.attach first"):
        mission.advance(mission.start_ns)
    with pytest.raises(RuntimeError, match=r"Mission\.attach first"):
        mission.produced()
    opened, _ = open_in_process(load("rocksat", SHORT), 1)
    with opened, pytest.raises(RuntimeError, match="attached already"):
        opened.attach({})


def test_closing_gives_the_buses_back() -> None:
    mission, urls = open_in_process("rocksat", 1)
    directory = Path(urls["sync_line"].removeprefix("gpio+unix://")).parent
    assert directory.is_dir()
    mission.close()
    assert not directory.exists()
    with pytest.raises(OSError, match=re.escape(errno.errorcode[errno.ENOENT]) + "|No such file"):
        smbus2.SMBus(urls["i2c_1"].removeprefix("i2c://"))
    again, _ = open_in_process("rocksat", 1)
    again.close()


def test_no_such_scenario_opens_nothing() -> None:
    with pytest.raises(ScenarioError, match="apollo"):
        open_in_process("apollo", 1)


# Any mix of devices on the same world


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
    np.testing.assert_array_equal(one.plant.history.moment_n_m[:2000], other.plant.history.moment_n_m[:2000])
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
