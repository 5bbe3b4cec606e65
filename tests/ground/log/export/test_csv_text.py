"""Numbers and text to CSV without a loop over rows, against Python's own text of each value."""

import csv
import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from onboard.ground.log.export.csv import CsvEncoder, cells, header
from onboard.ground.log.tables.columns import TableColumn

integers = st.sampled_from(["|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8"])


def texts(values, digits=None):
    made = cells(values, digits)
    made = np.broadcast_to(made, (len(values), made.shape[1]))  # one row stands for values that are all alike
    return [bytes(row[row != 0]).decode() for row in made]


@given(integers.flatmap(lambda kind: hnp.arrays(kind, st.integers(0, 30))))
def test_integers_are_python_s(values):
    assert texts(values) == [str(value) for value in values.tolist()]


@pytest.mark.parametrize("kind", ["<i2", "<i4", "<i8", "<u8", "|i1", "|u1"])
def test_integers_at_their_ends(kind):
    limits = np.iinfo(kind)
    values = np.array([limits.min, limits.max, 0, 9, 10, 99, 100], kind)
    assert texts(values) == [str(value) for value in values.tolist()]


@given(hnp.arrays("<f8", st.integers(0, 30)))
def test_float64_reads_back_as_it_was(values):
    assert np.array_equal(np.array([float(text) for text in texts(values)]), values, equal_nan=True)


@given(hnp.arrays("<f4", st.integers(0, 30)))
def test_float32_reads_back_as_it_was_and_is_short(values):
    shown = texts(values)
    assert np.array_equal(np.array([np.float32(text) for text in shown], np.float32), values, equal_nan=True)
    assert texts(np.array([0.1], np.float32)) == ["0.1"]


NANOSECONDS = st.integers(-(2**62), 2**62)
TIMES = st.lists(NANOSECONDS, max_size=12) | st.tuples(NANOSECONDS, st.integers(0, 12)).map(
    lambda two: [two[0]] * two[1]
)


@given(TIMES)
def test_instants_are_numpy_s_whether_they_share_a_day_or_not(values):
    instants = np.array(values, "<i8").view("<M8[ns]")
    assert texts(instants) == [f"{np.datetime_as_string(one)}Z" for one in instants]


@given(TIMES)
def test_durations_are_seconds_with_nine_decimals(values):
    expected = [f"{'-' if ns < 0 else ''}{abs(ns) // 10**9}.{abs(ns) % 10**9:09d}" for ns in values]
    assert texts(np.array(values, "<i8").view("<m8[ns]")) == expected


@pytest.mark.parametrize("kind", ["<M8[ns]", "<m8[ns]"])
def test_an_unknown_time_among_known_ones(kind):
    first, unknown, last = texts(np.array([5, np.iinfo(np.int64).min, 5], "<i8").view(kind))
    assert unknown == {"<M8[ns]": "", "<m8[ns]": "nan"}[kind]
    assert first == last == texts(np.array([5], "<i8").view(kind))[0]


@pytest.mark.parametrize(("digits", "text"), [(9, "0.333333333"), (3, "0.333"), (17, "0.3333333333333333")])
def test_digits(digits, text):
    assert texts(np.array([1 / 3]), digits) == [text]


def test_booleans_are_numbers():
    assert texts(np.array([True, False])) == ["1", "0"]


@given(st.lists(st.binary(max_size=12), min_size=1, max_size=8))
def test_text_is_read_back_by_the_csv_module(values):
    column = TableColumn("text, with comma", "", lambda rows: rows["text"])
    rows = np.zeros(len(values), [("text", "S12")])
    rows["text"] = values
    number = TableColumn("n", "count", lambda rows: np.arange(len(rows)))
    data = header([number, column]) + CsvEncoder([number, column]).block(rows)
    lines = list(csv.reader(io.StringIO(data.decode(), newline=""), strict=True))
    assert lines[0] == ["n [count]", "text, with comma"]
    expected = [bytes(value).decode(errors="backslashreplace").replace("\0", "\\x00") for value in rows["text"]]
    expected = [f"'{text}" if text[:1] in ("=", "+", "-", "@", "\t", "\r") and text else text for text in expected]
    assert [line[1] for line in lines[1:]] == expected
    assert [line[0] for line in lines[1:]] == [str(n) for n in range(len(values))]


def test_no_rows_no_lines():
    assert CsvEncoder([TableColumn("a", "", lambda rows: rows["a"])]).block(np.zeros(0, [("a", "<i4")])) == b""


def product(scale_kind):
    """A column that is counts x scale, and its rows' dtype."""
    dtype = np.dtype([("counts", "<i2"), ("scale", scale_kind)])

    def values(rows):
        return rows["counts"].astype(np.float64) * rows["scale"].astype(np.float64)

    return dtype, TableColumn("v", "m", values, 9, (lambda rows: rows["counts"], lambda rows: rows["scale"]))


@given(
    st.lists(
        st.tuples(hnp.arrays("<i2", st.integers(1, 40)), st.floats(2**-20, 2**20, width=32)), min_size=1, max_size=5
    )
)
def test_products_from_the_table_are_those_made_one_by_one(blocks):
    dtype, column = product("<f4")
    encoder = CsvEncoder([column])
    for counts, scale in blocks:
        rows = np.zeros(len(counts), dtype)
        rows["counts"], rows["scale"] = counts, scale
        expected = [f"{value:.9g}" for value in column.values(rows).tolist()]
        assert encoder.block(rows).decode().splitlines() == expected


def test_a_scale_that_changes_within_a_block():
    dtype, column = product("<f8")
    rows = np.array([(3, 0.5), (3, 0.25)], dtype)
    assert CsvEncoder([column]).block(rows) == b"1.5\n0.75\n"
