"""Recorders' logs into one: every row of each, in the order of time, under a name that tells where it is from."""

from pathlib import Path

import numpy as np
import pytest

from drivers import records
from drivers.records import Severity
from onboard import cli
from onboard.ground.log.rescue.merge import RecorderLog, merge
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from onboard.recording.writer import LogWriter

MS = 1_000_000
ROWS = 10_000


def scalar_rows(count, first_ns):
    rows = np.zeros(count, records.SCALAR)
    rows["sequence"] = np.arange(count)
    rows["host_ns"] = first_ns + np.arange(count) * MS
    rows["value_raw"] = np.arange(count) * 3
    return rows


def write(path, channels, metadata=None, attachment=b""):
    with LogWriter.create(path, durable=False) as writer:
        if attachment:
            writer.attach("vehicle.toml", "application/toml", attachment)
        for name, items in (metadata or {}).items():
            writer.add_metadata(name, items)
        for name, rows in channels.items():
            writer.register(name, rows.dtype)
        parts = [(int(part["host_ns"][0]), name, part) for name, rows in channels.items() for part in pieces(rows)]
        for _, name, part in sorted(parts, key=lambda item: item[0]):
            writer.write(name, part)
    return path


def pieces(rows):
    return [rows[first : first + 100] for first in range(0, len(rows), 100)]


@pytest.fixture
def two(tmp_path):
    event = records.event(5 * MS, Severity.INFO, "started", "imu", "hello").rows
    gap = records.gap(7 * MS, "angle", 3, 4, MS, "test").rows
    a = write(
        tmp_path / "a.mcap", {"force": scalar_rows(ROWS, 0), "event": event}, {"flight": {"vehicle": "x"}}, b"one"
    )
    b = write(
        tmp_path / "b.mcap",
        {"angle": scalar_rows(ROWS, 40 * MS), "event": event, "gap": gap},
        {"flight": {"vehicle": "y"}},
        b"two",
    )
    return a, b


def test_every_row_of_each_in_the_order_of_time(tmp_path, two):
    made = merge([RecorderLog((path,)) for path in two], tmp_path / "both.mcap")
    log = LogReader(tmp_path / "both.mcap")
    assert set(log.channels) == {"force", "angle", "a_event", "b_event", "gap"}
    for name, path in (("force", two[0]), ("angle", two[1])):
        assert np.array_equal(log.read(name), LogReader(path).read(name))
    assert made.rows["force"] == ROWS
    starts = [int(batch.rows["host_ns"][0]) for batch in log.batches(["force", "angle"])]
    late = [max(starts[:n]) - start for n, start in enumerate(starts) if n]
    assert max(late) < 2000 * MS  # the writer fills its chunks a channel at a time
    assert log.metadata["flight"] == {"vehicle": "x"}
    assert log.metadata["b.flight"] == {"vehicle": "y"}
    assert {name: log.attachments[name].data for name in log.attachments} == {
        "vehicle.toml": b"one", "b.vehicle.toml": b"two"
    }  # fmt: skip
    assert set(log.metadata["merged"]) == {"a", "b"}
    assert made.warnings == ()


def test_samples_of_one_name_are_refused_or_renamed_and_gaps_follow(tmp_path):
    gap = records.gap(7 * MS, "force", 3, 4, MS, "test").rows
    for name in "ab":
        write(tmp_path / f"{name}.mcap", {"force": scalar_rows(10, 0), "gap": gap})
    parts = [RecorderLog((tmp_path / f"{name}.mcap",)) for name in "ab"]
    with pytest.raises(ChannelError, match=r"force \(a and b\).*--rename"):
        merge(parts, tmp_path / "both.mcap")
    assert not (tmp_path / "both.mcap").exists()
    merge(parts, tmp_path / "both.mcap", rename=True)
    log = LogReader(tmp_path / "both.mcap")
    assert set(log.channels) == {"a_force", "b_force", "a_gap", "b_gap"}
    assert log.read("a_gap")["channel"].tolist() == [b"a_force"]
    assert log.read("b_gap")["channel"].tolist() == [b"b_force"]


def test_a_clock_put_on_that_of_the_first(tmp_path, two):
    merge([RecorderLog((two[0],)), RecorderLog((two[1],), 1_000, 1.5)], tmp_path / "both.mcap")
    before, after = LogReader(two[1]).read("angle"), LogReader(tmp_path / "both.mcap").read("angle")
    assert np.array_equal(after["host_ns"], before["host_ns"] * 3 // 2 + 1_000)
    assert np.array_equal(after["value_raw"], before["value_raw"])


def test_logs_without_a_common_time_are_told(tmp_path, capsys):
    write(tmp_path / "a.mcap", {"force": scalar_rows(10, 0)})
    write(tmp_path / "b.mcap", {"angle": scalar_rows(10, 10**12)})
    arguments = ["merge", str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap"), "-o"]
    assert cli.main([*arguments, str(tmp_path / "both.mcap")]) == cli.OK
    assert "no time in common" in capsys.readouterr().err
    assert cli.main([*arguments, str(tmp_path / "again.mcap"), "--align", "b=-1000"]) == cli.OK
    assert capsys.readouterr().err == ""
    assert LogReader(tmp_path / "again.mcap").read("angle")["host_ns"][0] == 0


def test_a_damaged_log_is_merged_as_far_as_it_goes(tmp_path, two):
    two[1].write_bytes(two[1].read_bytes()[:40_000])
    code = cli.main(["merge", *map(str, two), "-o", str(tmp_path / "both.mcap")])
    assert code == cli.DAMAGED
    log = LogReader(tmp_path / "both.mcap")
    assert len(log.read("force")) == ROWS
    assert 100 < len(log.read("angle")) < 1000


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["merge", "a.mcap"], "two logs or more"),
        (["merge", "a.mcap", "b.mcap", "--align", "c=1"], "the logs are a, b"),
        (["merge", "a.mcap", "b.mcap", "--align", "b=soon"], "write LOG=SECONDS"),
        (["recover", "a.mcap", "b.mcap"], "each by itself"),
    ],
)
def test_what_cannot_be_done_is_said(two, tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert cli.main([*arguments, "-o", "out.mcap"]) == cli.BAD_INPUT
    assert said in capsys.readouterr().err
    assert not Path("out.mcap").exists()


def test_logs_under_the_names_that_flights_give_them_are_told_apart(tmp_path):
    long, twin = tmp_path / "dymaflex_air_bearing-001.mcap", tmp_path / "again" / "dymaflex_air_bearing-001.mcap"
    twin.parent.mkdir()
    gap = records.gap(7 * MS, "imu_base_temperature", 3, 4, MS, "test").rows
    for path in (long, twin):
        write(path, {"imu_base_temperature": scalar_rows(10, 0), "gap": gap})
    made = merge([RecorderLog([long]), RecorderLog([twin])], tmp_path / "both.mcap", rename=True)
    assert set(made.rows) == {f"log{n}_{name}" for n in (1, 2) for name in ("imu_base_temperature", "gap")}
    assert f"log2 is {twin}" in made.warnings[0]
    rows = LogReader(tmp_path / "both.mcap").read("log2_gap")
    assert rows["channel"].tolist() == [b"log2_imu_base_temperature"]


def test_recover_says_what_is_lost_by_its_exit_code(two, tmp_path, capsys):
    whole, cut, nothing = (tmp_path / f"{name}.mcap" for name in ("whole", "cut", "nothing"))
    assert cli.main(["recover", str(two[0]), "-o", str(whole)]) == cli.OK
    assert np.array_equal(LogReader(whole).read("force"), LogReader(two[0]).read("force"))
    assert "lossless" in capsys.readouterr().out
    data = bytearray(two[0].read_bytes())
    data[data.index((500 * MS).to_bytes(8, "little"))] ^= 1  # host_ns of the row in the middle
    two[0].write_bytes(data)
    assert cli.main(["recover", str(two[0]), "-o", str(cut)]) == cli.DAMAGED
    said = capsys.readouterr().out
    assert "damage: bytes" in said
    assert "gap: force:" in said
    two[0].write_bytes(data[:20])
    assert cli.main(["recover", str(two[0]), "-o", str(nothing)]) == cli.FAILED
    assert not nothing.exists()
    assert "Traceback" not in capsys.readouterr().err


def test_a_segment_that_is_missing_at_the_end_of_a_flight_is_told(two, tmp_path, capsys):
    log = SegmentedLog(
        tmp_path / "x.mcap", Preamble("f", (), {}), limits=SegmentLimits(span_ns=50 * MS), sync_interval_ns=0
    )
    rows = scalar_rows(200, 0)
    log.register("own", rows.dtype)
    for part in np.split(rows, 20):
        log.write("own", part)
        log.sync(int(part["host_ns"][-1]))
    log.close()
    made = sorted(tmp_path.glob("x_*.mcap"))
    assert len(made) >= 2
    merged = ["merge", str(two[0]), str(tmp_path / "x.mcap"), "-o"]
    assert cli.main([*merged, str(tmp_path / "whole.mcap")]) == cli.OK
    made[-1].unlink()
    capsys.readouterr()
    assert cli.main([*merged, str(tmp_path / "cut.mcap")]) == cli.DAMAGED
    assert f"segment {len(made)} is missing" in capsys.readouterr().err
