"""Proposals for recordings as people keep them: layouts of text, units by size, clocks; what cannot be a recording."""

import re

import numpy as np
import pytest

from onboard.cli import BAD_INPUT, OK, main
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.guess.body import BodyChannels
from onboard.ground.log.bring_in.guess.magnitudes import of_others
from onboard.ground.log.bring_in.guess.propose import Names, propose
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.recording.reader import LogReader
from tests.ground.log.bring_in.guess import made
from tests.ground.log.bring_in.guess.brought_in import held, held_imu
from tests.ground.log.bring_in.guess.made import COUNT, IMU_NAMES, T, arm, body, imu_columns

DEG = 180.0 / np.pi


def brought_in(path):
    found = propose(path, Names())
    (path.parent / "m.toml").write_text(found.text, encoding="utf-8")
    [log] = import_recordings(path.parent / "m.toml", path, path.parent / "logs")
    return LogReader(log.path), found, log.left_out


@pytest.mark.parametrize(
    "layout",
    [
        {},
        {"between": ";", "decimal": ","},
        {"between": ";"},
        {"between": "\t"},
        {"between": "\t", "decimal": ","},
        {"between": "   "},
        {"between": "|"},
        {"encoding": "utf-8-sig"},
        {"encoding": "utf-16"},
        {"before": "# a rig\n# another line, with commas, in it\n"},
        {"before": "My recording\n\nof the lab; 3, 4\n"},
        {"before": "% written by a script\n", "between": ";"},
    ],
    ids=str,
)
def test_layouts_of_text(tmp_path, layout):
    log, found, left_out = brought_in(made.text(tmp_path / "a.csv", IMU_NAMES, imu_columns(body()), **layout))
    held_imu(log, body(), began_ns=0)
    assert found.doubts == left_out == ()


def test_names_in_a_comment_and_text_of_latin_1(tmp_path):
    names = [*IMU_NAMES, "größe"]
    columns = [*imu_columns(body()), T]
    log, _, _ = brought_in(made.text(tmp_path / "a.csv", ["# time", *names[1:]], columns, encoding="latin-1"))
    held_imu(log, body())


def test_a_line_of_units(tmp_path):
    of = body()
    columns = [1e3 * T, *(DEG * of.rate).T, *(of.force / 9.80665).T]
    rows = [[unit, *(f"{value:.9f}" for value in one)] for unit, one in zip(
        ("[ms]", "[deg/s]", "[deg/s]", "[deg/s]", "[g]", "[g]", "[g]"), columns, strict=True
    )]  # fmt: skip
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", ("t", *IMU_NAMES[1:]), rows))
    held_imu(log, of)
    assert found.doubts == ()


@pytest.mark.parametrize(
    ("names", "rate", "force"),
    [
        (("gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s", "acc_x_g", "acc_y_g", "acc_z_g"), DEG, 1 / 9.80665),
        (("GyroX (deg/s)", "GyroY (deg/s)", "GyroZ (deg/s)", "AccX (m/s^2)", "AccY (m/s^2)", "AccZ (m/s^2)"), DEG, 1.0),
        (("gx_dps", "gy_dps", "gz_dps", "ax_g", "ay_g", "az_g"), DEG, 1 / 9.80665),
        (("wx", "wy", "wz", "ax", "ay", "az"), 1.0, 1.0),
        (("gx", "gy", "gz", "ax", "ay", "az"), 1.0, 1.0),
        (("angular_velocity.x", "angular_velocity.y", "angular_velocity.z", "a.x", "a.y", "a.z"), DEG, 1 / 9.80665),
        (("imu.gyro[0]", "imu.gyro[1]", "imu.gyro[2]", "imu.accel[0]", "imu.accel[1]", "imu.accel[2]"), 1.0, 1.0),
        (("omega_x", "omega_y", "omega_z", "accel_x", "accel_y", "accel_z"), DEG, 1e3 / 9.80665),
    ],
)
def test_units_of_an_imu_by_name_and_by_size(tmp_path, names, rate, force):
    of = body()
    columns = [T, *(rate * of.rate).T, *(force * of.force).T]
    log, _, _ = brought_in(made.text(tmp_path / "a.csv", ("time", *names), columns, digits=9))
    held_imu(log, of)


def test_an_attitude_beside_a_gyro_decides_its_unit(tmp_path):
    """Slow turns: 12 could be rad/s or deg/s by their size."""
    slow = body(12.0 / DEG)
    names = ("time", "gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z")
    columns = [T, *(DEG * slow.rate).T, *slow.force.T]
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", names, columns))
    assert any("up to 12" in doubt for doubt in found.doubts)
    columns += list(slow.attitude.T)
    log, found, _ = brought_in(made.text(tmp_path / "b.csv", (*names, "qw", "qx", "qy", "qz"), columns))
    held_imu(log, slow)
    assert found.doubts == ()


def test_counts_of_an_imu_are_kept_and_told_as_doubtful(tmp_path):
    of = body()
    columns = [1e6 * T, *np.rint(16.4 * DEG * of.rate).T, *np.rint(4096 / 9.80665 * of.force).T]
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", ("t_us", *IMU_NAMES[1:]), columns, digits=0))
    rows = log.read("imu_base")
    assert np.array_equal(rows["accel_raw"], np.rint(4096 / 9.80665 * of.force))
    assert rows["accel_scale_m_s2"] == pytest.approx(9.80665 / 4096)
    assert len(found.doubts) == 2


@pytest.mark.parametrize(
    ("unit", "factor", "began", "sure"),
    [
        ("s", 1.0, 0.0, True),
        ("ms", 1e3, 0.0, False),  # 8 ms could be 8 us of a fast recorder, or s of a slow one: 125 Hz is likelier
        ("us", 1e6, 0.0, True),
        ("ns", 1e9, 0.0, True),
        ("s", 1.0, 1.7e9, True),
        ("ms", 1e3, 1.7e12, True),
        ("us", 1e6, 1.7e15, True),
        ("ns", 1e9, 1.7e18, True),
    ],
)
def test_units_of_times(tmp_path, unit, factor, began, sure):
    stamps = [f"{int(began) + round(factor * one)}" if unit != "s" else f"{began + one:.6f}" for one in T.tolist()]
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", ("t", "force"), [stamps, np.sin(T)]))
    assert f'unit = "{unit}"' in found.text
    assert not (sure and found.doubts)
    held(log, {"load_cell": np.sin(T)})


def test_dates_as_in_iso_8601(tmp_path):
    begun = np.datetime64("2024-05-01T12:00:00", "ns")
    for between, end in ((" ", ""), ("T", "Z")):
        dates = [f"{begun + np.timedelta64(round(1e9 * one), 'ns')}".replace("T", between)[:26] + end for one in T]
        log, _, _ = brought_in(made.text(tmp_path / "a.csv", ("date", "force"), [dates, np.sin(T)]))
        held(log, {"load_cell": np.sin(T)}, began_ns=int(begun.astype(np.int64)))
    clocks = [f"9:{int(one) // 60:02d}:{one % 60.0:09.6f}" for one in T + 3.0]
    log, _, _ = brought_in(made.text(tmp_path / "b.csv", ("time", "force"), [clocks, np.sin(T)]))
    held(log, {"load_cell": np.sin(T)}, began_ns=(9 * 3600 + 3) * 10**9)


def test_angles_in_degrees_by_their_rates_and_by_their_size(tmp_path):
    own = arm(3)
    names = ("t", *(f"q{k}" for k in (1, 2, 3)), *(f"dq{k}" for k in (1, 2, 3)), *(f"i{k}" for k in (1, 2, 3)))
    small = [T, *(DEG * 0.05 * own.q).T, *(0.05 * own.qd).T, *own.tau.T]
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", names, small))
    held(log, {f"joint_{k + 1}": 0.05 * own.q[:, k] for k in range(3)})
    assert found.doubts == ()
    large = made.text(tmp_path / "b.csv", names[:4], [T, *(DEG * own.q).T])
    log, found, _ = brought_in(large)
    held(log, {f"joint_{k + 1}": own.q[:, k] for k in range(3)})
    odd = made.text(tmp_path / "c.csv", names[:7], [T, *own.q.T, *(7.0 * own.qd).T])
    assert "times as fast as 'dq1'" in propose(odd, Names()).doubts[0]


def test_poses_in_mm_moments_and_a_wrench(tmp_path):
    names = ("time", "pos_x", "pos_y", "pos_z", "fx", "fy", "fz", "tx [Nmm]", "ty [Nmm]", "tz [Nmm]")
    columns = [T, 900.0 + T, 2.0 * T, -T, 3.0 * T, T, T, 1e3 * T, T, T]
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", names, columns))
    held(log, {"position_x": 0.9 + 1e-3 * T, "force_x": 3.0 * T, "moment_x": T})
    assert set(log.read("position_x")["unit"]) == {b"m"}
    assert found.doubts == ("up to 903.2: m if it went so far",)


def test_bad_rows_are_proposed_to_be_skipped_and_counted(tmp_path):
    columns = [[f"{value:.7f}" for value in one] for one in imu_columns(body())]
    columns[1][5], columns[2][7], columns[3][9] = "NaN", "", "N/A"
    columns[0][50], columns[0][51] = columns[0][51], columns[0][50]
    columns[0][90] = columns[0][89]
    path = made.text(tmp_path / "a.csv", IMU_NAMES, columns)
    path.write_text(path.read_text() + "1.0,2.0\n" + path.read_text().splitlines()[-1].replace("3.", "9.", 1) + "\n")
    _, found, left_out = brought_in(path)
    assert "# 1 rows have another number of cells; 3 rows have a cell that is no number; " in found.text
    assert left_out[0].startswith("a.csv: 1 rows left out")
    assert left_out[1].startswith("5 rows left out")


def test_times_out_of_order_are_no_even_samples(tmp_path, capsys):
    order = np.random.default_rng(2).permutation(COUNT)
    path = made.text(tmp_path / "a.csv", IMU_NAMES, [one[order] for one in imu_columns(body())])
    assert main(["import", "--guess", str(path)]) == BAD_INPUT
    assert "'time' is a time by its name and does not rise: sort the recording" in capsys.readouterr().err


def test_rows_that_are_written_twice(tmp_path, capsys):
    """One in seven: they are left out. Times in whole seconds are coarser than the samples."""
    twice = np.sort(np.concatenate([np.arange(COUNT), np.arange(0, COUNT, 7)]))
    path = made.text(tmp_path / "a.csv", IMU_NAMES, [one[twice] for one in imu_columns(body())])
    log, found, _ = brought_in(path)
    assert f"{len(twice) - COUNT} rows have a time that does not rise" in found.text
    held_imu(log, body(), "imu_base")
    columns = imu_columns(body())
    made.text(path, IMU_NAMES, [np.floor(columns[0]), *columns[1:]])
    assert main(["import", "--guess", str(path)]) == BAD_INPUT
    assert "it is coarser than the samples" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(("unit", "modulus"), [("us", 1 << 32), ("ms", 1 << 16), ("us", 1 << 24)])
def test_a_counter_that_starts_at_0_again_goes_on(tmp_path, unit, modulus):
    """Of a microcontroller, 0.9 s before its end as the recording begins."""
    per_s = {"us": 1e6, "ms": 1e3}[unit]
    count = np.mod(np.rint(T * per_s) + modulus - np.rint(0.9 * per_s), modulus)
    path = made.text(tmp_path / "a.csv", (unit, *IMU_NAMES[1:]), [count, *imu_columns(body())[1:]], digits=7)
    log, found, left_out = brought_in(path)
    assert f"wraps = {modulus}    # it starts at 0 again" in found.text
    assert found.doubts == left_out == ()
    stamps = log.read("imu_base")["host_ns"].astype(np.int64)
    assert 1e-9 * (stamps - stamps[0]) == pytest.approx(np.rint(T * per_s) / per_s, abs=1e-9)
    (tmp_path / "m.toml").write_text(re.sub(r"(?m)^wraps.*\n", "", found.text), encoding="utf-8")
    with pytest.raises(SourceError, match="does not increase after row"):
        import_recordings(tmp_path / "m.toml", path, tmp_path / "without")


def test_times_that_begin_before_0(tmp_path):
    path = made.text(tmp_path / "a.csv", IMU_NAMES, [T - 1.3, *imu_columns(body())[1:]])
    log, found, left_out = brought_in(path)
    assert "offset = 2    # it begins before 0" in found.text
    assert left_out == ()
    assert log.read("imu_base")["host_ns"][0] == 700_000_000


@pytest.mark.parametrize(
    ("times", "why"),
    [
        (np.tile(T[: COUNT // 2], 2), f"'time' starts again in row {COUNT // 2 + 1}: cut the recordings apart"),
        (np.where(np.arange(COUNT) % 3, np.nan, T), "cells are no number: give them times"),
    ],
)
def test_times_that_are_none_are_told_with_the_remedy(tmp_path, times, why):
    path = made.text(tmp_path / "a.csv", IMU_NAMES, [times, *imu_columns(body())[1:]])
    with pytest.raises(SourceError, match=re.escape(why)):
        propose(path, Names())


def test_names_in_another_language_by_their_units(tmp_path):
    names = ("Zeit [ms]", "Gelenk 1 [°]", "Gelenk 2 [°]", "Drehmoment 1 [Nm]", "Drehmoment 2 [Nm]")
    own = arm(2)
    columns = [1e3 * T, *(DEG * own.q).T, np.sin(T), np.cos(T)]
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", names, columns, between=";", decimal=","))
    held(log, {"joint_1": own.q[:, 0], "joint_2": own.q[:, 1], "joint_1_torque": np.sin(T)})
    assert found.doubts == ("its unit, deg, is all that says what it is", "its unit, N m, is all that says what it is")


@pytest.mark.parametrize(
    ("unit", "size", "offset"),
    [("deg", 360.0, 0.0), ("deg", 360.0, -180.0), ("rad", 2.0 * np.pi, -np.pi), ("rev", 4096.0, 0.0)],
)
def test_angles_that_start_again_after_a_turn_go_on(tmp_path, unit, size, offset):
    turned = 3.0 * np.sin(0.5 * T) + 2.0  # rad, through the ends of any turn
    told = offset + np.mod(turned / (2.0 * np.pi) * size - offset, size)
    other = np.rint(told) if unit == "rev" else told
    names = ("time", f"q_1{'' if unit == 'rev' else f' [{unit}]'}")
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", names, [T, other]))
    [(_, rows)] = [(name, log.read(name)) for name in log.channels if name == "joint_1"]
    angle = rows["value_raw"] * float(rows["scale"][0])
    assert rows["unit"][0] == b"rad"
    np.testing.assert_allclose(angle - angle[0], turned - turned[0], atol=2.0 * np.pi / 4096)
    assert ("4096 in a turn" in "".join(found.doubts)) == (unit == "rev")


def test_an_angle_that_leaves_a_turn_does_not_start_again(tmp_path):
    path = made.text(tmp_path / "a.csv", ("time", "q_1 [deg]"), [T, 400.0 * np.sin(T)])
    assert "wraps" not in propose(path, Names()).text


@pytest.mark.parametrize("what", ["torque", "current"])
def test_angles_that_are_called_as_the_joints_of_torques(tmp_path, what):
    own, names = arm(2), ("time", "elbow", "wrist_1", f"elbow_{what}", f"wrist_1_{what}")
    columns = [T, *own.q.T, np.sin(T), np.cos(T)]
    log, _, _ = brought_in(made.text(tmp_path / "a.csv", names, columns))
    held(log, {"elbow": own.q[:, 0], "wrist_1": own.q[:, 1], "wrist_1_torque": np.cos(T)})
    log, _, _ = brought_in(made.text(tmp_path / "b.csv", ["time", "elbow", "q_1", *names[3:]], columns))
    assert "elbow" not in log.channels


@pytest.mark.parametrize(
    ("size", "between", "first"), [(1.0, 0, "gyro"), (16384 / 9.81, 1, "accel"), (1 / 9.81, 0, "accel")]
)
def test_numbers_without_names_of_which_three_are_gravity_at_rest(tmp_path, size, between, first):
    own = body()
    force = own.force * size if size < 100.0 else np.rint(own.force * size)
    blocks = [force, own.rate][:: 1 if first == "accel" else -1]
    columns = [T, *blocks[0].T, *[300.0 + T] * between, *blocks[1].T]
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", (), columns))
    rows = log.read("imu_base")
    sensed = rows["accel_raw"] * rows["accel_scale_m_s2"][:, None]
    np.testing.assert_allclose(sensed, own.force, rtol=2e-3, atol=2e-3)
    assert any("its size at rest is gravity's" in doubt for doubt in found.doubts)
    with pytest.raises(SourceError):
        propose(made.text(tmp_path / "b.csv", (), [T, *(own.rate.T), *(0.5 * own.rate.T)]), Names())


def test_axes_in_another_language_by_their_units(tmp_path):
    own = body()
    names = (
        "Zeit [s]",
        *(f"{what} {axis} [{unit}]" for what, unit in (("Drehrate", "rad/s"), ("Beschl.", "m/s²")) for axis in "XYZ"),
    )
    _, found, _ = brought_in(made.text(tmp_path / "a.csv", names, imu_columns(own), between=";", decimal=","))
    [channel] = found.channels
    assert channel == "imu_base"
    assert [one.partition(" is all")[0] for one in found.doubts] == ["its unit, m/s^2,", "its unit, rad/s,"]
    wrong = made.text(tmp_path / "b.csv", [name.replace("Beschl.", "error") for name in names], imu_columns(own))
    with pytest.raises(SourceError):
        propose(wrong, Names())


def test_translations_beside_rotations_are_no_moments(tmp_path):
    names = ("time", "RX", "RY", "RZ", "TX", "TY", "TZ")
    log, _, _ = brought_in(made.text(tmp_path / "a.csv", names, [T, T, T, T, 900.0 + T, T, T]))
    held(log, {"position_x": 0.9 + 1e-3 * T})


def test_a_gyro_beside_an_attitude_is_no_imu_of_a_vehicle(tmp_path):
    """Said first by heft identify, three commands later, before."""
    columns = np.column_stack([T, np.cos(T)[:, None] * [0.1, 0.2, 0.3], np.tile([1.0, 0.0, 0.0, 0.0], (COUNT, 1))])
    path = tmp_path / "bed.csv"
    np.savetxt(path, columns, delimiter=",", header="t,gyro_x,gyro_y,gyro_z,qw,qx,qy,qz", comments="")
    assert any("imu_base; gyro and accelerometer" in one for one in propose(path, Names(imus=("imu_base",))).doubts)
    assert not any("imu_base" in one for one in propose(path, Names()).doubts)


def test_yaml_is_refused_with_what_to_do(tmp_path):
    path = tmp_path / "poses.yaml"
    path.write_text("poses:\n" + "".join(f"- {{t: {k}, q: [1, 0, 0, 0]}}\n" for k in range(30)))
    with pytest.raises(SourceError, match="YAML, which is not read here: save it as JSON"):
        propose(path, Names())


def test_one_number_that_is_absurd_decides_neither_unit_nor_scale(tmp_path, capsys):
    """It made mm of m, and a scale by which nothing else was kept."""
    place = np.sin(T)
    place[7] = 1e30
    path = made.text(tmp_path / "a.csv", ["t", "x", "y", "yaw", "t1"], [T, place, np.cos(T), 0.1 * T, T > 1.0])
    proposed = propose(path, Names(body=BodyChannels(("t1",), pose="pose")))
    assert 'unit = "mm"' not in proposed.text
    (tmp_path / "a.toml").write_text(proposed.text)
    assert main(["import", str(tmp_path / "a.toml"), str(path), "-o", str(tmp_path / "logs")]) != OK
    assert "'x' is no usable number in row 8; remove the row" in capsys.readouterr().err


@pytest.mark.parametrize(("turn", "unit"), [(2.0 * np.pi, "rad"), (360.0, "deg")])
def test_a_heading_that_starts_again_says_its_unit_where_a_tracker_writes_zeros(tmp_path, turn, unit):
    yaw = (turn * 0.4 * T + 0.5 * turn) % turn - 0.5 * turn
    lost = slice(320, None)
    columns = [T, np.sin(T), np.cos(T), yaw, T > 1.0]
    for one in columns[1:4]:
        one[lost] = 0.0
    path = made.text(tmp_path / "a.csv", ["t", "x", "y", "yaw", "t1"], columns)
    proposed = propose(path, Names(body=BodyChannels(("t1",), pose="pose")))
    assert f'unit = "{unit}"    # it starts again after {turn:.4g}' in proposed.text


@pytest.mark.parametrize("pose_first", [True, False])
def test_a_body_without_names_by_the_places_of_its_columns(tmp_path, pose_first):
    place, levels = [np.sin(T), -np.cos(T), 0.5 * np.sin(T)], [(T > 1.0) * 1.0, (T < 2.0) * 1.0]
    columns = [T, *(place + levels if pose_first else levels + place)]
    path = made.text(tmp_path / "a.csv", [], columns)
    wanted = BodyChannels(("valve_x_left", "t2"), pose="pose")
    proposed = propose(path, Names(body=wanted))
    assert (
        "columns without names are taken by their places: x, y, yaw, and the thrusters in their order"
        in proposed.doubts
    )
    (tmp_path / "m.toml").write_text(proposed.text)
    [log] = import_recordings(tmp_path / "m.toml", path, tmp_path / "logs")
    own = dict(zip(("pose_x", "pose_y", "pose_yaw", "valve_x_left", "t2"), place + levels, strict=True))
    held(LogReader(log.path), own)
    made.text(path, [], [*columns[:-1], T - 1.0] if pose_first else [T, T - 1.0, *columns[2:]])
    with pytest.raises(SourceError, match="no name or number says what its columns are"):
        propose(path, Names(body=wanted))


@pytest.mark.parametrize(("absurd", "unit"), [(9, "m"), (15, "mm")])
def test_a_hundredth_of_a_position_decides_no_unit(absurd, unit):
    values = np.full((1000, 1), 0.4)
    values[:absurd] = 5000.0
    assert of_others("position", values, "", (), "m").name == unit
