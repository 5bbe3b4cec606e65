"""Files that are no recording, in part or at all: what is refused, and what is said of the rest."""

import struct
import zlib

import numpy as np
import pytest

from onboard.cli import OK, main
from onboard.ground.log.bring_in import mapping, matlab
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.guess.propose import Names, propose
from onboard.ground.log.bring_in.importer import import_recordings
from tests.ground.log.bring_in.guess import made
from tests.ground.log.bring_in.guess.brought_in import held_imu
from tests.ground.log.bring_in.guess.made import COUNT, IMU_NAMES, T, body, imu_columns
from tests.ground.log.bring_in.guess.test_odd_files import brought_in

_MAT = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


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
