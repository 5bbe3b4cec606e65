"""Dumps: what stands in the files, against lines typed by hand from the records' definitions."""

import csv

import numpy as np
import pytest
from rich.progress import Progress

from drivers import records
from drivers.records import SampleStatus, Severity
from onboard import cli
from onboard.channels import tick_dtype
from onboard.estimation.gates import GateReason
from onboard.ground.log.export import legend
from onboard.ground.log.export.dump import dump
from onboard.ground.log.tables.columns import unit_of
from onboard.ground.log.tables.selection import Selection
from onboard.recording.format.errors import ChannelError
from onboard.recording.writer import LogWriter
from onboard.timebase.clock import ClockState
from tests.recording.logs import make_log

IMU_HEADER = (
    "time_s [s],sequence,host_ns [ns],tick [count],accel_scale_m_s2 [m/s^2],gyro_scale_rad_s [rad/s],"
    "accel_raw_x [count],accel_raw_y [count],accel_raw_z [count],"
    "accel_x [m/s^2],accel_y [m/s^2],accel_z [m/s^2],"
    "gyro_raw_x [count],gyro_raw_y [count],gyro_raw_z [count],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s],"
    "temperature_raw [count],filter_code,sync,status"
)


@pytest.fixture
def imu_row():
    row = np.zeros(1, records.IMU)
    row[0] = (7, 123_456_789_012, 9, 0.25, 0.5, (1, -2, 32767), (-32768, 0, 3), -521, 2, 1, 0)
    return row


def scalar_rows(count, unit=b"N m", scale=0.125):
    rows = np.zeros(count, records.SCALAR)
    rows["sequence"] = rows["host_ns"] = rows["tick"] = np.arange(count)
    rows["value_raw"] = np.arange(count) - 1
    rows["scale"], rows["unit"] = scale, unit
    return rows


def lines(path):
    return path.read_text().splitlines()


def test_imu_raw_and_si_side_by_side(tmp_path, imu_row):
    result = dump(make_log(tmp_path / "a.mcap", {"imu_base": imu_row}), tmp_path / "csv")
    [path] = result.files
    assert path == tmp_path / "csv" / "imu_base.csv"
    assert lines(path) == [
        IMU_HEADER,
        "nan,7,123456789012,9,0.25,0.5,1,-2,32767,0.25,-0.5,8191.75,-32768,0,3,-16384,0,1.5,-521,2,1,0",
    ]
    assert (result.rows, result.damage, result.exit_code) == ({"imu_base": 1}, (), 0)


def test_scalar_in_the_unit_that_its_rows_name(tmp_path):
    dump(make_log(tmp_path / "a.mcap", {"load_cell": scalar_rows(3)}), tmp_path)
    assert lines(tmp_path / "load_cell.csv") == [
        "time_s [s],sequence,host_ns [ns],tick [count],value_raw [count],value [N m],scale,unit,"
        "sync_counter,device_status,status",
        "nan,0,0,0,-1,-0.125,0.125,N m,0,0,0",
        "nan,1,1,1,0,0.0,0.125,N m,0,0,0",
        "nan,2,2,2,1,0.125,0.125,N m,0,0,0",
    ]


def test_rows_of_another_unit_are_not_taken_for_the_first_s(tmp_path):
    rows = np.concatenate([scalar_rows(1), scalar_rows(2, unit=b"N")])
    dump(make_log(tmp_path / "a.mcap", {"load_cell": rows}), tmp_path)
    assert [line.split(",")[5] for line in lines(tmp_path / "load_cell.csv")[1:]] == ["-0.125", "nan", "nan"]


def test_counts_times_scale_keeps_every_digit_of_a_large_count(tmp_path):
    rows = scalar_rows(1, scale=2 * np.pi / 500_000)
    rows["value_raw"] = 2**40 + 1
    dump(make_log(tmp_path / "a.mcap", {"joint": rows}), tmp_path)
    value = float(lines(tmp_path / "joint.csv")[1].split(",")[5])
    assert value == (2**40 + 1) * (2 * np.pi / 500_000)


def test_text_and_arrays(tmp_path):
    dtype = np.dtype(
        [
            ("sequence", "<u8"),
            ("host_ns", "<i8"),
            ("masses", "<f8", (3,)),
            ("force_base_n", "<f8", (3,)),
            ("pair", "<u2", (2, 2)),
            ("name", "S8"),
        ],
        align=True,
    )
    rows = np.zeros(1, dtype)
    rows[0] = (0, 1, (1, 2, 3), (0.5, 0.25, 0.1), ((1, 2), (3, 4)), b'a,"b"')
    dump(make_log(tmp_path / "a.mcap", {"mixed": rows}), tmp_path)
    assert lines(tmp_path / "mixed.csv") == [
        "time_s [s],sequence,host_ns [ns],masses_0,masses_1,masses_2,"
        "force_base_n_x [N],force_base_n_y [N],force_base_n_z [N],pair_0_0,pair_0_1,pair_1_0,pair_1_1,name",
        '0.000000000,0,1,1.0,2.0,3.0,0.5,0.25,0.1,1,2,3,4,"a,""b"""',
    ]


def test_a_unit_in_the_log_stands_before_that_of_the_name(tmp_path):
    with LogWriter.create(tmp_path / "a.mcap") as writer:
        writer.register("pulse", records.PULSE, units={"edge_ns": "ns after start"})
    dump(tmp_path / "a.mcap", tmp_path)
    assert lines(tmp_path / "pulse.csv") == ["time_s [s],sequence,host_ns [ns],edge_ns [ns after start],line_sequence"]


@pytest.mark.parametrize(
    ("field", "unit"),
    [
        ("host_ns", "ns"),
        ("accel_scale_m_s2", "m/s^2"),
        ("joint_rad_s", "rad/s"),
        ("joint_rad", "rad"),
        ("moment_n_m", "N m"),
        ("lever_m", "m"),
        ("accel_raw", "count"),
        ("tick", "count"),
        ("sequence", ""),
        ("status", ""),
    ],
)
def test_units_by_name(field, unit):
    assert unit_of(field) == unit


def test_only_some_channels_and_an_odd_name(tmp_path, imu_row):
    log = make_log(tmp_path / "a.mcap", {"imu": imu_row, "arm/joint 1": scalar_rows(2), "arm_joint_1": scalar_rows(3)})
    result = dump(log, tmp_path / "some", Selection(("arm/joint 1", "arm_joint_1")))
    assert [path.name for path in result.files] == ["arm_joint_1_1.csv", "arm_joint_1.csv"]
    assert result.rows == {"arm/joint 1": 2, "arm_joint_1": 3}
    with pytest.raises(ChannelError, match="nobody"):
        dump(log, tmp_path / "none", Selection(("nobody",)))
    assert not (tmp_path / "none").exists()


def test_many_blocks_make_one_table(tmp_path, rng):
    rows = scalar_rows(40_000)
    rows["value_raw"] = rng.integers(-(2**50), 2**50, len(rows))
    dump(make_log(tmp_path / "a.mcap", {"many": rows}), tmp_path)
    with (tmp_path / "many.csv").open(newline="") as file:
        table = list(csv.reader(file))[1:]
    assert [int(line[4]) for line in table] == rows["value_raw"].tolist()
    assert [float(line[5]) for line in table] == (rows["value_raw"] * 0.125).tolist()


def test_a_cut_log_is_dumped_to_the_last_whole_chunk_and_says_so(tmp_path):
    log = make_log(tmp_path / "a.mcap", {"many": scalar_rows(5000)})
    log.write_bytes(log.read_bytes()[:100_000])
    result = dump(log, tmp_path)
    assert result.exit_code == 3
    assert "not closed" in str(result.damage[0])
    assert 500 < result.rows["many"] < 2000
    assert len(lines(tmp_path / "many.csv")) == result.rows["many"] + 1


def test_progress_ends_at_the_size_of_the_log(tmp_path):
    log = make_log(tmp_path / "a.mcap", {"many": scalar_rows(5000)})
    progress = Progress(disable=True)
    dump(log, tmp_path, progress=progress)
    [task] = progress.tasks
    assert task.finished
    assert task.total == log.stat().st_size


def test_an_instant_has_utc_where_the_wall_clock_was_set(tmp_path):
    dtype = np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), ("vehicle_ns", "<i8"), ("triangle", "<f8", (3,))])
    rows = np.zeros(3, dtype)
    rows["host_ns"], rows["vehicle_ns"] = 5_000_000_000, [4_999_999_999, 5_000_000_000, 86_405_000_000_001]
    for name, wall_ns in (("set", 1_795_190_705_000_000_000), ("never", 4_000_000_000)):
        with LogWriter.create(tmp_path / f"{name}.mcap") as writer:
            writer.add_metadata("flight", {"wall_clock_ns": str(wall_ns), "monotonic_ns": "5000000000"})
            writer.register("told", dtype)
            writer.write("told", rows)
        dump(tmp_path / f"{name}.mcap", tmp_path / name)
    assert [line.split(",")[:2] for line in lines(tmp_path / "set" / "told.csv")] == [
        ["time_s [s]", "utc"],
        ["-0.000000001", "2026-11-20T16:05:04.999999999Z"],
        ["0.000000000", "2026-11-20T16:05:05.000000000Z"],
        ["86400.000000001", "2026-11-21T16:05:05.000000001Z"],
    ]
    assert lines(tmp_path / "never" / "told.csv")[0] == "time_s [s],sequence,host_ns [ns],vehicle_ns [ns]"


def test_what_only_replay_needs_is_in_the_raw_dump_alone(tmp_path):
    rows = np.zeros(2, [("sequence", "<u8"), ("host_ns", "<i8"), ("vehicle_ns", "<i8"), ("triangle", "<f8", (3,))])
    ticks = np.zeros(2, tick_dtype(2))
    log = make_log(tmp_path / "a.mcap", {"estimate": rows, "tick": ticks})
    assert [path.name for path in dump(log, tmp_path / "both").files] == ["estimate.csv"]
    assert "triangle" not in lines(tmp_path / "both" / "estimate.csv")[0]
    assert dump(log, tmp_path / "raw", values="raw").rows == {"estimate": 2, "tick": 2}
    assert "triangle_2" in lines(tmp_path / "raw" / "estimate.csv")[0]


def test_files_are_replaced_only_by_force(tmp_path, capsys):
    log = make_log(tmp_path / "a.mcap", {"load_cell": scalar_rows(3)})
    told = ["dump", str(log), "--to", "csv", str(tmp_path / "out")]
    assert cli.main(told) == cli.OK
    (tmp_path / "out" / "load_cell.csv").write_text("mine")
    assert cli.main(told) == cli.BAD_INPUT
    assert "add --force" in capsys.readouterr().err
    assert (tmp_path / "out" / "load_cell.csv").read_text() == "mine"
    assert cli.main([*told, "--force"]) == cli.OK
    assert len(lines(tmp_path / "out" / "load_cell.csv")) == 4


def test_a_spreadsheet_computes_no_cell(tmp_path):
    rows = np.zeros(1, records.EVENT)
    rows["code"], rows["source"], rows["text"] = b"=1+1", b"-2", b"@now,+3"
    dump(make_log(tmp_path / "a.mcap", {"event": rows}), tmp_path)
    assert lines(tmp_path / "event.csv")[1] == """0.000000000,0,0,0,'=1+1,'-2,"'@now,+3\""""


def test_the_legend_names_every_bit_and_code():
    told = "\n".join(legend.codes())
    for kind in (SampleStatus, GateReason, ClockState, Severity):
        for code in kind:
            if code or kind in (ClockState, Severity):
                assert f"  {int(code):3d}  {code.name.lower()}" in told, code
