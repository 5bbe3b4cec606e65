"""Dumps in every format hold the same table; what is asked for is what comes; a pipe, several logs, aligned signals."""

import csv
import io
import resource
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
import scipy.io

from drivers import records
from onboard import cli
from onboard.ground.log.export.dump import dump
from onboard.ground.log.export.spool import BLOCK_BYTES
from onboard.ground.log.tables.selection import Selection
from tests.recording.logs import make_log

SECOND = 1_000_000_000


def scalar_rows(count, rng):
    rows = np.zeros(count, records.SCALAR)
    rows["sequence"] = rows["tick"] = np.arange(count)
    rows["host_ns"] = 5 * SECOND + np.arange(count) * 1_000_000
    rows["value_raw"] = rng.integers(-(2**50), 2**50, count)
    rows["scale"], rows["unit"] = 0.125, b"N m"
    return rows


def imu_rows(count, rng):
    rows = np.zeros(count, records.IMU)
    rows["sequence"] = rows["tick"] = np.arange(count)
    rows["host_ns"] = 5 * SECOND + np.arange(count) * 1_000_000
    rows["accel_raw"], rows["gyro_raw"] = rng.integers(-(2**15), 2**15, (2, count, 3))
    rows["accel_scale_m_s2"], rows["gyro_scale_rad_s"] = 0.0012, 1.3e-4
    return rows


@pytest.fixture
def channels(rng):
    return {"imu_base": imu_rows(20_000, rng), "load_cell": scalar_rows(4000, rng)}


@pytest.fixture
def log(tmp_path, channels):
    return make_log(tmp_path / "flight.mcap", channels)


def test_npz(tmp_path, log, channels):
    dump(log, tmp_path, kind="npz")
    with np.load(tmp_path / "imu_base.npz") as table:
        rows = channels["imu_base"]
        assert np.array_equal(table["accel_raw_y"], rows["accel_raw"][:, 1])
        assert table["accel_raw_y"].dtype == np.int16
        si = rows["gyro_raw"][:, 2] * rows["gyro_scale_rad_s"].astype(np.float64)
        assert np.array_equal(table["gyro_z"], si)
        assert dict(zip(table["columns"], table["units"], strict=True))["gyro_z"] == "rad/s"
    with np.load(tmp_path / "load_cell.npz") as table:
        assert set(table["unit"]) == {b"N m"}


def test_mat(tmp_path, log, channels):
    dump(log, tmp_path, kind="mat")
    table = scipy.io.loadmat(tmp_path / "imu_base.mat")
    assert np.array_equal(table["accel_raw_y"][:, 0], channels["imu_base"]["accel_raw"][:, 1])
    assert np.array_equal(table["host_ns"][:, 0], channels["imu_base"]["host_ns"])
    table = scipy.io.loadmat(tmp_path / "load_cell.mat")
    assert {text.strip() for text in table["unit"]} == {"N m"}
    assert len(table["unit"]) == 4000
    assert np.array_equal(table["value"][:, 0], channels["load_cell"]["value_raw"] * 0.125)
    assert "value [N m]" in {text.strip() for text in table["units"]}


def test_mat_text_longer_than_a_block(tmp_path, rng):
    count = BLOCK_BYTES // 2 + 3
    dtype = np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), ("text", "S2")], align=True)
    rows = np.zeros(count, dtype)
    rows["sequence"] = np.arange(count)
    rows["text"] = rng.choice(np.array([b"ab", b"c", b""]), count)
    dump(make_log(tmp_path / "a.mcap", {"said": rows}), tmp_path, kind="mat")
    texts = scipy.io.loadmat(tmp_path / "said.mat")["text"]
    assert np.array_equal(np.char.rstrip(texts), rows["text"].astype(str))


def test_parquet(tmp_path, log, channels):
    dump(log, tmp_path, kind="parquet")
    table = pq.read_table(tmp_path / "imu_base.parquet")
    assert np.array_equal(table["accel_raw_y"].to_numpy(), channels["imu_base"]["accel_raw"][:, 1])
    assert table.schema.field("accel_y").metadata == {b"unit": b"m/s^2"}
    table = pq.read_table(tmp_path / "load_cell.parquet")
    assert np.array_equal(table["value"].to_numpy(), channels["load_cell"]["value_raw"] * 0.125)
    assert set(table["unit"].to_pylist()) == {"N m"}


@pytest.mark.parametrize("kind", ["csv", "parquet", "npz", "mat"])
def test_a_channel_without_rows_is_a_table_without_rows(tmp_path, kind):
    result = dump(
        make_log(tmp_path / "a.mcap", {"load_cell": scalar_rows(0, np.random.default_rng(1))}), tmp_path, kind=kind
    )
    [path] = result.files
    assert path.stat().st_size > 0
    if kind == "npz":
        assert np.load(path)["value_raw"].shape == (0,)
    if kind == "mat":
        assert scipy.io.loadmat(path)["value_raw"].size == 0
    if kind == "parquet":
        assert pq.read_table(path).num_rows == 0


def heads(path):
    with path.open() as file:
        return [head.split(" ")[0] for head in next(csv.reader(file))]


def test_raw_or_si(tmp_path, log):
    dump(log, tmp_path / "raw", values="raw")
    dump(log, tmp_path / "si", values="si")
    assert heads(tmp_path / "raw" / "load_cell.csv") == ["time_s", *records.SCALAR.names]
    assert heads(tmp_path / "si" / "load_cell.csv") == [
        "time_s", "sequence", "host_ns", "tick", "value", "sync_counter", "device_status", "status"
    ]  # fmt: skip
    si = heads(tmp_path / "si" / "imu_base.csv")
    assert "gyro_x" in si
    assert not {"gyro_raw_x", "gyro_scale_rad_s", "accel_scale_m_s2"} & set(si)
    assert "temperature_raw" in si  # nothing stands for it


def test_times_count_from_the_first_record_and_the_end_is_not_in(tmp_path, log):
    result = dump(log, tmp_path / "part", Selection(("imu_base",), 1.0, 1.5))
    assert result.rows == {"imu_base": 500}
    first = (tmp_path / "part" / "imu_base.csv").read_text().splitlines()[1]
    assert first.startswith("nan,1000,6000000000,")
    with pytest.raises(ValueError, match="exchange them"):
        dump(log, tmp_path / "none", Selection(None, 2.0, 1.0))
    assert not (tmp_path / "none").exists()


def run(*arguments):
    return subprocess.run([sys.executable, "-m", "onboard.cli", *map(str, arguments)], capture_output=True, check=False)


def test_a_pipe_gets_the_one_channel_and_nothing_else(tmp_path, log):
    done = run("dump", log, "--to", "csv", "-", "--channel", "load_cell", "--until", "0.1")
    assert (done.returncode, done.stderr) == (cli.OK, b"")
    lines = list(csv.reader(io.StringIO(done.stdout.decode())))
    assert len(lines) == 101
    dump(log, tmp_path, Selection(("load_cell",), None, 0.1))
    assert done.stdout == (tmp_path / "load_cell.csv").read_bytes()
    for arguments in (["csv", "-"], ["npz", "-", "--channel", "load_cell"]):
        done = run("dump", log, "--to", *arguments)
        assert done.returncode == cli.BAD_INPUT
        assert b"pipe" in done.stderr


def test_a_reader_that_leaves_the_pipe_is_no_error(log):
    command = [sys.executable, "-m", "onboard.cli", "dump", str(log), "--to", "csv", "-", "--channel", "imu_base"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == b""
    assert process.returncode == cli.OK


def test_several_logs_each_get_a_directory(tmp_path, channels, capsys):
    logs = [make_log(tmp_path / f"{name}.mcap", channels) for name in ("one", "two")]
    logs[1].write_bytes(logs[1].read_bytes()[:-100])
    code = cli.main(["dump", *map(str, logs), "--to", "npz", str(tmp_path / "out"), "--channel", "load_cell"])
    assert code == cli.DAMAGED
    said = capsys.readouterr()
    assert said.out.split() == [str(tmp_path / "out" / name / "load_cell.npz") for name in ("one", "two")]
    assert "summary is damaged" in said.err


def test_an_unknown_format_is_refused_before_anything_is_written(tmp_path, log, capsys):
    assert cli.main(["dump", str(log), "--to", "xlsx", str(tmp_path / "out")]) == cli.BAD_INPUT
    assert "known formats: csv, parquet, npz, mat" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["csv", "parquet", "npz", "mat"])
def test_a_dump_that_the_disk_refuses_leaves_the_directory_as_it_was(tmp_path, log, kind, capsys):
    """A file-size limit stands for a full disk: both refuse the write with an OSError that names no file."""
    out = tmp_path / "out"
    out.mkdir()
    (out / f"imu_base.{kind}").write_text("before")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        code = cli.main(["dump", str(log), "--to", kind, str(out), "--force"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 2
    told = capsys.readouterr().err
    assert told.startswith(f"heft: {out}: ")
    assert "bytes, then" not in told  # a directory has no size
    assert "a file may have 100000 bytes here; raise it" in told
    assert [(path.name, path.read_text()) for path in out.iterdir()] == [(f"imu_base.{kind}", "before")]
    assert cli.main(["dump", str(log), "--to", kind, str(out), "--force"]) == 0
    assert {path.name for path in out.iterdir()} == {f"imu_base.{kind}", f"load_cell.{kind}", "README.txt"}
