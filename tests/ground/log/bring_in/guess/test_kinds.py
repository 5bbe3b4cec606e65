"""A mapping that is proposed brings the recording in as it is, for each kind of recording: numbers, units and times.

Files that are no recording, in part or at all: what is refused, and what is said of the rest.
"""

import json
import struct
import sys
import zlib

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from scipy.io import savemat

from onboard.cli import BAD_INPUT, OK, main
from onboard.ground.log.bring_in import mapping, matlab
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.guess.propose import Names, propose
from onboard.ground.log.bring_in.importer import import_recordings
from tests.ground.log.bring_in.guess import made
from tests.ground.log.bring_in.guess.brought_in import guessed, held, held_imu, joints
from tests.ground.log.bring_in.guess.made import COUNT, IMU_NAMES, BEGAN_ns, T, arm, body, imu_columns
from tests.ground.log.bring_in.guess.test_odd_files import brought_in

_MAT = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


@pytest.mark.parametrize("command", [["import", "--guess"], ["weigh"]])
def test_messages_of_another_encoding_are_refused_with_the_remedy(tmp_path, capsys, command):
    """Foxglove's, for instance; beside others that can be read they are passed over."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/imu", "protobuf", writer.register_schema("imu", "protobuf", b""))
        writer.add_message(channel, 1, b"\x00\x01", 1)
        writer.finish()
    assert main([*command, str(path)]) == BAD_INPUT
    assert (
        "its messages are protobuf, and those of ROS and JSON are read: write them as JSON" in capsys.readouterr().err
    )


def test_numbers_beyond_all_measure_are_refused_at_the_import(tmp_path):
    path = made.text(tmp_path / "a.csv", ("time", "q1", "q2"), [T, 1e200 * np.sin(T), T])
    with pytest.raises(ValueError, match="cannot be stored; correct the scale"):
        brought_in(path)


def test_names_that_stand_twice(tmp_path):
    columns = imu_columns(body())
    same = made.text(tmp_path / "a.csv", (*IMU_NAMES, "gyro_x"), [*columns, columns[1]])
    log, found, _ = brought_in(same)
    held_imu(log, body())
    assert found.doubts == ()
    other = made.text(tmp_path / "b.csv", (*IMU_NAMES, "gyro_x"), [*columns, columns[1] + 1.0])
    assert "'gyro_x (1)' could be 'gyro_x (2)' as well, which differs" in brought_in(other)[1].doubts[0]


def test_no_clock_is_told_and_pauses_are(tmp_path):
    log, found, _ = brought_in(made.text(tmp_path / "a.csv", ("force",), [np.sin(T)]))
    assert len(log.read("load_cell")) == COUNT
    assert "there is no column of times" in found.doubts[0]
    paused = T + np.where(T > 1.0, 0.5, 0.0)
    _, found, _ = brought_in(made.text(tmp_path / "b.csv", ("time", "force"), [paused, np.sin(T)]))
    assert "# 125 Hz, 1 intervals longer than 1.5 of that, up to 0.508 s" in found.text


def test_a_part_that_does_not_move_at_first_is_not_rounded_away(tmp_path):
    """The first two thirds are exact zeros: the size of counts is by all rows."""
    force = np.where(T > 2.0, 1e-3 * np.sin(T), 0.0)
    log, _, _ = brought_in(made.text(tmp_path / "a.csv", ("time", "force"), [T, force], digits=12))
    rows = log.read("load_cell")
    assert rows["value_raw"] * rows["scale"].astype(float) == pytest.approx(force, abs=1e-9)


def test_a_mat_file_that_swells_is_refused_before_it_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(matlab, "LARGEST_BYTES", 16 << 20)
    for size, refused in ((15 << 20, False), (17 << 20, True)):
        packed = zlib.compress(bytes(size), 9)
        assert len(packed) < 1 << 15
        (tmp_path / "a.mat").write_bytes(_MAT + struct.pack("<II", 15, len(packed)) + packed)
        with pytest.raises(SourceError) as told:
            propose(tmp_path / "a.mat", Names())
        assert ("would expand to more than" in str(told.value)) == refused


@pytest.mark.parametrize(
    ("name", "write", "why"),
    [
        ("a.csv", lambda p: p.write_bytes(b""), "is empty"),
        ("a.csv", lambda p: p.write_text("\n\n\n"), "no line but comments"),
        ("a.csv", lambda p: p.write_text("# only\n# comments\n"), "no line but comments"),
        ("a.csv", lambda p: p.write_text("time,force\n"), "no line of numbers"),
        ("a.csv", lambda p: p.write_text("hello world\nhow are you\n"), "no line of numbers"),
        ("a.csv", lambda p: p.write_text("1.5\n2.5\n3.5\n"), r"columns are \('1' 1.5 to 3.5\); with --vehicle"),
        (
            "a.csv",
            lambda p: p.write_text("time,colour\n0,1\n1,2\n2,3\n"),
            r"columns are \('time' rises as times do; 'colour' 1 to 3\); or",
        ),
        ("a.csv", lambda p: p.write_bytes(bytes(range(256)) * 99), "no text, and of no kind that is known"),
        ("a.xlsx", lambda p: p.write_bytes(b"PK\x03\x04" + bytes(99)), "save the sheet as CSV"),
        ("a.npy", lambda p: np.save(p, np.zeros(9)), "save it as NPZ"),
        ("a.mat", lambda p: p.write_bytes(b"MATLAB 7.3 MAT-file".ljust(200)), r"save\('FILE.mat', '-v7'\)"),
        (
            "a.mat",
            lambda p: p.write_bytes(_MAT + bytes(99)),
            "no MAT file|two numbers",
        ),
        ("a.bag", lambda p: p.write_bytes(b"#ROSBAG V2.0\n" + bytes(4999)), "no bag that can be read"),
        ("a.db3", lambda p: p.write_bytes(b"SQLite format 3\0" + bytes(99)), "no bag that can be read"),
        ("a.mcap", lambda p: p.write_bytes(b"\x89MCAP0\r\n" + b"\x04" + b"\xff" * 99), "no MCAP file|two numbers"),
        ("a.ulg", lambda p: p.write_bytes(b"ULog\x01\x12\x35\x01" + b"\xff" * 99), "no ULog file|two numbers"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, name, write, why):
    write(tmp_path / name)
    with pytest.raises(SourceError, match=why):
        propose(tmp_path / name, Names())


def test_columns_without_names_go_by_the_joints_of_a_vehicle(tmp_path):
    """Angles and currents alone: no column is the derivative of another."""
    time_s = np.arange(0.0, 5.0, 0.01)
    q, current = (np.sin(rate * time_s[:, None] + np.arange(3)) for rate in (0.7, 0.9))
    arm = Names((), ("a", "b", "c"), ("a_torque", "b_torque", "c_torque"))
    every = np.column_stack([time_s, q, 3.0 * current])
    for width, channels in ((7, (*arm.angles, *arm.torques)), (4, arm.angles)):
        np.savetxt(tmp_path / "a.csv", every[:, :width], delimiter=",", fmt="%.6f")
        found = propose(tmp_path / "a.csv", arm)
        assert found.channels == channels
        assert found.doubts[1].startswith("by its place: the vehicle file has 3 joints")
    np.savetxt(tmp_path / "a.csv", every[:, :6], delimiter=",", fmt="%.6f")
    with pytest.raises(SourceError, match=r"'2' .* to .*'6' .*the vehicle file has 3 joints: their angles"):
        propose(tmp_path / "a.csv", arm)


@pytest.mark.parametrize("make", [made.bag_1, made.mcap_of_json, made.ulog], ids=["bag", "mcap", "ulog"])
def test_files_that_were_cut_off_or_altered_give_rows_or_an_error(tmp_path, make):
    whole = make(tmp_path / f"a.{ {'bag_1': 'bag', 'ulog': 'ulg'}.get(make.__name__, 'mcap') }").read_bytes()
    rng = np.random.default_rng(7)
    told = 0
    for k in range(40):
        broken = bytearray(whole[: int(rng.integers(16, len(whole)))] if k % 2 else whole)
        if k % 2 == 0:
            for place in rng.integers(16, len(broken), 20).tolist():
                broken[place] = int(rng.integers(256))
        (tmp_path / "b").write_bytes(broken)
        try:
            told += "# it is damaged" in propose(tmp_path / "b", Names()).text
        except SourceError:
            told += 1
    assert told > 5


def test_a_name_can_say_anything(tmp_path):
    """Quotes, brackets and equals signs of a header stand in TOML as they are."""
    names = ("time", '"he said ""force_x"""', "force_y [N] # = ]", "force_z'", "b\\nc", "[x]")
    path = made.text(tmp_path / "a.csv", names, [T, T, T, T, T, T])
    found = propose(path, Names())
    (tmp_path / "m.toml").write_text(found.text, encoding="utf-8")
    mapping.load(tmp_path / "m.toml")
    [log] = import_recordings(tmp_path / "m.toml", path, tmp_path / "logs")
    assert log.rows == len(found.channels) * COUNT
    assert main(["import", "--guess", str(path)]) == OK


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
