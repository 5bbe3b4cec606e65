"""Foreign recordings into logs: counts, axes, signs, clocks; what cannot be right is refused by name."""

import hashlib
import re
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest

import heft
from drivers import records
from drivers.records import SampleStatus
from onboard import cli
from onboard.offline.bring_in import foreign, importer, mapping
from onboard.offline.bring_in.errors import MappingError, SourceError
from onboard.offline.bring_in.foreign import read_npz
from onboard.offline.bring_in.importer import import_recordings
from onboard.offline.views.info import info
from onboard.recording.reader import LogReader

CSV_MAPPING = """
[mapping]
name = "bench"
format = "csv"
[csv]
delimiter = ";"
header_line = 2
[time]
column = "t"
unit = "s"
offset = 0.5
[channel.imu]
record = "imu"
[channel.imu.accel]
columns = ["ax", "ay", "az"]
values = "physical"
scale = 0.01
unit = "g"
[channel.imu.gyro]
columns = ["gx", "gy", "gz"]
axes = ["+z", "-x", "+y"]
scale = [1, 4]
unit = "deg/s"
[channel.joint]
record = "scalar"
time = { column = "tj", unit = "us" }
[channel.joint.value]
column = "angle"
sign = "-"
scale = [1, 1000]
unit = "rev"
"""

CSV_TEXT = """\
exported by something
t;ax;ay;az;gx;gy;gz;tj;angle;note
0.1;0.011;-1;0.5;1;2;3;7;10;hello
0.2;1;2;3;-32768;32767;4;9;-20;world
"""


@pytest.fixture
def bench(tmp_path):
    (tmp_path / "bench.toml").write_text(CSV_MAPPING)
    (tmp_path / "run.csv").write_text(CSV_TEXT)
    return tmp_path


def npz(path, **changes):
    """A recording laid out as the packaged mapping expects."""
    count = 6
    arrays = {
        "time_us": np.arange(count, dtype=np.int64) * 248 + 1_000_000,
        "gyro_raw": np.arange(3 * count, dtype=np.int16).reshape(count, 3),
        "acc_raw": np.arange(3 * count, dtype=np.int16).reshape(count, 3) * 10,
        "erpm_raw": np.arange(count, dtype=np.int32) * 7,
    }
    np.savez(path, **{**arrays, **changes})
    return path


def test_csv_of_physical_values_and_counts(bench):
    [made] = import_recordings(bench / "bench.toml", bench / "run.csv", bench / "logs")
    assert (made.path, made.rows) == (bench / "logs" / "run.mcap", 4)
    log = LogReader(made.path)
    imu = log.read("imu")
    assert imu.dtype == records.IMU
    assert imu["host_ns"].tolist() == [600_000_000, 700_000_000]
    assert imu["accel_raw"].tolist() == [[1, -100, 50], [100, 200, 300]]
    assert imu["accel_scale_m_s2"] == pytest.approx(0.01 * 9.80665)
    assert imu["gyro_raw"].tolist() == [[3, -1, 2], [4, 32767, 32767]]  # z, -x, y; -(-32768) is at the rail
    assert imu["gyro_scale_rad_s"] == pytest.approx(np.pi / 180 / 4)
    assert imu["status"].tolist() == [SampleStatus.OK, SampleStatus.SATURATED]
    assert imu["tick"].tolist() == imu["sequence"].tolist() == [0, 1]
    joint = log.read("joint")
    assert joint["host_ns"].tolist() == [7000, 9000]
    assert joint["value_raw"].tolist() == [-10, 20]
    assert joint["scale"] == pytest.approx(2 * np.pi / 1000)
    assert set(joint["unit"]) == {b"rad"}


def test_the_log_says_that_it_is_an_import(bench):
    [made] = import_recordings(str(bench / "bench.toml"), bench / "run.csv", bench / "logs")
    log = LogReader(made.path)
    facts = log.metadata["import"]
    assert facts["source"] == "run.csv"
    assert facts["mapping"] == "bench"
    assert facts["sha256"] == hashlib.sha256(CSV_TEXT.encode()).hexdigest()
    assert "imu.temperature_raw" in facts["not_recorded"]
    assert log.attachments["mapping.toml"].data.decode() == CSV_MAPPING
    before = made.path.read_bytes()
    import_recordings(bench / "bench.toml", bench / "run.csv", bench / "logs")
    assert made.path.read_bytes() == before


def test_a_whole_directory_at_once(tmp_path):
    for name in ("b.npz", "a.npz"):
        npz(tmp_path / name)
    (tmp_path / "notes.txt").write_text("not a recording")
    made = import_recordings("tudelft", tmp_path, tmp_path / "logs")
    assert [one.path.name for one in made] == ["a.mcap", "b.mcap"]
    with pytest.raises(SourceError, match=r"no \.npz"):
        import_recordings("tudelft", tmp_path / "logs", tmp_path / "none")


def test_packaged_mapping_turns_axes_and_keeps_counts(tmp_path):
    [made] = import_recordings("tudelft", npz(tmp_path / "a.npz"), tmp_path)
    imu = LogReader(made.path).read("imu_base")
    assert imu["gyro_raw"][2].tolist() == [-7, 6, 8]  # -y, x, z of 6, 7, 8
    assert imu["accel_raw"][2].tolist() == [-70, 60, 80]
    assert imu["host_ns"][2] == (1_000_000 + 2 * 248) * 1000
    wheel = LogReader(made.path).read("wheel_rate")
    assert wheel["value_raw"].tolist() == [0, 7, 14, 21, 28, 35]
    assert wheel["scale"] == pytest.approx(100 / 7 * 2 * np.pi / 60, rel=1e-15)
    assert set(wheel["unit"]) == {b"rad/s"}


def test_a_flipped_rail_stays_at_the_rail_and_is_flagged(tmp_path):
    gyro = np.zeros((6, 3), np.int16)
    gyro[1, 1], gyro[2, 1], gyro[3, 0] = -32768, 32767, -32767
    [made] = import_recordings("tudelft", npz(tmp_path / "a.npz", gyro_raw=gyro), tmp_path)
    imu = LogReader(made.path).read("imu_base")
    assert imu["gyro_raw"][1:4].tolist() == [[32767, 0, 0], [-32767, 0, 0], [0, -32767, 0]]
    assert imu["status"].tolist() == [0, 1, 1, 0, 0, 0]


def test_channels_take_turns_in_time(tmp_path):
    count = 5000
    many = {
        "time_us": np.arange(count) * 250,
        "gyro_raw": np.zeros((count, 3), np.int16),
        "acc_raw": np.zeros((count, 3), np.int16),
        "erpm_raw": np.zeros(count, np.int32),
    }
    [made] = import_recordings("tudelft", npz(tmp_path / "a.npz", **many), tmp_path)
    newest = 0
    rows = 0
    for batch in LogReader(made.path).batches(["imu_base", "wheel_rate"]):
        assert int(batch.rows["host_ns"][0]) > newest - 200_000_000
        newest = max(newest, int(batch.rows["host_ns"][-1]))
        rows += len(batch.rows)
    assert rows == 2 * count


def test_a_pause_in_the_source_is_an_event(tmp_path):
    time_us = np.array([0, 250, 500, 5000, 5250, 5500])
    [made] = import_recordings("tudelft", npz(tmp_path / "a.npz", time_us=time_us), tmp_path)
    events = info(made.path).events
    assert [event.code for event in events] == ["pauses", "pauses"]
    assert "imu_base: 1 intervals" in events[0].text
    assert "4.500 ms after sample 2" in events[0].text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time_us": np.array([0, 1, 2, 2, 3, 4])}, "'time_us' does not increase after row 3"),
        ({"time_us": np.array([-5, 1, 2, 3, 4, 5])}, "'time_us' is no time from 0 on in row 1"),
        ({"time_us": np.array([0, 1, 2, np.nan, 4, 5])}, "'time_us' is no time from 0 on in row 4"),
        ({"time_us": np.zeros((6, 2))}, "'time_us' has shape"),
        ({"gyro_raw": np.zeros((6, 2), np.int16)}, "'gyro_raw' has shape"),
        ({"gyro_raw": np.zeros((5, 3), np.int16)}, "'gyro_raw' has 5 rows and its time column 6"),
        ({"gyro_raw": np.full((6, 3), 40_000)}, "'gyro_raw' does not fit 16 bits in row 1"),
        ({"gyro_raw": np.full((6, 3), 0.5)}, "'gyro_raw' is no whole count in row 1; say values"),
        ({"erpm_raw": np.array([0, 1, np.inf, 3, 4, 5])}, "'erpm_raw' is no usable number in row 3"),
        ({"erpm_raw": np.array(list("abcdef"))}, "'erpm_raw' holds cells that are not numbers"),
    ],
)
def test_a_recording_that_cannot_be_right_is_refused(tmp_path, changes, message):
    source = npz(tmp_path / "bad.npz", **changes)
    with pytest.raises(SourceError, match=message) as raised:
        import_recordings("tudelft", source, tmp_path)
    assert "bad.npz" in str(raised.value)
    assert not (tmp_path / "bad.mcap").exists()


def test_a_missing_column_is_named_with_those_there_are(tmp_path):
    np.savez(tmp_path / "a.npz", time_us=np.arange(3))
    with pytest.raises(SourceError, match="no column 'acc_raw'; it has 'time_us'"):
        import_recordings("tudelft", tmp_path / "a.npz", tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04broken"])
def test_a_file_that_is_no_npz_is_refused(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(SourceError, match=r"a\.npz is not an NPZ"):
        import_recordings("tudelft", tmp_path / "a.npz", tmp_path)


def test_a_lone_array_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.arange(3))
    (tmp_path / "a.npy").rename(tmp_path / "a.npz")
    with pytest.raises(SourceError, match="without a name"):
        import_recordings("tudelft", tmp_path / "a.npz", tmp_path)


def test_pickled_objects_are_not_loaded(tmp_path):
    np.savez(tmp_path / "a.npz", time_us=np.array([{}], dtype=object))
    with pytest.raises(SourceError, match="plain arrays"):
        import_recordings("tudelft", tmp_path / "a.npz", tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("world\n", "world;more\n", "row 2 has 11 cells where the header names 10"),
        ("0.2;1;2;3", "x;1;2;3", "'t' holds cells that are not numbers"),
        ("t;ax", "time;ax", "no column 't'"),
    ],
)
def test_a_bad_csv_is_refused(bench, old, new, message):
    (bench / "run.csv").write_text(CSV_TEXT.replace(old, new))
    with pytest.raises(SourceError, match=message):
        import_recordings(bench / "bench.toml", bench / "run.csv", bench)


@pytest.mark.parametrize("keep", ["0.2;1;2;3;-32768;32767;4;9;-2", "0.2;1;2", "0.2;1;2;3;-32768;32767;4;9;-"])
def test_a_last_row_that_is_cut_off_costs_that_row(bench, keep):
    first = CSV_TEXT.index("0.2;")
    text = (CSV_TEXT[:first] + "0.15;1;2;3;1;2;4;8;-20;x\n" + keep).replace(";note", "").replace(";hello", "")
    (bench / "run.csv").write_text(text.replace(";x\n", "\n"))
    [made] = import_recordings(bench / "bench.toml", bench / "run.csv", bench)
    log = LogReader(made.path)
    cut = not keep.endswith("-2")
    assert len(log.read("imu")) == len(log.read("joint")) == (2 if cut else 3)
    said = [(row["code"], row["text"]) for row in log.read("import_event")]
    assert said == ([(b"truncated", b"run.csv: row 3, the last one, is cut off: left out")] if cut else [])


@pytest.mark.parametrize(("scale", "refused"), [("0.01", False), ("10.0", True), ("1.6", True)])
def test_values_that_counts_would_round_away_are_refused(bench, scale, refused):
    mapped = (bench / "bench.toml").read_text().replace("scale = 0.01", f"scale = {scale}")
    (bench / "bench.toml").write_text(mapped)
    if refused:
        with pytest.raises(SourceError, match=r"g leave .* of 'ax, ay, az'; give the mapping a smaller"):
            import_recordings(bench / "bench.toml", bench / "run.csv", bench)
    else:
        assert import_recordings(bench / "bench.toml", bench / "run.csv", bench)


def test_text_that_is_no_csv_is_refused(bench):
    (bench / "run.csv").write_bytes(bytes(range(128, 256)))
    with pytest.raises(SourceError, match="not CSV text"):
        import_recordings(bench / "bench.toml", bench / "run.csv", bench)


def test_integer_times_in_ns_keep_every_digit(bench):
    wall = 1_790_000_000_123_456_789
    text = CSV_MAPPING.replace('unit = "s"\noffset = 0.5', 'unit = "ns"')
    (bench / "ns.toml").write_text(text)
    (bench / "run.csv").write_text(CSV_TEXT.replace("0.1;", f"{wall};").replace("0.2;", f"{wall + 1};"))
    [made] = import_recordings(bench / "ns.toml", bench / "run.csv", bench)
    assert LogReader(made.path).read("imu")["host_ns"].tolist() == [wall, wall + 1]


def test_an_offset_moves_whole_times_too(bench):
    changed = CSV_MAPPING.replace('column = "tj", unit = "us"', 'column = "tj", unit = "ms", offset = 2.5')
    (bench / "ms.toml").write_text(changed)
    [made] = import_recordings(bench / "ms.toml", bench / "run.csv", bench)
    assert LogReader(made.path).read("joint")["host_ns"].tolist() == [9_500_000, 11_500_000]


COUPLED = """
[mapping]
name = "coupled"
format = "csv"
[time]
rate_Hz = 100
[channel.wrist]
record = "scalar"
[channel.wrist.value]
sum = { a = 0.5, b = -0.25 }
values = "physical"
scale = 0.001
unit = "rad"
[channel.torque]
record = "scalar"
file = "currents.csv"
[channel.torque.value]
sum = { a = 45.0, c = 32.0 }
sign = "-"
values = "physical"
scale = 0.01
unit = "N m"
"""


def coupled(directory, text=COUPLED, currents="a,c\n1,10\n2,-1\n"):
    (directory / "coupled.toml").write_text(text)
    (directory / "positions.csv").write_text("a,b\n1,2\n3,8\n")
    (directory / "currents.csv").write_text(currents)
    [made] = import_recordings(directory / "coupled.toml", directory / "positions.csv", directory / "logs")
    return LogReader(made.path)


def test_a_channel_is_a_sum_of_columns_and_may_lie_in_a_file_beside(tmp_path):
    log = coupled(tmp_path)
    assert (log.read("wrist")["value_raw"] * 0.001).tolist() == [0.0, -0.5]
    assert (log.read("torque")["value_raw"] * 0.01).tolist() == [-365.0, -58.0]
    facts = log.metadata["import"]
    assert facts["source"] == "positions.csv, currents.csv"
    assert facts["sha256"].split(", ")[1] == hashlib.sha256((tmp_path / "currents.csv").read_bytes()).hexdigest()


def test_a_column_of_an_array_is_named_by_its_index(tmp_path):
    np.savez(tmp_path / "run.npz", angles=np.array([[1.0, 2.0], [3.0, 4.0]]))
    text = COUPLED[: COUPLED.index("[channel.torque]")].replace('"csv"', '"npz"')
    for given, expected in (('"angles[1]" = 1.0', [2.0, 4.0]), ('"angles[0]" = 1.0, "angles[1]" = 10.0', [21.0, 43.0])):
        (tmp_path / "run.toml").write_text(text.replace("a = 0.5, b = -0.25", given))
        [made] = import_recordings(tmp_path / "run.toml", tmp_path / "run.npz", tmp_path)
        assert (LogReader(made.path).read("wrist")["value_raw"] * 0.001).tolist() == expected
    (tmp_path / "run.toml").write_text(text.replace("a = 0.5, b = -0.25", '"angles[2]" = 1.0'))
    with pytest.raises(SourceError, match=r"no column 'angles\[2\]'; it has 'angles'"):
        import_recordings(tmp_path / "run.toml", tmp_path / "run.npz", tmp_path)


def test_what_cannot_be_summed_is_refused(tmp_path):
    with pytest.raises(SourceError, match="no column 'c'; it has 'a'"):
        coupled(tmp_path, currents="a\n1\n2\n")
    with pytest.raises(SourceError, match="holds cells that are not numbers"):
        coupled(tmp_path, currents="a,c\n1,x\n2,3\n")
    with pytest.raises(OSError, match=r"nowhere\.csv"):
        coupled(tmp_path, COUPLED.replace("currents.csv", "nowhere.csv"))
    for old, new in (
        ('values = "physical"\n', ""),
        ("sum = { a = 0.5, b = -0.25 }", "sum = {}"),
        ("sum = { a", 'column = "a"\nsum = { a'),
    ):
        with pytest.raises(MappingError):
            coupled(tmp_path, COUPLED.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("scale = 0.01\n", "scale = 0.01\nscael = 1\n", "unknown key 'channel.imu.accel.scael'"),
        ("scale = 0.01\n", "", "'channel.imu.accel.scale' is missing"),
        ("scale = 0.01\n", "scale = -0.01\n", "channel.imu.accel.scale"),
        ('unit = "g"', 'unit = "rad/s"', "'channel.imu.accel': .*unit 'rad/s' is not known here; use one of 'm/s"),
        ('unit = "rev"', 'unit = "furlong"', "unit 'furlong' is not known here"),
        ('"+z", "-x", "+y"', '"+z", "-x", "+x"', "must name each of x, y and z once"),
        ('columns = ["ax", "ay", "az"]', "", "give either `column`"),
        ('record = "scalar"', 'record = "tensor"', "channel.joint"),
        ('format = "csv"', 'format = "xls"', "mapping.format"),
        ("[mapping]", "[mapping", "not TOML"),
    ],
)
def test_a_bad_mapping_is_refused_by_its_key(bench, old, new, message):
    assert old in CSV_MAPPING
    (bench / "bad.toml").write_text(CSV_MAPPING.replace(old, new))
    with pytest.raises(MappingError, match=message) as raised:
        mapping.load(bench / "bad.toml")
    assert "bad.toml" in str(raised.value)


def test_a_mapping_that_is_not_there(tmp_path):
    with pytest.raises(MappingError, match="tudelft"):
        mapping.load("nobody")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(MappingError, match="UTF-8"):
        mapping.load(tmp_path / "binary.toml")


def test_every_packaged_mapping_is_good():
    names = mapping.packaged()
    assert "tudelft" in names
    for name in names:
        mapping.load(name)


def test_tudelft_recordings(datasets, tmp_path):
    made = import_recordings("tudelft", datasets / "tudelft_tumbling", tmp_path)
    assert len(made) == 33
    for one in made:
        source = np.load(one.source)
        log = LogReader(one.path)
        imu, wheel = log.read("imu_base"), log.read("wheel_rate")
        x, y, z = source["gyro_raw"].T.astype(int)
        assert np.array_equal(imu["gyro_raw"], np.stack([-y, x, z], axis=1))
        ax, ay, az = source["acc_raw"].T * 9.81 / 2048
        specific_force_m_s2 = imu["accel_raw"] * imu["accel_scale_m_s2"][:, None].astype(float)
        np.testing.assert_allclose(specific_force_m_s2, np.stack([-ay, ax, az], axis=1), rtol=1e-7)
        np.testing.assert_allclose(imu["gyro_scale_rad_s"], np.deg2rad(1 / 16.384), rtol=1e-7)
        rate_rad_s = source["erpm_raw"] * 100 / 7 * 2 * np.pi / 60
        np.testing.assert_allclose(wheel["value_raw"] * wheel["scale"], rate_rad_s, rtol=1e-14)
        assert np.array_equal(imu["host_ns"], source["time_us"] * 1000)
        assert not imu["status"].any()
        assert log.complete


def npz_of(tmp_path, shape, compression):
    """An NPZ file whose header says more than is in it, or that is all zeros and packed."""
    with zipfile.ZipFile(tmp_path / "big.npz", "w", compression) as archive, archive.open("t.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
        if compression == zipfile.ZIP_DEFLATED:
            for _ in range(10):
                file.write(bytes(8 << 20))
    return tmp_path / "big.npz"


@pytest.mark.parametrize(("shape", "compression"), [((10**14,), 0), ((10 << 20,), zipfile.ZIP_DEFLATED)])
def test_an_npz_that_expands_to_gigabytes_is_refused(tmp_path, monkeypatch, shape, compression):
    monkeypatch.setattr(foreign, "LARGEST_BYTES", 40 << 20)
    path = npz_of(tmp_path, shape, compression)
    assert path.stat().st_size < 5 << 20
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SourceError, match="would expand to"):
        read_npz(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 40_000  # kB


def test_an_import_that_fails_leaves_an_earlier_log_as_it_was(bench, tmp_path, monkeypatch):
    [first] = import_recordings(tmp_path / "bench.toml", tmp_path / "run.csv", tmp_path / "logs")
    before = first.path.read_bytes()

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(importer, "_write_by_time", refuse)
    with pytest.raises(OSError, match="No space"):
        import_recordings(tmp_path / "bench.toml", tmp_path / "run.csv", tmp_path / "logs")
    assert first.path.read_bytes() == before
    assert list((tmp_path / "logs").iterdir()) == [first.path]


def test_the_example_of_the_documentation_runs(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).resolve().parents[3] / "docs" / "import.md").read_text()
    blocks = dict(re.findall(r"```(\w*)\n(.*?)```", page, re.DOTALL))
    monkeypatch.chdir(tmp_path)
    Path("bench.csv").write_text(blocks["csv"])
    Path("bench.toml").write_text(blocks["toml"])
    commands = blocks[""].splitlines()
    assert len(commands) == 3
    for command in commands:
        assert cli.main(command.split()[1:]) == cli.OK
    log = heft.open("logs/bench.mcap")
    imu, joint = log["imu_base"].to_numpy(), log["joint_1"].to_numpy()
    assert imu["time_s"].tolist() == pytest.approx([0.0, 0.002, 0.004, 0.006])
    assert imu["accel_x"] == pytest.approx(np.array([3, 2, 4, 3]) * 9.80665 / 2048)
    assert joint["value"] == pytest.approx(np.deg2rad([0.0, 0.01, 0.03, 0.06]))
    assert log["load_cell"].to_numpy()["value"] == pytest.approx([-0.10, -0.11, -0.09, -0.12])


def test_the_documentation_has_every_key_and_unit():
    page = (Path(__file__).resolve().parents[3] / "docs" / "import.md").read_text()
    sections = (mapping.About, mapping.Csv, mapping.Time, mapping.ImuChannel, mapping.ScalarChannel)
    for section in (*sections, mapping.VectorMapping, mapping.Scalar):
        for key in section.model_fields:
            assert f"`{key}`" in page, key
    assert all(f"`{unit}`" in page for unit in mapping.UNITS)
    assert all(f"`{name}`" in page for name in mapping.packaged())
