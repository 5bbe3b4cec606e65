"""Recordings as people keep them: without names, with bad rows, units below the names, comments, other text."""

import json
from itertools import combinations

import numpy as np
import pytest

from onboard.cli import BAD_INPUT, OK, main
from onboard.ground.log.bring_in.channel_rows import rising
from onboard.ground.log.bring_in.errors import MappingError, SourceError
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.recording.reader import LogReader

VALUE = 'record = "scalar"\n[channel.{0}.value]\ncolumn = {1}\nvalues = "physical"\nscale = 1e-6\nunit = "{2}"\n'


def mapped(tmp_path, csv="", about="", time="1", unit="s", **channels):
    """A mapping file of scalars: name = (column, unit)."""
    text = f'[mapping]\nname = "odd"\nformat = "csv"\n{about}\n[csv]\n{csv}\n[time]\ncolumn = {time}\nunit = "{unit}"\n'
    for name, (column, own) in channels.items():
        text += f"[channel.{name}]\n{VALUE.format(name, column, own)}"
    (tmp_path / "odd.toml").write_text(text)
    return tmp_path / "odd.toml"


def brought_in(tmp_path, mapping, text, encoding="utf-8"):
    (tmp_path / "run.csv").write_bytes(text.encode(encoding))
    [made] = import_recordings(mapping, tmp_path / "run.csv", tmp_path / "logs")
    return made, LogReader(made.path)


def values(log, name):
    rows = log.read(name)
    return rows["value_raw"] * rows["scale"].astype(np.float64)


def test_columns_without_names_are_numbered_from_1(tmp_path):
    mapping = mapped(tmp_path, "header = false", angle=("2", "rad"), slide=('"3"', "mm"))
    made, log = brought_in(tmp_path, mapping, "0.0,0.25,12\n0.1,0.5,14\n0.2,0.75,-16\n")
    assert made.rows == 6
    assert values(log, "angle") == pytest.approx([0.25, 0.5, 0.75])
    assert values(log, "slide") == pytest.approx([0.012, 0.014, -0.016])
    assert set(log.read("slide")["unit"]) == {b"m"}
    with pytest.raises(SourceError, match="no column '4'; it has '1', '2', '3'"):
        brought_in(tmp_path, mapped(tmp_path, "header = false", x=("4", "N")), "0.0,0.25,12\n")
    with pytest.raises(MappingError, match="has no `header_line`"):
        brought_in(tmp_path, mapped(tmp_path, "header = false\nheader_line = 2", x=("2", "N")), "0,1\n")


@pytest.mark.parametrize(
    ("csv", "text", "encoding"),
    [
        ("rows_from = 3", "t,f\n[s],[N]\n0,1.5\n1,2.5\n", "utf-8"),
        ('comment = "#"\nheader_line = 2', "# made by a rig\n#t, f\n0,1.5\n# paused here\n1,2.5\n", "utf-8"),
        ('delimiter = " "', "  t   f\n0  1.5\n 1    2.5  \n", "utf-8"),
        ('delimiter = "\\t"\ndecimal = ","', "t\tf\n0\t1,5\n1\t2,5\n", "utf-8-sig"),
        ('delimiter = ";"\nencoding = "latin-1"', "t;f;gr\u00f6\u00dfe\n0;1.5;3\n1;2.5;3\n", "latin-1"),
        ('encoding = "utf-16"', "t,f\n0,1.5\n1,2.5\n", "utf-16"),
        ("header = false\nrows_from = 3", "made by\na rig\n0,1.5\n1,2.5", "utf-8"),
    ],
)
def test_layouts(tmp_path, csv, text, encoding):
    named = "header = false" not in csv
    mapping = mapped(tmp_path, csv, time='"t"' if named else "1", f=('"f"' if named else "2", "N"))
    _, log = brought_in(tmp_path, mapping, text, encoding)
    assert log.read("f")["host_ns"].tolist() == [0, 10**9]
    assert values(log, "f") == pytest.approx([1.5, 2.5])


def test_text_of_another_encoding_names_the_key(tmp_path):
    with pytest.raises(SourceError, match=r"encoding of \[csv\]"):
        brought_in(tmp_path, mapped(tmp_path, time='"t"', f=('"f"', "N")), "t,f,\u00b5\n0,1,2\n", "latin-1")


def test_columns_of_the_same_name_are_told_apart_and_never_taken_by_chance(tmp_path):
    text = "t,f,f\n0,1,2\n1,3,4\n"
    with pytest.raises(SourceError, match=r"no column 'f'; it has 't', 'f \(1\)', 'f \(2\)'"):
        brought_in(tmp_path, mapped(tmp_path, time='"t"', f=('"f"', "N")), text)
    _, log = brought_in(tmp_path, mapped(tmp_path, time='"t"', f=('"f (2)"', "N")), text)
    assert values(log, "f") == pytest.approx([2.0, 4.0])


BAD = (
    "t,f,g\n0,1,5\n1,nan,6\n2,3\n3,N/A,7\nx,5,8\n4,6,9\n4,7,9\n3.5,8,9\n"
    "5,9,\n900,1,1\n6,10,11\n7,11,12,13\n8,inf,12\n9,12,13\n"
)


def test_bad_rows_are_refused_by_name_unless_they_may_be_skipped(tmp_path, capsys):
    """Of f: nan, N/A, inf, a time that is text, two that do not rise, one that jumped ahead; g lacks a cell."""
    plain = mapped(tmp_path, time='"t"', f=('"f"', "N"), g=('"g"', "A"))
    with pytest.raises(SourceError, match="row 3 has 2 cells where the header names 3"):
        brought_in(tmp_path, plain, BAD)
    short = BAD.replace("2,3\n", "").replace("7,11,12,13\n", "")
    with pytest.raises(SourceError, match=r"row 4 has 'x', which is no number.* bad_rows = \"skip\" in \[mapping\]"):
        brought_in(tmp_path, plain, short)
    with pytest.raises(SourceError, match=r"no usable number in row 2; remove the row; bad_rows"):
        brought_in(tmp_path, plain, "t,f,g\n0,1,2\n1,nan,3\n2,2,3\n")
    with pytest.raises(SourceError, match=r"does not increase after row 1; sort the recording; bad_rows"):
        brought_in(tmp_path, plain, "t,f,g\n1,1,2\n1,2,3\n2,2,3\n")
    skipping = mapped(tmp_path, about='bad_rows = "skip"', time='"t"', f=('"f"', "N"), g=('"g"', "A"))
    made, log = brought_in(tmp_path, skipping, BAD)
    assert (log.read("f")["host_ns"] * 1e-9).tolist() == [0.0, 3.5, 5.0, 6.0, 9.0]
    assert values(log, "f") == pytest.approx([1.0, 8.0, 9.0, 10.0, 12.0])
    assert (log.read("g")["host_ns"] * 1e-9).tolist() == [0.0, 1.0, 3.0, 3.5, 6.0, 8.0, 9.0]
    said = (
        "run.csv: 2 rows left out: another number of cells than the others",
        "5 rows left out: a cell that is no number, or a time that does not rise: g",
        "7 rows left out: a cell that is no number, or a time that does not rise: f",
    )
    assert made.left_out == said
    events = log.read("import_event")
    assert [row["text"].decode() for row in events if row["code"] == b"bad_rows"] == list(said)
    answer = tmp_path / "a.json"
    command = ["import", str(skipping), str(tmp_path / "run.csv"), "-o", str(tmp_path / "l"), "--json", str(answer)]
    assert main(command) == OK
    assert capsys.readouterr().out.count("note: ") == 3
    assert json.loads(answer.read_text())[0]["left_out"] == list(said)
    mapped(tmp_path, time='"t"', f=('"f"', "N"), g=('"g"', "A"))
    assert main(command) == BAD_INPUT


def test_a_recording_without_bad_rows_is_the_same_either_way(tmp_path):
    text = "t,f,g\n" + "".join(f"{k},{k % 7},{k * 0.5}\n" for k in range(500))
    made, log = brought_in(tmp_path, mapped(tmp_path, time='"t"', f=('"f"', "N"), g=('"g"', "A")), text)
    refused = {name: log.read(name).tobytes() for name in ("f", "g")}
    skipping = mapped(tmp_path, about='bad_rows = "skip"', time='"t"', f=('"f"', "N"), g=('"g"', "A"))
    again, log = brought_in(tmp_path, skipping, text)
    assert refused == {name: log.read(name).tobytes() for name in ("f", "g")}
    assert made.left_out == again.left_out == ()


def test_a_column_without_any_number_is_an_error_where_rows_are_skipped_too(tmp_path):
    skipping = mapped(tmp_path, about='bad_rows = "skip"', time='"t"', f=('"f"', "N"))
    with pytest.raises(SourceError, match="no row has numbers in all of 'f'"):
        brought_in(tmp_path, skipping, "t,f\n0,a\n1,b\n2,c\n")


def test_the_fewest_rows_are_left_out_so_that_times_rise():
    """Against the longest rising part by brute force."""
    rng = np.random.default_rng(3)
    for _ in range(60):
        times = rng.integers(0, 8, rng.integers(1, 9))
        kept = rising(times)
        assert (np.diff(kept) > 0).all()
        assert (np.diff(times[kept]) > 0).all()
        most = max(
            k
            for k in range(1, len(times) + 1)
            for part in combinations(range(len(times)), k)
            if (np.diff(times[list(part)]) > 0).all()
        )
        assert len(kept) == most
