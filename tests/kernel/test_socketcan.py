"""drivers.transports.open_can on vcan0: real stamps, real drops, real errors; cansend and candump at the other end."""

import errno
import itertools
import re
import select
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator

import network
import pytest

from drivers.ports import CanFrame, CanPort
from drivers.transports import open_can
from drivers.transports.can.can_reopen import ReopeningCanPort
from drivers.transports.can.can_socket import SocketcanPort

FRAME = struct.Struct("=IB3x8s")  # linux/can.h, struct can_frame
CAN_ERR_FLAG, CAN_ERR_BUSOFF, CAN_EFF_FLAG, CAN_RTR_FLAG = 0x2000_0000, 0x40, 0x8000_0000, 0x4000_0000


def opened(port: CanPort) -> SocketcanPort:
    """The port that is open behind the one that opens it again."""
    assert isinstance(port, ReopeningCanPort)
    assert isinstance(port.port, SocketcanPort)
    return port.port


@pytest.fixture
def port() -> Iterator[CanPort]:
    port = open_can("can+socketcan://vcan0?bitrate=500000", time.monotonic_ns)
    yield port
    port.close()


@pytest.fixture
def talker() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as talker:
        talker.bind(("vcan0",))
        yield talker


def test_cansend_is_received_with_the_kernels_stamp(
    port: CanPort, run: Callable[..., "subprocess.CompletedProcess[str]"]
) -> None:
    before_ns = time.monotonic_ns()
    assert run("cansend", "vcan0", "181#A0860100").returncode == 0
    after_ns = time.monotonic_ns()
    time.sleep(0.05)  # the stamp is the frame's, not the read's
    (frame,) = port.receive(1.0)
    assert frame[1:] == (0x181, bytes.fromhex("A0860100"), False)
    assert before_ns < frame.host_ns < after_ns


def test_candump_hears_what_we_send(port: CanPort) -> None:
    with subprocess.Popen(["candump", "-n", "2", "-L", "vcan0"], stdout=subprocess.PIPE, text=True) as dump:
        assert dump.stdout is not None
        lines: list[str] = []
        deadline = time.monotonic() + 10.0
        while not lines and time.monotonic() < deadline:  # until it has opened its socket
            port.send(0x60A, bytes(range(8)))
            if select.select([dump.stdout], [], [], 0.05)[0]:
                lines.append(dump.stdout.readline())
        port.send(0x000, b"\x01\x00")
        lines += dump.stdout.readlines()
    assert re.fullmatch(r"\(\d+\.\d{6}\) vcan0 60A#0001020304050607\n", lines[0])
    assert lines[-1].split()[-1] in {"000#0100", "60A#0001020304050607"}


def test_frames_come_in_order_with_growing_stamps(port: CanPort, talker: socket.socket) -> None:
    for n in range(200):
        talker.send(FRAME.pack(n, 2, n.to_bytes(2, "little")))
    frames = port.receive(1.0)
    assert [frame.identifier for frame in frames] == list(range(200))
    assert all(one.host_ns <= two.host_ns for one, two in itertools.pairwise(frames))


def test_a_talker_that_outruns_us_is_counted(port: CanPort, talker: socket.socket) -> None:
    socketcan, sent = opened(port), 4000
    for n in range(sent):
        talker.send(FRAME.pack(0x100, 4, n.to_bytes(4, "little")))
    frames: list[CanFrame] = []
    while received := port.receive(0.2):
        frames += received
    lost = sent - len(frames)
    assert lost > 0, f"{socketcan.receive_buffer} bytes held everything"
    talker.send(FRAME.pack(0x101, 0, b""))  # the count comes with the next frame
    (last,) = port.receive(1.0)
    assert last.identifier == 0x101
    assert port.lost_frames == lost
    assert [int.from_bytes(frame.data, "little") for frame in frames] == list(range(len(frames)))


def test_a_bigger_buffer_is_granted_as_far_as_the_kernel_allows(port: CanPort) -> None:
    with open("/proc/sys/net/core/rmem_max", encoding="ascii") as file:
        limit = int(file.read())
    socketcan = opened(port)
    assert socketcan.receive_buffer == 2 * limit  # doubled for the kernel's own bookkeeping, socket(7)


def test_error_frames_are_delivered(port: CanPort, talker: socket.socket) -> None:
    talker.send(FRAME.pack(CAN_ERR_FLAG | CAN_ERR_BUSOFF, 8, bytes(8)))
    (frame,) = port.receive(1.0)
    assert frame.is_error
    assert (frame.identifier, frame.data) == (CAN_ERR_BUSOFF, bytes(8))


def test_extended_and_remote_frames_are_passed_over_and_counted(port: CanPort, talker: socket.socket) -> None:
    talker.send(FRAME.pack(CAN_EFF_FLAG | 0x1234567, 1, b"\x01"))
    talker.send(FRAME.pack(CAN_RTR_FLAG | 0x701, 0, b""))
    talker.send(FRAME.pack(0x123, 0, b""))
    frames = port.receive(1.0)
    assert [frame.identifier for frame in frames] == [0x123]
    socketcan = opened(port)
    assert socketcan.foreign_frames == 2


def test_an_interface_that_goes_down_and_up(port: CanPort, talker: socket.socket) -> None:
    network.set_up("vcan0", False)
    try:
        with pytest.raises(OSError, match=r".") as receiving:
            port.receive(1.0)
        assert port.receive(0.0) == []  # the kernel tells the reader once
        with pytest.raises(OSError, match=r".") as sending:
            port.send(0x123, b"")
        assert (receiving.value.errno, sending.value.errno) == (errno.ENETDOWN, errno.ENETDOWN)
    finally:
        network.set_up("vcan0")
    assert talker.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == errno.ENETDOWN
    talker.send(FRAME.pack(0x123, 1, b"\x07"))
    (frame,) = port.receive(1.0)  # the same socket goes on
    assert frame.data == b"\x07"


def test_no_such_interface() -> None:
    with pytest.raises(OSError, match=r".") as caught:
        open_can("can+socketcan://can7", time.monotonic_ns)
    assert caught.value.errno == errno.ENODEV
