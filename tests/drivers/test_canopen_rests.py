"""A CAN bus that rests need not be pumped: it says and sends the same, but reads an event back later by a rest."""

import numpy as np
import pytest

from drivers.canopen_pdo import CanopenBus, CanopenObjectConfig, GuardConfig, SyncConfig
from drivers.canopen_pdo.bus import LONGEST_REST_NS
from drivers.records import SCALAR
from tests.drivers.can_peers import MS, ArmController, Bench, Encoder, LoadCell, u8, u16
from tests.drivers.three_nodes import CELL, JOINT, PHASE

COUNTED = CanopenObjectConfig(
    "arm_phase", 3, tpdo=1, byte_offset=0, format="u8", index=0x2000, subindex=1, counter_subindex=2
)
READ_MS = 50  # between two times that rows are asked for


class Seldom:
    """Pumps a bus only where it does not rest, or rows are asked for."""

    def __init__(self, bus: CanopenBus, *, rests: bool) -> None:
        self.bus, self.rests, self.until_ns, self.pumps = bus, rests, 0, 0

    def start(self, now_ns):
        return self.bus.start(now_ns)

    def stop(self, now_ns):
        return self.bus.stop(now_ns)

    def pump(self, now_ns):
        if self.rests and now_ns < self.until_ns and now_ns // MS % READ_MS > 10:
            return []
        self.pumps += 1
        batches = self.bus.pump(now_ns)
        self.until_ns = self.bus.rests_until(now_ns)
        return batches


def flown(clock_of, phase, *, rests):
    """A flight of 6 s whose phase changes thrice; the bench, and what was sent when."""
    clock, sent = clock_of(), []

    def make(port):
        send = port.send
        port.send = lambda identifier, data: (sent.append((clock(), identifier, bytes(data))), send(identifier, data))
        return Seldom(CanopenBus(port, [JOINT, CELL, phase], SyncConfig(), "can_0"), rests=rests)

    bench = Bench(clock, make, Encoder(), LoadCell(), ArmController())
    bench.start()
    for number, wait_ms in ((1, 1003), (2, 1511), (3, 2509)):
        bench.put([bench.nodes[3].change(number)])
        bench.run(wait_ms)
    bench.stop()
    return bench, sent


def whole_bytes(bench, channel):
    """All rows of a channel, padding included."""
    return b"".join(batch.rows.tobytes() for batch in bench.batches if batch.channel == channel)


@pytest.mark.parametrize("phase", [PHASE, COUNTED], ids=["without counter", "with counter"])
def test_a_bus_that_is_pumped_where_it_does_not_rest_says_and_sends_the_same(clock, phase):
    always, sent_always = flown(type(clock), phase, rests=False)
    seldom, sent_seldom = flown(type(clock), phase, rests=True)
    assert seldom.device.pumps < 0.8 * always.device.pumps
    assert [frame for _, *frame in sent_seldom] == [frame for _, *frame in sent_always]
    assert len(sent_always) > 40
    late = [(one[0] - other[0], one[1]) for one, other in zip(sent_seldom, sent_always, strict=True) if one != other]
    assert all(0 < late_ns <= LONGEST_REST_NS and to == 0x600 + phase.node for late_ns, to in late)
    for channel in ("can_sync", "joint_1", "load_cell", "event"):
        rows = whole_bytes(always, channel)
        assert rows
        assert whole_bytes(seldom, channel) == rows
    fields = [name for name in SCALAR.names if name not in ("host_ns", "tick")]
    first, second = (np.frombuffer(whole_bytes(of, "arm_phase"), SCALAR) for of in (always, seldom))
    assert len(first) >= 7
    assert np.array_equal(first[fields], second[fields])
    for number in (1, 2, 3):
        assert first[first["value_raw"] == number][0] == second[second["value_raw"] == number][0], "heard when it came"


def test_a_bus_does_not_rest_before_its_nodes_run_nor_without_sync(clock):
    bench = Bench(clock, lambda port: CanopenBus(port, [JOINT, CELL, PHASE], SyncConfig(), "can_0"), Encoder())
    bench.start()
    assert bench.device.rests_until(clock()) == clock(), "two nodes are away"
    bench = Bench(clock, lambda port: CanopenBus(port, [JOINT], SyncConfig(), "can_0"), Encoder())
    bench.start()
    assert clock() < bench.device.rests_until(clock()) <= clock() + LONGEST_REST_NS
    bench.sync_on = False
    bench.run(30)
    assert bench.device.rests_until(clock()) == clock(), "it must settle what it holds"


def test_a_guarded_bus_rests_until_its_next_question(clock):
    no_heartbeat = {(0x1017, 0): None, (0x100C, 0): u16(0), (0x100D, 0): u8(0)}
    guards = [GuardConfig(1, guard_time_ms=15)]
    bench = Bench(
        clock,
        lambda port: CanopenBus(port, [JOINT], SyncConfig(), "can_0", guards),
        Encoder(objects=no_heartbeat),
    )
    bench.start()
    rests_ms = []
    for _ in range(40):
        bench.run(10)
        rests_ms.append((bench.device.rests_until(clock()) - clock()) / MS)
    assert bench.nodes[1].guarded > 20
    assert max(rests_ms) <= 15.0


def test_frames_of_some_time_are_read_at_once_but_while_a_node_is_asked(clock):
    bench = Bench(clock, lambda port: CanopenBus(port, [JOINT], SyncConfig(), "can_0"), Encoder())
    bench.device.start(clock())
    assert bench.device.coalesces_ns == 0, "its set-up"
    bench.start()
    assert bench.device.coalesces_ns == 50 * MS
