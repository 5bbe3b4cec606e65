"""The CANopen bus with nodes that are wrong, absent, rebooted or in trouble."""

import numpy as np
import pytest

from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.can_peers import MS, ArmController, Bench, Encoder, LoadCell, u8, u32
from tests.drivers.three_nodes import make, sources


@pytest.fixture
def bench(clock):
    return Bench(clock, make, Encoder(), LoadCell(), ArmController())


# Nodes that are not what they should be


def test_a_wrong_device_is_named_and_the_mission_goes_on_without_it(clock):
    bench = Bench(clock, make, Encoder(objects={(0x1000, 0): u32(0x0002_0194)}), LoadCell(), ArmController())
    bench.start()
    bench.run(3_000)
    (text,) = texts(bench.batches, "wrong_device")
    assert text.startswith("node 1 has device type 00020194h, joint_1 needs xxxx0196h")
    assert sources(bench.batches, "wrong_device") == ["joint_1"]
    assert not len(of(bench.batches, "joint_1"))
    assert len(whole(bench.batches, "load_cell")) > 500
    assert bench.nodes[1].state == 0x7F
    assert bench.nodes[1].requests == [("read", 0x1000, 0)], "asked once, then left alone"


def test_swapped_node_numbers_are_both_named(clock):
    bench = Bench(clock, make, Encoder(number=2), LoadCell(number=1), ArmController())
    bench.start()
    assert sources(bench.batches, "wrong_device") == ["joint_1", "load_cell"]


def test_a_wrong_device_that_was_exchanged_is_taken_when_it_boots(clock):
    bench = Bench(clock, make, Encoder(objects={(0x1000, 0): u32(0x0002_0194)}), LoadCell(), ArmController())
    bench.start()
    bench.nodes[1] = Encoder()
    bench.put(bench.nodes[1].boot(clock()))
    bench.run(1_000)
    assert len(whole(bench.batches, "joint_1")) > 100


def test_a_configuration_that_does_not_fit_is_named(clock):
    nodes = (
        Encoder(objects={(0x6501, 0): u32(4096)}),
        LoadCell(unit=0xFA01_0100),
        ArmController(objects={(0x1A00, 1): u32(0x2000_0208)}),
    )
    bench = Bench(clock, make, *nodes)
    bench.start()
    assert sorted(sources(bench.batches, "configuration")) == ["arm_phase", "joint_1", "load_cell"]
    named = " ".join(texts(bench.batches, "configuration"))
    for part in ("4096 counts/rev", "FA010100h, not newton", "no 2000h:01 as u8 at byte 0"):
        assert part in named


def test_an_absent_node_is_told_once_and_taken_when_it_comes(clock):
    bench = Bench(clock, make, LoadCell(), ArmController())
    bench.start()
    bench.run(30_000)
    assert sources(bench.batches, "no_answer") == ["joint_1"]
    assert 15 < bench.unanswered < 30, "tries that are 0.5, 1, 2, 4, 8 s apart"
    assert "node 1 does not answer" in texts(bench.batches, "no_answer")[0]
    assert len(whole(bench.batches, "load_cell")) > 5_000
    bench.nodes[1] = Encoder()
    bench.put(bench.nodes[1].boot(clock()))
    bench.run(500)
    bench.stop()
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])
    assert len(joint) == bench.nodes[1].answers


def test_an_absent_node_that_comes_without_a_word_is_found_by_asking(clock):
    bench = Bench(clock, make, LoadCell(), ArmController())
    bench.start()
    bench.run(5_000)
    bench.nodes[1] = Encoder()
    bench.run(10_000)
    assert len(whole(bench.batches, "joint_1")) > 100


@pytest.mark.parametrize(
    "place", [pytest.param(one, marks=pytest.mark.campaign if one % 3 else ()) for one in range(11)]
)  # answers between those of the others
def test_a_node_that_falls_silent_at_any_point_of_its_set_up_is_set_up_later(clock, place):
    encoder = Encoder()
    bench = Bench(clock, make, encoder, LoadCell(), ArmController())
    answer = encoder.sdo
    encoder.sdo = lambda data: None if len(encoder.requests) >= place else answer(data)
    bench.start()
    bench.run(4_000)
    encoder.sdo = answer
    bench.run(8_000)
    bench.stop()
    assert codes(bench.batches).count("no_answer") == 1
    assert len(whole(bench.batches, "joint_1")) > 100


# Nodes in trouble


def test_a_node_that_reboots_is_set_up_again_and_says_so(bench):
    bench.start()
    bench.run(1_000)
    bench.put(bench.nodes[1].boot(bench.clock()))
    bench.run(2_000)
    bench.stop()
    assert sources(bench.batches, "node_rebooted") == ["joint_1"]
    assert sources(bench.batches, "started").count("joint_1") == 2
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])
    assert np.count_nonzero(joint["status"] & SampleStatus.AFTER_RESET) == 1
    gaps = [row for row in of(bench.batches, "gap") if row["channel"] == b"joint_1"]
    assert [row["cause"] for row in gaps] == [b"node_reset"]
    assert bench.nodes[1].objects[0x1800, 1] == u32(0xC000_0181), "its event TPDO is silenced again"


def test_a_node_that_dies_is_told_by_its_heartbeat_and_its_gap_ends_with_the_flight(bench):
    bench.start()
    bench.run(1_000)
    bench.nodes[2].deaf = True
    bench.run(5_000)
    bench.stop()
    assert sources(bench.batches, "heartbeat_lost") == ["load_cell"]
    assert sources(bench.batches, "no_answer") == ["load_cell"]
    cell, sync = whole(bench.batches, "load_cell"), whole(bench.batches, "can_sync")
    (gap,) = [row for row in of(bench.batches, "gap") if row["channel"] == b"load_cell"]
    assert int(cell["tick"][0]) + int(gap["last_missing"]) == int(sync["tick"][-1])
    assert len(whole(bench.batches, "joint_1")) > 1_000


def test_a_node_somebody_stopped_is_started_again(bench):
    bench.start()
    bench.run(2_000)
    bench.nodes[1].nmt(0x80)
    bench.run(1_000)
    bench.stop()
    (text,) = texts(bench.batches, "not_operational")
    assert "pre_operational" in text
    joint = whole(bench.batches, "joint_1")
    assert joint["tick"][-1] == bench.number - 1
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])


def test_a_heartbeat_from_before_the_start_is_no_reason_to_start_again(bench):
    bench.start()
    for number in (1, 2, 3):
        bench.put([(0x700 + number, b"\x7f")])
    bench.run(100)
    assert "not_operational" not in codes(bench.batches)


def test_the_answer_before_a_restart_of_sync_keeps_its_number(clock):
    device = make(port := Bench(clock, make).port)
    device.start(0)
    joint = next(channel for channel in device._channels if channel.data.name == "joint_1")
    joint.go_live()
    for number in range(3):
        port.put(number * 5 * MS, 0x080, u8(number + 1))
    port.put(28 * MS, 0x281, u32(0))  # the answer to SYNC 2, read late
    port.put(30 * MS, 0x080, u8(200))
    batches = device.pump(31 * MS) + device.stop(31 * MS)
    assert "sync_restarted" in codes(batches)
    assert of(batches, "joint_1")["tick"].tolist() == [2]


def test_an_emergency_is_an_event(bench):
    bench.start()
    bench.put([(0x082, bytes.fromhex("10 FF 81 00 00 00 00 07"))])
    bench.run(20)
    bench.put([(0x082, bytes(8)), (0x081, b"\1\2")])
    bench.run(20)
    assert "FF10h, register 81h, 0000000007" in texts(bench.batches, "emcy_FF10")[0]
    assert sources(bench.batches, "emcy_0000") == ["load_cell"]
    assert sources(bench.batches, "bad_emergency") == ["joint_1"]


def test_damaged_service_frames_are_told(bench):
    bench.start()
    bench.put([(0x701, b""), (0x080, b"\xff"), (0x581, b"\x43")])
    bench.run(20)
    assert {"bad_heartbeat", "bad_sync"} <= set(codes(bench.batches))


def test_a_sync_without_counter_is_told(clock):
    device = make(port := Bench(clock, make).port)
    device.start(0)
    for number in range(10):
        if number != 5:
            port.put(number * 5 * MS, 0x080, b"")
    batches = device.pump(50 * MS)
    assert of(batches, "can_sync")["tick"].tolist() == [0, 1, 2, 3, 4, 6, 7, 8, 9]
    assert "1019h" in texts(batches, "sync_uncounted")[0]
