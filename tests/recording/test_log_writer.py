"""The writer, checked by readers that know nothing of it: the stock ``mcap`` package and ``mcap-ros2-support``.

Schemas: dtype -> text -> the same dtype; the layout is CDR's.
"""

import io
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, SeekingReader

from drivers import records
from onboard import channels
from onboard.recording.format.errors import ChannelError, RecordingError, SchemaError
from onboard.recording.format.schema import CDR_HEADER, dtype_from_ros2msg, message_name, ros2msg, units_from_ros2msg
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.recording.logs import LABEL, READING, MemorySink, label_rows, random_rows, reading_rows
from tests.recording.stock_readers import assert_same, stock_rows, written

IMU_TEXT = """\
uint64 sequence
int64 host_ns
uint64 tick
float32 accel_scale_m_s2
float32 gyro_scale_rad_s
int16[3] accel_raw
int16[3] gyro_raw
int16 temperature_raw
uint8 filter_code
uint8 sync
uint8 status
"""

names = st.from_regex(r"[a-z](?:_?[a-z0-9])*", fullmatch=True)
any_kinds = st.sampled_from(
    ["|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", "<f8", "S1", "S5", "S32"]
)
any_shapes = st.sampled_from([(), (1,), (3,), (7,), (2, 3), (1, 1), (2, 1, 2)])
fields = st.lists(st.tuples(names, any_kinds, any_shapes), min_size=1, max_size=9, unique_by=lambda field: field[0])


def test_imu_is_said_in_ros_words():
    assert ros2msg(records.IMU) == IMU_TEXT


def test_what_ros_cannot_say_rides_in_the_comment():
    dtype = np.dtype([("channel", "S32"), ("inertia", "<f8", (2, 3)), ("names", "S4", (2,))], align=True)
    text = ros2msg(dtype, {"inertia": "kg m^2"})
    assert text == ("uint8[32] channel # S32\nfloat64[6] inertia # shape=2x3 [kg m^2]\nuint8[8] names # S4 shape=2\n")
    assert dtype_from_ros2msg(text) == dtype
    assert units_from_ros2msg(text) == {"inertia": "kg m^2"}


@pytest.mark.parametrize("name", ["IMU", "SCALAR", "CAN_SYNC", "PULSE", "GAP", "EVENT", "CLOCK", "QUANTITY"])
def test_every_record_of_ours_comes_back(name):
    dtype = getattr(records, name, None) or getattr(channels, name)
    assert dtype_from_ros2msg(ros2msg(dtype)) == dtype


@settings(max_examples=40)
@given(fields)
def test_any_dtype_comes_back(fields):
    dtype = np.dtype([(name, kind, shape) if shape else (name, kind) for name, kind, shape in fields], align=True)
    units = {name: "N m" for name, _, _ in fields[::2]}
    text = ros2msg(dtype, units)
    assert dtype_from_ros2msg(text) == dtype
    assert units_from_ros2msg(text) == units


@settings(max_examples=40)
@given(fields)
def test_offsets_are_those_of_cdr(fields):
    """Plain CDR: each primitive on a multiple of its own size, counted from the end of the encapsulation header."""
    dtype = np.dtype([(name, kind, shape) if shape else (name, kind) for name, kind, shape in fields], align=True)
    at = 0
    for name, kind, shape in fields:
        size = 1 if "S" in kind else int(kind[2:])
        at += -at % size
        assert dtype.fields[name][1] == at
        at += int(np.prod(shape)) * np.dtype(kind).itemsize


def test_encapsulation_header_says_plain_cdr_little_endian():
    assert bytes([0, 1, 0, 0]) == CDR_HEADER


@pytest.mark.parametrize(
    ("dtype", "remedy"),
    [
        (np.dtype("<f8"), "structured"),
        (np.dtype([("Upper", "<f8")], align=True), "lower-case"),
        (np.dtype([("a__b", "<f8")], align=True), "lower-case"),
        (np.dtype([("a_", "<f8")], align=True), "lower-case"),
        (np.dtype([("half", "<f2")], align=True), "little-endian"),
        (np.dtype([("text", "<U4")], align=True), "little-endian"),
        (np.dtype([("big", ">f8")], align=True), "little-endian"),
        (np.dtype([("when", "<M8[ns]")], align=True), "little-endian"),
        (np.dtype([("nothing", "S0")], align=True), "little-endian"),
        (np.dtype([("nested", [("x", "<f8")])], align=True), "little-endian"),
        (np.dtype([("none", "<f8", (0,))], align=True), "leave the field out"),
        (np.dtype([("a", "u1"), ("b", "<f8")]), "align=True"),
    ],
)
def test_a_dtype_that_cannot_be_said_is_refused_with_the_remedy(dtype, remedy):
    with pytest.raises(SchemaError, match=remedy):
        ros2msg(dtype)


@pytest.mark.parametrize("unit", ["", "a]b", "m,s", "m#", "m\ns"])
def test_a_unit_that_would_break_the_text_is_refused(unit):
    with pytest.raises(SchemaError):
        ros2msg(records.PULSE, {"edge_ns": unit})


def test_a_unit_of_no_field_is_refused():
    with pytest.raises(SchemaError, match="wrong"):
        ros2msg(records.PULSE, {"wrong": "ns"})


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\n",
        "string name",
        "geometry_msgs/Vector3 v",
        "uint8[] data",
        "float64[4] m # shape=2x3",
        "uint8[8] s # S5",
        "uint64 a\nuint64 a",
        "int8 X=1",
    ],
)
def test_a_foreign_text_is_refused(text):
    with pytest.raises(SchemaError):
        dtype_from_ros2msg(text)


@given(st.text(alphabet=st.sampled_from(list("uint8floa32S[]# =x\nab")), max_size=60))
def test_any_text_gives_a_dtype_or_schema_error(text):
    try:
        dtype = dtype_from_ros2msg(text)
    except SchemaError:
        return
    assert dtype.names


@pytest.mark.parametrize(
    ("channel", "dtype", "name"),
    [
        ("imu_base", records.IMU, "heft/msg/Imu"),
        ("can_sync", records.CAN_SYNC, "heft/msg/CanSync"),
        ("estimate", LABEL, "heft/msg/Estimate"),
        ("2nd/arm", LABEL, "heft/msg/Channel2ndArm"),
    ],
)
def test_message_name(channel, dtype, name):
    rebuilt = dtype_from_ros2msg(ros2msg(dtype))
    assert message_name(channel, dtype) == message_name(channel, rebuilt) == name


EVERY_RECORD = {
    "imu_base": records.IMU,
    "joint_1": records.SCALAR,
    "load_cell": records.SCALAR,
    "can_sync": records.CAN_SYNC,
    "pulse": records.PULSE,
    "gap": records.GAP,
    "event": records.EVENT,
    "clock": channels.CLOCK,
    "quantity": channels.QUANTITY,
    "label": LABEL,
}


def test_stock_readers_decode_every_channel_to_the_same_numbers(rng):
    rows = {name: random_rows(rng, dtype, 120) for name, dtype in EVERY_RECORD.items()}

    def build(writer):
        for name, dtype in EVERY_RECORD.items():
            writer.register(name, dtype)
        for first in range(0, 120, 7):
            for name in rows:
                writer.write(name, rows[name][first : first + 7])

    data = written(build)
    decoded = stock_rows(data)
    assert list(decoded) == list(EVERY_RECORD)
    for name, expected in rows.items():
        assert_same(expected, decoded[name])
    unseekable = NonSeekingReader(io.BytesIO(data), validate_crcs=True)
    assert sum(1 for _ in unseekable.iter_messages()) == 120 * len(rows)


kinds = st.sampled_from(["|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", "<f8", "S1", "S5"])
shapes = st.sampled_from([(), (1,), (3,), (2, 3)])


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(kinds, shapes), max_size=7), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_any_dtype_decodes_to_the_same_numbers(fields, count, seed):
    more = [(f"f{n}", kind, shape) if shape else (f"f{n}", kind) for n, (kind, shape) in enumerate(fields)]
    dtype = np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), *more], align=True)
    rows = random_rows(np.random.default_rng(seed), dtype, count)

    def build(writer):
        writer.register("anything", dtype)
        writer.write("anything", rows)

    data = written(build, chunk_bytes=1000)
    assert_same(rows, stock_rows(data)["anything"])
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "a.mcap"
        path.write_bytes(data)
        back = LogReader(path).read("anything")
    assert back.dtype == dtype
    for name in dtype.names:
        assert np.array_equal(back[name], rows[name]), name


def test_same_rows_give_the_same_bytes_whatever_lies_in_the_padding():
    def build_with(padding):
        raw = np.full((50, READING.itemsize), padding, np.uint8)
        rows = raw.reshape(-1).view(READING)
        clean = reading_rows(0, 50)
        for name in READING.names:
            rows[name] = clean[name]
        assert rows.tobytes().count(padding) > 50

        def build(writer):
            writer.register("reading", READING)
            writer.write("reading", rows)

        return written(build)

    assert build_with(0xAA) == build_with(0x55)


def test_batches_of_any_size_make_the_same_rows():
    def build_with(sizes):
        def build(writer):
            writer.register("reading", READING)
            first = 0
            for size in sizes:
                writer.write("reading", reading_rows(first, size))
                first += size

        return written(build)

    assert build_with([1] * 600) == build_with([600]) == build_with([0, 599, 1])


def test_rows_of_a_strided_view_are_written_as_they_are():
    every_other = reading_rows(0, 40)[::2]

    def build(writer):
        writer.register("reading", READING)
        writer.write("reading", every_other)

    assert [decoded.value for _, decoded in stock_rows(written(build))["reading"]] == every_other["value"].tolist()


def test_two_channels_share_a_schema_and_other_records_of_a_name_do_not():
    def build(writer):
        writer.register("a", records.SCALAR)
        writer.register("b", records.SCALAR)
        writer.register("c", READING, schema="heft/msg/Scalar")

    summary = SeekingReader(io.BytesIO(written(build))).get_summary()
    assert [c.schema_id for c in summary.channels.values()] == [1, 1, 2]
    assert len({schema.name for schema in summary.schemas.values()}) == 2


def test_large_numbers_keep_their_low_32_bits_in_the_message_and_all_in_the_row():
    rows = reading_rows(2**32 + 5, 1)

    def build(writer):
        writer.register("reading", READING)
        writer.write("reading", rows)

    [(message, decoded)] = stock_rows(written(build))["reading"]
    assert (message.sequence, decoded.sequence) == (5, 2**32 + 5)


@pytest.mark.parametrize(
    ("act", "error"),
    [
        (lambda w: w.write("nobody", reading_rows(0, 1)), ChannelError),
        (lambda w: w.write("reading", label_rows(0, 1)), ChannelError),
        (lambda w: w.write("reading", reading_rows(0, 4).reshape(2, 2)), ChannelError),
        (lambda w: w.register("reading", LABEL), ChannelError),
        (lambda w: w.register("other", np.dtype([("value", "<f8")])), ChannelError),
        (lambda w: w.register("a" * 33, READING), ChannelError),
        (lambda w: w.register("", READING), ChannelError),
        (lambda w: w.register("other", np.dtype([("sequence", "<u4"), ("host_ns", "<i8")], align=True)), ChannelError),
        (lambda w: w.register("other", np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), ("x", "<f2")])), SchemaError),
    ],
)
def test_misuse_is_named_and_leaves_the_log_good(act, error):
    def build(writer):
        writer.register("reading", READING)
        with pytest.raises(error):
            act(writer)
        writer.register("reading", READING)
        writer.write("reading", reading_rows(0, 3))

    assert len(stock_rows(written(build))["reading"]) == 3


@pytest.mark.parametrize("late", ["write", "attach", "add_metadata"])
def test_a_closed_log_takes_nothing(late):
    sink = MemorySink()
    writer = LogWriter(sink)
    writer.register("reading", READING)
    writer.close()
    size = len(sink.data)
    arguments = {"write": ("reading", reading_rows(0, 1)), "attach": ("a", "b", b"c"), "add_metadata": ("a", {})}
    with pytest.raises(RecordingError, match="closed"):
        getattr(writer, late)(*arguments[late])
    assert len(sink.data) == size


def test_log_time_is_utc_where_the_wall_clock_was_set():
    wall_ns = 1_795_190_705_000_000_000

    def times(facts):
        def build(writer):
            writer.add_metadata("flight", facts)
            writer.register("reading", READING)
            writer.write("reading", reading_rows(0, 20))

        messages = SeekingReader(io.BytesIO(written(build))).iter_messages()
        return np.array([(message.log_time, message.publish_time) for _, _, message in messages])

    host_ns = reading_rows(0, 20)["host_ns"]
    told = {"wall_clock_ns": str(wall_ns), "monotonic_ns": "1000"}
    assert np.array_equal(times(told), np.stack([host_ns + wall_ns - 1000] * 2, axis=1))
    for unset in ({}, {**told, "wall_clock_ns": "1234567"}):  # simulated; a computer that began at 1970
        assert np.array_equal(times(unset), np.stack([host_ns] * 2, axis=1))
