"""What fuzz.py throws bytes at: one function a decoder, and valid inputs to begin from.

A target takes any bytes. The first few (its head) choose the configuration, how the rest is cut into reads, the step of
the clock and which call of the port fails; the rest is what comes over the wire. Where a checksum stands between the
fuzzer and the decoder, a bit of the head has it put right, so that what lies behind is reached.

What is let pass is the named error of a decoder. ``start``, ``pump`` and ``stop`` of a device may raise nothing at all,
and rows and gaps of every channel have to add up to 0, 1, 2 ... without hole or overlap (``drivers.records``).
"""

import contextlib
import random
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

import numpy as np

from bench import peers
from drivers import dsc_load_cell, marks, modbus_load_cell, mpu6050, node_frame, records
from drivers import nimu as nimu_room
from drivers import qsb as qsb_room
from drivers.canopen_pdo import CanopenBus, CanopenObjectConfig, Cia404Config, Cia406Config, SyncConfig
from drivers.canopen_pdo import frame as canopen_frame
from drivers.device import Device
from drivers.errors import FrameError
from drivers.modbus_load_cell.frame import ModbusException, read_request
from drivers.mpu6050.decode import first_misaligned
from drivers.nimu.packet import CHECKSUM_SPANS
from drivers.ports import CanFrame
from drivers.records import Batch
from drivers.transports.can_slcan import SlcanDecoder, decode_line, encode_line

MS = 1_000_000
STEPS_NS = (10 * MS, MS, 100 * MS, 0, 1000 * MS, 60_000 * MS, 5 * MS, 3_600_000 * MS)
MOST_PUMPS = 48
TRANSFER_NS = 100_000  # three bytes at 400 kHz: no bus is faster, and no two stamps are the same
ERRNOS = (5, 6, 121, 110, 11)  # EIO, ENXIO, EREMOTEIO, ETIMEDOUT, EAGAIN
NODE_CHANNELS = ("angle", "force")
CAN_IDS = (0x080, 0x281, 0x182, 0x183, 0x581, 0x582, 0x583, 0x701, 0x702, 0x703, 0x081, 0x082, 0x083, 0x7FF, 0x181, 0)
CAN_STEPS_NS = (0, 300_000, 5 * MS, 4 * MS, -MS, 50 * MS, 600 * MS, 3000 * MS)
CAN_NODES = (
    Cia406Config("joint_1", 1, 500_000),
    Cia404Config("load_cell", 2, 1000.0),
    CanopenObjectConfig("phase", 3, 1, 0, "u8", 0x2000, 1),
)


class Stream(Protocol):
    """A decoder that is fed, and asked until it has nothing more."""

    def receive(self, data: bytes) -> None:
        """More bytes."""

    def take(self) -> object | None:
        """What they made; raises FrameError."""


class Ledger:
    """Batches of one device: are their dtypes known ones, do rows and gaps add up?"""

    _DTYPES = (records.IMU, records.SCALAR, records.CAN_SYNC, records.EVENT, records.GAP, marks.MARK)

    def __init__(self) -> None:
        self._spans: dict[str, list[tuple[int, int]]] = {}

    def take(self, batches: list[Batch]) -> None:
        """Enter batches."""
        for channel, rows in batches:
            assert rows.dtype in self._DTYPES, f"{channel}: {rows.dtype}"
            assert len(rows), f"{channel}: a batch of nothing"
            if channel == "gap":
                for gap in rows:
                    span = int(gap["first_missing"]), int(gap["last_missing"])
                    self._spans.setdefault(gap["channel"].decode(), []).append(span)
            elif channel != "event":
                numbers = rows["sequence"]
                ends = np.flatnonzero(np.diff(numbers) != 1) + 1
                spans = [(int(run[0]), int(run[-1])) for run in np.split(numbers, ends)]
                self._spans.setdefault(channel, []).extend(spans)

    def check(self) -> None:
        """Every number of every channel once."""
        for channel, spans in self._spans.items():
            following = 0
            for first, last in sorted(spans):
                assert first == following, f"{channel}: {first}..{last} where {following} follows"
                assert last >= first, f"{channel}: a gap from {first} to {last}"
                following = last + 1


def _cut(data: bytes, how: int, least: int = 1) -> Iterator[bytes]:
    """Pieces of ``data``: all at once (0), ``least`` bytes at a time (1), or of random length."""
    rng = random.Random(how)
    at = 0
    while at < len(data):
        size = len(data) if how == 0 else least if how == 1 else least + rng.randrange(60)
        yield data[at : at + size]
        at += size


def _split(data: bytes) -> Iterator[bytes]:
    """Records, each led by its length."""
    at = 0
    while at < len(data):
        yield data[at + 1 : at + 1 + data[at]]
        at += 1 + data[at]


def _joined(*parts: bytes) -> bytes:
    return b"".join(bytes([len(part)]) + part for part in parts)


def _head(data: bytes, size: int) -> tuple[bytes, bytes]:
    return data[:size].ljust(size, b"\0"), data[size:]


def _exhaust(stream: Stream, data: bytes, how: int) -> None:
    """Feed a stream decoder: it must come to an end."""
    for piece in _cut(data, how):
        stream.receive(piece)
        for _ in range(2 * len(data) + 2):
            try:
                if stream.take() is None:
                    break
            except FrameError:
                continue
        else:
            raise AssertionError("take gives something without end")


def _drive(device: Device, clock: peers.Clock, steps: Iterator[None], step_ns: int) -> None:
    """Start, pump once a step, stop; start and stop again, as after a pause."""
    ledger = Ledger()
    ledger.take(device.start(clock()))
    for _ in steps:
        clock.now_ns += step_ns
        ledger.take(device.pump(clock()))
    for _ in range(2):
        clock.now_ns += step_ns
        ledger.take(device.stop(clock()))
        ledger.take(device.start(clock()))
        ledger.take(device.pump(clock()))
    ledger.take(device.stop(clock()))
    ledger.check()


def _said(port: peers.MemorySerial, data: bytes, how: int) -> Iterator[None]:
    for piece in _cut(data, how, len(data) // MOST_PUMPS + 1):
        port.waiting += piece
        yield


# Targets


def mpu6050_fifo(data: bytes) -> None:
    """FIFO decode, and the device on a chip whose count, status, registers and errors the bytes say."""
    (which, identity), body = _head(data, 2)
    config = mpu6050.Mpu6050Config(
        accel_range_g=(2, 4, 8, 16)[which & 3],
        gyro_range_deg_s=(250, 500, 1000, 2000)[which >> 2 & 3],
        filter_code=(which >> 4) % 7,
        max_transfer_bytes=(14, 32, 252, 8192)[which >> 6],
        mode="burst" if identity & 4 else "fifo",
    )
    with contextlib.suppress(FrameError):
        rows = mpu6050.decode_packets(body, config)
        first_misaligned(rows["temperature_raw"], None if which & 1 else -3920)
    clock = peers.Clock()
    chip = peers.MemoryMpu6050(clock, (0x68, 0x70, 0x98, identity)[identity & 3], TRANSFER_NS)
    device = mpu6050.Mpu6050("imu", chip, config)

    def steps() -> Iterator[None]:
        for _ in range(2):  # reset, wake and run
            clock.now_ns += 200 * MS
            yield
        for number in range(min(len(body) // 3, MOST_PUMPS)):
            kind, a, b = body[3 * number : 3 * number + 3]
            chip.count = None
            if kind & 7 < 3:
                chip.fifo = peers.mpu6050_packets(100 * number, (a % 75, 10, 300)[kind & 3])
            elif kind & 7 == 3:
                chip.fifo, chip.count = body, a << 8 | b
            elif kind & 7 == 4:
                chip.fail_in, chip.code = a % 16, ERRNOS[b % 5]
            elif kind & 7 == 5:
                chip.registers[a % 128] = b
            elif kind & 7 == 6:
                chip.registers[0x3A] = a
                chip.fifo = body[3 * number :] * 14
            clock.now_ns += STEPS_NS[kind >> 3 & 7]
            yield

    _drive(device, clock, steps(), 0)


def canopen(data: bytes) -> None:
    """Any frames, at any time, to a bus of three nodes; every frame decoder of its own too."""
    (which,), body = _head(data, 1)
    for decode in (
        canopen_frame.decode_heartbeat,
        canopen_frame.decode_sync,
        canopen_frame.decode_emergency,
        canopen_frame.decode_sdo_reply,
    ):
        with contextlib.suppress(FrameError):
            decode(body[:9])
    clock = peers.Clock()
    port = peers.MemoryCan(clock, answering=bool(which & 1))
    bus = CanopenBus(port, CAN_NODES, SyncConfig(period_ms=5.0))

    def steps() -> Iterator[None]:
        for _ in range(40 if which & 1 else 0):  # the setting up
            clock.now_ns += MS
            yield
        at = 0
        while at + 2 <= len(body):
            head, size = body[at : at + 2]
            step_ns = CAN_STEPS_NS[head >> 5]  # a stamp may be older than the one before it, the clock never goes back
            clock.now_ns += max(step_ns, 0)
            payload = body[at + 2 : at + 2 + (size & 15) % 9]
            frame = CanFrame(clock() + min(step_ns, 0), CAN_IDS[head & 15], payload, bool(head & 16))
            port.waiting.append(frame)
            at += 2 + (size & 15) % 9
            if size & 0x80:
                yield
        yield

    _drive(bus, clock, steps(), 0)


def slcan(data: bytes) -> None:
    """The same bytes at once and in pieces: the same frames; each frame survives being sent."""
    (how,), body = _head(data, 1)
    whole = SlcanDecoder().feed(body)
    decoder = SlcanDecoder()
    pieces = [frame for piece in _cut(body, how or 1) for frame in decoder.feed(piece)]
    assert pieces == whole, "pieces give other frames than the whole"
    for identifier, payload in whole:
        assert decode_line(encode_line(identifier, payload)[:-1]) == (identifier, payload)
    with contextlib.suppress(FrameError):
        decode_line(body)
    with contextlib.suppress(FrameError):
        encode_line(int.from_bytes(body[:2], "big"), body[2:])


def nimu(data: bytes) -> None:
    """Packets by the decoder and by the device."""
    (how, which, fail_at), body = _head(data, 3)
    span = tuple(CHECKSUM_SPANS)[which % 3]
    if which & 0x80:
        at = body.find(peers.NIMU_HEADER)
        while at >= 0:
            body = body[:at] + peers.nimu_summed(body[at:], CHECKSUM_SPANS[span])
            at = body.find(peers.NIMU_HEADER, at + 5)
    with contextlib.suppress(FrameError):
        nimu_room.decode_packets(body, span)
    _exhaust(nimu_room.PacketStream(span), body, how)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    config = nimu_room.NimuConfig(checksum_span=span, magnetometer=bool(which & 8))
    device = nimu_room.Nimu("imu", lambda: port, clock, config)
    _drive(device, clock, _said(port, body, how), STEPS_NS[which >> 4 & 7])


def qsb(data: bytes) -> None:
    """Lines by the decoder and by the device, whose commands are answered or not."""
    (how, which, fail_at), body = _head(data, 3)
    with contextlib.suppress(FrameError):
        qsb_room.decode_lines(body)
    _exhaust(qsb_room.LineStream(), body, how)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    if not which & 0x80:
        port.answer = lambda command: peers.qsb_answer(command, clock() // peers.QSB_TICK_NS)
    config = qsb_room.QsbConfig(
        interval_ticks=(1, 1, 5, 0xFFFE)[which & 3], sync_edge=(None, "falling", "rising", "rising")[which >> 2 & 3]
    )
    device = qsb_room.Qsb("joint", lambda: port, clock, config)
    _drive(device, clock, _said(port, body, how), STEPS_NS[which >> 4 & 7])


def _polled(device: Device, port: peers.MemorySerial, clock: peers.Clock, answers: Iterator[bytes], how: int) -> None:
    """A polled device; each question is given the next answer, at once or half now and half later."""
    late: list[bytes] = []

    def answer(question: bytes) -> bytes:
        del question
        said = next(answers, b"")
        half = len(said) // 2 if how & 8 else len(said)
        late.append(said[half:])
        return said[:half]

    def steps() -> Iterator[None]:
        for _ in range(MOST_PUMPS // 2):
            port.waiting += b"".join(late)
            late.clear()
            yield

    port.answer = answer
    _drive(device, clock, steps(), STEPS_NS[how & 7])


def modbus(data: bytes) -> None:
    """Answers to a read by the decoder and by the device."""
    (how, which, fail_at), body = _head(data, 3)
    answers = list(_split(body))
    if which & 0x80:
        answers = [said[:-2] + peers.modbus_crc(said[:-2]) for said in answers]
    config = modbus_load_cell.ModbusLoadCellConfig(
        values=(("gross",), ("gross", "net"), ("net",))[which % 3],
        sign=("status", "twos_complement", "positive")[which // 3 % 3],
        echo=bool(which & 0x40),
        sample_period_ms=20.0 if which & 0x20 else 0.0,
    )
    for said in answers:
        decoder = modbus_load_cell.Answer(read_request(1, 6, 8), config.echo)
        with contextlib.suppress(FrameError, ModbusException):
            for piece in _cut(said, how >> 4):
                registers = decoder.receive(piece)
                assert decoder.missing >= 1
                if registers is not None:
                    modbus_load_cell.decode_weights(registers, config)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    device = modbus_load_cell.ModbusLoadCell("cell", lambda: port, clock, config)
    _polled(device, port, clock, iter(answers), how)


def dsc(data: bytes) -> None:
    """Answers to a read by the decoder and by the device."""
    (how, which, fail_at), body = _head(data, 3)
    answers = list(_split(body))
    for said in answers:
        with contextlib.suppress(FrameError):
            dsc_load_cell.decode_number(said)
        decoder = dsc_load_cell.Answer()
        with contextlib.suppress(FrameError):
            for piece in _cut(said, how >> 4):
                decoder.receive(piece)
    config = dsc_load_cell.DscLoadCellConfig(sample_period_ms=20.0 if which & 1 else 0.0)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    device = dsc_load_cell.DscLoadCell("cell", lambda: port, clock, config)
    _polled(device, port, clock, iter(answers), how)


def node(data: bytes) -> None:
    """Frames by the decoder and by the device; a bit of the head frames records that have no CRC and no COBS."""
    (how, which, fail_at), body = _head(data, 3)
    with contextlib.suppress(FrameError):
        node_frame.decode_descriptor(body)
    if which & 0x80:
        framed = b""
        schema = 0
        for record in _split(body):
            payload = record
            if payload[:1] == b"\x11" and len(payload) > 20:
                schema = peers.node_schema(payload)
            if payload[:1] in {b"\x10", b"\x11"} and not which & 8:
                payload = payload[:2] + schema.to_bytes(2, "little") + payload[4:]
            framed += peers.node_framed(payload)
            if payload[:1] == b"\x11":
                with contextlib.suppress(FrameError):
                    node_frame.decode_descriptor(payload + b"\0\0")
        body = framed
    _exhaust(node_frame.FrameStream(), body, how)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    device = node_frame.NodeFrame("node", lambda: port, clock, node_frame.NodeFrameConfig(channels=NODE_CHANNELS))
    _drive(device, clock, _said(port, body, how), STEPS_NS[which >> 4 & 7])


# Seeds


def _canopen_seeds() -> list[bytes]:
    def entry(step: int, identifier: int, payload: bytes, *, pump: bool) -> bytes:
        return bytes([step << 5 | CAN_IDS.index(identifier), pump << 7 | len(payload)]) + payload

    rounds = b""
    for number in range(6):
        sync, *answers = peers.can_round(number)
        rounds += entry(2, *sync, pump=False)
        rounds += b"".join(entry(1, *answer, pump=at == 1) for at, answer in enumerate(answers))
    phase = entry(0, 0x183, b"\3\1", pump=True)
    emergency = entry(0, 0x081, b"\x10\x81\x11\1\2\3\4\5", pump=True)
    beats = b"".join(entry(0, 0x701 + at, b"\5", pump=True) for at in range(3))
    boot = entry(5, 0x701, b"\0", pump=True) + entry(5, 0x702, b"\x7f", pump=True)
    clock = peers.Clock()
    port = peers.MemoryCan(clock)
    bus = CanopenBus(port, CAN_NODES, SyncConfig())
    bus.start(clock())
    answered = b""
    while port.waiting:
        answered += b"".join(entry(0, frame.identifier, frame.data, pump=True) for frame in port.waiting)
        bus.pump(clock())
    lost = entry(2, 0x080, b"\1", pump=True) + entry(6, 0x080, b"\x20", pump=True) + entry(7, 0x080, b"\5", pump=True)
    return [
        b"\1" + rounds + phase + emergency + beats,
        b"\1" + boot + rounds,
        b"\0" + answered + rounds,
        b"\1" + lost + rounds,
    ]


def _node_seeds() -> list[bytes]:
    descriptor = peers.node_descriptor(NODE_CHANNELS, 0, 10_000_000)
    schema = peers.node_schema(descriptor)
    frames = [peers.node_data(schema, at, 10_000_000 + 1000 * at, (at, -at), at // 4) for at in range(12)]
    again = peers.node_descriptor(NODE_CHANNELS, 12, 10_012_000)
    wire = b"".join(map(peers.node_framed, [descriptor, *frames, again]))
    late = b"".join(map(peers.node_framed, [*frames[:4], descriptor, *frames[4:]]))
    return [b"\0\0\0" + wire, b"\2\0\0" + late, b"\0\x80\0" + _joined(descriptor, *frames), b"\0\0\0" + descriptor]


def _seeds() -> dict[str, list[bytes]]:
    packets = b"".join(peers.nimu_packet(at) for at in range(14))
    start = 10_000_000_000 // peers.QSB_TICK_NS
    lines = b"".join(peers.qsb_line("s", 0x0E, 1000 * at, start + at) for at in range(20))
    edges = peers.qsb_line("s", 0x05, 77, start + 21) + peers.qsb_line("s", 0x01, 1, start + 21)
    odd = b"s0E00000001!\r\ne 03 !\nQSB-D  0E!"
    asked = [read_request(1, 6, count) for count in (8, 9)]
    weights = [peers.modbus_answer(asked[0], gross) for gross in (5, -5, 70_000)]
    refused = b"\x01\x83\x02" + peers.modbus_crc(b"\x01\x83\x02")
    numbers = [b"+123.45\r", b"-000.10\r", b"?\r", b"+1.2\r"]
    can = b"".join(encode_line(identifier, payload) for at in range(8) for identifier, payload in peers.can_round(at))
    return {
        "mpu6050": [
            b"\0\0" + bytes(range(3)) * 14,
            b"\x85\x02" + bytes([0, 9, 0, 1, 0, 0, 4, 3, 2, 0, 9, 0, 3, 0, 28, 6, 16, 0, 5, 0x6B, 0x40, 24, 0, 0]),
            b"\x01\x01" + peers.mpu6050_packets(0, 20),
            b"\x01\x04" + bytes([1, 0, 0, 9, 0, 0, 5, 0x3A, 1]) * 5,
        ],
        "canopen": _canopen_seeds(),
        "slcan": [b"\0" + can, b"\2" + b"t1234AABBCCDD\rT0000012320102\r\az\rV1013\rt12320102A1B2\r"],
        "nimu": [b"\0\0\0" + packets, b"\3\x89\0" + packets, b"\2\x18\x09" + packets[:200] + packets[230:]],
        "qsb": [b"\0\2\0" + lines + edges, b"\2\x0d\x1f" + odd + lines, b"\1\x80\0" + lines + odd],
        "modbus": [
            b"\1\x01\0" + _joined(*weights, refused),
            b"\x19\x81\x09" + _joined(weights[0], weights[1][:9], refused, peers.modbus_answer(asked[1], 9)),
            b"\1\x40\0" + _joined(asked[0] + weights[0], weights[1]),
        ],
        "dsc": [b"\1\0\0" + _joined(*numbers), b"\x19\1\x09" + _joined(*numbers[::-1], b"+1\r+2\r", b"1" * 40)],
        "node_frame": _node_seeds(),
    }


class Target(NamedTuple):
    """A decoder under fuzz: what is called, and valid inputs."""

    call: Callable[[bytes], None]
    seeds: list[bytes]


_CALLS = {
    "mpu6050": mpu6050_fifo,
    "canopen": canopen,
    "slcan": slcan,
    "nimu": nimu,
    "qsb": qsb,
    "modbus": modbus,
    "dsc": dsc,
    "node_frame": node,
}


def targets() -> dict[str, Target]:
    """All of them, by name."""
    seeds = _seeds()
    return {name: Target(call, seeds[name]) for name, call in _CALLS.items()}
