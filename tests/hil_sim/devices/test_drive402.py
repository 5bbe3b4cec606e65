"""The drive twin against IEC 61800-7-201 (CiA 402), bits and transitions typed here; and python ``canopen``'s own 402.

A state is its bits 6, 5, 3, 2, 1, 0 of the statusword; a command is a controlword.
"""

import contextlib
import math
import struct
import time

import canopen
import hypothesis.strategies as st
import pytest
from canopen.objectdictionary import ObjectDictionary, ODRecord, ODVariable, datatypes
from canopen.profiles.p402 import BaseNode402
from hypothesis import given

from hil_sim.buses.can.virtual import VirtualCan
from hil_sim.buses.media import CanBus
from hil_sim.devices.canopen.drive402 import Drive402
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import START_NS, Analog, CanRig

NODE = 5
COUNTS = 500_000
SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED = 0x40, 0x21, 0x23, 0x27
QUICK_STOP, FAULT_REACTION, FAULT = 0x07, 0x0F, 0x08
SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK, RESET = 0x06, 0x07, 0x0F, 0x00, 0x02, 0x80


def mask(word):
    """The state in a statusword: of the states without bit 5, bit 5 does not matter."""
    return word & 0x4F if word & 0x4F in (0x40, 0x0F, 0x08) else word & 0x6F


class Bench:
    """A drive, booted; ``word`` writes a controlword over SDO and gives the state that follows."""

    def __init__(self, angle=lambda t: 0.0, torque=lambda t: 0.0, commands=(), **options):
        self.drive = Drive402(NODE, Analog(angle), Analog(torque), START_NS, commands=commands, **options)
        self.rig = CanRig(self.drive)
        self.rig.run(100)

    def read(self, index, form="<I", sub=0):
        answer = self.rig.ask(NODE, f"40 {index & 0xFF:02x} {index >> 8:02x} {sub:02x} 00 00 00 00")
        size = struct.calcsize(form)
        assert bytes.fromhex(answer)[0] == {1: 0x4F, 2: 0x4B, 4: 0x43}[size]
        return struct.unpack(form, bytes.fromhex(answer)[4 : 4 + size])[0]

    def word(self, *words):
        for word in words:
            assert self.rig.ask(NODE, f"2b 40 60 00 {word & 0xFF:02x} {word >> 8:02x} 00 00").startswith("60")
        return self.state()

    def state(self):
        return mask(self.read(0x6041, "<H"))

    def start(self):
        self.rig.send(0x000, 1, NODE)
        return self.rig.run(2)

    def sync(self, ms=5.0):
        self.rig.send(0x080)
        return {frame.identifier: frame.data for frame in self.rig.run(ms)}


def faults(*faults):
    return FaultPlan(faults, START_NS).of("drive")


TO = {
    SWITCH_ON_DISABLED: (),
    READY: (SHUTDOWN,),
    SWITCHED_ON: (SHUTDOWN, SWITCH_ON),
    ENABLED: (SHUTDOWN, SWITCH_ON, ENABLE),
}


def test_it_comes_up_with_switch_on_disabled():
    bench = Bench()
    assert bench.read(0x1000) == 0x0002_0192
    assert bench.read(0x6041, "<H") == 0x0240  # remote
    assert bench.read(0x603F, "<H") == 0


@pytest.mark.parametrize(
    ("state", "command", "then"),
    [
        (SWITCH_ON_DISABLED, SHUTDOWN, READY),  # 2
        (READY, SWITCH_ON, SWITCHED_ON),  # 3
        (SWITCHED_ON, ENABLE, ENABLED),  # 4
        (ENABLED, SWITCH_ON, SWITCHED_ON),  # 5
        (SWITCHED_ON, SHUTDOWN, READY),  # 6
        (READY, DISABLE_VOLTAGE, SWITCH_ON_DISABLED),  # 7
        (READY, QUICK, SWITCH_ON_DISABLED),  # 7
        (ENABLED, SHUTDOWN, READY),  # 8
        (ENABLED, DISABLE_VOLTAGE, SWITCH_ON_DISABLED),  # 9
        (SWITCHED_ON, DISABLE_VOLTAGE, SWITCH_ON_DISABLED),  # 10
        (SWITCHED_ON, QUICK, SWITCH_ON_DISABLED),  # 10
        (ENABLED, QUICK, QUICK_STOP),  # 11
        (READY, ENABLE, ENABLED),  # 3 and 4 in one
        (SWITCH_ON_DISABLED, SWITCH_ON, SWITCH_ON_DISABLED),
        (SWITCH_ON_DISABLED, ENABLE, SWITCH_ON_DISABLED),
        (SWITCH_ON_DISABLED, RESET, SWITCH_ON_DISABLED),
        (READY, SHUTDOWN, READY),
        (ENABLED, ENABLE, ENABLED),
    ],
)
def test_transitions(state, command, then):
    bench = Bench()
    assert (bench.word(*TO[state]) if TO[state] else bench.state()) == state
    assert bench.word(command) == then == bench.drive.drive_state


def test_a_quick_stop_ends_in_switch_on_disabled_by_itself_or_goes_back():
    bench = Bench()
    bench.word(*TO[ENABLED])
    assert bench.word(QUICK) == QUICK_STOP
    bench.rig.run(60)
    assert bench.state() == SWITCH_ON_DISABLED  # 12
    bench.word(*TO[ENABLED])
    bench.word(QUICK)
    assert bench.word(ENABLE) == ENABLED  # 16
    bench.rig.run(60)
    assert bench.state() == ENABLED


def test_a_fault_reacts_reports_and_waits_for_the_rising_edge_of_reset():
    bench = Bench(trips=((0.3, 0x2310),))
    bench.word(*TO[ENABLED])
    bench.word(ENABLE | RESET)  # bit 7 is set beforehand: no edge later
    frames = bench.rig.run(300)
    emergencies = [frame for frame in frames if frame.identifier == 0x080 + NODE]
    assert [frame.data.hex(" ") for frame in emergencies] == ["10 23 03 00 00 00 00 00"]
    assert bench.state() == FAULT
    assert bench.read(0x603F, "<H") == 0x2310
    assert bench.read(0x1001, "<B") == 0x03
    assert bench.word(ENABLE | RESET) == FAULT
    assert bench.word(SHUTDOWN) == FAULT
    assert bench.word(RESET) == SWITCH_ON_DISABLED  # 15
    assert bench.read(0x603F, "<H") == 0
    assert bench.word(*TO[ENABLED]) == ENABLED


def test_the_fault_reaction_takes_20_ms_and_obeys_nothing():
    bench = Bench()
    bench.word(*TO[ENABLED])
    bench.drive.trip(0x7305, bench.rig.now_ns)
    assert bench.word(RESET) == FAULT_REACTION
    assert bench.read(0x1001, "<B") == 0x01
    bench.rig.run(20)
    assert bench.state() == FAULT


def test_the_motion_controllers_commands_and_the_statusword_on_every_change():
    bench = Bench(commands=((0.3, SHUTDOWN), (0.35, SWITCH_ON), (0.4, ENABLE)))
    first = bench.start()
    assert [(frame.identifier, frame.data.hex()) for frame in first] == [(0x180 + NODE, "4002")]
    changes = [frame for frame in bench.rig.run(400) if frame.identifier == 0x180 + NODE]
    assert [frame.data.hex() for frame in changes] == ["2102", "3302", "3706"]
    assert [(frame.end_ns - START_NS) * 1e-9 for frame in changes] == pytest.approx([0.3, 0.35, 0.4], abs=1e-3)


def test_enabling_from_ready_passes_through_switched_on():
    bench = Bench(commands=((0.3, SHUTDOWN), (0.35, ENABLE)))
    bench.start()
    changes = [frame.data.hex() for frame in bench.rig.run(400) if frame.identifier == 0x180 + NODE]
    assert changes == ["2102", "3302", "3706"]


@pytest.mark.parametrize(
    ("code", "register"),
    [(0x1000, 0x01), (0x2310, 0x03), (0x3210, 0x05), (0x4310, 0x09), (0x7305, 0x01), (0x8130, 0x11)],
)
def test_the_error_register_tells_the_class(code, register):
    bench = Bench(trips=((0.15, code),))
    bench.rig.run(100)
    assert bench.read(0x1001, "<B") == register


def test_a_controlword_in_rpdo1_counts_in_operational_only():
    bench = Bench()
    bench.rig.send(0x200 + NODE, SHUTDOWN, 0)
    bench.rig.run(2)
    assert bench.state() == SWITCH_ON_DISABLED
    bench.start()
    bench.rig.send(0x200 + NODE, SHUTDOWN, 0)
    bench.rig.run(2)
    assert bench.state() == READY
    bench.rig.send(0x200 + NODE, SWITCH_ON)  # too short
    bench.rig.run(2)
    assert bench.state() == READY


def test_position_velocity_and_torque_on_sync():
    bench = Bench(lambda t: 0.5 * math.sin(2 * t), lambda t: -2.5, commands=((0.01, 0x06), (0.02, 0x0F)))
    bench.start()
    bench.rig.run(300)
    sent_s = (bench.rig.now_ns - START_NS) * 1e-9 + 100e-6
    frames = bench.sync()
    position, velocity = struct.unpack("<ii", frames[0x280 + NODE])
    torque, status = struct.unpack("<hH", frames[0x380 + NODE])
    per_rad = COUNTS / math.tau
    assert position == pytest.approx(per_rad * 0.5 * math.sin(2 * sent_s), abs=20)
    assert velocity == pytest.approx(per_rad * math.cos(2 * (sent_s - 0.002)), abs=400)  # half the window late
    assert torque == -250  # 25.0 % of 10 N m
    assert mask(status) == ENABLED
    assert bench.drive.produced == 1
    assert bench.read(0x6076) == 10_000
    assert (bench.read(0x608F, "<B"), bench.read(0x608F, sub=1), bench.read(0x608F, sub=2)) == (2, COUNTS, 1)


def test_no_torque_unless_enabled():
    bench = Bench(torque=lambda t: 4.0)
    assert bench.read(0x6077, "<h") == 0
    bench.word(*TO[ENABLED])
    assert bench.read(0x6077, "<h") == 400
    bench.word(SWITCH_ON)
    assert bench.read(0x6077, "<h") == 0


def test_the_position_wraps_at_signed_32_bits():
    bench = Bench(lambda t: math.tau / COUNTS * (3 if t > 0.05 else 0), zero_increments=2**31 - 2)
    assert bench.read(0x6064, "<i") == -(2**31) + 1
    assert bench.read(0x606C, "<i") == 0


def test_velocity_is_not_disturbed_by_the_wrap():
    bench = Bench(lambda t: math.tau / COUNTS * 1e6 * t, zero_increments=2**31 - 150_000)
    bench.rig.run(50)
    assert bench.read(0x606C, "<i") == pytest.approx(1_000_000, abs=300)
    bench.rig.run(50)
    assert bench.read(0x6064, "<i") < 0
    assert bench.read(0x606C, "<i") == pytest.approx(1_000_000, abs=300)


def test_modes_that_it_has():
    bench = Bench()
    assert bench.read(0x6502) == 0x0280
    assert bench.read(0x6061, "<B") == 8
    assert bench.rig.ask(NODE, "2f 60 60 00 0a 00 00 00").startswith("60")
    assert bench.read(0x6061, "<B") == 10
    assert bench.rig.ask(NODE, "2f 60 60 00 01 00 00 00") == "80 60 60 00 30 00 09 06"


def test_stuck_and_saturated():
    broken = faults(Fault("stuck", "drive", 0.2, 0.4), Fault("saturated", "drive", 0.5, 0.6, value=-1.0))
    bench = Bench(lambda t: t, lambda t: 1.0, commands=((0.01, 0x06), (0.02, 0x0F)), faults=broken)
    bench.rig.run(90)
    last = bench.read(0x6064, "<i")
    bench.rig.run(50)
    assert (bench.read(0x6064, "<i"), bench.read(0x606C, "<i")) == (last, 0)
    bench.rig.run(200)
    assert bench.read(0x6064, "<i") > last
    bench.rig.run(60)
    assert bench.read(0x6077, "<h") == -32_767
    assert bench.read(0x6041, "<H") & 0x0800  # internal limit


def test_a_brown_out_disables_it_and_forgets_the_fault():
    bench = Bench(
        trips=((0.2, 0x3210),), commands=((0.01, 0x06), (0.02, 0x0F)), faults=faults(Fault("reset", "drive", 0.5))
    )
    bench.rig.run(300)
    assert bench.state() == FAULT
    frames = bench.rig.run(300)
    assert [frame.data for frame in frames if frame.identifier == 0x700 + NODE] == [b"\0"]
    assert bench.state() == SWITCH_ON_DISABLED
    assert bench.read(0x603F, "<H") == 0


def test_what_happens_while_it_is_off_does_not_reach_it():
    broken = faults(Fault("off", "drive", 0.2, 0.5))
    bench = Bench(commands=((0.1, 0x06), (0.3, 0x07)), trips=((0.35, 0x2310),), faults=broken)
    bench.rig.run(600)
    assert bench.state() == SWITCH_ON_DISABLED


def test_a_fault_that_it_cannot_have_is_refused():
    with pytest.raises(FaultError, match="cannot have the fault nack"):
        Bench(faults=faults(Fault("nack", "drive", 1.0)))


@given(
    st.lists(
        st.one_of(st.sampled_from([SHUTDOWN, SWITCH_ON, ENABLE, QUICK, RESET]), st.integers(0, 0xFFFF)), max_size=12
    )
)
def test_any_controlwords_lead_to_a_state_of_the_standard(words):
    bench = Bench()
    known = {SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT_REACTION, FAULT}
    assert all(bench.word(word) in known for word in words)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_any_frame_is_survived(identifier, data):
    bench = Bench()
    bench.rig.send(identifier, *data)
    bench.rig.run(5)
    bench.rig.send(0x000, 0x81, 0)
    bench.rig.run(20)
    assert bench.state() == SWITCH_ON_DISABLED


# python canopen


def dictionary():
    """What an EDS of such a drive would say, as far as ``BaseNode402`` looks."""
    od = ObjectDictionary()

    def variable(index, sub, kind):
        made = ODVariable(f"object {index:04X}h sub {sub}", index, sub)
        made.data_type = kind
        return made

    u8, u16, u32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
    i8, i16, i32 = datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32
    single = {0x1000: u32, 0x1017: u16, 0x603F: u16, 0x6040: u16, 0x6041: u16, 0x6060: i8, 0x6061: i8}
    single |= {0x6064: i32, 0x606C: i32, 0x6077: i16, 0x6502: u32}
    for index, kind in single.items():
        od.add_object(variable(index, 0, kind))
    for communication in (0x1400, 0x1800, 0x1801, 0x1802):
        parameter, mapping = {0: u8, 1: u32, 2: u8, 5: u16}, {0: u8, **dict.fromkeys(range(1, 9), u32)}
        for index, subs in ((communication, parameter), (communication + 0x200, mapping)):
            record = ODRecord(f"record {index:04X}h", index)
            for sub, kind in subs.items():
                record.add_member(variable(index, sub, kind))
            od.add_object(record)
    return od


@contextlib.contextmanager
def network(drive, channel, node):
    """A drive on a virtual bus in real time, with a SYNC producer, and a canopen network with its node, booted.

    The library's times to wait for a state are those of an idle computer.
    """
    node.TIMEOUT_SWITCH_OP_MODE = node.TIMEOUT_SWITCH_STATE_FINAL = node.TIMEOUT_SWITCH_STATE_SINGLE = 10.0
    link = VirtualCan(channel)
    bus = CanBus(link)
    bus.add(drive)
    net = canopen.Network()
    net.connect(channel, interface="virtual")
    net.add_node(node)
    with contextlib.closing(link), RealTime(bus):
        until_s = time.monotonic() + 10.0
        while node.nmt.state != "PRE-OPERATIONAL" and time.monotonic() < until_s:
            time.sleep(0.01)
        try:
            yield net
        finally:
            net.sync.stop()
            net.disconnect()


@pytest.mark.realtime
def test_canopen_p402_enables_it_reads_it_and_resets_its_fault():
    start_ns = time.monotonic_ns()
    drive = Drive402(NODE, Analog(lambda t: 0.25), Analog(lambda t: -2.5), start_ns, commands=())
    node = BaseNode402(NODE, dictionary())
    with network(drive, "hil_402", node) as net:
        assert node.sdo[0x1000].raw == 0x0002_0192
        node.sdo[0x1800][5].raw = 10  # canopen takes a PDO that came twice for periodic, and waits for the next
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        net.sync.start(0.01)
        assert node.tpdo[1].wait_for_reception(2.0)
        assert node.state == "SWITCH ON DISABLED"
        node.state = "OPERATION ENABLED"
        assert node.state == "OPERATION ENABLED"
        assert (node.sdo[0x6064].raw, node.sdo[0x6077].raw) == (round(0.25 / math.tau * COUNTS), -250)
        assert node.op_mode == "CYCLIC SYNCHRONOUS POSITION"
        assert node.tpdo[2].wait_for_reception(2.0)
        assert node.tpdo[2][0x6064].raw == round(0.25 / math.tau * COUNTS)
        drive.trip(0x2310, time.monotonic_ns())
        assert node.emcy.wait(0x2310, 2.0).code == 0x2310
        assert node.tpdo[3].wait_for_reception(2.0)
        assert node.tpdo[3][0x6077].raw == 0
        until_s = time.monotonic() + 5.0
        while node.state != "FAULT" and time.monotonic() < until_s:
            time.sleep(0.01)
        assert node.state == "FAULT"
        node.reset_from_fault()
        assert node.state == "OPERATION ENABLED"
