"""The wire: frame lengths bit by bit, arbitration, order."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from hil_sim.devices.can_bus.can_wire import CanWire
from hil_sim.devices.can_bus.frame_length import crc15, frame_bits
from hil_sim.faults import NEVER
from tests.hil_sim.devices.twin_bench import START_NS

BIT_NS = 2000  # 500 kbit/s


def bits_on_the_wire(identifier, data):
    """A data frame as ISO 11898-1 writes it down, as a string of 0 and 1, to the end of the end-of-frame field."""
    head = "0" + f"{identifier:011b}" + "0" + "0" + "0" + f"{len(data):04b}"
    body = head + "".join(f"{byte:08b}" for byte in data)
    crc = 0
    for bit in body:
        invert = int(bit) ^ crc >> 14
        crc = (crc << 1 & 0x7FFF) ^ (0x4599 if invert else 0)
    stuffed = ""
    for bit in body + f"{crc:015b}":
        stuffed += bit
        if stuffed[-5:] in ("00000", "11111"):
            stuffed += "1" if bit == "0" else "0"
    return stuffed + "1" + "0" + "1" + "1111111"


def test_crc_check_value():
    assert crc15(int.from_bytes(b"123456789", "big"), 9) == 0x059E  # CRC-15/CAN of the catalogue of CRCs


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_frame_length_is_that_of_the_frame_written_out(identifier, data):
    assert frame_bits(identifier, data) == len(bits_on_the_wire(identifier, data))


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_frame_length_lies_between_no_stuffing_and_the_worst(identifier, data):
    shortest = 44 + 8 * len(data)
    assert shortest <= frame_bits(identifier, data) <= shortest + (34 + 8 * len(data) - 1) // 4


class Talker:
    """Sends the frames of a list at their times; hears everything."""

    def __init__(self, *script):
        self.script = sorted(script)
        self.heard = []

    @property
    def due_ns(self):
        return START_NS + self.script[0][0] if self.script else NEVER

    def connect(self, transmit):
        self.transmit = transmit

    def act(self, now_ns):
        while self.due_ns <= now_ns:
            _, identifier, data = self.script.pop(0)
            self.transmit(identifier, data, now_ns)

    hears_process_data = True

    def receive(self, identifier, data, now_ns):
        self.heard.append((now_ns, identifier, data))


def wire_with(*nodes):
    wire = CanWire()
    for node in nodes:
        wire.add(node)
    return wire


def test_the_lowest_identifier_goes_first_and_the_others_follow_after_the_intermission():
    nodes = [Talker((0, identifier, b"\x55" * n)) for identifier, n in ((0x281, 4), (0x182, 5), (0x080, 1))]
    frames = wire_with(*nodes).advance(START_NS + 10**6)
    assert [frame.identifier for frame in frames] == [0x080, 0x182, 0x281]
    ends = [frame.end_ns - START_NS for frame in frames]
    lengths = [len(bits_on_the_wire(frame.identifier, frame.data)) for frame in frames]
    expected = np.cumsum([lengths[0], lengths[1] + 3, lengths[2] + 3]) * BIT_NS
    assert ends == expected.tolist()


def test_a_frame_on_the_wire_is_not_interrupted():
    long_frame = len(bits_on_the_wire(0x7FF, bytes(8))) * BIT_NS
    nodes = Talker((0, 0x7FF, bytes(8))), Talker((10_000, 0x300, b"")), Talker((10_001, 0x001, b""))
    frames = wire_with(*nodes).advance(START_NS + 10**6)
    assert [frame.identifier for frame in frames] == [0x7FF, 0x001, 0x300]
    assert frames[0].end_ns == START_NS + long_frame


def test_the_sender_does_not_hear_itself_and_the_host_not_its_own():
    a, b = Talker((0, 0x10, b"a")), Talker()
    wire = wire_with(a, b)
    wire.send(0x20, b"host", START_NS)
    frames = wire.advance(START_NS + 10**6)
    assert [frame.data for frame in frames] == [b"a"]
    assert [data for _, _, data in a.heard] == [b"host"]
    assert [data for _, _, data in b.heard] == [b"a", b"host"]


def test_frames_of_one_identifier_keep_their_order():
    wire = wire_with(Talker((0, 0x10, b"1"), (0, 0x10, b"2"), (0, 0x10, b"3")))
    assert [frame.data for frame in wire.advance(START_NS + 10**6)] == [b"1", b"2", b"3"]


def test_nothing_is_offered_before_it_is_ready():
    node = Talker()
    wire = wire_with(node)
    wire.send(0x10, b"", START_NS + 500_000)
    assert wire.due_ns == START_NS + 500_000
    wire.advance(START_NS + 500_000)
    assert node.heard == []
    wire.advance(START_NS + 10**6)
    assert node.heard == [(START_NS + 500_000 + len(bits_on_the_wire(0x10, b"")) * BIT_NS, 0x10, b"")]


script = st.lists(
    st.tuples(st.integers(0, 3000), st.integers(0, 0x7FF), st.binary(max_size=8)).map(
        lambda x: (x[0] * 1000, x[1], x[2])
    ),
    max_size=8,
)


@given(scripts=st.lists(script, min_size=1, max_size=3), steps_us=st.lists(st.integers(1, 900), max_size=12))
def test_the_frames_do_not_depend_on_when_anybody_looks(scripts, steps_us):
    end_ns = START_NS + 20_000_000
    whole = wire_with(*(Talker(*s) for s in scripts)).advance(end_ns)
    wire, now_ns, pieces = wire_with(*(Talker(*s) for s in scripts)), START_NS, []
    for step_us in steps_us:
        now_ns += step_us * 1000
        new = wire.advance(now_ns)
        assert all(frame.end_ns <= now_ns for frame in new)
        pieces += new
    assert pieces + wire.advance(end_ns) == whole
    assert len(whole) == sum(len(s) for s in scripts)
    starts = [f.end_ns - len(bits_on_the_wire(f.identifier, f.data)) * BIT_NS for f in whole]
    assert all(s >= f.end_ns + 3 * BIT_NS for s, f in zip(starts[1:], whole, strict=False))


@pytest.mark.parametrize(("bit_rate", "bit_ns"), [(125_000, 8000), (1_000_000, 1000)])
def test_bit_rate(bit_rate, bit_ns):
    wire = CanWire(bit_rate)
    wire.add(Talker((0, 0x2A5, b"\x5a")))
    (frame,) = wire.advance(START_NS + 10**7)
    assert frame.end_ns - START_NS == len(bits_on_the_wire(0x2A5, b"\x5a")) * bit_ns
