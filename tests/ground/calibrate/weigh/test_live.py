"""``heft weigh --device``: poses are taken at rest, the end, what is refused; against the simulated workshop."""

import json
import re

import numpy as np
import pytest

from drivers.records import IMU, SCALAR, SampleStatus
from hil_sim.bench import BenchMission
from hil_sim.devices.vehicle_file import scenario_of
from onboard.cli import BAD_INPUT, OK, main
from onboard.cli.common import load_vehicle
from onboard.estimation.errors import CalibrationError
from onboard.ground.calibrate.place import place
from onboard.ground.calibrate.weigh import tare
from onboard.ground.calibrate.weigh.conventions import Said
from onboard.ground.calibrate.weigh.errors import PosesError
from onboard.ground.calibrate.weigh.judge import judge_live
from onboard.ground.calibrate.weigh.live import Session
from onboard.ground.calibrate.weigh.wrist_sensor import wrist_sensor
from tests.ground.calibrate.weigh.wrist_bench import GRAVITY, turn

MASS, CENTRE = 1.3, np.array([0.01, -0.004, 0.06])
IMU_TABLE = """
[device.hand]
kind = "mpu6050"
bus = "i2c_1"
address = 0x68
sample_rate_hz = 100
gyro_noise_rad_s = 2e-3
accel_noise_m_s2 = 0.02
frame = "wrist"

[bus.i2c_1]
url = "i2c:///dev/i2c-1"
"""


@pytest.fixture(scope="module")
def workshop():
    return load_vehicle("workshop")


def session(vehicle, said=(), link="", scale=0.0025):
    told = []
    return (
        Session(
            *(wrist_sensor(vehicle, link), place(None), (0.0, 0.0, -1.0), scale, 0.1, 0.01),
            *(Said("sensor-in-base", "sensor", *said), told.append),
        ),
        told,
    )


class Wrist:
    """Held in poses by hand, and read: rows as the drivers make them, at 50 Hz. The axes by NumPy."""

    def __init__(self, live, seed, noise=0.5, readings=lambda force, moment: (force, moment)):
        self.live, self.rng, self.now_s, self.noise = live, np.random.default_rng(seed), 100.0, noise
        self.readings, self.q, self.without = readings, np.zeros(5), ()
        self.zero = self.rng.normal(size=6) * 0.3

    def rotation(self, q):
        z, y = ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
        return np.linalg.multi_dot([turn(a * np.array(u)) for a, u in zip(q, (z, y, z, y, z), strict=True)])

    def values(self, q, count):
        """By channel, (count,) or (count, 3): what a cell reads is what the wrist pushes with."""
        up = self.rotation(q).T @ [0.0, 0.0, GRAVITY]
        parts = self.readings(MASS * up, np.cross(CENTRE, MASS * up))
        made = np.concatenate(parts) / np.repeat([1.0, 0.05], 3)
        for k, cell in enumerate(self.live.sensor.cells):
            yield cell.channel, made[k] + self.zero[k] + self.noise * cell.keys.noise_N * self.rng.normal(size=count)
        for channel, angle in zip(self.live.sensor.joints, q, strict=False):
            yield channel, np.full(count, angle)
        if self.live.sensor.imu:
            yield self.live.sensor.imu, up + 0.01 * self.rng.normal(size=(count, 3))

    def pass_s(self, seconds, rate=0.0):
        """Time goes by; joint 2 turns at ``rate``, rad/s."""
        for _ in range(round(seconds / 0.2)):
            if self.live.done:
                return
            self.q = self.q + np.array([0.0, 0.2 * rate, 0.0, 0.0, 0.0])
            for channel, values in self.values(self.q, 10):
                if channel not in self.without:
                    self.live.feed(channel, self.rows(channel, values))
            self.now_s += 0.2
            self.live.step(self.now_s)

    def rows(self, channel, values):
        imu = channel == self.live.sensor.imu
        rows = np.zeros(len(values), IMU if imu else SCALAR)
        rows["host_ns"] = ((self.now_s + 0.02 * np.arange(len(values))) * 1e9).astype(np.int64)
        if imu:
            rows["accel_scale_m_s2"], rows["gyro_scale_rad_s"] = 1e-3, 1e-3
            rows["accel_raw"] = np.rint(values / 1e-3)
        else:
            signal = self.live.sensor.signals[channel]
            rows["unit"], rows["scale"] = next(iter(signal.si)), 1e-5
            rows["value_raw"] = np.rint(values / 1e-5) + signal.zero_count
        return rows

    def poses(self, count):
        """From pose to pose by hand, until it is done."""
        for _ in range(count):
            self.q = self.rng.uniform(-2.5, 2.5, 5)
            self.pass_s(4.0)
        return self.live.answer


@pytest.mark.campaign  # it ends so in the simulated workshop, and by an accelerometer: below
def test_it_ends_when_the_mass_is_known_to_one_percent(workshop):
    live, told = session(workshop)
    answer = Wrist(live, 3).poses(30)
    mass = answer.quantities[0]
    assert mass.low <= MASS <= mass.high
    assert 0.5 * (mass.high - mass.low) <= 0.01 * mass.value
    assert 6 <= len(live.R) < 12
    assert live.done.startswith("the mass is known to")
    assert all("most tells" in line for line in told[4:-1])  # which pose comes next
    centre = np.array([[one.low, one.high] for one in answer.quantities[1:4]])
    assert ((centre[:, 0] <= CENTRE) & (centre[:, 1] >= CENTRE)).all()


def test_an_ill_calibrated_sensor_ends_where_no_pose_would_tell_more(workshop):
    live, _ = session(workshop, scale=0.03)
    Wrist(live, 5).poses(40)
    assert "how well the sensor is calibrated" in live.done
    assert 12 <= len(live.R) <= 40


def test_nothing_is_taken_while_the_wrist_turns_and_no_pose_twice(workshop):
    live, told = session(workshop)
    wrist = Wrist(live, 7)
    wrist.pass_s(8.0, rate=0.004)  # 0.2 deg/s: 0.5 deg in the window
    assert not live.R
    wrist.pass_s(4.0)
    assert len(live.R) == 1
    wrist.pass_s(20.0)
    assert len(live.R) == 1
    assert any("rests where it was" in line for line in told)
    wrist.q = np.array([0.9, 0.9, 0.0, 0.0, 0.0])
    wrist.pass_s(1.0)
    assert len(live.R) == 1  # not yet at rest for long enough
    wrist.pass_s(2.0)
    assert len(live.R) == 2


def test_a_tool_that_swings_is_waited_for(workshop):
    live, told = session(workshop)
    wrist = Wrist(live, 8, noise=40.0)
    wrist.pass_s(20.0)
    assert not live.R
    assert any(re.search(r"wrist_\w+ moves by .* let the tool come to rest", line) for line in told)


@pytest.mark.campaign  # by a table of poses: test_weigh; a verdict of live poses: below
def test_a_stuck_axis_is_named(workshop):
    live, _ = session(workshop)
    Wrist(live, 9, readings=lambda f, m: (f * [0.0, 1.0, 1.0], m), noise=0.0).poses(7)
    judged = judge_live(live.answer, "wrist")
    assert judged.verdict.level == "do not use"
    assert "force x reads the same in poses that differ: it is stuck" in judged.verdict.text


def test_cells_of_the_other_sign_are_named(workshop):
    live, _ = session(workshop)
    Wrist(live, 10, readings=lambda f, m: (-f, -m)).poses(9)
    judged = judge_live(live.answer, "wrist")
    assert judged.verdict.level == "do not use"
    assert "turn the sign of each `axis`" in judged.verdict.text


@pytest.mark.campaign  # by a table of poses: test_weigh; all axes: above
def test_one_axis_of_the_other_sign_is_named(workshop):
    live, _ = session(workshop)
    Wrist(live, 12, readings=lambda f, m: (f * [1.0, -1.0, 1.0], m)).poses(14)
    assert "the sign of force y is turned" in judge_live(live.answer, "wrist").verdict.text


def test_a_sensor_that_sits_turned_is_told_with_its_angle(workshop):
    about_z = turn([0.0, 0.0, np.deg2rad(30.0)]).T
    live, _ = session(workshop)
    answer = Wrist(live, 11, readings=lambda f, m: (about_z @ f, about_z @ m)).poses(12)
    assert answer.quantities[0].low <= MASS <= answer.quantities[0].high
    notes = " ".join(judge_live(answer, "wrist").notes)
    assert re.search(r"turned against wrist as it is drawn, by (29\.9|30\.0|30\.1) deg about its z", notes)


def test_moments_in_another_unit_are_beyond_the_cells(workshop):
    live, told = session(workshop)
    Wrist(live, 13, readings=lambda f, m: (f, 1000.0 * m)).poses(3)
    assert not live.R
    assert any(re.search(r"wrist_moment_\w is overloaded", line) for line in told)


def test_a_silent_or_overloaded_channel_or_another_unit(workshop):
    live, told = session(workshop)
    wrist = Wrist(live, 1)
    rows = wrist.rows("wrist_force_x", np.zeros(10))
    rows["unit"] = b"lbf"
    with pytest.raises(CalibrationError, match="'lbf', which is none of N, kg"):
        live.feed("wrist_force_x", rows)
    rows["unit"], rows["status"] = b"N", SampleStatus.SATURATED
    wrist.without = ("wrist_force_x",)
    wrist.pass_s(1.0)
    for _ in range(20):
        rows["host_ns"] = int(wrist.now_s * 1e9) + np.arange(10) * 20_000_000
        live.feed("wrist_force_x", rows)
        wrist.pass_s(0.2)
    assert not live.R
    assert any("wrist_force_x is overloaded" in line for line in told)
    with pytest.raises(CalibrationError, match="nothing came from wrist_force_x"):
        wrist.pass_s(5.0)


def test_a_wrist_with_an_accelerometer_needs_no_encoders(workshop, tmp_path):
    assert main(["init", str(tmp_path / "lab"), "--from", "workshop"]) == OK
    file = tmp_path / "lab" / "vehicle.toml"
    text = re.sub(r"\[device\.joint_5\].*?\n\n", "", file.read_text(encoding="utf-8"), flags=re.S)
    file.write_text(text, encoding="utf-8")
    with pytest.raises(PosesError, match=r"an encoder on each of .*joint_5 \(joint_5 has none\), or an IMU"):
        wrist_sensor(load_vehicle(str(file)))
    file.write_text(text + IMU_TABLE, encoding="utf-8")
    live, told = session(load_vehicle(str(file)))
    answer = Wrist(live, 21).poses(20)
    assert "accelerometer of hand" in told[0]
    assert answer.quantities[0].low <= MASS <= answer.quantities[0].high
    assert live.done.startswith("the mass is known to")


def test_cells_that_are_no_wrist_sensor(workshop, tmp_path):
    with pytest.raises(PosesError, match="six load cells of a frame"):
        wrist_sensor(load_vehicle("rocksat"))
    with pytest.raises(PosesError, match="6 at wrist"):
        wrist_sensor(workshop, "elbow")
    main(["init", str(tmp_path / "lab"), "--from", "workshop"])
    file = tmp_path / "lab" / "vehicle.toml"
    text = file.read_text(encoding="utf-8").replace("axis = [0.0, 1.0, 0.0]", "axis = [1.0, 0.0, 0.0]", 1)
    file.write_text(text, encoding="utf-8")
    with pytest.raises(PosesError, match="do not tell force and moment apart"):
        wrist_sensor(load_vehicle(str(file)))


def test_a_cell_with_a_gain_gets_the_zero_that_it_reads(workshop, tmp_path):
    main(["init", str(tmp_path / "lab"), "--from", "workshop"])
    file = tmp_path / "lab" / "vehicle.toml"
    text = file.read_text(encoding="utf-8").replace("capacity_N = 120.0", "capacity_N = 120.0\ngain = 2.0", 1)
    file.write_text(text, encoding="utf-8")
    vehicle = load_vehicle(str(file))
    live, _ = session(vehicle)
    wrist = Wrist(live, 30, readings=lambda f, m: (f * [2.0, 1.0, 1.0], m))
    answer = wrist.poses(12)
    assert answer.quantities[0].low <= MASS <= answer.quantities[0].high
    written = {one.table[1]: one.value for one in tare.changes(vehicle, answer)}
    assert float(written["wrist_force_x"]) == pytest.approx(wrist.zero[0], abs=0.02)
    assert float(written["wrist_moment_y"]) == pytest.approx(wrist.zero[4], abs=0.02)


def test_the_simulated_workshop(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "lab", "--from", "workshop"]) == OK
    command = "weigh --device lab/vehicle.toml --hil workshop --seed 88 --vehicle lab/vehicle.toml --json one.json"
    assert main(command.split()) == OK
    found = json.loads((tmp_path / "one.json").read_text(encoding="utf-8"))
    truth = BenchMission("weigh", scenario_of("workshop"), 88, {}).truth()
    mass = truth["links"]["gripper"]["mass_kg"] + truth["quantities"]["m_tool"]
    told = next(one for one in found["quantities"] if one["name"] == "m")
    assert told["low"] <= mass <= told["high"]
    assert told["high"] - told["low"] <= 0.02 * mass
    assert 6 <= len(found["wrenches"]) <= 12
    assert (tmp_path / found["log"]).stat().st_size > 10_000
    assert (tmp_path / "lab" / "vehicle.toml").read_text(encoding="utf-8").count("offset_N") == 6
    assert "done, the mass is known to" in capsys.readouterr().out


def test_a_bench_without_a_bus_of_the_file_is_refused(tmp_path, monkeypatch, capsys):
    """Where the file is a copy of a packaged vehicle, with another bus."""
    monkeypatch.chdir(tmp_path)
    assert main(["init", "lab", "--from", "workshop"]) == OK
    file = tmp_path / "lab" / "vehicle.toml"
    file.write_text(file.read_text(encoding="utf-8").replace("can_0", "can_7"), encoding="utf-8")
    assert main(["weigh", "--device", "lab/vehicle.toml", "--hil"]) == BAD_INPUT
    assert "no bus 'can_7'; simulate the file: --hil lab/vehicle.toml" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("weigh", "give a table of poses"),
        ("weigh a.csv --device workshop", "give a table of poses"),
        ("weigh a.csv --hil", "--hil is for --device only"),
        ("weigh --device workshop --turned fx", "--turned is for a table of poses only"),
        ("weigh --device workshop --until-percent 0", "--until-percent 0"),
        ("weigh --device rocksat --hil", "six load cells"),
        ("weigh --device workshop --hil rocksat", "no arm on a fixed base"),
    ],
)
def test_what_is_refused(command, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(command.split()) == BAD_INPUT
    assert said in capsys.readouterr().err
