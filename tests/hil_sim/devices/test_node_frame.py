"""The node twin against ``docs/node_frame.md`` (its example byte for byte), the ``cobs`` package, and the C encoder."""

import binascii
import struct

import hypothesis.strategies as st
import pytest
from cobs import cobs
from fastcrc.crc16 import ibm_3740
from hypothesis import given

from hil_sim.devices.serial_line.node_frame import FrameNode, NodeChannel, ValueType, crc16, frame, stuff
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock
from tests.node_encoder import CEncoder, built

HEAD = struct.Struct("<BBHIIIIB")
DESCRIPTOR = struct.Struct("<BBHIQI")


def force(value=0.0, **options):
    function = value if callable(value) else lambda t: value
    fields = {"name": "force", "unit": "N", "value_type": ValueType.I32, "mantissa": 1, "exponent": -4}
    return NodeChannel(**{**fields, **options}, analog=Analog(function))


def node(*channels, rate_error=0.0, **options):
    return FrameNode(channels or (force(),), RateClock(rate_error), START_NS, **{"boot_ns": 0, **options})


def faults(*faults):
    return FaultPlan(faults, START_NS).of("node")


def payloads(data):
    """Payloads of the whole frames in a stream, their CRC checked."""
    *frames, _ = data.split(b"\0")
    decoded = [cobs.decode(stuffed) for stuffed in frames]
    assert decoded
    assert all(binascii.crc_hqx(payload, 0xFFFF) == 0 for payload in decoded)
    return [payload[:-2] for payload in decoded]


def data_frames(data):
    return [(HEAD.unpack(p[:21]), p[21:]) for p in payloads(data) if p[0] == 0x10]


def descriptors(data):
    return [(DESCRIPTOR.unpack(p[:20]), p[20:]) for p in payloads(data) if p[0] == 0x11]


def test_the_example_of_the_document_byte_for_byte():
    twin = node(force(-12.3456), node=7, rate_hz=1000.0, counts_boots=False)
    line = Line(twin)
    twin.sync_edge(START_NS + 900_000, 300_000)
    stream = line.run(15)
    descriptor = bytes.fromhex(
        "05 11 07 36 76 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 04 40 42 0f 03 01 05 02 01 01 01 03 fc 4e"
        "01 01 01 01 01 01 06 66 6f 72 63 65 01 01 01 01 01 01 01 01 01 01 03 70 fc 00"
    )
    data = bytes.fromhex("05 10 07 36 76 01 01 01 03 e8 03 01 02 01 01 01 03 84 03 01 01 07 c0 1d fe ff 91 7d 00")
    assert stream.startswith(descriptor + data)


def test_check_values():
    assert crc16(b"123456789") == 0x29B1
    assert stuff(b"") == b"\x01"
    assert len(stuff(b"\x01" * 254)) == 255
    assert len(stuff(b"\x01" * 255)) == 257
    assert stuff(b"\x01" * 254 + b"\0") == b"\xff" + b"\x01" * 254 + b"\x01\x01"


@given(st.lists(st.one_of(st.binary(max_size=300), st.just(b"\x07" * 254), st.just(b"\0")), max_size=6).map(b"".join))
def test_stuffing_and_crc_are_those_of_the_libraries(data):
    assert stuff(data) == cobs.encode(data)
    assert crc16(data) == ibm_3740(data)
    assert frame(data).count(0) == 1


# Data and descriptor


def test_a_descriptor_comes_first_and_then_once_a_second_of_its_own_clock():
    line = Line(node(rate_error=0.01))
    stream = line.run(3500)
    heads = [head for head, _ in descriptors(stream)]
    assert payloads(stream)[0][0] == 0x11
    assert [head[4] for head in heads] == pytest.approx([0, 1_000_000, 2_000_000, 3_000_000], abs=1)
    assert [head[3] for head in heads] == pytest.approx([0, 199, 399, 599], abs=1)
    assert {head[5] for head in heads} == {1}


def test_the_descriptor_describes():
    count = force(
        name="counter of ticks", unit="rad/turn", value_type=ValueType.U16, mantissa=1_533_980_788, exponent=-12
    )
    count = count._replace(wraps=True)
    (head, rest), *_ = descriptors(Line(node(force(), count, node=200, tick_hz=32_768)).run(50))
    assert head[1] == 200
    assert head[2] == binascii.crc_hqx(rest, 0xFFFF)
    assert rest[:5] == struct.pack("<IB", 32_768, 2)
    assert rest[5:36] == struct.pack("<BBib8s16s", 5, 0, 1, -4, b"N", b"force")
    assert rest[36:67] == struct.pack("<BBib8s16s", 2, 1, 1_533_980_788, -12, b"rad/turn", b"counter of ticks")
    assert len(rest) == 67


def test_samples_are_numbered_ticked_and_those_of_their_instant():
    line = Line(node(force(lambda t: 3.0 * t), rate_error=0.005, rate_hz=200.0))
    frames = data_frames(line.run(1006))
    assert [head[3] for head, _ in frames] == list(range(len(frames)))
    assert len(frames) == 201
    ticks = [head[4] for head, _ in frames]
    assert ticks == pytest.approx([5000 * (k + 1) for k in range(len(ticks))], abs=1)
    values = [int.from_bytes(value, "little", signed=True) * 1e-4 for _, value in frames]
    assert values == pytest.approx([3.0 * tick * 1e-6 / 1.005 for tick in ticks], abs=1e-4)


@pytest.mark.parametrize(
    ("value_type", "value", "packed", "saturated"),
    [
        (ValueType.U8, 200.0, b"\xc8", False),
        (ValueType.U8, -1.0, b"\x00", True),
        (ValueType.I8, 200.0, b"\x7f", True),
        (ValueType.U16, 65_535.4, b"\xff\xff", False),
        (ValueType.I16, -40_000.0, b"\x00\x80", True),
        (ValueType.U32, 4_294_967_295.0, b"\xff\xff\xff\xff", False),
        (ValueType.I32, -2.0, b"\xfe\xff\xff\xff", False),
        (ValueType.I64, -2.0, b"\xfe" + b"\xff" * 7, False),
        (ValueType.I64, float("inf"), (2**62).to_bytes(8, "little"), True),
    ],
)
def test_values_are_packed_as_their_type_and_clipped_with_a_flag(value_type, value, packed, saturated):
    channel = force(value, value_type=value_type, exponent=0)
    head, values = data_frames(Line(node(channel)).run(10))[0]
    assert values == packed
    assert bool(head[7] & 2) is saturated


def test_a_counter_wraps_at_its_width():
    for value_type, value, count in ((ValueType.U16, 65_537.0, 1), (ValueType.I16, 32_768.0, -32_768)):
        channel = force(value, value_type=value_type, exponent=0, wraps=True)
        head, values = data_frames(Line(node(channel)).run(10))[0]
        assert int.from_bytes(values, "little", signed=count < 0) == count
        assert not head[7]


def test_pulses_are_numbered_and_latched_by_the_nodes_clock():
    twin = node(rate_error=-0.01, rate_hz=100.0)
    line = Line(twin)
    edges_ms = [42.0, 255.5, 400.25]
    for edge_ms in edges_ms:
        twin.sync_edge(START_NS + round(edge_ms * MS), 300_000)
    marks = {head[5]: head[6] for head, _ in data_frames(line.run(500))}
    assert marks.pop(0) == 0
    assert marks == {n: pytest.approx(ms * 990, abs=1) for n, ms in enumerate(edges_ms, 1)}


def test_edges_before_its_start_are_not_counted_and_a_late_one_is_refused():
    twin = node(boot_ns=100 * MS)
    line = Line(twin)
    twin.sync_edge(START_NS + 50 * MS, 300_000)
    twin.sync_edge(START_NS + 150 * MS, 300_000)
    line.run(300)
    assert twin.pulses == 1
    with pytest.raises(ValueError, match="advance the pulse source before the node"):
        twin.sync_edge(START_NS + 200 * MS, 300_000)


def test_a_frame_that_has_no_room_is_left_out_and_its_number_too():
    line = Line(node(rate_hz=500.0, line=LineFormat(115_200)))
    numbers = [head[3] for head, _ in data_frames(line.run(2000))]
    left_out = [n for n in range(numbers[-1]) if n not in numbers]
    assert numbers == sorted(numbers)
    assert len(left_out) > 150  # 500 samples a second, room for 397
    assert len(left_out) <= line.device.overrun <= len(left_out) + 12  # some are still in the queue
    assert line.device.produced == 1000


# Faults


def test_a_brown_out_begins_again_with_another_boot_number():
    line = Line(node(boot_ns=100 * MS, faults=faults(Fault("reset", "node", 0.5))))
    line.device.sync_edge(START_NS + 200 * MS, 300_000)
    before = line.run(550)
    after = line.run(300)
    assert {head[5] for head, _ in descriptors(before)} == {1}
    assert {head[5] for head, _ in descriptors(after)} == {2}
    first, _ = data_frames(after)[0]
    assert first[3:7] == (0, 105_000, 0, 0)


def test_stuck_saturated_and_silent():
    broken = faults(
        Fault("stuck", "node", 0.2, 0.4), Fault("saturated", "node", 0.5, 0.6, 1.0), Fault("silent", "node", 0.7, 0.8)
    )
    frames = data_frames(Line(node(force(lambda t: t), faults=broken)).run(1000))
    by_ms = {head[4] // 1000: (head, values) for head, values in frames}
    assert len({values for ms, (_, values) in by_ms.items() if 200 <= ms < 400}) == 1
    assert {values for ms, (_, values) in by_ms.items() if 500 <= ms < 600} == {b"\xff\xff\xff\x7f"}
    assert {head[7] for ms, (head, _) in by_ms.items() if 500 <= ms < 600} == {2}
    assert not [ms for ms in by_ms if 700 <= ms < 799]
    assert 805 in by_ms


def test_pulses_dropped_and_spurious():
    broken = faults(Fault("pulse_drop", "node", 0.3, 0.6), Fault("pulse_spurious", "node", 1.0, 1.5, value=0.1))
    twin = node(faults=broken)
    line = Line(twin)
    for k in range(9):
        twin.sync_edge(START_NS + (50 + 100 * k) * MS, 300_000)
    line.run(900)
    assert twin.pulses == 6
    line.run(900)
    assert twin.pulses == 11


def test_what_it_hears_it_ignores():
    line = Line(node())
    line.send(bytes(range(256)))
    assert len(data_frames(line.run(100))) == 19


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ((), "1 to 65 channels, not 0"),
        ((force(),) * 66, "1 to 65 channels, not 66"),
        ((force(name="a name of 17 lett"),), "16 characters for a name"),
        ((force(unit="newtonmet"),), "8 for a unit"),
        ((force(mantissa=1 << 31),), "no room in a descriptor"),
        ((force(exponent=-200),), "no room in a descriptor"),
    ],
)
def test_channels_that_cannot_be_described_are_refused(channels, message):
    with pytest.raises(ValueError, match=message):
        FrameNode(channels, RateClock(), START_NS)


# The C encoder


def test_the_twin_and_the_c_encoder_send_the_same_bytes(tmp_path):
    channels = (
        force(lambda t: 40.0 * t - 3.0),
        force(lambda t: 900.0 * t, name="angle", unit="rad", value_type=ValueType.U16, exponent=-3, wraps=True),
        force(-1.0, name="big", unit="1", value_type=ValueType.I64, exponent=0),
    )
    twin = node(*channels, node=9, rate_hz=100.0)
    line = Line(twin)
    twin.sync_edge(START_NS + 333_333_333, 300_000)
    stream = line.run(2500)

    fields = [(c.name, c.unit, c.value_type, c.wraps, c.mantissa, c.exponent) for c in channels]
    encoder = CEncoder(built(tmp_path), fields, node=9, boot=1)
    expected = b""
    pulsed = False
    for payload in payloads(stream):
        if payload[0] == 0x11:
            expected += encoder.descriptor(DESCRIPTOR.unpack(payload[:20])[4])
            continue
        head = HEAD.unpack(payload[:21])
        if head[5] and not pulsed:
            encoder.edge(333_333)
            pulsed = True
        expected += encoder.data(head[4], *struct.unpack("<iHq", payload[21:]), status=head[7])
    assert pulsed
    assert stream.startswith(expected)
    assert len(expected) > 250 * 40
