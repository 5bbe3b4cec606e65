"""Node guarding: questions, toggle bit, losses on the way, nodes that die, and nodes that only seem to live."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from drivers.canopen_pdo import CanopenBus, Cia406Config, GuardConfig, SyncConfig
from drivers.canopen_pdo.guarding import Guard
from drivers.errors import ConfigurationError
from tests.drivers.batches import codes, texts, whole
from tests.drivers.can_peers import MS, Bench, Encoder, FakeCan, u8, u16

JOINT = Cia406Config("joint_1", 1, 500_000)
NO_HEARTBEAT = {(0x1017, 0): None, (0x100C, 0): u16(0), (0x100D, 0): u8(0)}


GUARDS = (GuardConfig(1, 100, 3),)


def make(guards=GUARDS):
    return lambda port: CanopenBus(port, [JOINT], SyncConfig(), guards=guards)


@pytest.fixture
def bench(clock):
    return Bench(clock, make(), Encoder(objects=NO_HEARTBEAT))


def test_a_node_without_heartbeat_is_asked_every_guard_time(bench):
    bench.start()
    before = bench.nodes[1].guarded
    bench.run(5_000)
    bench.stop()
    assert bench.nodes[1].guarded - before == pytest.approx(50, abs=1)
    assert bench.nodes[1].objects[0x100C, 0] == u16(100)
    assert bench.nodes[1].objects[0x100D, 0] == u8(3)
    assert set(codes(bench.batches)) == {"started", "stopped"}
    assert len(whole(bench.batches, "joint_1")) > 1_000


def test_a_node_with_heartbeat_is_not_asked(clock):
    bench = Bench(clock, make(), Encoder())
    bench.start()
    bench.run(3_000)
    assert bench.nodes[1].guarded == 0
    assert bench.nodes[1].objects[0x1017, 0] == u16(500)
    assert set(codes(bench.batches)) == {"started"}


def test_a_node_without_either_says_what_to_configure(clock):
    bench = Bench(clock, make(guards=()), Encoder(objects=NO_HEARTBEAT))
    bench.start()
    assert "configure node guarding" in texts(bench.batches, "configuration")[0]


def test_a_node_that_does_not_watch_us_is_guarded_all_the_same(clock):
    bench = Bench(clock, make(), Encoder(objects={(0x1017, 0): None}))
    bench.start()
    bench.run(1_000)
    assert bench.nodes[1].guarded > 8
    assert set(codes(bench.batches)) == {"started"}


def test_a_node_that_dies_is_lost_after_its_life_time_and_set_up_when_it_is_back(bench):
    bench.start()
    bench.run(1_000)
    bench.nodes[1].deaf = True
    made = bench.run(280)
    assert "guarding_lost" not in codes(made)
    made += bench.run(200)
    assert "guarding_lost" in codes(made)
    assert "no sign of life when guarded" in texts(made, "guarding_lost")[0]
    bench.run(2_000)
    bench.nodes[1].deaf = False
    bench.put(bench.nodes[1].boot(bench.clock()))
    bench.run(1_000)
    bench.stop()
    assert codes(bench.batches).count("guarding_lost") == 1
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["tick"], joint["value_raw"])


def test_a_toggle_bit_that_stands_is_no_sign_of_life(bench):
    """A controller that answers remote frames out of a buffer, and a program behind it that is dead."""
    bench.start()
    bench.run(1_000)
    node = bench.nodes[1]
    node.guard = lambda: bytes([node.toggle | node.state])
    bench.run(1_000)
    assert "guard_toggle" in codes(bench.batches)
    assert "guarding_lost" in codes(bench.batches)


@pytest.mark.parametrize("what", ["question", 0x701])
def test_a_question_or_an_answer_lost_now_and_then_is_nothing(bench, rng, what):
    bench.start()
    bench.drop = lambda number, identifier: identifier == what and rng.random() < 0.2
    bench.run(2_000)
    lost = iter([True, False, True, False, False])
    bench.drop = lambda number, identifier: identifier == what and next(lost, False)
    bench.run(20_000)
    assert "guarding_lost" not in codes(bench.batches)
    assert "guard_toggle" not in codes(bench.batches)


def test_a_host_that_did_not_ask_accuses_nobody(bench, clock):
    bench.start()
    bench.run(500)
    clock.advance(5_000 * MS)
    bench.run(1_000)
    assert "guarding_lost" not in codes(bench.batches)


def test_a_node_that_reboots_begins_its_bit_anew_and_so_do_we(bench):
    bench.start()
    bench.run(1_040)
    bench.put(bench.nodes[1].boot(bench.clock()))
    bench.run(2_000)
    assert codes(bench.batches).count("node_rebooted") == 1
    assert not {"guard_toggle", "guarding_lost"} & set(codes(bench.batches))


def test_a_node_somebody_stopped_is_found_by_its_state(bench):
    bench.start()
    bench.run(2_000)
    bench.nodes[1].nmt(0x80)
    bench.run(1_000)
    assert "pre_operational" in texts(bench.batches, "not_operational")[0]
    assert bench.nodes[1].state == 0x05


def test_a_bus_that_is_down_when_asked_is_told(bench):
    bench.start()
    bench.port.down = True
    bench.run(50)
    bench.port.inbox.clear()
    bench.run(200)
    assert "bus_error" in codes(bench.batches)


@given(st.lists(st.sampled_from(["asked", "answered", "lost question", "lost answer"]), max_size=60))
def test_a_node_that_toggles_is_never_accused_while_two_of_three_come_through(history):
    """``Guard`` by itself against a node that keeps to the rule, whatever is lost on the way."""
    asked = []
    guard = Guard(GuardConfig(1, 100, 3), lambda: asked.append(1))
    guard.begin(0)
    now_ns, toggle, in_a_row = 0, 0x80, 0
    for event in history:
        asked.clear()
        alive = guard.poll(now_ns)
        assert alive == (in_a_row < 3)
        if not alive:
            return
        assert len(asked) == 1
        now_ns += 100 * MS
        in_a_row += 1
        if event == "lost question":
            continue
        answer = bytes([toggle | 0x05])
        toggle ^= 0x80
        if event != "lost answer":
            assert guard.answered(answer)
            in_a_row = 0


@pytest.mark.parametrize("wrong", [{"guard_time_ms": 0}, {"guard_time_ms": 65_536}, {"life_time_factor": 1}])
def test_configurations_that_cannot_be_are_refused(wrong):
    with pytest.raises(ConfigurationError, match="node 1: "):
        GuardConfig(1, **wrong)


def test_a_guard_without_a_node_and_a_port_without_remote_frames_are_refused():
    with pytest.raises(ConfigurationError, match="guards node 9 and has no channel"):
        make(guards=(GuardConfig(9),))(FakeCan())

    class Deaf:
        send = receive = mute = close = None

    with pytest.raises(ConfigurationError, match="sends no remote frames"):
        make()(Deaf())
