"""A mission on its buses, seen by a flight computer written here with smbus2 and python-can alone.

COB-IDs, mappings and units are those of the published bus layout: SYNC 0x080, encoder TPDO2 0x281 (u32 position),
load cell TPDO1 0x182 (i32 at 0.1 mN, u8 status), arm controller TPDO1 0x183 (u8 phase, u8 event counter).

What a mission's seed settles, and what nothing else changes: draws, bytes on the buses, truth.
"""

import errno
import re
import struct
from pathlib import Path

import can
import numpy as np
import pytest
import smbus2

from hil_sim.buses.in_process import in_process
from hil_sim.faults import FaultError
from hil_sim.mission import Mission, open_in_process
from hil_sim.scenario.load import ScenarioError, load
from tests.hil_sim.built import AS_DRAWN
from tests.hil_sim.mission_ground import SHORT, Ground


def test_same_seed_same_bytes_and_another_seed_others(ground) -> None:
    scenario, one = load("rocksat", SHORT), ground
    again, other = (Ground(scenario, seed, wake_imu=True) for seed in (5, 6))
    assert one.frames == again.frames
    assert one.edges == again.edges
    assert one.words == again.words
    assert one.frames != other.frames
    assert str(one.truth) == str(again.truth)


def test_data_do_not_hang_on_the_step_of_the_clock() -> None:
    scenario = load("rocksat", SHORT)
    fine, coarse = (Ground(scenario, 5, step_ns=step) for step in (1_000_000, 50_000_000))
    assert fine.frames == coarse.frames
    assert fine.edges == coarse.edges
    assert len(fine.edges) > 10
    assert len(fine.of(0x281)) > 400


def test_nothing_hangs_on_how_far_the_plant_is_computed_ahead(ground, monkeypatch) -> None:
    monkeypatch.setattr("hil_sim.mission._AHEAD_S", 0.0)
    other = Ground(load("rocksat", SHORT), wake_imu=True)
    assert len(other.words) > 100
    assert (other.frames, other.edges, other.words) == (ground.frames, ground.edges, ground.words)


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
    for mission in (one, other):
        mission.plant.advance(1.0)
    forces = [mission.plant.inertial("imu_base").specific_force_m_s2[:2000] for mission in (one, other)]
    assert (forces[0] != forces[1]).all()
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
    lighter = {"as_built": AS_DRAWN | {"tip_mass": AS_DRAWN["tip_mass"] | {"mass_factor": 0.9}}}
    truth = Mission(load("rocksat", lighter), 1).truth()
    arm, c = truth["links"]["arm"], truth["quantities"]
    assert arm["mass_kg"] == pytest.approx(0.23313)
    np.testing.assert_allclose(arm["mass_kg"] * arm["centre_of_mass_m"][:2], [9.26692e-3, 3.28713e-4], rtol=1e-5)
    assert c["m_tip_mass"] == pytest.approx(0.9 * 0.06627)
    seat_m = 0.1557 + 0.0164
    about_joint = c["I_zz_tip_mass"] + c["m_tip_mass"] * ((seat_m + c["c_x_tip_mass"]) ** 2 + c["c_y_tip_mass"] ** 2)
    assert about_joint == pytest.approx(0.9 * 1.981613e-3, rel=1e-6)
    assert truth["phases"][0] == {"code": 0, "action": "hold", "start_s": 0.0, "end_s": 5.0}


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
        near = mission.plant.moment_n_m("joint_1")[row - 4 : row + 5] / t["moment_Nm_per_N"] + t["zero_N"]
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
        near = mission.plant.angle_rad("joint_1")[row - 2 : row + 3]
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
    assert ground.truth["ejection_s"] == pytest.approx(2.3)


def test_imu_words_are_specific_force_and_rate(ground) -> None:
    t, imu = ground.truth["imu_base"], ground.mission.plant.inertial("imu_base")
    words = np.array([word for _, word in ground.words], dtype=float)
    accel_g, gyro = words[:, 0:3] / 8192, words[:, 4:7] / 131
    rows = np.array([round(ground.seconds(at) / 5e-4) for at, _ in ground.words])
    # 3 ms filters and 1 ms sampling: compare means over the flight.
    force_g = imu.specific_force_m_s2[rows].mean(axis=0) / 9.80665
    rate = np.rad2deg(imu.rate_rad_s[rows]).mean(axis=0)
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


def test_devices_stay_on_after_the_sequence_where_that_is_asked(tmp_path) -> None:
    mission = Mission(load("rocksat", SHORT), 1, linger_s=1.0)
    with in_process(mission.scenario.bus, tmp_path, lambda: mission.now_ns) as ports:
        channel = re.fullmatch(r"can\+virtual://([^?]+)\?.*", ports.urls["can_0"]).group(1)
        with can.Bus(interface="virtual", channel=channel):
            mission.attach(ports.buses)
            of_the_sequence_ns = mission.start_ns + round(1e9 * mission.duration_s)
            mission.advance(of_the_sequence_ns)
            syncs = mission.produced()["can_sync"]
            mission.advance(mission.end_ns)
            assert mission.end_ns - of_the_sequence_ns == 1_000_000_000
            assert mission.produced()["can_sync"] - syncs == pytest.approx(200, abs=3)
    assert mission.truth()["duration_s"] == Mission(load("rocksat", SHORT), 1).duration_s
    late = {"kind": "silent", "device": "load_cell", "start_s": mission.duration_s + 0.5}
    with pytest.raises(FaultError, match="the mission ends at"):
        Mission(load("rocksat", SHORT | {"fault": [late]}), 1, linger_s=1.0)


def test_closing_gives_the_buses_back() -> None:
    mission, urls = open_in_process(load("rocksat", SHORT), 1)
    directory = Path(urls["sync_line"].removeprefix("gpio+unix://")).parent
    assert directory.is_dir()
    mission.close()
    assert not directory.exists()
    with pytest.raises(OSError, match=re.escape(errno.errorcode[errno.ENOENT]) + "|No such file"):
        smbus2.SMBus(urls["i2c_1"].removeprefix("i2c://"))
    again, _ = open_in_process(load("rocksat", SHORT), 1)
    again.close()


def test_no_such_scenario_opens_nothing() -> None:
    with pytest.raises(ScenarioError, match="apollo"):
        open_in_process("apollo", 1)
