"""Objects in event-driven TPDOs: every change is a row or a named gap, whatever is lost on the way."""

import struct

import numpy as np
import pytest

from drivers.canopen_pdo import CanopenBus, CanopenObjectConfig, SyncConfig
from drivers.canopen_pdo.profiles.mapped_object import MappedObject
from drivers.errors import ConfigurationError, FrameError
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.can_peers import ArmController, Bench, u8, u16, u32

PHASE = CanopenObjectConfig("arm_phase", 3, tpdo=1, byte_offset=0, format="u8", index=0x2000, subindex=1)
COUNTED = CanopenObjectConfig(
    "arm_phase", 3, tpdo=1, byte_offset=0, format="u8", index=0x2000, subindex=1, counter_subindex=2
)


def bench_of(clock, config, node=None):
    return Bench(clock, lambda port: CanopenBus(port, [config], SyncConfig(), "can_0"), node or ArmController())


@pytest.fixture(params=[PHASE, COUNTED], ids=["without counter", "with counter"])
def bench(request, clock):
    return bench_of(clock, request.param)


def change(bench, phase, heard=True):
    frame = bench.nodes[3].change(phase)
    if heard:
        bench.put([frame])
    bench.run(100)


def values(bench, good=True):
    rows = whole(bench.batches, "arm_phase")
    return [int(row["value_raw"]) for row in rows if not (good and row["status"] & SampleStatus.NOT_VALID)]


def lost(bench):
    return [int(row["last_missing"] - row["first_missing"]) + 1 for row in of(bench.batches, "gap")]


def test_a_change_is_a_row_when_it_comes_and_a_row_when_it_is_read_back(bench):
    bench.nodes[3].objects[0x2000, 1] = u8(4)
    bench.start()
    stamps = []
    for phase in (1, 2, 3, 3):
        stamps.append(bench.clock())
        change(bench, phase)
    bench.run(5_000)
    rows = whole(bench.batches, "arm_phase")
    assert rows["value_raw"].tolist() == [4, 4, 1, 1, 2, 2, 3, 3, 3]
    assert rows["host_ns"][[2, 4, 6, 8]].tolist() == stamps
    assert np.all(rows["host_ns"][[3, 5, 7]] - stamps[:3] < 50e6)
    assert rows["sync_counter"].tolist() == [0] * 9
    assert not rows["status"].any()
    assert "gap" not in {batch.channel for batch in bench.batches}
    sync = of(bench.batches, "can_sync")
    for row in rows[2:]:
        assert row["tick"] == sync["tick"][sync["host_ns"] <= row["host_ns"]].max()


def test_a_value_that_stands_is_read_back_twice_a_second_and_makes_no_rows(clock):
    for config, subindex in ((PHASE, 1), (COUNTED, 2)):
        bench = bench_of(clock, config)
        bench.start()
        before = len(bench.nodes[3].requests)
        bench.run(10_000)
        asked = bench.nodes[3].requests[before:]
        assert 18 <= len(asked) <= 20
        assert set(asked) == {("read", 0x2000, subindex)}
        assert values(bench) == [0, 0]


def test_a_change_whose_tpdo_is_lost_is_found_and_named_within_half_a_second(bench):
    bench.start()
    change(bench, 7)
    lost_ns = bench.clock()
    change(bench, 3, heard=False)
    bench.run(500)
    rows = whole(bench.batches, "arm_phase")
    assert rows["value_raw"].tolist() == [0, 0, 7, 7, 3]
    assert rows["host_ns"][4] - lost_ns < 520e6
    (gap,) = of(bench.batches, "gap")
    assert (gap["first_missing"], gap["last_missing"], gap["cause"]) == (4, 4, b"no_pdo")
    assert "183h did not arrive" in texts(bench.batches, "pdo_lost")[0]


def test_losses_are_counted_where_the_node_counts(clock):
    bench = bench_of(clock, COUNTED)
    bench.start()
    for phase in (1, 2, 0):  # back where it was: only the counter tells
        change(bench, phase, heard=False)
    bench.run(500)
    assert (lost(bench), values(bench)) == ([3], [0, 0, 0])
    for _ in range(255):
        bench.nodes[3].change(0)
    bench.run(600)
    assert (lost(bench), values(bench)) == ([3, 255], [0, 0, 0, 0])


def test_a_tpdo_after_a_lost_one_is_believed_when_the_node_confirms_it(clock):
    bench = bench_of(clock, COUNTED)
    bench.start()
    change(bench, 1, heard=False)
    change(bench, 2)
    rows = whole(bench.batches, "arm_phase")
    assert rows["value_raw"].tolist() == [0, 0, 2, 2]
    assert rows["status"].tolist() == [0, 0, SampleStatus.NOT_VALID, 0]
    assert lost(bench) == [1]


def test_tpdos_that_come_too_fast_to_be_read_back_confirm_each_other(clock):
    bench = bench_of(clock, COUNTED)
    bench.start()
    before = len(bench.nodes[3].requests)
    for number in range(400):
        frame = bench.nodes[3].change(number % 200)
        if number not in {100, 101, 250}:
            bench.put([frame])
        bench.run(5)
    assert bench.nodes[3].requests[before:] == []
    assert lost(bench) == [2, 1]
    assert len(values(bench, good=False)) == 2 + 400 - 3
    assert np.count_nonzero(of(bench.batches, "arm_phase")["status"]) == 2


def test_garbage_between_two_changes_is_not_valid_and_costs_no_samples(clock):
    bench = bench_of(clock, COUNTED)
    bench.start()
    change(bench, 4)
    garbage = [bytes([5, counter]) for counter in (200, 77, 13)]
    bench.put([(0x183, data) for data in garbage])
    bench.run(100)
    change(bench, 6)
    assert values(bench) == [0, 0, 4, 4, 4, 6, 6]
    assert values(bench, good=False).count(5) == 3
    assert not lost(bench)


def test_a_value_that_a_tpdo_crossed_on_its_way_is_not_believed(bench):
    """The node answers with what it held when it was asked, and its TPDO overtakes the answer."""
    bench.start()
    change(bench, 1)
    node, sdo = bench.nodes[3], bench.nodes[3].sdo

    def crossed(data):
        answer = sdo(data)
        if node.objects[0x2000, 1] == u8(1):
            bench.put([node.change(2)])
        return answer

    node.sdo = crossed
    bench.run(1_200)
    good = values(bench)
    assert good[:4] == [0, 0, 1, 1]
    assert set(good[4:]) == {2}
    assert not lost(bench)


def test_a_value_that_agrees_with_a_tpdo_before_it_is_its_only_confirmation(bench):
    """The value changes while it is asked for: the TPDO comes first, the answer has the new value."""
    bench.start()
    change(bench, 1)
    node, sdo = bench.nodes[3], bench.nodes[3].sdo

    def changed(data):
        if node.objects[0x2000, 1] == u8(1):
            bench.put([node.change(2)])
        return sdo(data)

    node.sdo = changed
    bench.run(1_200)
    assert values(bench, good=False) == values(bench) == [0, 0, 1, 1, 2, 2]
    assert not lost(bench)


def test_trouble_on_the_bus_is_a_reason_to_ask_at_once(bench):
    bench.start()
    bench.run(110)
    before = len(bench.nodes[3].requests)
    bench.put([(0x083, bytes.fromhex("40 81 10 00 00 00 00 00"))])
    bench.run(30)
    assert len(bench.nodes[3].requests) > before


def test_a_node_that_was_unplugged_for_a_while_is_asked_what_it_did(clock):
    """It ran on, and its counter includes changes that nobody heard."""
    bench = bench_of(clock, COUNTED)
    bench.start()
    bench.nodes[3].deaf = True
    for phase in (1, 2, 3):
        change(bench, phase, heard=False)
    bench.run(2_000)
    assert "heartbeat_lost" in codes(bench.batches)
    bench.nodes[3].deaf = False
    bench.run(10_000)
    assert lost(bench) == [3]
    rows = whole(bench.batches, "arm_phase")
    assert rows["value_raw"].tolist() == [0, 0, 3, 3]
    assert rows["status"][2] == SampleStatus.AFTER_RESET


def test_changes_that_nobody_could_tell_are_named_as_one_or_so(clock):
    """It was away and its value is the same, or it never returned: it may have changed and changed back."""
    bench = bench_of(clock, PHASE)
    bench.start()
    bench.run(3_000)
    bench.nodes[3].deaf = True
    bench.run(4_000)
    bench.nodes[3].deaf = False
    bench.run(10_000)
    assert lost(bench) == [1]
    bench.nodes[3].deaf = True
    bench.run(4_000)
    bench.stop()
    assert lost(bench) == [1, 1]
    assert not any(gap["counted"] for gap in of(bench.batches, "gap"))
    assert values(bench) == [0, 0, 0]


def test_a_node_that_rebooted_has_lost_nothing(bench):
    bench.start()
    change(bench, 5)
    bench.nodes[3].objects[0x2000, 2] = u8(100)
    bench.put(bench.nodes[3].boot(bench.clock()))
    bench.run(1_000)
    assert values(bench) == [0, 0, 5, 5, 0, 0]
    assert not lost(bench)


def test_a_node_that_refuses_or_keeps_silent_when_asked_is_told_and_goes_on(bench):
    bench.start()
    node, objects = bench.nodes[3], dict(bench.nodes[3].objects)
    for subindex in (1, 2):
        del node.objects[0x2000, subindex]
    bench.run(2_000)
    assert codes(bench.batches).count("configuration") == 1
    node.objects = dict(objects)
    bench.run(1_000)
    sdo, node.sdo = node.sdo, lambda data: None
    bench.run(3_000)
    assert codes(bench.batches).count("no_answer") == 1
    node.sdo = sdo
    bench.run(1_000)
    change(bench, 8)
    assert values(bench) == [0, 0, 8, 8]


# Configurations


def test_an_object_mapped_at_another_byte_is_named(clock):
    swapped = ArmController(objects={(0x1A00, 1): u32(0x2000_0208), (0x1A00, 2): u32(0x2000_0108)})
    bench = bench_of(clock, PHASE, swapped)
    bench.start()
    assert "no 2000h:01 as u8 at byte 0" in texts(bench.batches, "configuration")[0]


def test_a_counter_that_is_not_mapped_is_named(clock):
    bench = bench_of(clock, COUNTED, ArmController(objects={(0x1A00, 0): u8(1)}))
    bench.start()
    assert "no 2000h:02: drop counter_subindex" in texts(bench.batches, "configuration")[0]


def test_an_object_too_long_for_one_transfer_is_not_read(clock):
    long = CanopenObjectConfig("clock", 3, tpdo=1, byte_offset=0, format="u64", index=0x2000, subindex=1)
    node = ArmController(objects={(0x2000, 1): bytes(8), (0x1A00, 0): u8(1), (0x1A00, 1): u32(0x2000_0140)})
    bench = bench_of(clock, long, node)
    bench.start()
    assert not len(of(bench.batches, "clock"))
    bench.put([(0x183, (77).to_bytes(8, "little"))])
    bench.run(2_000)
    assert of(bench.batches, "clock")["value_raw"].tolist() == [77]
    assert ("read", 0x2000, 1) not in node.requests


def test_an_object_shorter_than_its_format_is_named(clock):
    wide = CanopenObjectConfig("arm_phase", 3, tpdo=1, byte_offset=0, format="u16", index=0x2000, subindex=1)
    bench = bench_of(clock, wide, ArmController(objects={(0x1A00, 1): u32(0x2000_0110)}))
    bench.start()
    assert "2000h has 1 bytes, u16 does not fit" in texts(bench.batches, "configuration")[0]


def test_several_objects_share_a_node_and_a_tpdo(clock):
    events = CanopenObjectConfig("arm_events", 3, tpdo=1, byte_offset=1, format="u8", index=0x2000, subindex=2)
    bench = Bench(clock, lambda port: CanopenBus(port, [PHASE, events], SyncConfig()), ArmController())
    bench.start()
    bench.put([bench.nodes[3].change(3), bench.nodes[3].change(4)])
    bench.run(100)
    assert of(bench.batches, "arm_phase")["value_raw"].tolist() == [0, 0, 3, 4, 4]
    assert of(bench.batches, "arm_events")["value_raw"].tolist() == [0, 0, 1, 2, 2]


def current_node(kind):
    """A motor's current, i16, in TPDO2 on every SYNC."""
    node = ArmController(objects={(0x1801, 1): u32(0x283), (0x1801, 2): u8(kind), (0x2001, 0): u16(0)})
    node.objects |= {(0x1A01, 0): u8(1), (0x1A01, 1): u32(0x2001_0010), (0x1800, 1): u32(1 << 31)}
    node.factory = dict(node.objects)
    node.value = lambda index, number, now_ns: struct.pack("<h", -number)
    return node


def test_an_object_that_answers_sync_is_counted_by_sync(clock):
    current = CanopenObjectConfig(
        "current", 3, tpdo=2, byte_offset=0, format="i16", index=0x2001, unit="A", scale=0.001, synchronous=True
    )
    bench = bench_of(clock, current, current_node(1))
    bench.start()
    bench.drop = lambda number, identifier: identifier == 0x283 and number % 50 == 0
    bench.run(2_000)
    bench.stop()
    rows = whole(bench.batches, "current")
    np.testing.assert_array_equal(rows["value_raw"], -rows["tick"].astype(int))
    assert (rows["unit"][0], rows["scale"][0]) == (b"A", 0.001)
    assert sum(lost(bench)) == 8
    other = bench_of(clock, current, current_node(2))
    other.start()
    assert "transmission type 2, not 1: write 1801h" in texts(other.batches, "configuration")[0]


@pytest.mark.parametrize(
    ("name", "packing", "value"),
    [
        ("u8", "<B", 200),
        ("i8", "<b", -100),
        ("u16", "<H", 60_000),
        ("i16", "<h", -30_000),
        ("u32", "<I", 4_000_000_000),
        ("i32", "<i", -2_000_000_000),
        ("i64", "<q", -(2**60)),
    ],
)
def test_formats_of_objects(name, packing, value):
    size = struct.calcsize(packing)
    offset = 8 - size
    data = MappedObject(CanopenObjectConfig("x", 9, 2, offset, name, 0x2001))
    frame = bytes(offset) + struct.pack(packing, value)
    assert data.decode(frame).value_raw == value
    assert data.cob_id == 0x289
    with pytest.raises(FrameError):
        data.decode(frame[:-1])


@pytest.mark.parametrize(
    "make_wrong",
    [
        lambda: CanopenObjectConfig("x", 3, 1, 0, "f32", 0x2000),
        lambda: CanopenObjectConfig("x", 3, 5, 0, "u8", 0x2000),
        lambda: CanopenObjectConfig("x", 3, 1, 7, "u16", 0x2000),
        lambda: CanopenObjectConfig("x", 3, 1, -1, "u8", 0x2000),
        lambda: CanopenObjectConfig("x", 3, 1, 0, "u8", 0x2000, counter_subindex=2, synchronous=True),
    ],
)
def test_configurations_that_cannot_be_are_refused(make_wrong):
    with pytest.raises(ConfigurationError, match=":"):
        make_wrong()
