"""Node guarding (CiA 301, 7.2.8.3.2.1) of nodes without heartbeat, on the wire and by a stranger's master."""

import contextlib
import time

import canopen
import hypothesis.strategies as st
import pytest
from hypothesis import given

from hil_sim.buses.can.virtual import VirtualCan
from hil_sim.buses.media import CanBus
from hil_sim.devices.can_bus.frame_length import frame_bits
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import START_NS, Analog, CanRig

NODE, GUARD, EMCY = 2, 0x702, 0x082
PRE_OPERATIONAL, OPERATIONAL = 0x7F, 0x05


def cell(start_ns=START_NS, faults=()):
    node = LoadCell404(NODE, Analog(lambda t: 1.0), start_ns, faults=FaultPlan(faults, start_ns).of("cell"))
    node.guard_for_heartbeat()
    return node


class Guarded(CanRig):
    """A node that has booted, and who asks it."""

    def __init__(self, *faults, node=None):
        super().__init__(node or cell(faults=faults))
        self.run(100)

    def guard(self, identifier=GUARD, ms=1.0):
        """What it answers to one remote frame."""
        self.wire.request(identifier, 1, self.now_ns)
        return [frame.data for frame in self.run(ms) if frame.identifier == GUARD]

    def emergencies(self):
        return [frame.data[:3] for frame in self.frames if frame.identifier == EMCY]


def test_it_answers_with_its_state_and_a_bit_that_toggles():
    rig = Guarded()
    assert [rig.guard() for _ in range(4)] == [[b"\x7f"], [b"\xff"], [b"\x7f"], [b"\xff"]]
    rig.send(0x000, 0x01, NODE)
    rig.run(1)
    assert [rig.guard() for _ in range(2)] == [[b"\x05"], [b"\x85"]]
    assert rig.guard(0x701) == []
    assert rig.emergencies() == []  # no life time was set


def test_the_bit_begins_anew_when_the_node_does():
    rig = Guarded()
    rig.guard()
    rig.send(0x000, 0x81, NODE)  # reset node
    rig.run(2)
    assert rig.guard() == []  # it boots
    rig.run(20)
    assert rig.guard() == [b"\x7f"]


def test_it_has_the_objects_of_guarding_and_none_of_the_heartbeat():
    rig = Guarded()
    assert rig.ask(NODE, "2b 17 10 00 64 00 00 00") == "80 17 10 00 00 00 02 06"  # object does not exist
    assert rig.ask(NODE, "2b 0c 10 00 64 00 00 00") == "60 0c 10 00 00 00 00 00"
    assert rig.ask(NODE, "2f 0d 10 00 03 00 00 00") == "60 0d 10 00 00 00 00 00"
    assert rig.ask(NODE, "40 0c 10 00 00 00 00 00") == "4b 0c 10 00 64 00 00 00"


def test_a_node_with_heartbeat_is_not_guarded():
    rig = Guarded(node=LoadCell404(NODE, Analog(lambda t: 1.0), START_NS))
    assert rig.guard() == []
    assert rig.ask(NODE, "2b 0c 10 00 64 00 00 00") == "80 0c 10 00 00 00 02 06"


def test_a_node_that_nobody_asks_any_more_says_so_and_leaves_operational():
    rig = Guarded()
    rig.ask(NODE, "2b 0c 10 00 64 00 00 00")  # 100 ms
    rig.ask(NODE, "2f 0d 10 00 03 00 00 00")  # three times
    rig.send(0x000, 0x01, NODE)
    rig.run(400)
    assert rig.emergencies() == []  # life guarding begins with the first question
    assert rig.guard() == [bytes([OPERATIONAL])]
    rig.run(290)
    assert rig.emergencies() == []
    rig.run(20)
    assert rig.emergencies() == [bytes.fromhex("30 81 10")]
    assert rig.guard() == [bytes([0x80 | PRE_OPERATIONAL])]
    assert rig.emergencies()[1:] == [bytes(3)]  # somebody is there again
    rig.run(310)
    assert len(rig.emergencies()) == 3


@pytest.mark.parametrize("kind", ["silent", "off"])
def test_one_that_is_not_there_does_not_answer(kind):
    rig = Guarded(Fault(kind, "cell", 0.2, 0.4))
    assert rig.guard()
    rig.run(200)
    assert rig.guard() == []


@given(st.integers(0, 0x7FF), st.integers(0, 8))
def test_a_remote_frame_has_no_data_and_another_bit(identifier, asked):
    """Bit by bit: start, identifier, RTR, IDE, r0, length; the remainder of the polynomial; stuffing; the tail."""
    bits = [0, *(identifier >> k & 1 for k in range(10, -1, -1)), 1, 0, 0, *(asked >> k & 1 for k in range(3, -1, -1))]
    crc = 0
    for bit in bits:
        crc = (crc << 1 ^ (0x4599 if (crc >> 14 & 1) != bit else 0)) & 0x7FFF
    bits += [crc >> k & 1 for k in range(14, -1, -1)]
    sent, run = [], 0
    for bit in bits:
        run = run + 1 if sent and bit == sent[-1] else 1
        sent.append(bit)
        if run == 5:
            sent.append(1 - bit)
            run = 1
    assert frame_bits(identifier, b"", asked) == len(sent) + 10  # delimiters, acknowledge, end of frame


@pytest.mark.realtime
def test_the_master_of_python_canopen_guards_it():
    link = VirtualCan("guarding")
    bus = CanBus(link)
    bus.add(cell(time.monotonic_ns()))
    with contextlib.closing(link), RealTime(bus), canopen.Network() as net:
        net.connect(interface="virtual", channel="guarding")
        remote = net.add_node(NODE, canopen.ObjectDictionary())
        remote.nmt.wait_for_bootup(3)
        remote.nmt.start_node_guarding(0.02)
        states = {remote.nmt.wait_for_heartbeat(3) for _ in range(3)}
        remote.nmt.state = "OPERATIONAL"
        deadline = time.monotonic() + 3
        while remote.nmt.wait_for_heartbeat(3) != "OPERATIONAL" and time.monotonic() < deadline:
            continue
        assert states == {"PRE-OPERATIONAL"}
        assert remote.nmt.state == "OPERATIONAL"
        remote.nmt.stop_node_guarding()
