"""Our driver flying nodes of the canopen library: its LocalNode, unmodified, with the SYNC that it lacks added here.

A LocalNode keeps an object dictionary, serves SDO, changes its NMT state and beats. It answers no SYNC and gates no
TPDO by its state (canopen-python/canopen 328, 166); ``LibraryNode`` does both, and carries frames without threads.
"""

from collections.abc import Callable

import can
import canopen
import numpy as np
import pytest
from canopen.objectdictionary import ObjectDictionary, ODArray, ODVariable, datatypes

from drivers.canopen_pdo import CanopenBus, Cia402Config, Cia404Config, Cia406Config, SyncConfig
from tests.drivers.batches import codes, of, whole
from tests.drivers.can_peers import Bench, Encoder

U8, U16, U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
I16, I32 = datatypes.INTEGER16, datatypes.INTEGER32
SYNC = 0x080


class Periodic:
    """A cyclic task of python-can, in the time of the test."""

    def __init__(self, message, period_s):
        self.message, self.period_ns, self.due_ns = message, round(period_s * 1e9), None

    def modify_data(self, message):
        self.message = message

    def stop(self):
        self.period_ns = None


class Wire:
    """Stands where canopen expects a python-can bus."""

    def __init__(self):
        self.sent, self.tasks = [], []

    def send(self, message):
        self.sent.append((message.arbitration_id, bytes(message.data)))

    def send_periodic(self, message: can.Message, period: float):
        self.tasks.append(Periodic(message, period))
        return self.tasks[-1]


class LibraryNode:
    """A LocalNode as a node of ``can_peers.Bench``.

    Args:
        number: Node number.
        dictionary: Its objects.
        values: Process values on a SYNC, by its number: (index, subindex): value.
    """

    deaf = False

    def __init__(self, number: int, dictionary: ObjectDictionary, values: Callable[[int], dict]) -> None:
        self.number, self.values = number, values
        self.wire = Wire()
        self.network = canopen.Network(self.wire)
        self.local = canopen.LocalNode(number, dictionary)
        self.network.add_node(self.local)
        self.network.subscribe(SYNC, self._answer)
        self.local.nmt.send_command(0)
        self.local.nmt.state = "PRE-OPERATIONAL"
        self.answers = self.syncs = 0

    def sdo(self, data):
        answers = [said for identifier, said in self._given(0x600 + self.number, data) if identifier > 0x580]
        return answers[-1] if answers else None

    def nmt(self, command):
        self._given(0, bytes([command, self.number]))
        if self.local.nmt.state == "OPERATIONAL":
            self.local.tpdo.read()

    def guard(self):
        return None

    def heartbeat(self, now_ns):
        frames = self._taken()
        for task in self.wire.tasks:
            if task.period_ns and (task.due_ns is None or now_ns >= task.due_ns):
                task.due_ns = now_ns + task.period_ns
                frames.append((task.message.arbitration_id, bytes(task.message.data)))
        return frames

    def on_sync(self, number, now_ns):
        self.syncs = number
        frames = self._given(SYNC, b"")
        self.answers += len(frames)
        return frames

    def _answer(self, identifier, data, timestamp):
        """The missing SYNC: synchronous TPDOs of an operational node, filled from its object dictionary."""
        if self.local.nmt.state != "OPERATIONAL":
            return
        for (index, subindex), value in self.values(self.syncs).items():
            place = self.local.sdo[index]
            (place[subindex] if subindex else place).raw = value
        for pdo in self.local.tpdo.values():
            if pdo.enabled and 1 <= pdo.trans_type <= 240 and self.syncs % pdo.trans_type == 0:
                for variable in pdo.map:
                    place = self.local.sdo[variable.index]
                    variable.raw = (place[variable.subindex] if variable.subindex else place).raw
                pdo.transmit()

    def _given(self, identifier, data):
        self.network.notify(identifier, bytearray(data), 0.0)
        return self._taken()

    def _taken(self):
        taken, self.wire.sent = self.wire.sent, []
        return taken


def dictionary(**objects):
    """Object dictionary from x1000=(type, value) and x1800={subindex: (type, value)}."""
    found = ObjectDictionary()
    for name, content in objects.items():
        index = int(name[1:], 16)
        if isinstance(content, tuple):
            found.add_object(variable(index, 0, *content))
            continue
        array = ODArray(name, index)
        for subindex, (kind, value) in content.items():
            array.add_member(variable(index, subindex, kind, value))
        found.add_object(array)
    return found


def variable(index, subindex, kind, value, access="rw"):
    made = ODVariable(f"{index:X} {subindex}", index, subindex)
    made.data_type, made.default, made.access_type, made.pdo_mappable = kind, value, access, True
    return made


def tpdos(number, *mapped):
    """From the factory: event-driven, each with one object."""
    return {
        f"x{base + pdo:X}": content
        for pdo, entry in enumerate(mapped)
        for base, content in (
            (0x1800, {0: (U8, 2), 1: (U32, 0x180 + 0x100 * pdo + number), 2: (U8, 255)}),
            (0x1A00, {0: (U8, 1), **{k + 1: (U32, entry if k == 0 else 0) for k in range(4)}}),
        )
    }


def encoder(number):
    objects = dictionary(
        x1000=(U32, 0x0002_0196),
        x1017=(U16, 0),
        x6000=(U16, 0),
        x6001=(U32, 500_000),
        x6004=(U32, 0),
        x6200=(U16, 10),
        x6501=(U32, 500_000),
        **tpdos(number, 0x6004_0020, 0x6004_0020),
    )
    return LibraryNode(number, objects, lambda sync: {(0x6004, 0): (4_294_967_000 + sync) % 2**32})


def load_cell(number):
    objects = dictionary(
        x1000=(U32, 0x0002_0194),
        x1017=(U16, 0),
        x6131={0: (U8, 1), 1: (U32, 0xFD21_0000)},  # mN
        x6132={0: (U8, 1), 1: (U8, 2)},
        x6150={0: (U8, 1), 1: (U8, 0)},
        x9130={0: (U8, 1), 1: (I32, 0)},
        **tpdos(number, 0x9130_0120),
    )
    return LibraryNode(number, objects, lambda sync: {(0x9130, 1): -3 * sync, (0x6150, 1): int(sync % 10 == 0)})


def drive(number):
    objects = dictionary(
        x1000=(U32, 0x0002_0192),
        x1017=(U16, 0),
        x6041=(U16, 0),
        x6064=(I32, 0),
        x606C=(I32, 0),
        x6076=(U32, 1_270),
        x6077=(I16, 0),
        **tpdos(number, *(0x6041_0010,) * 4),
    )
    return LibraryNode(
        number, objects, lambda sync: {(0x6064, 0): 7 * sync, (0x606C, 0): -sync, (0x6077, 0): sync % 1000 - 500}
    )


def make(port):
    joint, cell = Cia406Config("joint_1", 1, 500_000, zero_count=4_294_967_000), Cia404Config("load_cell", 2, 50.0)
    motor = Cia402Config(4, 4096, position="shoulder", velocity="shoulder_speed", torque="shoulder_torque")
    return CanopenBus(port, [joint, cell, motor], SyncConfig())


@pytest.fixture
def bench(clock):
    return Bench(clock, make, encoder(1), load_cell(2), drive(4))


def test_nodes_of_the_library_are_set_up_and_every_sync_answered_is_a_row(bench):
    bench.start()
    bench.run(5_000)
    bench.stop()
    assert sorted(codes(bench.batches)) == ["started", "started", "started", "stopped"]
    assert not len(of(bench.batches, "gap"))
    joint, cell, shoulder = (whole(bench.batches, name) for name in ("joint_1", "load_cell", "shoulder"))
    assert len(joint) == bench.nodes[1].answers > 900
    assert len(cell) == bench.nodes[2].answers
    assert len(shoulder) * 2 == bench.nodes[4].answers  # two TPDOs
    np.testing.assert_array_equal(joint["value_raw"] - 4_294_967_000, joint["tick"])  # unwrapped past 2^32
    np.testing.assert_array_equal(cell["value_raw"], -3 * cell["tick"].astype(int))
    np.testing.assert_array_equal(cell["device_status"], cell["tick"] % 10 == 0)
    assert (cell["unit"][0], cell["scale"][0]) == (b"N", 1e-5)
    np.testing.assert_array_equal(shoulder["value_raw"], 7 * shoulder["tick"].astype(int))
    torque = whole(bench.batches, "shoulder_torque")
    np.testing.assert_array_equal(torque["value_raw"], torque["tick"].astype(int) % 1000 - 500)


def test_what_the_library_holds_after_our_set_up_is_what_the_profiles_want(bench):
    bench.start()
    joint, cell = (bench.nodes[number].local for number in (1, 2))
    assert joint.sdo[0x6200].raw == 0
    assert joint.sdo[0x1800][1].raw & 0x8000_0000
    assert (joint.sdo[0x1801][1].raw, joint.sdo[0x1801][2].raw) == (0x281, 1)
    assert [cell.sdo[0x1A00][k].raw for k in range(3)] == [2, 0x9130_0120, 0x6150_0108]
    assert {node.local.nmt.state for node in bench.nodes.values()} == {"OPERATIONAL"}
    assert {node.local.sdo[0x1017].raw for node in bench.nodes.values()} == {500}
    bench.stop()
    assert {node.local.nmt.state for node in bench.nodes.values()} == {"PRE-OPERATIONAL"}


def test_a_node_of_the_library_that_falls_silent_is_reported_and_taken_up_again(bench):
    bench.start()
    bench.run(1_000)
    bench.drop = lambda number, identifier: identifier & 0x7F == 1
    bench.nodes[1].heartbeat = lambda now_ns: []
    made = bench.run(3_000)
    assert "heartbeat_lost" in codes(made)
    del bench.nodes[1].heartbeat
    bench.drop = lambda number, identifier: False
    bench.run(12_000)
    bench.stop()
    joint = whole(bench.batches, "joint_1")
    np.testing.assert_array_equal(joint["value_raw"] - 4_294_967_000, joint["tick"])
    assert joint["tick"][-1] > bench.number - 20


def test_the_library_answers_sdo_requests_as_our_own_peer_does():
    """The node that our other tests fly, typed by us: the same bytes for the same requests."""
    ours, library = Encoder(1), encoder(1)
    for request in (
        "40 00 10 00 00 00 00 00",
        "40 01 60 00 00 00 00 00",
        "2B 00 62 00 00 00 00 00",
        "23 00 18 01 81 01 00 C0",
        "40 45 23 00 00 00 00 00",
    ):
        said = bytes.fromhex(request)
        assert library.sdo(said) == ours.sdo(said), request
