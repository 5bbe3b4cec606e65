"""The CANopen bus when SYNCs and TPDOs are lost, or read late."""

import numpy as np
import pytest

from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.can_peers import ArmController, Bench, Encoder, LoadCell
from tests.drivers.three_nodes import make


@pytest.fixture
def bench(clock):
    return Bench(clock, make, Encoder(), LoadCell(), ArmController())


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
    """The device waits for a frame, and gathers those of the next 50 ms; ``mean`` is done to the gathered ones."""
    pump = bench.device.pump
    waited = []

    def gather(seconds):
        assert seconds == 0.05
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


def test_frames_of_50_ms_are_taken_at_once_while_no_node_is_asked(bench):
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
