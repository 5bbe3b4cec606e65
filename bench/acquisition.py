"""What a record costs from the wire into the ring, beside the loop that makes one object of each sample.

::

    python bench/acquisition.py [--rounds 41] [--json FILE]

CPU time (``process_time_ns``) of a pump of the real driver and a push of all its rows into rings, divided by the
records (samples, frames, lines) of that pump; the port is one in memory unless the line says otherwise, and filling it
is not counted. Each figure is the median of rounds; ours and the naive loop take turns within a round. The naive loop
unpacks each record with ``struct`` (or ``int``), checks it the same way where there is a checksum, makes a dataclass
object of it and keeps that ("objects"); "to ring" is that and a push of a row for each object, to where ours ends. It
unwraps, numbers and accounts for nothing. The collector is frozen and on, as in the worker that flies; nothing else is
tuned. Exit code 1 where a bar is missed.
"""

import argparse
import atexit
import binascii
import gc
import json
import os
import platform
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import can
import numpy as np
from cobs import cobs  # type: ignore[import-untyped]  # it ships no type hints

from bench import peers
from drivers import records
from drivers.canopen_pdo import CanopenBus, Cia404Config, Cia406Config, SyncConfig
from drivers.mpu6050 import Mpu6050, Mpu6050Config, decode_packets
from drivers.node_frame import NodeFrame, NodeFrameConfig
from drivers.ports import CanPort
from drivers.qsb import Qsb
from drivers.records import Batch, Rows
from drivers.transports import open_can
from drivers.transports.can_slcan import SlcanPort, encode_line
from drivers.transports.can_socket import SO_TIMESTAMPNS, SocketcanPort
from onboard.ring import RingWriter

ROOT = Path(__file__).resolve().parents[1]
MS = 1_000_000
PUMPS = 25  # in a round
CAPACITY = 4096
IMPORT_ROUNDS = 9
IMPORT_BAR_S = 0.15
ROOMS = (
    *("canopen_pdo", "dsc_load_cell", "modbus_load_cell", "mpu6050", "nimu"),
    *("node_frame", "qsb", "sync_pulse", "transports"),
)
CAN_NODES = (Cia406Config("joint_1", 1, 500_000), Cia404Config("load_cell", 2, 1000.0))
_KERNEL_FRAME = struct.Struct("=IB3x8s")
_NODE = struct.Struct("<BBHIIIIB")

CanFrames = list[tuple[int, bytes]]


def nothing() -> None:
    """Nothing is to be made ready."""


class Case(NamedTuple):
    """One line of the table.

    Attributes:
        name: What is measured.
        bar: us a record, at most.
        records: In a pump.
        rows: That a pump must hand over.
        fill: Have the next pump's bytes wait. Not counted.
        ours: Pump and push; how many rows.
        naive: As many records, one object each.
        samples: Where it keeps them.
        naive_fill: As ``fill``, for it.
    """

    name: str
    bar: float
    records: int
    rows: int
    fill: Callable[[], None]
    ours: Callable[[], int]
    naive: Callable[[], None]
    samples: "deque[Sample]"
    naive_fill: Callable[[], None] = nothing


class Line(NamedTuple):
    """A case measured, us a record."""

    name: str
    bar: float
    ours: float
    objects: float
    to_ring: float


@dataclass
class Sample:
    """What the naive loop makes of a record."""

    host_ns: int
    number: int
    values: tuple[int, ...]


class Rings:
    """A ring for each channel, made when its first rows come."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._rings: dict[str, RingWriter] = {}

    def push(self, channel: str, rows: Rows) -> int:
        """Push; how many rows."""
        ring = self._rings.get(channel)
        if ring is None:
            ring = self._rings[channel] = RingWriter(self._folder / f"{channel}.ring", rows.dtype, CAPACITY)
        ring.push(rows)
        return len(rows)

    def push_all(self, batches: list[Batch]) -> int:
        """Push the batches of one pump; how many rows.

        Raises:
            RuntimeError: There is an event or a gap among them: the stream is not the good one to be measured.
        """
        count = 0
        for channel, rows in batches:
            if channel in {"event", "gap"}:
                raise RuntimeError(f"a good stream made a {channel}: {rows}")
            count += self.push(channel, rows)
        return count


def push_one_by_one(samples: "deque[Sample]", ring: RingWriter) -> None:
    """A row for each object, and a push for each row."""
    while samples:
        sample = samples.popleft()
        row = np.zeros(1, records.SCALAR)
        row[0] = (sample.number, sample.host_ns, sample.number, sum(sample.values), 1.0, "1", 0, 0, 0)
        ring.push(row)


def mpu6050_cases(rings: Rings) -> list[Case]:
    """Decoder and ring alone, and the whole device on a chip in memory."""
    count = 100
    config = Mpu6050Config(poll_period_ms=18.0)
    data = peers.mpu6050_packets(0, count)
    clock = peers.Clock()
    chip = peers.MemoryMpu6050(clock, 0x98)  # ICM-20689: its FIFO holds 292 samples
    device = Mpu6050("imu_device", chip, config)
    device.start(clock())
    for _ in range(2):  # out of reset, awake
        clock.now_ns += 200 * MS
        device.pump(clock())
    samples: deque[Sample] = deque()

    def fill() -> None:
        clock.now_ns += count * MS
        chip.fifo = data

    def decoded() -> int:
        rows = decode_packets(data, config)
        rows["sequence"] = rows["tick"] = np.arange(count)
        rows["host_ns"] = clock()
        return rings.push("imu", rows)

    def drained() -> int:
        return rings.push_all(device.pump(clock()))

    def naive() -> None:
        for number, words in enumerate(struct.iter_unpack(">7h", data)):
            samples.append(Sample(0, number, words))

    name = f"MPU-6050 FIFO, {count} samples"
    return [
        Case(f"{name}, decode and push", 1.5, count, count, nothing, decoded, naive, samples),
        Case(f"{name}, whole drain of the device", 1.5, count, count, fill, drained, naive, samples),
    ]


def node_case(rings: Rings, count: int, channels: int) -> Case:
    """COBS frames, ``count`` of them a pump."""
    names = tuple(f"value_{place}" for place in range(channels))
    clock, port = peers.Clock(), peers.MemorySerial()
    config = NodeFrameConfig(channels=names)
    device = NodeFrame(f"node_{count}_{channels}", lambda: port, clock, config)
    descriptor = peers.node_descriptor(names, 0, clock() // 1000)
    schema = peers.node_schema(descriptor)
    samples: deque[Sample] = deque()
    sent = 0

    def wire() -> bytes:
        """A frame every millisecond."""
        nonlocal sent
        numbers = range(sent, sent + count)
        sent += count
        clock.now_ns += count * MS
        frames = (peers.node_data(schema, at, 10_000_000 + 1000 * at, (at,) * channels) for at in numbers)
        return b"".join(map(peers.node_framed, frames))

    def fill() -> None:
        port.waiting = wire()

    def pumped() -> int:
        return rings.push_all(device.pump(clock()))

    device.start(clock())
    data = wire()
    port.waiting = peers.node_framed(descriptor) + data
    device.pump(clock())

    def naive() -> None:
        for frame in data.split(b"\0")[:-1]:
            payload = cobs.decode(frame)
            if not binascii.crc_hqx(payload, 0xFFFF):
                _, _, _, number, *_ = _NODE.unpack_from(payload)
                values = struct.unpack_from(f"<{channels}i", payload, _NODE.size)
                samples.append(Sample(0, number, values))

    name = f"COBS node frames of {channels} channel{'s' * (channels > 1)}, {count} a pump"
    return Case(name, 3.0, count, count * channels, fill, pumped, naive, samples)


def qsb_case(rings: Rings, count: int) -> Case:
    """QSB lines, ``count`` of them a pump."""
    clock = peers.Clock()
    tick = clock() // peers.QSB_TICK_NS
    port = peers.MemorySerial(lambda command: peers.qsb_answer(command, clock() // peers.QSB_TICK_NS))
    device = Qsb(f"qsb_{count}", lambda: port, clock)
    samples: deque[Sample] = deque()

    def wire() -> bytes:
        nonlocal tick
        ticks = range(tick + 1, tick + 1 + count)
        tick += count
        clock.now_ns += count * peers.QSB_TICK_NS
        return b"".join(peers.qsb_line("s", 0x0E, 37 * at, at) for at in ticks)

    def fill() -> None:
        port.waiting = wire()

    def pumped() -> int:
        return rings.push_all(device.pump(clock()))

    device.start(clock())
    port.waiting = data = wire()
    device.pump(clock())

    def naive() -> None:
        for line in data.split(b"\r\n")[:-1]:
            kind, register, value, stamp, end = line.split()
            if kind == b"s" and end == b"!" and register == b"0E":
                samples.append(Sample(0, int(stamp, 16), (int(value, 16),)))

    return Case(f"QSB lines, {count} a pump", 3.0, count, count, fill, pumped, naive, samples)


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
    samples: deque[Sample],
    naive_fill: Callable[[], None],
) -> Case:
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
    return Case(text, 15.0, traffic.frames, 3 * rounds, fill, pumped, naive, samples, naive_fill)


def virtual_case(rings: Rings, rounds: int) -> Case:
    """python-can's in-process bus; its receive is counted, the other end's send is not."""
    clock = peers.Clock()
    traffic = CanTraffic(rounds)
    samples: deque[Sample] = deque()

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
            samples.append(Sample(round(message.timestamp * 1e9), message.arbitration_id, tuple(message.data)))

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


def slcan_case(rings: Rings, rounds: int) -> Case:
    """Our slcan port on a tty in memory."""
    clock = peers.Clock()
    sent: list[bytes] = []

    def answer(line: bytes) -> bytes:
        sent.append(line)
        return b""

    tty = peers.MemorySerial(answer)
    samples: deque[Sample] = deque()

    def send(frames: CanFrames) -> None:
        tty.waiting += b"".join(encode_line(*frame) for frame in frames)

    def receive() -> CanFrames:
        lines = list(sent)
        sent.clear()
        return [(int(line[1:4], 16), bytes.fromhex(line[5:-1].decode())) for line in lines]

    data = b"".join(encode_line(*frame) for frame in CanTraffic(rounds).next())

    def naive() -> None:
        for line in data.split(b"\r")[:-1]:
            samples.append(Sample(0, int(line[1:4], 16), tuple(bytes.fromhex(line[5:].decode()))))

    port = SlcanPort(tty, clock, lambda _: None)
    return can_case("our slcan port", rings, rounds, port, clock, send, receive, naive, samples, nothing)


def socket_case(rings: Rings, rounds: int) -> Case:
    """Our SocketCAN port on a datagram pair of the kernel's, which stamps as a CAN socket does."""

    def pair() -> tuple[socket.socket, socket.socket]:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        ours.setblocking(False)
        theirs.setblocking(False)
        return ours, theirs

    ours, theirs = pair()
    loop_in, loop_out = pair()
    traffic = CanTraffic(rounds)
    samples: deque[Sample] = deque()

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
            samples.append(Sample(0, identifier, tuple(payload[:size])))

    return can_case(
        "our socketcan port, datagram pair",
        rings,
        rounds,
        SocketcanPort(ours, time.monotonic_ns),
        time.monotonic_ns,
        lambda frames: put(theirs, frames),
        receive,
        naive,
        samples,
        lambda: put(loop_out, traffic.next()),
    )


def measured(case: Case, rounds: int, ring: RingWriter) -> Line:
    """Medians over ``rounds`` of the mean of ``PUMPS``, us a record.

    Raises:
        RuntimeError: Other rows came than had to: the measurement is worth nothing.
    """
    clock = time.process_time_ns
    figures: tuple[list[float], list[float], list[float]] = ([], [], [])
    for number in range(rounds + 2):
        ours_ns = objects_ns = pushes_ns = 0
        for _ in range(PUMPS):
            case.fill()
            began = clock()
            rows = case.ours()
            ours_ns += clock() - began
            if rows != case.rows:
                raise RuntimeError(f"{case.name}: {rows} rows where {case.rows} had to come")
            case.naive_fill()
            began = clock()
            case.naive()
            made = clock()
            push_one_by_one(case.samples, ring)
            objects_ns += made - began
            pushes_ns += clock() - made
        if number >= 2:  # two to warm up
            for total_ns, figure in zip((ours_ns, objects_ns, objects_ns + pushes_ns), figures, strict=True):
                figure.append(1e-3 * total_ns / (PUMPS * case.records))
    return Line(case.name, case.bar, *map(statistics.median, figures))


def import_seconds(modules: str) -> tuple[float, float]:
    """CPU and wall time that a fresh interpreter takes to import ``modules``, medians, s."""
    code = f"import time; w, c = time.perf_counter(), time.process_time(); import {modules}; "
    code += "print(time.process_time() - c, time.perf_counter() - w)"
    runs = [
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
        for _ in range(IMPORT_ROUNDS)
    ]
    times = [tuple(map(float, run.stdout.split())) for run in runs]
    return statistics.median(cpu for cpu, _ in times), statistics.median(wall for _, wall in times)


def machine() -> str:
    """What it is measured on."""
    model = platform.processor() or platform.machine()
    with Path("/proc/cpuinfo").open(encoding="ascii", errors="replace") as file:
        model = next((line.partition(":")[2].strip() for line in file if line.startswith("model name")), model)
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}, python-can {can.__version__}"
    collector = "on" if gc.isenabled() else "off"
    return f"{model}, {os.cpu_count()} cores, load {load}; {versions}; collector frozen and {collector}"


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=21)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures too")
    arguments = parser.parse_args()
    shared = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=shared if shared.is_dir() else None) as folder:
        rings, ring = Rings(Path(folder)), RingWriter(Path(folder) / "naive.ring", records.SCALAR, CAPACITY)
        cases = [
            *mpu6050_cases(rings),
            *(node_case(rings, count, channels) for count, channels in ((10, 1), (100, 1), (100, 3))),
            *(qsb_case(rings, count) for count in (10, 100)),
            *(make(rings, rounds) for make in (virtual_case, slcan_case, socket_case) for rounds in (2, 20)),
        ]
        gc.collect()
        gc.freeze()
        print(machine())
        print(f"CPU us a record, medians of {arguments.rounds} rounds of {PUMPS} pumps\n")
        print(f"{'':64}{'ours':>8}{'bar':>8}{'objects':>10}{'to ring':>10}")
        lines = []
        for case in cases:
            lines.append(line := measured(case, arguments.rounds, ring))
            missed = "  MISSED" if line.ours > line.bar else ""
            naive = f"{line.objects:10.2f}{line.to_ring:10.2f}"
            print(f"{line.name:64}{line.ours:8.2f}{line.bar:8.2f}{naive}{missed}", flush=True)
    print(f"\n{'s, fresh interpreter':64}{'CPU':>8}{'bar':>8}{'wall':>8}")
    rooms = ", ".join(f"drivers.{room}" for room in ROOMS)
    slow = False
    for name, modules in (("import numpy alone", "numpy"), ("import drivers, every room", rooms)):
        cpu, wall = import_seconds(modules)
        slow = cpu > IMPORT_BAR_S and modules == rooms
        print(f"{name:64}{cpu:8.3f}{IMPORT_BAR_S:8.3f}{wall:8.3f}{'  MISSED' if slow else ''}", flush=True)
    if arguments.json:
        text = json.dumps({"machine": machine(), "us": [line._asdict() for line in lines], "import_s": [cpu, wall]})
        arguments.json.write_text(text, encoding="utf-8")
    return int(slow or any(line.ours > line.bar for line in lines))


if __name__ == "__main__":
    sys.exit(main())
