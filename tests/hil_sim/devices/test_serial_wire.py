"""The asynchronous line: pacing, formats that do and do not agree, and what every serial twin has in common."""

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from hil_sim.devices.serial_line.dsc_load_cell import DscLoadCellTwin
from hil_sim.devices.serial_line.modbus_load_cell import ModbusLoadCellTwin
from hil_sim.devices.serial_line.nimu import NimuTwin
from hil_sim.devices.serial_line.node_frame import FrameNode, NodeChannel, ValueType
from hil_sim.devices.serial_line.qsb import QsbTwin
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_wire import LineFormat, SerialWire, hear, waveform
from hil_sim.faults import NO_FAULTS, Fault, FaultError, FaultPlan
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock, StairImu


class Echo(SerialTwin):
    """Sends back what it hears, and a dot every 10 ms."""

    def __init__(self, faults=NO_FAULTS):
        super().__init__(LineFormat(9600), START_NS, faults)
        self.heard = []
        self.boots = []

    def _power_up(self, now_ns):
        self.boots.append(now_ns)
        self._at("dot", now_ns + 10 * MS, self._dot)

    def _dot(self, now_ns):
        self._send(b".", now_ns)
        self._at("dot", now_ns + 10 * MS, self._dot)

    def _on_byte(self, byte, now_ns):
        self.heard.append((now_ns, byte))
        self._send(bytes([byte]), now_ns)


def faults(*faults):
    return FaultPlan(faults, START_NS).of("echo")


@pytest.mark.parametrize(
    ("line", "bits"),
    [
        (LineFormat(9600), 10),
        (LineFormat(9600, "E"), 11),
        (LineFormat(9600, "O", 2), 12),
        (LineFormat(9600, "N", 2), 11),
    ],
)
def test_a_character_has_its_bits(line, bits):
    assert line.bits == bits
    assert line.character_ns == pytest.approx(bits / 9600 * 1e9)


def test_the_waveform_of_a_character():
    # 41h = 0100 0001: start, then the lowest bit first, two ones (even parity 0), stop.
    assert waveform(b"A", LineFormat(1)) == [0, 1, 0, 0, 0, 0, 0, 1, 0, 1]
    assert waveform(b"A", LineFormat(1, "E")) == [0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 1]
    assert waveform(b"A", LineFormat(1, "O", 2)) == [0, 1, 0, 0, 0, 0, 0, 1, 0, 1, 1, 1]
    assert waveform(b"C", LineFormat(1, "E")) == [0, 1, 1, 0, 0, 0, 0, 1, 0, 1, 1]  # three ones: parity 1


def test_characters_end_one_after_the_other():
    heard = hear(b"abc", 1000, LineFormat(115_200), LineFormat(115_200))
    assert heard.data == b"abc"
    assert [end_ns - 1000 for end_ns in heard.ends_ns] == [86_806, 173_611, 260_417]  # 10 bits of 8.68 us


def test_two_percent_apart_is_understood_and_twice_as_fast_is_not():
    data = bytes(range(256))
    assert hear(data, 0, LineFormat(115_200), LineFormat(117_000)).data == data
    wrong = hear(data, 0, LineFormat(115_200), LineFormat(57_600)).data
    assert wrong
    assert wrong != data
    assert len(wrong) <= len(data)


def test_a_receiver_of_half_the_speed_samples_every_other_bit():
    # "U" = 55h at 2 f: 0 1 0 1 0 1 0 1 0 1 then idle. A receiver at f samples the middles of bits 2 wide, from the
    # start edge: at 3, 5, 7, 9 (all ones), then idle (ones).
    assert hear(b"U", 0, LineFormat(9600), LineFormat(4800)).data == b"\xff"
    # 00h at 2 f: nine zeros, then the stop bit: samples at 3, 5, 7 are zeros, at 9 the stop bit.
    assert list(hear(b"\0", 0, LineFormat(9600), LineFormat(4800)).data) == [0b1111_1000]


def test_a_receiver_of_twice_the_speed_finds_two_characters_in_one():
    # "U" = 55h: 0 1 0 1 0 1 0 1 0 1. Sampled at bits 0.75, 1.25 .. 4.25: 0 1 1 0 0 1 1 0, and a zero for a stop bit.
    # The next falling edge is at bit 6: 6.75 .. 9.75: 0 1 1 0 0 1 1, then idle.
    heard = hear(b"U", 0, LineFormat(4800), LineFormat(9600))
    assert list(heard.data) == [0b0110_0110, 0b1110_0110]
    assert heard.ends_ns == [round(bits * 1e9 / 4800) for bits in (5, 11)]


def test_a_pause_in_the_receivers_frame_does_not_lose_the_next_character():
    # 1 % slow against 3 % fast: sampled, as they do not agree, but every bit is met.
    sender, receiver = LineFormat(9900), LineFormat(10_300)
    heard = hear(b"hello, world", 0, sender, receiver)
    assert heard.data == b"hello, world"
    step_ns = 1e10 / 9900
    early_ns = 10 * (1e9 / 9900 - 1e9 / 10_300)  # it does not wait for the end of the sender's stop bit
    assert heard.ends_ns == pytest.approx([(k + 1) * step_ns - early_ns for k in range(12)], abs=2)


def test_parity_that_nobody_expects():
    # 8E1 heard as 8N1: the parity bit stands where the stop bit is expected; the data are the same.
    assert hear(b"AC", 0, LineFormat(9600, "E"), LineFormat(9600)).data == b"AC"


@given(st.binary(max_size=12), st.integers(300, 1_000_000), st.integers(300, 1_000_000), st.sampled_from("NEO"))
def test_any_two_formats_hear_something_in_order(data, sender, receiver, parity):
    heard = hear(data, 0, LineFormat(sender), LineFormat(receiver, parity))
    assert heard.ends_ns == sorted(heard.ends_ns)
    assert len(heard.ends_ns) == len(heard.data)
    if sender == receiver and parity == "N":
        assert heard.data == data


def test_both_ways_are_paced_and_do_not_wait_for_each_other():
    line = Line(Echo())
    line.send(b"abcd")
    assert line.run(2) == b""  # one character heard at 1.04 ms, its echo ends at 2.08 ms
    assert line.run(0.1) == b"a"
    assert line.run(3.2) == b"bcd"
    heard_ms = [(at - START_NS) / MS for at, _ in line.device.heard]
    assert heard_ms == pytest.approx([1.0417, 2.0833, 3.125, 4.1667], abs=1e-3)


def test_a_second_write_waits_for_the_first():
    line = Line(Echo())
    line.send(b"ab")
    line.send(b"c")
    assert line.run(4.2) == b"abc"
    heard_ms = [(at - START_NS) / MS for at, _ in line.device.heard]
    assert heard_ms == pytest.approx([1.0417, 2.0833, 3.125], abs=1e-3)


def test_a_character_is_received_at_the_instant_at_which_it_ends():
    line = Line(Echo())
    line.send(b"a")
    line.wire.advance(START_NS + 1_041_666)
    assert line.device.heard == []
    assert line.wire.advance(START_NS + 1_041_667).data == b""
    assert line.device.heard == [(START_NS + 1_041_667, ord("a"))]
    assert line.wire.advance(START_NS + 2 * 1_041_667 - 1).data == b""
    assert len(line.wire.advance(START_NS + 2 * 1_041_667).data) == 1


def test_a_transmission_in_pieces_of_time_is_the_same():
    whole, pieces = Line(Echo()), Line(Echo())
    whole.send(b"hello")
    pieces.send(b"hello")
    received = whole.run(100)
    assert received == b"hello........."  # the dot of 100 ms is still under way
    assert b"".join(pieces.run(0.25) for _ in range(400)) == received
    assert pieces.device.heard == whole.device.heard


def test_the_line_says_when_something_happens_next():
    line = Line(Echo())
    assert line.wire.due_ns == START_NS
    line.run(0)
    assert line.wire.due_ns == START_NS + 10 * MS
    line.send(b"a")
    assert line.wire.due_ns == START_NS + 1_041_667


def test_a_closed_port_sends_and_receives_nothing():
    echo = Echo()
    wire = SerialWire(echo)
    wire.send(b"a", START_NS)
    assert wire.advance(START_NS + 25 * MS).data == b""
    assert echo.heard == []


def test_a_cut_loses_what_is_under_way():
    line = Line(Echo())
    line.send(b"abcdef")
    line.run(2.2)
    line.wire.cut()
    assert line.run(5) == b""
    assert [byte for _, byte in line.device.heard] == list(b"ab")


def test_off_and_on_again():
    line = Line(Echo(faults=faults(Fault("off", "echo", 0.015, 0.042))))
    assert line.run(41) == b"."
    line.send(b"x")
    assert line.run(0.9) == b""
    assert line.run(11.5) == b"x."  # the character ended after the supply was back
    assert line.device.boots == [START_NS, START_NS + 42 * MS]


def test_what_an_unpowered_twin_is_told_is_lost():
    line = Line(Echo(faults=faults(Fault("off", "echo", 0.001, 0.5))))
    line.run(2)
    assert line.ask(b"hello", 100) == b""
    assert not line.device.powered


def test_a_brown_out_begins_again_at_once():
    line = Line(Echo(faults=faults(Fault("reset", "echo", 0.035))))
    line.run(60)
    assert line.device.boots == [START_NS, START_NS + 35 * MS]
    assert [end - START_NS for end in line.ends_ns] == [t * MS + 1_041_667 for t in (10, 20, 30, 45, 55)]


def test_a_silent_twin_neither_hears_nor_is_heard():
    line = Line(Echo(faults=faults(Fault("silent", "echo", 0.005, 0.022))))
    line.run(6)
    assert line.ask(b"a", 10) == b""
    assert line.device.heard == []
    assert line.run(20) == b"."
    assert line.device.boots == [START_NS]


def nothing(t):
    return 0.0


CHANNEL = NodeChannel("a", "N", ValueType.I32, Analog(nothing))
TWINS = {
    "nimu": lambda **on: NimuTwin(StairImu(), RateClock(), START_NS, **on),
    "qsb": lambda **on: QsbTwin(Analog(nothing), RateClock(), START_NS, **on),
    "modbus": lambda **on: ModbusLoadCellTwin(Analog(nothing), RateClock(), START_NS, **on),
    "dsc": lambda **on: DscLoadCellTwin(Analog(nothing), RateClock(), START_NS, **on),
    "node": lambda **on: FrameNode([CHANNEL], RateClock(), START_NS, **on),
}


@pytest.mark.parametrize(
    ("twin", "kind"), [*((twin, "nack") for twin in TWINS), ("nimu", "who_am_i"), ("qsb", "saturated")]
)
def test_a_fault_that_it_cannot_have_is_refused(twin, kind):
    with pytest.raises(FaultError, match=f"cannot have the fault {kind}"):
        TWINS[twin](faults=faults(Fault(kind, "echo", 1.0, value=3)))


@pytest.mark.parametrize("twin", TWINS)
@settings(max_examples=20)
@given(
    pieces=st.lists(st.tuples(st.binary(max_size=60), st.floats(0.0, 30.0)), max_size=5),
    baud_rate=st.sampled_from([9600, 115_200, 230_400]),
    parity=st.sampled_from("NE"),
)
def test_no_bytes_at_any_speed_bring_a_twin_down(twin, pieces, baud_rate, parity):
    line = Line(TWINS[twin](), LineFormat(baud_rate, parity))
    line.run(600)
    for data, pause_ms in pieces:
        line.ask(data, pause_ms)
        assert line.ends_ns == sorted(line.ends_ns)
    line.run(100)
    assert line.device.powered
    assert line.wire.due_ns > line.now_ns
