"""Pumps of a CANopen bus: python-can's virtual bus, slcan out of memory, a datagram pair as SocketCAN's sockets are."""

import atexit
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from unittest import mock

import can
from can.interfaces.socketcan import SocketcanBus, socketcan

from bench import peers
from bench.pumps.case import MS, NaiveSample, PumpCase, Rings, nothing
from drivers.canopen_pdo import CanopenBus, Cia404Config, Cia406Config, SyncConfig
from drivers.ports import CanPort
from drivers.transports import open_can
from drivers.transports.can.can_slcan import SlcanPort, encode_line
from drivers.transports.can.can_socket import SO_TIMESTAMPNS, SocketcanPort

CAN_NODES = (Cia406Config("joint_1", 1, 500_000), Cia404Config("load_cell", 2, 1000.0))
_KERNEL_FRAME = struct.Struct("=IB3x8s")

CanFrames = list[tuple[int, bytes]]


class CanTraffic:
    """SYNCs with the two TPDOs that answer each, and the nodes' heartbeats: what is on the bus between two pumps.

    Args:
        rounds: SYNCs in a pump.
    """

    def __init__(self, rounds: int) -> None:
        self.rounds = rounds
        self.frames = 3 * rounds + len(CAN_NODES)
        self._number = 0

    def next(self) -> CanFrames:
        """The frames of the next pump."""
        frames = [frame for at in range(self.rounds) for frame in peers.can_round(self._number + at)]
        self._number += self.rounds
        return frames + [(0x700 + node.node, b"\5") for node in CAN_NODES]


def can_case(
    name: str,
    rings: Rings,
    rounds: int,
    port: CanPort,
    clock: Callable[[], int],
    send: Callable[[CanFrames], None],
    receive: Callable[[], CanFrames],
    naive: Callable[[], None],
    samples: deque[NaiveSample],
    naive_fill: Callable[[], None],
) -> PumpCase:
    """A CANopen bus behind ``port``.

    Args:
        name: Transport.
        rings: Where rows go.
        rounds: SYNCs in a pump.
        port: Ours.
        clock: CLOCK_MONOTONIC; one of ``peers`` is moved by 5 ms a SYNC.
        send: Puts frames on the bus from its other end.
        receive: What the driver sent.
        naive: The naive loop.
        samples: Where it keeps its objects.
        naive_fill: What it needs.
    """
    moved = isinstance(clock, peers.Clock)
    sync = SyncConfig(name=f"{name}_sync", period_ms=5.0 if moved else 1000.0)
    bus = CanopenBus(port, CAN_NODES, sync, name)
    traffic = CanTraffic(rounds)

    def fill() -> None:
        if isinstance(clock, peers.Clock):
            clock.now_ns += rounds * 5 * MS
        send(traffic.next())

    def pumped() -> int:
        return rings.push_all(bus.pump(clock()))

    bus.start(clock())
    for _ in range(40):  # each answers one SDO request of each node
        send([answer for frame in receive() if (answer := peers.sdo_answer(*frame)) is not None])
        bus.pump(clock())
    for _ in range(2):
        fill()
        bus.pump(clock())
    text = f"CAN frame, {name}, {traffic.frames} a pump"
    return PumpCase(text, 15.0, traffic.frames, 3 * rounds, fill, pumped, naive, samples, naive_fill)


def virtual_case(rings: Rings, rounds: int) -> PumpCase:
    """python-can's in-process bus; its receive is counted, the other end's send is not."""
    clock = peers.Clock()
    traffic = CanTraffic(rounds)
    samples: deque[NaiveSample] = deque()

    def joined(channel: str) -> can.BusABC:
        bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True, ignore_config=True)
        atexit.register(bus.shutdown)
        return bus

    theirs, loop_in, loop_out = joined(f"ours_{rounds}"), joined(f"naive_{rounds}"), joined(f"naive_{rounds}")

    def put(bus: can.BusABC, frames: CanFrames) -> None:
        for identifier, data in frames:
            bus.send(can.Message(clock() * 1e-9, identifier, is_extended_id=False, data=data))

    def receive() -> CanFrames:
        frames = []
        while (message := theirs.recv(0.0)) is not None:
            frames.append((message.arbitration_id, bytes(message.data)))
        return frames

    def naive() -> None:
        while (message := loop_in.recv(0.0)) is not None:
            samples.append(NaiveSample(round(message.timestamp * 1e9), message.arbitration_id, tuple(message.data)))

    port = open_can(f"can+virtual://ours_{rounds}?timestamps=monotonic", clock)
    atexit.register(port.close)
    return can_case(
        "python-can virtual",
        rings,
        rounds,
        port,
        clock,
        lambda frames: put(theirs, frames),
        receive,
        naive,
        samples,
        lambda: put(loop_out, traffic.next()),
    )


def slcan_case(rings: Rings, rounds: int) -> PumpCase:
    """Our slcan port on a tty in memory."""
    clock = peers.Clock()
    sent: list[bytes] = []

    def answer(line: bytes) -> bytes:
        sent.append(line)
        return b""

    tty = peers.MemorySerial(answer)
    samples: deque[NaiveSample] = deque()

    def send(frames: CanFrames) -> None:
        tty.waiting += b"".join(encode_line(*frame) for frame in frames)

    def receive() -> CanFrames:
        lines = list(sent)
        sent.clear()
        return [(int(line[1:4], 16), bytes.fromhex(line[5:-1].decode())) for line in lines]

    data = b"".join(encode_line(*frame) for frame in CanTraffic(rounds).next())

    def naive() -> None:
        for line in data.split(b"\r")[:-1]:
            samples.append(NaiveSample(0, int(line[1:4], 16), tuple(bytes.fromhex(line[5:].decode()))))

    port = SlcanPort(tty, clock, lambda _: None)
    return can_case("our slcan port", rings, rounds, port, clock, send, receive, naive, samples, nothing)


def socket_case(rings: Rings, rounds: int) -> PumpCase:
    """Our SocketCAN port on a datagram pair of the kernel's, which stamps as a CAN socket does."""

    def pair() -> tuple[socket.socket, socket.socket]:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        ours.setblocking(False)
        theirs.setblocking(False)
        return ours, theirs

    ours, theirs = pair()
    loop_in, loop_out = pair()
    with mock.patch.multiple(socketcan, create_socket=lambda: ours, bind_socket=lambda sock, channel: None):
        bus = SocketcanBus("can0")
    traffic = CanTraffic(rounds)
    samples: deque[NaiveSample] = deque()

    def put(end: socket.socket, frames: CanFrames) -> None:
        for identifier, data in frames:
            end.send(_KERNEL_FRAME.pack(identifier, len(data), data))

    def receive() -> CanFrames:
        frames: CanFrames = []
        while True:
            try:
                identifier, size, data = _KERNEL_FRAME.unpack(theirs.recv(16))
            except BlockingIOError:
                return frames
            frames.append((identifier, data[:size]))

    def naive() -> None:
        for _ in range(traffic.frames):
            data, _, _, _ = loop_in.recvmsg(16, 64)
            identifier, size, payload = _KERNEL_FRAME.unpack(data)
            samples.append(NaiveSample(0, identifier, tuple(payload[:size])))

    return can_case(
        "our socketcan port, datagram pair",
        rings,
        rounds,
        SocketcanPort(bus, time.monotonic_ns, 4 << 20),
        time.monotonic_ns,
        lambda frames: put(theirs, frames),
        receive,
        naive,
        samples,
        lambda: put(loop_out, traffic.next()),
    )
