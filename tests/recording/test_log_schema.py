"""Schemas: dtype -> text -> the same dtype; the layout is CDR's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import records
from onboard import channels
from onboard.recording.format.errors import SchemaError
from onboard.recording.format.schema import CDR_HEADER, dtype_from_ros2msg, message_name, ros2msg, units_from_ros2msg
from tests.recording.logs import LABEL

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
kinds = st.sampled_from(
    ["|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", "<f8", "S1", "S5", "S32"]
)
shapes = st.sampled_from([(), (1,), (3,), (7,), (2, 3), (1, 1), (2, 1, 2)])
fields = st.lists(st.tuples(names, kinds, shapes), min_size=1, max_size=9, unique_by=lambda field: field[0])


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


@given(fields)
def test_any_dtype_comes_back(fields):
    dtype = np.dtype([(name, kind, shape) if shape else (name, kind) for name, kind, shape in fields], align=True)
    units = {name: "N m" for name, _, _ in fields[::2]}
    text = ros2msg(dtype, units)
    assert dtype_from_ros2msg(text) == dtype
    assert units_from_ros2msg(text) == units


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
