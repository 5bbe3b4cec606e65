"""The CANopen bus as a device: start, rows, stop, and the port itself."""

import math

import numpy as np
import pytest

from drivers.canopen_pdo import CanopenBus, Cia404Config, Cia406Config, SyncConfig
from drivers.records import SampleStatus
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.can_peers import ArmController, Bench, Encoder, FakeCan, LoadCell, u16, u32
from tests.drivers.three_nodes import CELL, PHASE, make, sources


@pytest.fixture
def bench(clock):
    return Bench(clock, make, Encoder(), LoadCell(), ArmController())


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


def test_no_node_is_stopped_before_a_sync_that_is_late(bench):
    """A producer on a busy computer: three reads find nothing, and the node would have been stopped on the fourth."""
    bench.start()
    bench.run(200)
    port, receive = bench.port, bench.port.receive
    late = iter([False, False, False, True])
    sent_at_sync = []

    def receive_late(timeout_s):
        if timeout_s > 0.0 and next(late, False):
            sent_at_sync.append(len(port.sent))
            port.put(bench.clock(), 0x080, [bench.number % 240 + 1])
        return receive(timeout_s)

    port.receive = receive_late
    before = len(port.sent)
    bench.device.stop(bench.clock())
    assert sent_at_sync == [before]
    assert len(port.sent) > before


def test_no_node_is_stopped_between_a_sync_and_its_answer(bench):
    """Nodes on a busy computer answer a read later than that which brings the SYNC, unless they are stopped by then."""
    bench.start()
    bench.run(200)
    port, receive, awaited = bench.port, bench.port.receive, []

    def receive_late(timeout_s):
        if port.muted or timeout_s == 0.0:
            return receive(timeout_s)
        bench.clock.advance(2_500_000)
        stopped = any(identifier == 0 for identifier, _ in port.sent[before:])
        if awaited and not stopped:
            bench.put(frame for node in bench.nodes.values() for frame in node.on_sync(awaited.pop(), bench.clock()))
        elif not awaited:
            awaited.extend([bench.number] * len(bench.nodes))
            port.put(bench.clock(), 0x080, [bench.number % 240 + 1])
            bench.number += not stopped
        return receive(timeout_s)

    port.receive, before = receive_late, len(port.sent)
    batches = [*bench.batches, *bench.device.stop(bench.clock())]
    assert not len(of(batches, "gap"))
    assert whole(batches, "joint_1")["tick"][-1] == bench.number - 1


@pytest.mark.parametrize("together", ["a SYNC and its answers", "answers and the next SYNC"])
def test_what_nodes_answer_until_they_have_read_the_stop_is_taken(bench, together):
    """Nodes on a busy computer: the SYNC before the stop and two after it are answered late, one by one."""
    bench.start()
    bench.run(200)
    port, receive, before = bench.port, bench.port.receive, len(bench.port.sent)
    late, on_the_way = iter(range(3)), []

    def receive_late(timeout_s):
        port.inbox += on_the_way
        on_the_way.clear()
        if timeout_s > 0.0 and not port.muted:
            bench.clock.advance(5_000_000)
            held = len(port.inbox)
            if len(port.sent) == before or next(late, None) is not None:
                bench.sync_round(bench.clock())
            else:
                port.put(bench.clock(), 0x080, [bench.number % 240 + 1])
                bench.number += 1
            if together.startswith("answers"):
                on_the_way.extend(port.inbox[held + 1 :])
                del port.inbox[held + 1 :]
        return receive(timeout_s)

    port.receive = receive_late
    batches = [*bench.batches, *bench.device.stop(bench.clock())]
    assert next(late, None) is None
    assert len(whole(batches, "joint_1")) == bench.nodes[1].answers
    assert not len(of(batches, "gap"))


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
