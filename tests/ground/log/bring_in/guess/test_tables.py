"""A mapping proposed for a table: thrusters and poses of a body, joints by their columns, and what is refused."""

import re

import numpy as np
import pytest

from onboard.cli import OK, main
from onboard.ground.log.bring_in.guess.body import BodyChannels
from onboard.ground.log.bring_in.guess.propose import Names, propose
from onboard.ground.log.bring_in.guess.wheels import WheelChannels
from onboard.recording.reader import LogReader
from tests.ground.log.bring_in.guess import made
from tests.ground.log.bring_in.guess.brought_in import guessed, held, joints, values
from tests.ground.log.bring_in.guess.made import COUNT, T, arm


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


@pytest.mark.parametrize(
    ("unit", "largest", "y_sign"),
    [  # each pair of the three; the other four are campaigns
        ("rad", 0.15, 1.0),
        ("deg", 12.0, 1.0),
        ("deg", 0.15, -1.0),
        ("rad", 12.0, -1.0),
        *(
            pytest.param(*one, marks=pytest.mark.campaign)
            for one in (("rad", 12.0, 1.0), ("deg", 0.15, 1.0), ("deg", 12.0, -1.0), ("rad", 0.15, -1.0))
        ),
    ],
)
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
