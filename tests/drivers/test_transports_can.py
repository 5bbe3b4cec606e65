"""CAN ports: the kernel's socket (a datagram pair stands for it), python-can's virtual bus, slcan beside python-can."""

import errno
import os
import socket
import struct
import time

import can
import can.interfaces.socketcan.socketcan as socketcan
import pytest
from can.interfaces.socketcan import SocketcanBus

from drivers.errors import UrlError
from drivers.transports import open_can
from drivers.transports.can.can_reopen import ReopeningCanPort
from drivers.transports.can.can_socket import SO_RXQ_OVFL, SO_TIMESTAMPNS, SocketcanPort
from drivers.transports.clock import realtime_minus_monotonic


def kernel_frame(identifier, data):
    """struct can_frame of linux/can.h."""
    return struct.pack("=IB3x", identifier, len(data)) + data.ljust(8, b"\0")


def read_frame(end):
    """Identifier, length and data of a struct can_frame; its padding and len8_dlc are nobody's."""
    return struct.unpack("=IB3x8s", end.recv(64))


# SocketCAN


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        yield ours, theirs


def port_on(kernel, clock=time.monotonic_ns):
    """The port on a python-can bus whose raw socket is ``kernel``, which need not know CAN's options."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socketcan, "create_socket", lambda: kernel)
        patch.setattr(socketcan, "bind_socket", lambda sock, channel: None)
        return SocketcanPort(SocketcanBus("can0"), clock, 1 << 20)


def test_frames_of_the_kernel_are_stamped_by_the_kernel_in_our_clock(pair):
    ours, theirs = pair
    port = port_on(ours)
    before = time.monotonic_ns()
    theirs.send(kernel_frame(0x281, b"\x01\x02\x03\x04"))
    after = time.monotonic_ns()
    time.sleep(0.05)
    theirs.send(kernel_frame(0x080, b""))
    frames = port.receive(1.0)
    assert [(frame.identifier, frame.data, frame.is_error) for frame in frames] == [
        (0x281, b"\x01\x02\x03\x04", False),
        (0x080, b"", False),
    ]
    one_millisecond = 1_000_000
    assert before - one_millisecond <= frames[0].host_ns <= after + one_millisecond
    assert frames[1].host_ns - frames[0].host_ns > 40 * one_millisecond


def test_error_frames_keep_their_classes_and_foreign_frames_are_counted(pair):
    ours, theirs = pair
    port = port_on(ours)
    theirs.send(kernel_frame(0x2000_0040, bytes(8)))
    theirs.send(kernel_frame(0x8000_0281, b"\1"))
    theirs.send(kernel_frame(0x4000_0281, b""))
    (frame,) = port.receive(1.0)
    assert frame[1:] == (0x040, bytes(8), True)
    assert port.foreign_frames == 2


def test_nothing_waiting_is_nothing_and_a_frame_is_sent_as_the_kernel_wants_it(pair):
    ours, theirs = pair
    port = port_on(ours)
    assert port.receive(0.0) == []
    assert port.receive(0.01) == []
    port.send(0x601, b"\x40\x00\x10\x00\x00\x00\x00\x00")
    assert read_frame(theirs) == (0x601, 8, b"\x40\x00\x10\x00\x00\x00\x00\x00")


class KernelThatDrops:
    """A socket that reports drops, as a raw CAN socket does and a datagram pair does not."""

    def __init__(self, real, messages):
        self.messages = messages
        self.fileno, self.getsockopt, self.setblocking = real.fileno, real.getsockopt, real.setblocking
        self.setsockopt, self.close = real.setsockopt, real.close

    def recvmsg(self, size, ancillary_size):
        assert size == 16
        if not self.messages:
            raise BlockingIOError
        message = self.messages.pop(0)
        if isinstance(message, OSError):
            raise message
        return message


def test_frames_dropped_by_the_kernel_are_counted(pair):
    stamp = (socket.SOL_SOCKET, SO_TIMESTAMPNS, struct.pack("@ll", 5, 7))
    drops = (socket.SOL_SOCKET, SO_RXQ_OVFL, struct.pack("=I", 41))
    frame = kernel_frame(0x080, b"\1")
    kernel = KernelThatDrops(pair[0], [(frame, [stamp], 0, None), (frame, [stamp, drops], 0, None)])
    port = port_on(kernel, lambda: 0)
    assert len(port.receive(0.0)) == 2
    assert port.lost_frames == 41


class RawSocket:
    """Notes how it is set up. ``refuse`` names options that this kernel does not know."""

    made: "RawSocket"

    def __init__(self, *kind, refuse=()):
        self.kind, self.refuse, self.options, self.bound, self.closed = kind, set(refuse), {}, None, False
        RawSocket.made = self

    def setsockopt(self, level, option, value):
        if option in self.refuse:
            raise OSError(errno.ENOPROTOOPT, os.strerror(errno.ENOPROTOOPT))
        self.options[level, option] = value

    def getsockopt(self, level, option):
        return 425_984

    def bind(self, address):
        if address == ("can9",):
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        self.bound = address

    def setblocking(self, flag):
        self.blocking = flag

    def fileno(self):
        return 0

    def close(self):
        self.closed = True


def test_a_raw_socket_is_asked_for_stamps_errors_buffer_and_drop_counts(monkeypatch, clock):
    monkeypatch.setattr(socket, "socket", RawSocket)
    port = open_can("can+socketcan://can0?bitrate=500000&receive_buffer=1000000", clock)
    raw = RawSocket.made
    assert raw.kind == (socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    assert raw.bound == ("can0",)
    assert not raw.blocking
    assert raw.options == {
        (socket.SOL_SOCKET, SO_TIMESTAMPNS): 1,
        (socket.SOL_CAN_RAW, 1): struct.pack("=II", 0, 0),  # CAN_RAW_FILTER: everything
        (socket.SOL_CAN_RAW, 2): 0x1FFF_FFFF,  # CAN_RAW_ERR_FILTER: all classes
        (socket.SOL_CAN_RAW, 3): 1,  # CAN_RAW_LOOPBACK: other programs on this computer hear us
        (socket.SOL_CAN_RAW, 4): 0,  # CAN_RAW_RECV_OWN_MSGS
        (socket.SOL_SOCKET, socket.SO_RCVBUF): 1_000_000,
        (socket.SOL_SOCKET, SO_RXQ_OVFL): 1,
    }
    assert port.port.receive_buffer == 425_984
    port.mute()
    assert raw.options[socket.SOL_CAN_RAW, 1] == struct.pack("=II", 0x2000_0000, 0)  # all that is not everything
    assert raw.options[socket.SOL_CAN_RAW, 2] == 0
    port.close()
    assert raw.closed


def test_a_kernel_without_drop_counts_will_do_and_an_absent_interface_is_closed_again(monkeypatch, clock):
    monkeypatch.setattr(socket, "socket", lambda *kind: RawSocket(*kind, refuse={SO_RXQ_OVFL, socket.SO_RCVBUF}))
    open_can("can+socketcan://can0", clock)
    assert RawSocket.made.bound == ("can0",)
    with pytest.raises(OSError, match="No such device"):
        open_can("can+socketcan://can9", clock)
    assert RawSocket.made.closed


def test_an_interface_that_goes_down_is_an_os_error(pair):
    port = port_on(KernelThatDrops(pair[0], [OSError(errno.ENETDOWN, "down")]), lambda: 0)
    with pytest.raises(OSError, match="down") as caught:
        port.receive(0.0)
    assert caught.value.errno == errno.ENETDOWN


def test_the_offset_of_the_clocks_is_that_of_the_narrowest_bracket():
    monotonic = iter([0, 100_000, 200_000, 230_000, 300_000, 390_000, 400_000, 500_000])
    wall = iter([1_000_090_000, 1_000_215_000, 1_000_301_000, 1_000_499_000])
    assert realtime_minus_monotonic(lambda: next(monotonic), lambda: next(wall)) == 1_000_000_000
    quick = iter([0, 10_000])
    assert realtime_minus_monotonic(lambda: next(quick), lambda: 77_005_000) == 77_000_000


# python-can's virtual bus


@pytest.fixture
def stranger():
    buses = []

    def join(name):
        buses.append(can.Bus(interface="virtual", channel=name, preserve_timestamps=True, ignore_config=True))
        return buses[-1]

    yield join
    for bus in buses:
        bus.shutdown()


def message(identifier, data=b"", stamp_s=0.0, **flags):
    return can.Message(stamp_s, identifier, is_extended_id=flags.pop("extended", False), data=data, **flags)


def test_virtual_frames_carry_the_simulators_stamp_to_the_nanosecond(stranger, clock):
    bus = stranger("stamps")
    port = open_can("can+virtual://stamps?timestamps=monotonic", clock)
    stamps = [1_000_000_000, 1_000_000_001, 86_400_123_456_789]
    for stamp in stamps:
        bus.send(message(0x281, b"\1\2\3\4", stamp * 1e-9))
    bus.send(message(0x281, b"", extended=True))
    bus.send(message(0x281, is_remote_frame=True))
    bus.send(message(0x040, bytes(8), is_error_frame=True))
    frames, library = port.receive(0.0), port.port
    port.close()
    assert [frame.host_ns for frame in frames[:3]] == stamps
    assert frames[0][1:] == (0x281, b"\1\2\3\4", False)
    assert frames[3][1:] == (0x040, bytes(8), True)
    assert library.foreign_frames == 2


def test_what_we_send_on_the_virtual_bus_is_stamped_with_our_clock(stranger, clock):
    bus = stranger("sent")
    port = open_can("can+virtual://sent?timestamps=monotonic", clock)
    port.send(0x000, b"\x01\x05")
    assert port.receive(0.0) == []
    got = bus.recv(0.0)
    port.close()
    assert (got.arbitration_id, bytes(got.data), got.is_extended_id) == (0, b"\x01\x05", False)
    assert round(got.timestamp * 1e9) == clock()


def test_virtual_frames_with_wall_clock_stamps_are_moved_to_ours(stranger):
    bus = stranger("wall")
    port = open_can("can+virtual://wall", time.monotonic_ns)
    bus.send(message(0x080, b"\1", time.time()))
    (frame,) = port.receive(0.0)
    port.close()
    assert abs(frame.host_ns - time.monotonic_ns()) < 1_000_000_000


def test_a_muted_bus_gives_what_had_arrived_and_no_more(stranger, clock):
    bus = stranger("muted")
    port = open_can("can+virtual://muted?timestamps=monotonic", clock)
    now_s = clock() * 1e-9
    bus.send(can.Message(timestamp=now_s - 1e-3, arbitration_id=0x80, data=[1], is_extended_id=False))
    port.mute()
    bus.send(can.Message(timestamp=now_s + 1e-3, arbitration_id=0x80, data=[2], is_extended_id=False))
    assert [frame.data for frame in port.receive(0.0)] == [b"\x01"]
    assert port.receive(0.0) == []
    port.close()


def test_any_interface_of_python_can_is_reached_by_url(stranger):
    bus = stranger("anywhere")
    port = open_can("can+python:///virtual/anywhere?bitrate=500000", time.monotonic_ns)
    bus.send(can.Message(timestamp=time.time(), arbitration_id=0x123, data=[7], is_extended_id=False))
    (frame,) = port.receive(1.0)
    assert (frame.identifier, frame.data) == (0x123, b"\x07")
    assert abs(frame.host_ns - time.monotonic_ns()) < 1_000_000_000
    port.close()


@pytest.mark.parametrize("url", ["can+python:///virtual?bitrate=500000", "can+python:///virtual/x"])
def test_an_interface_url_that_lacks_something_says_what(url):
    with pytest.raises(UrlError, match=r"can\+python:///pcan/PCAN_USBBUS1|lacks bitrate"):
        open_can(url, time.monotonic_ns)


def test_an_interface_that_is_not_there_is_an_os_error():
    with pytest.raises(OSError, match="python-can cannot open nosuch"):
        open_can("can+python:///nosuch/x?bitrate=500000", time.monotonic_ns)


def test_a_closed_virtual_bus_is_an_os_error(clock):
    port = open_can("can+virtual://closed", clock)
    port.port.close()
    with pytest.raises(OSError, match="CAN receive failed"):
        port.receive(0.0)
    port = open_can("can+virtual://closed", clock)
    port.port.close()
    with pytest.raises(OSError, match="CAN send failed"):
        port.send(0x000, b"")
    port.close()
    with pytest.raises(OSError, match="gone"):
        port.send(0x000, b"")


def test_a_socket_keeps_what_is_gathered_with_the_kernels_stamps(pair):
    ours, theirs = pair
    port = port_on(ours)
    theirs.send(kernel_frame(0x281, b"\x01"))
    sent_ns = time.monotonic_ns()
    (frame,) = port.gather(0.05)
    assert frame.data == b"\x01"
    assert time.monotonic_ns() - sent_ns >= 50_000_000
    assert frame.host_ns <= sent_ns + 1_000_000


def test_an_interface_that_is_down_keeps_its_socket_and_one_that_is_gone_is_opened_again(clock):
    class Dead:
        errno, closed = errno.ENETDOWN, 0

        def receive(self, timeout_s):
            raise OSError(self.errno, "of the interface")

        def close(self):
            self.closed += 1

    opened = []

    def dead():
        opened.append(Dead())
        return opened[-1]

    port = ReopeningCanPort(dead, clock)
    for _ in range(3):
        with pytest.raises(OSError, match="of the interface"):
            port.receive(0.0)
    assert (len(opened), opened[0].closed) == (1, 0)
    opened[0].errno = errno.ENODEV
    with pytest.raises(OSError, match="of the interface"):
        port.receive(0.0)
    assert opened[0].closed == 1
    clock.now_ns += 20_000_000
    with pytest.raises(OSError, match="of the interface"):
        port.receive(0.0)
    assert len(opened) == 2


# Remote frames: what node guarding asks with


def test_a_remote_frame_is_sent_as_the_kernel_wants_it(pair):
    ours, theirs = pair
    port_on(ours).request(0x701, 1)
    assert read_frame(theirs) == (0x4000_0701, 1, bytes(8))


def test_a_remote_frame_through_python_can_is_one(clock):
    port = open_can("can+virtual://remote?timestamps=monotonic", clock)
    with can.Bus(interface="virtual", channel="remote", ignore_config=True) as other:
        port.request(0x701, 1)
        message = other.recv(1.0)
    port.close()
    assert (message.arbitration_id, message.is_remote_frame, message.dlc) == (0x701, True, 1)
    assert not message.is_extended_id
