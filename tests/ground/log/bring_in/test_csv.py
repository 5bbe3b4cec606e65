"""CSV text into logs: values, counts, axes and times; text that cannot be right is refused by name."""

import numpy as np
import pytest

from drivers import records
from drivers.records import SampleStatus
from onboard.ground.log.bring_in import text_rows
from onboard.ground.log.bring_in.errors import MappingError, SourceError
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.ground.log.bring_in.mapping import Csv
from onboard.recording.reader import LogReader
from tests.ground.log.bring_in.recordings import CSV_MAPPING, CSV_TEXT


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


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("world\n", "world;more\n", "row 2 has 11 cells where the header names 10"),
        ("0.2;1;2;3", "x;1;2;3", "column 't': row 2 has 'x', which is no number"),
        ("t;ax", "time;ax", "no column 't'"),
    ],
)
def test_a_bad_csv_is_refused(bench, old, new, message):
    (bench / "run.csv").write_text(CSV_TEXT.replace(old, new))
    with pytest.raises(SourceError, match=message):
        import_recordings(bench / "bench.toml", bench / "run.csv", bench)


def test_decimal_commas_are_named_with_the_key_that_reads_them(bench):
    """Cells as a German spreadsheet writes them: with the key the log is that of the same file with points."""
    [points] = import_recordings(bench / "bench.toml", bench / "run.csv", bench / "points")
    commas = CSV_TEXT.replace(".", ",")
    assert commas.count(",") > 3
    (bench / "run.csv").write_text(commas)
    told = r"column 't': row 1 has '0,1', with a decimal comma: write decimal = \",\" into \[csv\]"
    with pytest.raises(SourceError, match=told):
        import_recordings(bench / "bench.toml", bench / "run.csv", bench / "refused")
    mapping = (bench / "bench.toml").read_text()
    (bench / "bench.toml").write_text(mapping.replace('delimiter = ";"', 'delimiter = ";"\ndecimal = ","'))
    [read] = import_recordings(bench / "bench.toml", bench / "run.csv", bench / "commas")
    for channel in ("imu", "joint"):
        assert np.array_equal(*(LogReader(one.path).read(channel) for one in (points, read)))
    (bench / "bench.toml").write_text(mapping.replace('delimiter = ";"', 'decimal = ","'))
    with pytest.raises(MappingError, match="`delimiter` and `decimal` are both ','"):
        import_recordings(bench / "bench.toml", bench / "run.csv", bench / "refused")
    (bench / "bench.toml").write_text(mapping.replace('delimiter = ";"', ""))
    with pytest.raises(SourceError, match=r"they seem to be separated by ';': write delimiter = \";\" into \[csv\]"):
        import_recordings(bench / "bench.toml", bench / "run.csv", bench / "refused")


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
    assert said == ([(b"truncated", b"run.csv: row 3, the last, is cut off: left out")] if cut else [])


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


@pytest.mark.parametrize("block", [1, 7, 40])
def test_a_long_csv_is_read_in_blocks_as_it_is_at_once(tmp_path, monkeypatch, block):
    """Whole numbers, numbers of which a late one has a point, text that begins late, and a last row that is cut."""
    rows = [f"{n},{n if n < 30 else n + 0.5},{'x' if n > 35 else n}" for n in range(50)]
    (tmp_path / "run.csv").write_text("a,b,c\n" + "\n".join(rows) + "\n51,5", encoding="utf-8")
    whole = text_rows.read_csv(tmp_path / "run.csv", Csv())
    monkeypatch.setattr(text_rows, "_BLOCK", block)
    parts = text_rows.read_csv(tmp_path / "run.csv", Csv())
    assert whole.truncated == parts.truncated == "row 51, the last, is cut off: left out"
    for name, kind in (("a", "i"), ("b", "f"), ("c", "U")):
        assert whole.columns[name].dtype.kind == parts.columns[name].dtype.kind == kind
        assert whole.columns[name].tolist() == parts.columns[name].tolist()
    assert parts.columns["a"].tolist() == list(range(50))
