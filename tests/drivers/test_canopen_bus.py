"""The CANopen bus as a device: three nodes, SYNC, and everything that can happen to them."""

import math

import numpy as np
import pytest

from drivers.canopen_pdo import CanopenBus, CanopenObjectConfig, Cia404Config, Cia406Config, SyncConfig
from drivers.errors import ConfigurationError
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.can_peers import MS, ArmController, Bench, Encoder, FakeCan, LoadCell, u8, u16, u32

JOINT = Cia406Config("joint_1", 1, 500_000)
CELL = Cia404Config("load_cell", 2, 50.0)
PHASE = CanopenObjectConfig("arm_phase", 3, tpdo=1, byte_offset=0, format="u8", index=0x2000, subindex=1)


def make(port):
    return CanopenBus(port, [JOINT, CELL, PHASE], SyncConfig(), "can_0")


@pytest.fixture
def bench(clock):
    return Bench(clock, make, Encoder(), LoadCell(), ArmController())


def sources(batches, code):
    rows = of(batches, "event")
    return [row["source"].decode() for row in rows if row["code"].decode() == code]


# Start, rows, stop


def test_three_nodes_are_set_up_and_every_sync_answered_is_a_row(bench):
    bench.start()
    bench.run(5_000)
    bench.stop()
    assert sorted(sources(bench.batches, "started")) == ["arm_phase", "joint_1", "load_cell"]
    assert set(codes(bench.batches)) == {"started", "stopped"}
    joint, cell, sync = (whole(bench.batches, name) for name in ("joint_1", "load_cell", "can_sync"))
    assert len(sync) == bench.number
    assert len(joint) == bench.nodes[1].answers > 900
    assert len(cell) == bench.nodes[2].answers
    assert not len(of(bench.batches, "gap"))
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])
    np.testing.assert_array_equal(cell["tick"], -cell["value_raw"])
    np.testing.assert_array_equal(sync["tick"], np.arange(len(sync)))
    np.testing.assert_array_equal(sync["sync_counter"], np.arange(len(sync)) % 240 + 1)
    assert np.all(joint["host_ns"] == sync["host_ns"][joint["tick"].astype(int)] + bench.answer_ns)
    assert joint["scale"][0] == 2.0 * math.pi / 500_000
    assert (joint["unit"][0], cell["unit"][0], cell["scale"][0]) == (b"rad", b"N", 1e-4)
    assert [node.state for node in bench.nodes.values()] == [0x7F] * 3


def test_the_encoder_sends_only_on_sync_after_its_set_up(bench):
    bench.start()
    encoder = bench.nodes[1]
    assert encoder.objects[0x6200, 0] == u16(0)
    assert encoder.objects[0x1800, 1] == u32(0xC000_0181)
    assert encoder.objects[0x1017, 0] == u16(500)


def test_the_first_sync_number_follows_its_counter(clock):
    bench = Bench(clock, make, Encoder(), LoadCell(), ArmController(), first_sync=1_000_000)
    bench.start()
    bench.run(2_000)
    sync = of(bench.batches, "can_sync")
    assert sync["tick"][0] == 1_000_000 % 240
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["value_raw"] - joint["tick"].astype(int), 1_000_000 - 1_000_000 % 240)


@pytest.mark.parametrize("offset", [(1 << 32) - 300, (1 << 31) - 300])
def test_a_counter_that_wraps_is_unwrapped(clock, offset):
    joint = Cia406Config("joint_1", 1, 500_000, zero_count=offset)
    nodes = Encoder(offset=offset), LoadCell(), ArmController()
    bench = Bench(clock, lambda port: CanopenBus(port, [joint, CELL, PHASE], SyncConfig(), "can_0"), *nodes)
    bench.start()
    bench.run(3_000)
    rows = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(rows["value_raw"], offset + rows["tick"].astype(int))
    assert rows["value_raw"][-1] > offset + 400


def test_load_cell_status_and_capacity(bench):
    bench.start()
    cell = bench.nodes[2]
    marks = []
    for force, status in [(499_999, 0), (500_000, 0), (-500_000, 0), (0, 0x01), (600_000, 0x83), (1, 0x80)]:
        cell.force, cell.status = force, status
        made = bench.run(100)
        row = of(made, "load_cell")[-1]
        assert (row["value_raw"], row["device_status"]) == (force, status)
        marks.append(SampleStatus(int(row["status"])))
    saturated, invalid = SampleStatus.SATURATED, SampleStatus.NOT_VALID
    assert marks == [SampleStatus.OK, saturated, saturated, invalid, saturated | invalid, SampleStatus.OK]


class TaringCell(LoadCell):
    """6125h takes the word "zero", as in a manual of a strain link, and nothing else."""

    def __init__(self):
        super().__init__(objects={(0x6125, 1): bytes(4)})
        self.tares = 0

    def sdo(self, data):
        self.tares += data == bytes.fromhex("23 25 61 01 7A 65 72 6F")
        return super().sdo(data)


def test_a_load_cell_is_tared_once_and_not_under_a_load_of_nobody_knows(clock):
    cell = TaringCell()
    tared = Cia404Config("load_cell", 2, 50.0, tare=True)
    bench = Bench(clock, lambda port: CanopenBus(port, [tared], SyncConfig(), "can_0"), cell)
    bench.start()
    bench.run(500)
    assert cell.tares == 1
    assert not whole(bench.batches, "load_cell")["status"].any()
    bench.put(cell.boot(clock()))
    made = bench.run(1_000)
    rows = of(made, "load_cell")
    assert cell.tares == 1
    after = rows[np.flatnonzero(rows["status"] & SampleStatus.AFTER_RESET)[0] :]
    assert len(after) > 100
    assert (after["status"] & SampleStatus.NOT_VALID).all()


def test_a_load_cell_that_cannot_be_tared_is_named(clock):
    tared = Cia404Config("load_cell", 2, 50.0, tare=True)
    bench = Bench(clock, lambda port: CanopenBus(port, [tared], SyncConfig(), "can_0"), LoadCell())
    bench.start()
    assert "refuses to write 6125h:01" in texts(bench.batches, "configuration")[0]


def test_rows_are_the_same_to_the_byte_padding_included(clock):
    logs = []
    for _ in range(2):
        clock.now_ns = 1_000_000_000
        bench = Bench(clock, make, Encoder(), LoadCell(), ArmController())
        bench.start()
        bench.run(1_000)
        bench.stop()
        logs.append([(batch.channel, batch.rows.tobytes()) for batch in bench.batches])
    assert logs[0] == logs[1]


# Losses


def test_frames_lost_at_random_are_named_and_ticks_stay_true(bench, rng):
    bench.start()
    lost = {(int(number), int(rng.choice([0x080, 0x281, 0x182]))) for number in rng.integers(200, 2_000, 400)}
    burst = {(number, identifier) for number in range(500, 800) for identifier in (0x080, 0x281, 0x182)}
    bench.drop = lambda number, identifier: (number, identifier) in lost | burst
    bench.run(10_000)
    bench.stop()
    sync, joint, cell = (whole(bench.batches, name) for name in ("can_sync", "joint_1", "load_cell"))
    np.testing.assert_array_equal(sync["tick"], sync["sequence"])
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])
    np.testing.assert_array_equal(cell["tick"], -cell["value_raw"])
    dropped = len({number for number, identifier in lost | burst if identifier == 0x281})
    assert len(joint) == bench.nodes[1].answers - dropped
    assert {"no_sync", "no_pdo"} == {row["cause"].decode() for row in of(bench.batches, "gap")}


def test_a_sync_producer_that_stops_is_told_once_and_again_when_it_is_back(bench):
    bench.start()
    bench.sync_on = False
    bench.run(50)
    assert of(bench.batches, "joint_1")["tick"][-1] == bench.number - 1, "the last answer does not wait for a SYNC"
    bench.run(5_000)
    assert codes(bench.batches).count("sync_lost") == 1
    assert "silent" not in codes(bench.batches)
    bench.sync_on = True
    bench.number += 1_000
    bench.run(100)
    assert codes(bench.batches).count("sync_recovered") == 1
    (gap,) = [row for row in of(bench.batches, "gap") if row["channel"] == b"can_sync"]
    assert int(gap["last_missing"]) - int(gap["first_missing"]) + 1 == 1_000
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])


def test_a_sync_producer_that_stands_still_for_a_moment_is_told(bench):
    bench.start()
    bench.sync_on = False
    bench.run(100)
    bench.sync_on = True
    bench.run(1_000)
    bench.stop()
    (text,) = texts(bench.batches, "sync_paused")
    assert text.startswith("SYNC paused for 100 ms, none is missing")
    assert "sync_lost" not in codes(bench.batches)
    assert not len(of(bench.batches, "gap"))


def test_a_reader_that_stood_still_is_told_and_the_producer_is_not_blamed(bench):
    bench.start()
    bench.run(1_000)
    pump, bench.device.pump = bench.device.pump, lambda now: []
    bench.drop = lambda number, identifier: len(bench.port.inbox) > 100  # what the adapter does not keep
    bench.run(3_000)
    bench.drop = lambda number, identifier: False
    bench.device.pump = pump
    bench.run(1_000)
    bench.stop()
    (text,) = texts(bench.batches, "not_read")
    assert text.startswith("not read for 3.0 s")
    assert not {"sync_lost", "sync_paused", "sync_restarted"} & set(codes(bench.batches))
    lost = [row for row in of(bench.batches, "gap") if row["channel"] == b"can_sync"]
    assert {row["cause"] for row in lost} == {b"not_read"}
    whole(bench.batches, "can_sync")


def test_a_reader_that_stood_still_within_its_read_lost_what_the_queue_did_not_keep(bench):
    bench.start()
    bench.run(1_000)
    began_ns, pump, bench.device.pump = bench.clock(), bench.device.pump, lambda now, timeout_s=0.0: []
    bench.drop = lambda number, identifier: len(bench.port.inbox) > 1_000
    bench.run(3_000)
    bench.drop = lambda number, identifier: False
    bench.device.pump = pump
    bench.port.inbox = [frame._replace(host_ns=bench.clock()) for frame in bench.port.inbox]
    bench.batches += bench.device.pump(began_ns, 0.05)  # it was stopped while it waited
    bench.run(1_000)
    bench.stop()
    assert texts(bench.batches, "not_read") == ["not read for 3.0 s: the process stood still"]
    assert not {"sync_lost", "sync_paused", "sync_restarted"} & set(codes(bench.batches))
    lost = [row for row in of(bench.batches, "gap") if row["channel"] == b"can_sync"]
    assert {row["cause"] for row in lost} == {b"not_read"}
    missing = sum(int(row["last_missing"] - row["first_missing"]) + 1 for row in lost)
    assert missing > 240  # a whole round of the counter is among them
    assert len(whole(bench.batches, "can_sync")) + missing == pytest.approx(bench.number, abs=1)


def gathered(bench, duration_ms, mean):
    """The device waits for a frame, and gathers those of the next 20 ms; ``mean`` is done to the gathered ones."""
    pump = bench.device.pump
    waited = []

    def gather(seconds):
        assert seconds == 0.02
        waited.append(bench.clock())
        held, bench.port.inbox = bench.port.inbox, []
        return mean(held)

    def pumped(now):
        first, bench.port.inbox = bench.port.inbox[:1], bench.port.inbox[1:]
        receive, bench.port.receive = bench.port.receive, lambda timeout_s: first
        bench.port.gather = lambda seconds: (setattr(bench.port, "receive", receive), gather(seconds))[1]
        made = pump(now, 0.05)
        bench.port.receive = receive
        return made

    bench.device.pump = pumped
    bench.run(duration_ms)
    bench.device.pump = pump
    return waited


def test_frames_of_20_ms_are_taken_at_once_while_no_node_is_asked(bench):
    bench.start()
    times = gathered(bench, 1_000, lambda frames: frames)
    bench.stop()
    assert len(times) == pytest.approx(100, abs=10)  # all but those in which an object was read back
    assert not len(of(bench.batches, "gap"))
    assert len(whole(bench.batches, "can_sync")) == bench.number
    assert {row["channel"] for row in of(bench.batches, "gap")} == set()
    assert not {"not_read", "sync_paused", "pdo_extra"} & set(codes(bench.batches))


def test_what_was_read_late_within_a_gather_is_numbered_like_what_was_read_late_between_pumps(bench):
    """The process stands still for 2 s within a gather: a tty keeps all, and gives it the stamp of its reading."""
    bench.start()
    bench.run(500)
    pump, bench.device.pump = bench.device.pump, lambda now, timeout_s=0.0: []
    bench.run(20)
    began_ns, first, bench.port.inbox = bench.clock(), bench.port.inbox, []
    lost = range(bench.number, bench.number + 3)
    bench.drop = lambda number, identifier: number in lost
    bench.run(2_000)
    late, bench.port.inbox = [frame._replace(host_ns=bench.clock()) for frame in bench.port.inbox], []
    bench.device.pump = pump
    receive, inbox = bench.port.receive, [first, late[500:]]
    bench.port.receive = lambda timeout_s: inbox.pop(0) if inbox else receive(timeout_s)
    bench.port.gather = lambda seconds: late[:500]
    bench.batches += bench.device.pump(began_ns, 0.05)
    del bench.port.gather
    bench.run(500)
    bench.stop()
    assert not inbox
    assert texts(bench.batches, "not_read") == ["not read for 2.0 s: the process stood still"]
    assert not {"sync_lost", "sync_paused", "sync_restarted"} & set(codes(bench.batches))
    missing = [
        (row["channel"], int(row["last_missing"] - row["first_missing"]) + 1) for row in of(bench.batches, "gap")
    ]
    assert sorted(missing) == [(b"can_sync", 3), (b"joint_1", 3), (b"load_cell", 3)]
    assert len(whole(bench.batches, "can_sync")) == bench.number - 3


def test_a_bus_without_sync_is_told(bench):
    bench.sync_on = False
    bench.start()
    bench.run(1_000)
    assert codes(bench.batches).count("sync_lost") == 1


def test_a_producer_that_rebooted_is_told_and_rows_go_on(bench):
    bench.start()
    bench.run(1_001)
    bench.number = 0
    bench.run(3_000)
    bench.stop()
    assert codes(bench.batches).count("sync_restarted") == 1
    sync, joint = whole(bench.batches, "can_sync"), whole(bench.batches, "joint_1")
    assert np.all(np.diff(sync["tick"].astype(int)) > 0)
    np.testing.assert_array_equal(sync["tick"] % 240, sync["sync_counter"] - 1)
    assert not len(of(bench.batches, "gap"))
    np.testing.assert_array_equal((joint["value_raw"] - joint["tick"].astype(int)) % 240, 0)


def test_a_host_that_slept_reads_late_and_loses_nothing(clock):
    """A tty gives frames the stamp of their reading: two seconds of them at once, in two portions."""
    bench = Bench(clock, make, Encoder(), LoadCell(), ArmController())
    bench.start()
    bench.run(500)
    waiting, bench.device.pump = [], lambda now, timeout_s=0.0: []
    bench.run(2_000)
    del bench.device.pump
    waiting = [frame._replace(host_ns=bench.clock()) for frame in bench.port.inbox]
    portions = [waiting[:300], waiting[300:], []]
    receive = bench.port.receive
    bench.port.inbox = []
    bench.port.receive = lambda timeout_s: portions.pop(0) if portions else receive(timeout_s)
    bench.batches += bench.device.pump(bench.clock())
    bench.run(500)
    bench.stop()
    assert not len(of(bench.batches, "gap"))
    assert "sync_restarted" not in codes(bench.batches)
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])


def test_a_tpdo_of_another_length_is_a_gap_with_a_reason(bench):
    bench.start()
    original = bench.nodes[1].value
    bench.nodes[1].value = lambda index, number, now_ns: original(index, number, now_ns)[: 2 if number % 50 == 7 else 4]
    bench.run(1_000)
    bench.nodes[1].value = original
    bench.run(20)
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])
    assert "check the mapping 1A01h" in texts(bench.batches, "bad_pdo")[0]
    assert len(of(bench.batches, "gap")) == 4


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


@pytest.mark.parametrize("place", range(11))
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


# The bus itself


def test_error_frames_are_events_that_do_not_flood(bench):
    bench.start()
    for _ in range(500):
        bench.port.put(bench.clock(), 0x008, bytes(8), is_error=True)
    bench.port.put(bench.clock(), 0x040, bytes(8), is_error=True)
    bench.run(20)
    bench.stop()
    assert codes(bench.batches).count("can_error_008") == 2
    assert "499 more" in texts(bench.batches, "can_error_008")[1]
    (off,) = [row for row in of(bench.batches, "event") if row["code"] == b"can_error_040"]
    assert off["severity"] == 2
    assert b"bus off" in off["text"]


def test_a_bus_that_goes_down_is_told_once_and_comes_back(bench):
    bench.start()
    assert bench.device.period_ns == 0
    bench.port.down = True
    bench.port.inbox.clear()
    bench.run(1_000)
    assert bench.device.period_ns > 0, "a port that fails does not wait: the runner must"
    bench.port.down = False
    bench.port.inbox.clear()
    bench.run(1_000)
    bench.stop()
    assert codes(bench.batches).count("bus_error") == 1
    assert codes(bench.batches).count("bus_recovered") == 1
    assert bench.device.period_ns == 0
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])


def test_a_bus_that_is_down_from_the_start_is_waited_for(bench):
    bench.port.down = True
    bench.start()
    bench.run(5_000)
    bench.port.down = False
    bench.run(10_000)
    assert codes(bench.batches).count("bus_error") == 1
    assert len(whole(bench.batches, "joint_1")) > 100


def test_frames_that_the_port_lost_are_told_with_their_number(bench):
    bench.port.lost_frames = 0
    bench.start()
    bench.port.lost_frames = 41
    bench.run(20)
    bench.port.lost_frames = 42
    bench.run(1_000)
    bench.stop()
    told = texts(bench.batches, "frames_lost")
    assert "lost 41 frames: raise net.core.rmem_max" in told[0]
    assert len(told) == 2


def test_frames_of_others_are_counted(bench):
    bench.start()
    bench.put([(0x100, bytes(6)), (0x7E5, bytes(8)), (0x281 + 5, bytes(4))])
    bench.run(20)
    bench.stop()
    assert bench.device.unclaimed == 3
    assert "3 unclaimed frames" in texts(bench.batches, "stopped")[0]


def test_any_frames_at_all_raise_nothing(bench, rng):
    bench.start()
    identifiers = [0x000, 0x080, 0x081, 0x182, 0x281, 0x183, 0x581, 0x582, 0x601, 0x701, 0x703, 0x7FF]
    for _ in range(3_000):
        data = rng.bytes(int(rng.integers(0, 9)))
        bench.port.put(bench.clock(), int(rng.choice(identifiers)), data, is_error=bool(rng.random() < 0.02))
        if rng.random() < 0.1:
            bench.run(int(rng.integers(1, 30)))
    bench.run(20_000)
    made = bench.run(1_000)
    bench.stop()
    for name in ("joint_1", "load_cell", "arm_phase", "can_sync"):
        whole(bench.batches, name)
    assert len(of(made, "joint_1")) == 200, "and it flies on"


def test_a_stop_before_anything_came_is_a_stop(clock):
    device = make(Bench(clock, make).port)
    assert codes(device.stop(0)) == ["stopped"]
    device.start(0)
    assert codes(device.stop(1)) == ["stopped"]


def test_services_of_a_bus_that_is_stopped_are_left(bench):
    bench.start()
    bench.stop()
    bench.put([(0x701, b"\x00"), (0x581, bytes(8))])
    assert codes(bench.device.pump(bench.clock())) == []


# Configurations


@pytest.mark.parametrize(
    "make_wrong",
    [
        lambda: Cia404Config("x", 3, 0.0),
        lambda: Cia404Config("x", 3, float("nan")),
        lambda: Cia406Config("x", 3, 0),
        lambda: CanopenBus(None, [Cia406Config("x", 0, 1)], SyncConfig()),
        lambda: CanopenBus(None, [Cia406Config("x", 128, 1)], SyncConfig()),
        lambda: CanopenBus(None, [Cia406Config("x", 1, 1), Cia406Config("x", 2, 1)], SyncConfig()),
        lambda: CanopenBus(None, [Cia406Config("can_sync", 1, 1)], SyncConfig()),
    ],
)
def test_configurations_that_cannot_be_are_refused(make_wrong):
    with pytest.raises(ConfigurationError, match=":"):
        make_wrong()


def test_stop_mutes_the_bus_and_takes_what_is_left():
    port = FakeCan()
    bus = CanopenBus(port, [], SyncConfig("can_sync", 5.0))
    bus.start(0)
    port.put(5_000_000, 0x080, [7])
    late = iter([[8], [9]])

    def mute():
        port.muted = True
        port.put(10_000_000, 0x080, next(late))

    port.mute = mute
    (batch,) = [batch for batch in bus.stop(11_000_000) if batch.channel == "can_sync"]
    assert port.muted
    assert batch.rows["sync_counter"].tolist() == [7, 8]


def test_a_bus_that_cannot_be_muted_still_hands_over_what_it_has():
    port = FakeCan()
    bus = CanopenBus(port, [], SyncConfig("can_sync", 5.0))
    bus.start(0)
    port.put(5_000_000, 0x080, [7])

    def mute():
        port.down = True
        raise OSError(5, "gone")

    port.mute = mute
    batches = bus.stop(6_000_000)
    assert [len(b.rows) for b in batches if b.channel == "can_sync"] == [1]
    assert any(b"bus_error" in b.rows["code"] for b in batches if b.channel == "event")
