"""A mapping that is proposed brings the recording in as it is, for each kind of recording: numbers, units and times."""

import json
import re
import sys

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from scipy.io import savemat

from onboard.cli import BAD_INPUT, OK, main
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.guess.body import BodyChannels
from onboard.ground.log.bring_in.guess.propose import Names, propose
from onboard.ground.log.bring_in.guess.wheels import WheelChannels
from onboard.recording.reader import LogReader
from tests.ground.log.bring_in.guess import made
from tests.ground.log.bring_in.guess.made import COUNT, BEGAN_ns, PERIOD_s, T, arm, body


def guessed(path, *options):
    """Proposed by the command and brought in by the next one: the log and the proposal."""
    mapping = path.parent / f"{path.name}.toml"
    assert main(["import", "--guess", str(path), "-o", str(mapping), *options]) == OK
    assert main(["import", str(mapping), str(path), "-o", str(path.parent / "logs")]) == OK
    return LogReader(path.parent / "logs" / f"{path.stem}.mcap"), mapping.read_text(encoding="utf-8")


def values(log, name):
    rows = log.read(name)
    assert len(rows) == COUNT, name
    return rows["value_raw"] * rows["scale"].astype(np.float64)


def held(log, quantities, began_ns=None):
    """Channels against numbers in SI, and that samples are where they were."""
    for name, truth in quantities.items():
        assert values(log, name) == pytest.approx(truth, abs=2e-6 * max(1.0, np.abs(truth).max())), name
        time_ns = log.read(name)["host_ns"]
        assert np.diff(time_ns) == pytest.approx(1e9 * PERIOD_s, abs=2.0)
        if began_ns is not None:
            assert time_ns[0] == began_ns


def held_imu(log, of, name="imu_base", began_ns=None):
    rows = log.read(name)
    assert len(rows) == COUNT
    gyro = rows["gyro_raw"] * rows["gyro_scale_rad_s"][:, None].astype(np.float64)
    accel = rows["accel_raw"] * rows["accel_scale_m_s2"][:, None].astype(np.float64)
    sixteen_bits = 2.0**-12  # a quarter of their range: another recording may go further
    assert np.abs(gyro - of.rate).max() < sixteen_bits * np.abs(of.rate).max()
    assert np.abs(accel - of.force).max() < sixteen_bits * np.abs(of.force).max()
    assert np.diff(rows["host_ns"]) == pytest.approx(1e9 * PERIOD_s, abs=2.0)
    if began_ns is not None:
        assert rows["host_ns"][0] == began_ns


def joints(of, torque, joints_of=None):
    """Channels of an arm by their names."""
    count = of.q.shape[1]
    names = joints_of or [f"joint_{k + 1}" for k in range(count)]
    return {name: of.q[:, k] for k, name in enumerate(names)} | {
        f"{name}_torque": torque[:, k] for k, name in enumerate(names)
    }


@pytest.mark.parametrize("between", [",", " "])
def test_rtde_of_a_ur_arm(tmp_path, between):
    log, said = guessed(made.rtde(tmp_path / "rtde.csv", between))
    own = arm(6)
    held(log, joints(own, own.tau / 10.0), began_ns=12_345 * 10**9)
    assert set(log.read("joint_1_torque")["unit"]) == {b"A"}
    wrench = [f"{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz"]
    held(log, {name: own.tau[:, k] for k, name in enumerate(wrench)})
    assert "# doubtful" not in said
    assert '# not taken (commanded or computed, not measured): "target_q_0"' in said
    assert "125 Hz, no gaps" in said


def test_a_log_of_franka(tmp_path):
    log, said = guessed(made.franka(tmp_path / "franka.csv"))
    own = arm(7)
    held(log, joints(own, own.tau), began_ns=0)
    assert set(log.read("joint_7_torque")["unit"]) == {b"N m"}
    assert 'unit = "ms"    # as angles and their rates agree' in said
    assert "# doubtful" not in said


def test_an_imu_as_rostopic_writes_it(tmp_path):
    log, said = guessed(made.rostopic(tmp_path / "imu.csv"))
    held_imu(log, body(), began_ns=BEGAN_ns)
    held(log, {f"attitude_{axis}": body().attitude[:, k] for k, axis in enumerate("wxyz")}, began_ns=BEGAN_ns)
    assert 'unit = "ns"    # since 1970' in said
    assert "as the attitude turns" in said


@pytest.mark.parametrize(
    "make",
    [
        lambda d: made.bag_1(d / "a.bag"),
        lambda d: made.bag_2(d / "a"),
        lambda d: next(made.bag_2(d / "dir").glob("*.db3")),
        lambda d: made.bag_2(d / "a", StoragePlugin.MCAP),
        lambda d: made.mcap_of_ros(d / "a.mcap"),
    ],
    ids=["ros1", "ros2", "ros2_file", "ros2_mcap", "mcap"],
)
def test_bags_of_a_free_flyer(tmp_path, make):
    """By the stamps of the headers, which arrive later; joints by their names, whose order changes."""
    log, said = guessed(make(tmp_path))
    held_imu(log, body(), began_ns=BEGAN_ns)
    own = arm(2)
    held(log, joints(own, own.tau, ["shoulder", "elbow"]), began_ns=BEGAN_ns)
    held(log, {"force_z": T, "moment_y": 0.2 + 0.0 * T}, began_ns=BEGAN_ns)
    assert "# doubtful" not in said


def test_mcap_with_json(tmp_path):
    log, said = guessed(made.mcap_of_json(tmp_path / "a.mcap"))
    held_imu(log, body(), began_ns=BEGAN_ns)
    assert 'column = "/imu:log_time"' in said


def test_ulog_of_px4(tmp_path):
    log, said = guessed(made.ulog(tmp_path / "flight.ulg"))
    held_imu(log, body(), began_ns=5 * 10**9)
    held(log, {f"attitude_{k}": body().attitude[:, k].astype(np.float32) for k in range(4)}, began_ns=5_000_500_000)
    assert "# doubtful" not in said


def test_npz_and_mat(tmp_path):
    of, own = body(), arm(7)
    arrays = {"t": T, "imu_gyro": of.rate, "imu_accel": of.force, "q": own.q, "dq": own.qd, "tau": own.tau}
    np.savez(tmp_path / "a.npz", **arrays, label=np.array("text"), count=np.array(7))
    log, said = guessed(tmp_path / "a.npz")
    held_imu(log, of)
    held(log, joints(own, own.tau))
    assert "# doubtful" not in said
    nested = {"data": {"time": T[None], "q": own.q.T, "current": own.tau.T, "imu": {"gyro": of.rate, "acc": of.force}}}
    savemat(tmp_path / "b.mat", nested, do_compression=True)
    log, said = guessed(tmp_path / "b.mat")
    held_imu(log, of)
    held(log, joints(own, own.tau))
    assert set(log.read("joint_2_torque")["unit"]) == {b"A"}


def test_json_by_rows_by_columns_and_by_lines(tmp_path):
    """The same recording as a list of objects, an object of lists beside other things, and an object on each line."""
    own = arm(2)
    rows = [
        {"t": t, "state": {"q": q, "tau": tau}}
        for t, q, tau in zip(T.tolist(), own.q.tolist(), own.tau.tolist(), strict=True)
    ]
    lists = {"note": "x", "gains": [1.0, 2.0], "t": T.tolist(), "state": {"q": own.q.tolist(), "tau": own.tau.tolist()}}
    for name, text in (
        ("rows", json.dumps(rows, indent=1)),
        ("columns", json.dumps({"robot": "a", "samples": rows})),
        ("lists", json.dumps(lists)),
        ("lines", "\n".join(map(json.dumps, rows))),
    ):
        (tmp_path / f"{name}.json").write_text(text, encoding="utf-8")
        log, proposal = guessed(tmp_path / f"{name}.json")
        assert 'format = "json"' in proposal
        held(log, joints(own, own.tau))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"t": [0, 1], "q": [', "is no JSON that can be read"),
        ('[{"name": "a"}, {"name": "b"}]', "has no two rows of numbers"),
        ('[{"q": 1.0}]', "has no two rows of numbers"),
        ('{"a": ' * 100_000, "is no JSON that can be read"),
    ],
)
def test_json_without_rows_is_refused(tmp_path, capsys, text, said):
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    assert main(["import", "--guess", str(tmp_path / "a.json")]) == BAD_INPUT
    assert said in " ".join(capsys.readouterr().err.split())


def test_channels_are_named_like_the_devices_of_a_vehicle(tmp_path):
    made.rtde(tmp_path / "rtde.csv")
    init = ["init", str(tmp_path / "lab"), "--base", "fixed", "--joints", "a,b,c,d,e,f", "--encoder", "recorded"]
    assert main(init) == OK
    log, _ = guessed(tmp_path / "rtde.csv", "--vehicle", str(tmp_path / "lab" / "vehicle.toml"))
    own = arm(6)
    held(log, joints(own, own.tau / 10.0, list("abcdef")))


@pytest.mark.parametrize("form", ["[{}]", "({})", "array([{}])"])
def test_lists_in_a_cell_as_bags_in_csv_have_them(tmp_path, form):
    """An arm's angles, rates and torques, and an IMU; the list of the joints' names is text and not taken."""
    own, turning = arm(3), body()

    def lists(values, between=", "):
        return ['"' + form.format(between.join(f"{one:.7f}" for one in row)) + '"' for row in values]

    names = ["Time", "name", "position", "velocity", "effort"]
    columns = [T, ["\"['a', 'b', 'c']\""] * COUNT, lists(own.q), lists(own.qd), lists(own.tau)]
    log, said = guessed(made.text(tmp_path / "arm.csv", names, columns))
    held(log, joints(own, own.tau))
    assert 'column = "position[0]"' in said
    vectors = [T, lists(turning.rate, " "), lists(turning.force, "  ")]
    log, _ = guessed(made.text(tmp_path / "imu.csv", ["t", "angular_velocity", "linear_acceleration"], vectors))
    held_imu(log, turning)


@pytest.mark.parametrize(
    ("named", "pose"),
    [
        (("Valve_2", "valve_1"), ("x [mm]", "y [mm]", "heading [deg]")),
        (("cmd[1]", "cmd[0]"), ("pos_x_mm", "pos_y_mm", "yaw_deg")),
        (("u2", "u1"), ("pose_x [mm]", "pose_y [mm]", "theta_deg")),
    ],
)
def test_thrusters_and_the_pose_of_a_body_on_a_table(tmp_path, named, pose):
    """By the vehicle's names, or in the order of their numbers; a yaw that starts again after a turn goes on."""
    levels = np.random.default_rng(7).integers(0, 2, (2, COUNT)).astype(np.float64)
    yaw = 4.0 * T
    wrapped = np.degrees((yaw + np.pi) % (2.0 * np.pi) - np.pi)
    columns = [T, levels[1], levels[0], 1e3 * np.sin(T), 1e3 * np.cos(T), wrapped, np.cos(3.0 * T)]
    path = made.text(tmp_path / "a.csv", ["t", *named, *pose, "pressure"], columns)
    proposal = propose(path, Names(body=BodyChannels(("valve_1", "valve_2"), pose="tracker")))
    mapping = tmp_path / "a.toml"
    mapping.write_text(proposal.text)
    assert main(["import", str(mapping), str(path), "-o", str(tmp_path / "logs")]) == OK
    log = LogReader(tmp_path / "logs" / "a.mcap")
    held(log, {"valve_1": levels[0], "valve_2": levels[1], "tracker_x": np.sin(T), "tracker_y": np.cos(T)})
    assert np.unwrap(values(log, "tracker_yaw")) == pytest.approx(yaw, abs=1e-4)
    assert np.diff(values(log, "tracker_yaw")).max() < 0.1
    assert '# not taken (no name that is known, or no number): "pressure"' in proposal.text


@pytest.mark.parametrize("unit", ["rad", "deg"])
@pytest.mark.parametrize("largest", [0.15, 12.0])
@pytest.mark.parametrize("y_sign", [1.0, -1.0])
def test_the_unit_of_a_heading_is_told_by_where_the_thrusters_push(tmp_path, unit, largest, y_sign):
    """A heading up to 12 rad, or 9 degrees, of which no name says the unit; thrusters in per cent. A body of 8 kg.

    A y that counts the other way made degrees of radians.
    """
    rng = np.random.default_rng(3)
    time, step = np.arange(0.0, 60.0, 0.01), 0.01
    levels = np.repeat(rng.integers(0, 2, (4, 60)) * rng.uniform(0.3, 1.0, (4, 60)), 100, axis=1)
    yaw = largest * np.sin(0.11 * time)
    way = np.exp(1j * yaw) * ([1.0, -1.0, 1.0j, -1.0j] @ levels) * 0.5 / 8.0
    place = np.cumsum(np.cumsum(way)) * step**2 + 0.05 * np.exp(1j * yaw)
    noise = 3e-4 * rng.normal(size=(2, len(time)))
    columns = [time, *(100.0 * levels), place.real + noise[0], y_sign * place.imag + noise[1]]
    columns.append(yaw if unit == "rad" else np.degrees(yaw))
    path = made.text(tmp_path / "a.csv", ["t", "u1", "u2", "u3", "u4", "x", "y", "yaw"], columns)
    names = Names(body=BodyChannels(("t1", "t2", "t3", "t4"), pose="tracker"))
    proposal = propose(path, names)
    assert proposal.doubts == ()
    assert "bad_rows" not in proposal.text
    lost = made.text(tmp_path / "b.csv", ["t", "u1", "u2", "u3", "u4", "x", "y", "yaw"], columns)
    lines = lost.read_text().splitlines()
    lost.write_text("\n".join([*lines[:9], re.sub(r",[^,]*$", ",nan", lines[9]), *lines[10:]]))
    assert 'bad_rows = "skip"    # 1 rows have a cell that is no number' in propose(lost, names).text
    (tmp_path / "a.toml").write_text(proposal.text)
    assert main(["import", str(tmp_path / "a.toml"), str(path), "-o", str(tmp_path / "logs")]) == OK
    log = LogReader(tmp_path / "logs" / "a.mcap")
    for name, truth in (("tracker_yaw", yaw), ("t2", levels[1])):
        rows = log.read(name)
        assert rows["value_raw"] * rows["scale"].astype(np.float64) == pytest.approx(truth, abs=1e-5)


@pytest.mark.parametrize("up", ["z", "y"])
@pytest.mark.parametrize(
    ("named", "w_first"),
    [
        (("pos.x", "pos.y", "pos.z", "quat.w", "quat.x", "quat.y", "quat.z"), True),
        (("x [mm]", "y [mm]", "z [mm]", "qx", "qy", "qz", "qw"), False),
        (("body_position_x", "body_position_y", "body_position_z", "q0", "q1", "q2", "q3"), True),
        (("p_x", "p_y", "p_z", "quaternion[0]", "quaternion[1]", "quaternion[2]", "quaternion[3]"), False),
    ],
)
def test_a_body_on_a_table_that_is_tracked_with_a_quaternion(tmp_path, named, w_first, up):
    """w first or last, by name or by which two are large; with y up the table's y is the recorder's -z."""
    levels, yaw = np.random.default_rng(7).integers(0, 2, COUNT).astype(np.float64), 4.0 * T
    size, level = 1e3 if "[mm]" in named[0] else 1.0, np.full(COUNT, 1e-3)
    parts = {"w": np.cos(0.5 * yaw), "x": level, "y": -level, "z": np.sin(0.5 * yaw)}
    place = size * np.array([np.sin(T), np.cos(T), level])
    if up == "y":
        parts |= {"y": parts["z"], "z": -parts["y"]}
        place = np.array([place[0], place[2], -place[1]])
    columns = [T, levels, *place, *(parts[axis] for axis in ("wxyz" if w_first else "xyzw"))]
    path = made.text(tmp_path / "a.csv", ["t", "u1", *named], columns)
    mapping = tmp_path / "a.toml"
    mapping.write_text(propose(path, Names(body=BodyChannels(("valve_1",), pose="tracker"))).text)
    assert main(["import", str(mapping), str(path), "-o", str(tmp_path / "logs")]) == OK
    log = LogReader(tmp_path / "logs" / "a.mcap")
    held(log, {"valve_1": levels, "tracker_x": np.sin(T), "tracker_y": np.cos(T)})
    assert values(log, "tracker_yaw") == pytest.approx(yaw, abs=1e-4)


def test_a_column_that_says_from_when_on_the_payload_is_held(tmp_path):
    """By its name and its two values; a column that goes back, or says more, is none."""
    own, held_from = arm(2), np.where(T[COUNT // 3] < T, 1.0, 0.0)
    back, level = np.where((T > 1.0) & (T < 2.0), 1.0, 0.0), 3.0 * held_from
    names = ["t", "q1", "q2", "tau1", "tau2"]
    vehicle = Names(("imu",), ("a", "b"), ("a_torque", "b_torque"), wheels=WheelChannels(held="recording"))
    for called, column, found in (
        ("gripper_closed", held_from, True),
        ("holding", held_from + 1.0, True),
        ("object_held", back, False),
        ("load", level, False),
        ("mode", held_from, False),
    ):
        path = made.text(tmp_path / "a.csv", [*names, called], [T, *own.q.T, *own.tau.T, column])
        mapping = tmp_path / "a.toml"
        mapping.write_text(text := propose(path, vehicle).text)
        assert ("[channel.recording]" in text) == found, called
        if found:
            assert main(["import", str(mapping), str(path), "-o", str(tmp_path / called)]) == OK
            held(LogReader(tmp_path / called / "a.mcap"), {"recording": column})


def test_thrusters_that_were_commanded_by_times(tmp_path):
    seconds = np.random.default_rng(7).integers(0, 900, (2, COUNT)).astype(np.float64)
    path = made.text(tmp_path / "a.csv", ["t", "on_1", "on_2", "x", "y", "yaw"], [T, *seconds, T, T, T])
    text = propose(path, Names(body=BodyChannels(("a", "b"), on_time=True, pose="pose"))).text
    of_a = text.partition("[channel.a.value]\n")[2].partition("[channel.b]")[0]
    assert of_a.startswith('column = "on_1"\n')
    assert 'unit = "ms"    # up to 89' in of_a
    assert '"on_1"' not in propose(path, Names(body=BodyChannels(("a", "b"), pose="pose"))).text.partition("# not")[0]


def test_lists_of_another_length_are_bad_rows(tmp_path, capsys):
    rows = [f"{0.008 * k:.3f};[{k % 7}.5, 2.5];[1.5, {k % 5}.5]" for k in range(60)]
    rows[20] = "0.160;[1.5];[1.5, 2.5]"
    path = tmp_path / "a.csv"
    path.write_text("t;q;tau\n" + "\n".join(rows) + "\n")
    mapping = tmp_path / "a.toml"
    assert main(["import", "--guess", str(path), "-o", str(mapping)]) == OK
    text = mapping.read_text()
    assert 'bad_rows = "skip"    # 1 rows have a cell that is no number' in text
    mapping.write_text(text.replace('"skip"', '"refuse"'))
    assert main(["import", str(mapping), str(path), "-o", str(tmp_path / "logs")]) == BAD_INPUT
    assert "row 21 has '[1.5]', where others have a list of 2 numbers" in capsys.readouterr().err


def test_columns_of_a_kuka_controller(tmp_path):
    """Measured angles and motor currents; set points are not taken."""
    own = arm(6)
    names = ["time", *(f"{what}_A{k}" for what in ("ASPos", "AIPos", "MACur") for k in range(1, 7))]
    path = made.text(tmp_path / "a.csv", names, [T, *np.degrees(own.q + 0.1).T, *np.degrees(own.q).T, *own.tau.T])
    log, said = guessed(path)
    held(log, joints(own, own.tau))
    assert 'column = "MACur_A6"' in said


def test_columns_that_are_called_by_their_joints(tmp_path):
    """The file's order of joints is another than the vehicle's: names decide, and a lone current is no joint's."""
    own = arm(3)
    names = [f"{joint}_{what}" for what in ("pos_deg", "torque_Nm") for joint in ("elbow", "wrist_1", "base_pan")]
    columns = [T, *np.degrees(own.q[:, [1, 2, 0]]).T, *own.tau[:, [1, 2, 0]].T, np.cos(T)]
    path = made.text(tmp_path / "a.csv", ["time", *names, "supply_current_A"], columns)
    log, _ = guessed(path)
    held(log, joints(own, own.tau, ["base_pan", "elbow", "wrist_1"]))
    links = ("base_pan_joint", "elbow_joint", "wrist_1_joint")
    proposed = propose(path, Names(angles=links)).text
    assert '[channel.elbow_joint.value]\ncolumn = "elbow_pos_deg"' in proposed
    assert '[channel.wrist_1_joint.value]\ncolumn = "wrist_1_pos_deg"' in proposed


def test_columns_that_are_called_like_the_joints_of_the_vehicle_and_nothing_more(tmp_path):
    own = arm(3)
    names = ["elbow_deg", "wrist_2_deg", "Shoulder (deg)", "heading_deg"]
    columns = [T, *np.degrees(own.q[:, [1, 2, 0]]).T, np.cos(T)]
    path = made.text(tmp_path / "a.csv", ["time", *names], columns)
    for joints_of in (("shoulder", "elbow", "wrist_2"), ("shoulder_joint", "elbow_joint", "wrist_2_joint")):
        proposed = propose(path, Names(angles=joints_of)).text
        for joint, column in zip(joints_of, ("Shoulder (deg)", "elbow_deg", "wrist_2_deg"), strict=True):
            assert f'[channel.{joint}.value]\ncolumn = "{column}"' in proposed
        assert "channel.heading" not in proposed
    assert 'column = "elbow_deg"' not in propose(path, Names(angles=("shoulder", "elbow", "slide"))).text
    path = made.text(tmp_path / "b.csv", ["time", "Hinge1", "hinge_2", "other"], [T, *own.q[:, :2].T, np.cos(T)])
    proposed = propose(path, Names(angles=("hinge1", "hinge2"))).text
    for joint, column in (("hinge1", "Hinge1"), ("hinge2", "hinge_2")):
        assert f'[channel.{joint}.value]\ncolumn = "{column}"' in proposed


def test_a_single_angle_without_a_number_is_that_of_joint_1(tmp_path):
    log, _ = guessed(made.text(tmp_path / "a.csv", ["time", "angle_rad", "torque_Nm"], [T, np.sin(T), np.cos(T)]))
    held(log, {"joint_1": np.sin(T), "joint_1_torque": np.cos(T)})


def test_axes_and_attitudes_are_no_joints(tmp_path):
    names = ["time", "roll_angle", "pitch_angle", "x_pos", "y_pos"]
    _, mapping = guessed(made.text(tmp_path / "a.csv", names, [T, np.sin(T), np.cos(T), np.sin(2 * T), np.cos(2 * T)]))
    assert "channel.roll" not in mapping
    assert "channel.x" not in mapping


def test_columns_without_names_by_what_is_the_derivative_of_what(tmp_path):
    own = arm(6)
    columns = [100.0 + T, *own.q.T, *own.qd.T, *own.tau.T, *own.tau.T]
    log, said = guessed(made.text(tmp_path / "a.csv", (), columns, digits=4))
    for name, truth in joints(own, own.tau).items():
        assert values(log, name) == pytest.approx(truth, abs=1e-4), name
    assert said.count("# doubtful") == 1
    assert "it follows the rates: N m, or A of the motors' currents; or columns 20 to 25" in said


def test_what_reads_a_kind_and_is_not_installed_is_named_with_its_remedy(tmp_path, monkeypatch, capsys):
    files = {"rosbags": (made.bag_1(tmp_path / "a.bag"), made.mcap_of_ros(tmp_path / "b.mcap")), "pyulog": ()}
    files["pyulog"] = (made.ulog(tmp_path / "c.ulg"),)
    for package, some in files.items():
        extra = "bags" if package == "rosbags" else "ulog"
        for name in [name for name in sys.modules if name.partition(".")[0] == package] + [package]:
            monkeypatch.setitem(sys.modules, name, None)
        for path in some:
            assert main(["import", "--guess", str(path)]) == BAD_INPUT
            assert f"pip install 'heft-flight[{extra}]'" in capsys.readouterr().err


def test_a_file_is_not_written_over_and_wrong_uses_are_told(tmp_path, capsys):
    path = made.rtde(tmp_path / "rtde.csv")
    assert main(["import", "--guess", str(path)]) == OK
    assert capsys.readouterr().out.startswith('# Proposed by heft import --guess "rtde.csv"')
    there = tmp_path / "mine.toml"
    there.write_text("mine")
    assert main(["import", "--guess", str(path), "-o", str(there)]) == BAD_INPUT
    assert there.read_text() == "mine"
    assert main(["import", str(there), "--guess", str(path)]) == BAD_INPUT
    assert main(["import", str(there)]) == BAD_INPUT
    assert "--guess FILE for a mapping to begin with" in capsys.readouterr().err
    assert main(["import", str(there), str(path), "-o", str(tmp_path), "--vehicle", "rocksat"]) == BAD_INPUT
    with pytest.raises(SourceError, match="is a directory"):
        propose(tmp_path, Names())
