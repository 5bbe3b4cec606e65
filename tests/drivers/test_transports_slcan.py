"""CAN by the lines of an ASCII adapter (slcan), on a pseudo-terminal."""

import itertools
import os
import pty
import select
import threading
import time
import tty

import can
import hypothesis.strategies as st
import pytest
from hypothesis import given

from drivers.errors import FrameError
from drivers.transports import open_can
from drivers.transports.can.can_slcan import SlcanDecoder, decode_line, encode_line, encode_request

LINES = [  # Lawicel CAN232 manual; python-can's own spelling
    (b"t1811AA", 0x181, b"\xaa"),
    (b"t08001234", 0x080, b""),  # with the adapter's time stamp
    (b"t0800", 0x080, b""),
    (b"t7FF81122334455667788", 0x7FF, bytes.fromhex("1122334455667788")),
    (b"t28140a0B0c0D1F40", 0x281, b"\x0a\x0b\x0c\x0d"),
]


@pytest.mark.parametrize(("line", "identifier", "data"), LINES)
def test_lines_of_the_adapter(line, identifier, data):
    assert decode_line(line) == (identifier, data)


@pytest.mark.parametrize(
    "line", [b"t", b"t18", b"t181", b"t1819", b"t1811", b"t1811A", b"t1811AAB", b"t8001AA", b"t1_02AABB", b"t 811AA"]
)
def test_damaged_lines_are_frame_errors(line):
    with pytest.raises(FrameError, match="check the adapter's baud rate"):
        decode_line(line)


@pytest.mark.parametrize("line", [b"", b"z", b"V1013", b"NA123", b"F00", b"T000001811AA", b"r1810", b"R000001810"])
def test_what_is_no_data_frame_is_none(line):
    assert decode_line(line) is None


STREAM = b"".join(line + b"\r" for line, _, _ in LINES)
FRAMES = [(identifier, data) for _, identifier, data in LINES]


def three_ways(stream):
    """Whole, one byte at a time, with junk behind."""
    whole = SlcanDecoder()
    yield whole.feed(stream)
    bytewise = SlcanDecoder()
    yield [frame for byte in stream for frame in bytewise.feed(bytes([byte]))]
    junk = SlcanDecoder()
    yield junk.feed(stream + b"t12")


def test_a_stream_is_read_in_any_pieces():
    assert list(three_ways(STREAM)) == [FRAMES] * 3


@given(st.lists(st.sampled_from([*(line for line, _, _ in LINES), b"t18", b"\a", b"T000001811AA", b"z"]), max_size=9))
def test_any_pieces_of_lines_give_the_same(pieces):
    results = list(three_ways(b"\r".join(pieces) + b"\r"))
    assert results[0] == results[1] == results[2]


@given(st.lists(st.binary(max_size=40), max_size=10))
def test_any_bytes_give_frames_or_nothing_and_the_next_good_line_is_read(pieces):
    decoder = SlcanDecoder()
    for piece in pieces:
        for identifier, data in decoder.feed(piece):
            assert 0 <= identifier <= 0x7FF
            assert len(data) <= 8
    decoder.feed(b"\r")
    assert decoder.feed(STREAM) == FRAMES


def test_what_does_not_come_through_is_counted():
    decoder = SlcanDecoder()
    decoder.feed(b"t18\rT000001811AA\rr1810\r\a\a" + b"x" * 200)
    assert (decoder.damaged_lines, decoder.foreign_frames, decoder.refusals) == (2, 2, 2)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_lines_go_there_and_back(identifier, data):
    assert SlcanDecoder().feed(encode_line(identifier, data)) == [(identifier, data)]


@pytest.mark.parametrize(("identifier", "data"), [(0x800, b""), (-1, b""), (0, bytes(9))])
def test_no_line_for_what_is_no_frame(identifier, data):
    with pytest.raises(FrameError):
        encode_line(identifier, data)


class Adapter:
    """The far end of a pty, where the adapter's firmware would be."""

    def __init__(self):
        self.fd, slave = pty.openpty()
        tty.setraw(self.fd)
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        self._slave = slave

    def read(self, size):
        data = b""
        while len(data) < size and select.select([self.fd], [], [], 5.0)[0]:
            data += os.read(self.fd, size - len(data))
        return data

    def close(self):
        os.close(self.fd)
        os.close(self._slave)


@pytest.fixture
def adapter():
    far_end = Adapter()
    yield far_end
    far_end.close()


def test_an_adapter_is_set_to_its_bit_rate_and_opened_and_closed(adapter, clock):
    port = open_can(f"can+slcan://{adapter.path}?bitrate=500000", clock)
    assert adapter.read(7) == b"C\rS6\rO\r"
    port.send(0x601, b"\x40\x00\x10\x00\x00\x00\x00\x00")
    assert adapter.read(22) == b"t60184000100000000000\r"
    os.write(adapter.fd, b"\rz\rt1811AA\rt0801")
    clock.now_ns = 5_000
    frames = []
    while not frames:
        frames = port.receive(1.0)
    os.write(adapter.fd, b"07\r")
    clock.now_ns = 9_000
    while len(frames) < 2:
        frames += port.receive(1.0)
    assert port.lost_frames == 0
    assert frames == [(5_000, 0x181, b"\xaa", False), (9_000, 0x080, b"\x07", False)]
    assert port.receive(0.0) == port.receive(0.01) == []
    port.close()
    assert adapter.read(2) == b"C\r"


def test_frames_are_gathered_for_some_time_with_the_stamp_of_their_reading(adapter):
    port = open_can(f"can+slcan://{adapter.path}?bitrate=500000", time.monotonic_ns)
    adapter.read(7)
    began_ns = time.monotonic_ns()
    writes = [threading.Timer(0.05 * k, os.write, (adapter.fd, b"t1811%02X\r" % k)) for k in range(3)]
    for write in writes:
        write.start()
    frames = port.gather(0.3)
    assert time.monotonic_ns() - began_ns >= 300_000_000
    assert [frame.data for frame in frames] == [b"\0", b"\1", b"\2"]
    assert all(later.host_ns > earlier.host_ns for earlier, later in itertools.pairwise(frames))
    assert frames[-1].host_ns - frames[0].host_ns > 50_000_000
    port.close()


def test_what_waits_is_gathered_without_asking_and_a_tty_that_is_gone_is_an_os_error(monkeypatch):
    far_end = Adapter()
    port = open_can(f"can+slcan://{far_end.path}?bitrate=500000", time.monotonic_ns)
    far_end.read(7)
    os.write(far_end.fd, b"t1811AA\r")
    monkeypatch.setattr(select, "select", None)
    assert [frame.data for frame in port.gather(0.001)] == [b"\xaa"]
    monkeypatch.undo()
    assert port.gather(0.001) == []
    far_end.close()
    with pytest.raises(OSError, match=r"."):
        port.gather(0.001)
    port.close()


def test_python_can_and_our_port_understand_each_other(clock):
    """Two adapters back to back: python-can on one pty, we on another, bytes carried across by hand."""
    left, right = Adapter(), Adapter()
    bus = can.Bus(
        interface="slcan", channel=left.path, bitrate=500_000, sleep_after_open=0, ignore_config=True, timeout=0
    )
    port = open_can(f"can+slcan://{right.path}?bitrate=500000", clock)
    left.read(len(b"C\rS6\r\rO\rO\r"))
    right.read(len(b"C\rS6\rO\r"))
    sent = [(0x000, b""), (0x181, b"\x01\x02\x03\x04"), (0x7FF, bytes(range(8)))]
    for identifier, data in sent:
        bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        line = left.read(5 + 2 * len(data) + 1)
        os.write(right.fd, line)
        port.send(identifier, data)
        assert right.read(len(line)) == line
        os.write(left.fd, line)
    frames = []
    while len(frames) < len(sent):
        frames += port.receive(1.0)
    assert [(frame.identifier, frame.data) for frame in frames] == sent
    theirs = [bus.recv(5.0) for _ in sent]
    assert [(got.arbitration_id, bytes(got.data)) for got in theirs] == sent
    bus.shutdown()
    port.close()
    left.close()
    right.close()


def test_an_adapter_pulled_out_is_an_os_error(clock):
    far_end = Adapter()
    port = open_can(f"can+slcan://{far_end.path}?bitrate=500000", clock)
    far_end.close()
    with pytest.raises(OSError, match=r"."):
        port.receive(0.05)
    with pytest.raises(OSError, match=r"."):
        port.send(0x080, b"")
    port.close()


def test_an_adapter_that_returns_as_another_tty_is_opened_again_with_back_off(clock, tmp_path):
    link, far_end = tmp_path / "can", Adapter()
    link.symlink_to(far_end.path)
    port = open_can(f"can+slcan://{link}?bitrate=500000", clock)
    assert far_end.read(7) == b"C\rS6\rO\r"
    os.write(far_end.fd, b"t1811A\rt0801")  # one damaged line
    while not port.lost_frames:
        port.receive(0.05)
    far_end.close()
    link.unlink()
    tries = 0
    for _ in range(100):  # 1 s in steps of 10 ms
        clock.now_ns += 10_000_000
        try:
            port.receive(0.0)
        except OSError as error:
            tries += "No such file" in str(error)
    assert 4 <= tries <= 7, "after 20, 40, 80 ms and so on"
    back = Adapter()
    link.symlink_to(back.path)
    clock.now_ns += 1_000_000_000
    assert port.receive(0.0) == []
    assert back.read(7) == b"C\rS6\rO\r"
    os.write(back.fd, b"t181155\r")
    frames = []
    while not frames:
        frames = port.receive(0.05)
    assert [(frame.identifier, frame.data) for frame in frames] == [(0x181, b"\x55")]
    assert (port.reopened, port.lost_frames) == (1, 1)
    port.close()
    back.close()


def test_a_remote_frame_as_a_line_of_an_adapter():
    assert encode_request(0x701, 1) == b"r7011\r"
    assert decode_line(b"r7011") is None, "one that comes back is not ours to answer"
    for identifier, size in ((0x800, 1), (-1, 1), (0x701, 9), (0x701, -1)):
        with pytest.raises(FrameError, match="give 11 bits"):
            encode_request(identifier, size)
