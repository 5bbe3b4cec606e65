"""What is under fuzz: one function a decoder.

A target takes any bytes. The first few (its head) choose the configuration, how the rest is cut into reads, the step of
the clock and which call of the port fails; the rest is what comes over the wire. Where a checksum stands between the
fuzzer and the decoder, a bit of the head has it put right, so that what lies behind is reached.
"""

import binascii
import contextlib
from collections.abc import Callable, Iterator

from cobs import cobs  # type: ignore[import-untyped]

from bench import peers
from bench.fuzzing.laws import MOST_PUMPS, MS, STEPS_NS, cut, drive, exhaust, leading, polled, split, spoken
from drivers import dsc_load_cell, dynamixel, modbus_load_cell, mpu6050, node_frame
from drivers import nimu as nimu_room
from drivers import qsb as qsb_room
from drivers.bota_ft import BotaFt, BotaFtConfig
from drivers.bota_ft import frame as bota_frame
from drivers.canopen_pdo import CanopenBus, CanopenObjectConfig, Cia402Config, Cia404Config, Cia406Config, SyncConfig
from drivers.canopen_pdo import frame as canopen_frame
from drivers.canopen_pdo.guarding import GuardConfig
from drivers.errors import FrameError
from drivers.inertial.packet import first_misaligned
from drivers.modbus_load_cell.frame import ModbusException, read_request
from drivers.nimu.packet import CHECKSUM_SPANS
from drivers.ports import CanFrame, Edge
from drivers.serial_line.scalars import WrenchChannel
from drivers.sync_pulse import SyncPulse
from drivers.transports.can.can_slcan import SlcanDecoder, decode_line, encode_line
from tests.drivers.modbus_model import framed

TRANSFER_NS = 100_000  # three bytes at 400 kHz: no bus is faster, and no two stamps are the same
ERRNOS = (5, 6, 121, 110, 11)  # EIO, ENXIO, EREMOTEIO, ETIMEDOUT, EAGAIN
DYNAMIXEL_IDS = (1, 2)
NODE_CHANNELS = ("angle", "force")
CAN_IDS = (
    *(0x080, 0x281, 0x182, 0x183, 0x184, 0x284),
    *(0x581, 0x582, 0x583, 0x584, 0x701, 0x702, 0x703, 0x704, 0x081, 0x7FF),
)
CAN_STEPS_NS = (0, 300_000, 5 * MS, 4 * MS, -MS, 50 * MS, 600 * MS, 3000 * MS)
CAN_NODES = (
    Cia406Config("joint_1", 1, 500_000),
    Cia404Config("load_cell", 2, 1000.0),
    CanopenObjectConfig("phase", 3, 1, 0, "u8", 0x2000, 1),
    Cia402Config(4, 4096, position="shoulder", velocity="shoulder_speed", torque="shoulder_torque"),
)
CAN_GUARDS = (GuardConfig(3),)  # it makes no heartbeat


def mpu6050_fifo(data: bytes) -> None:
    """FIFO decode, and the device on a chip whose count, status, registers and errors the bytes say."""
    (which, identity), body = leading(data, 2)
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

    drive(device, clock, steps(), 0)


def canopen(data: bytes) -> None:
    """Any frames, at any time, to a bus of four nodes; every frame decoder of its own too."""
    (which,), body = leading(data, 1)
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
    bus = CanopenBus(port, CAN_NODES, SyncConfig(period_ms=5.0), guards=CAN_GUARDS)

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

    drive(bus, clock, steps(), 0)


def slcan(data: bytes) -> None:
    """The same bytes at once and in pieces: the same frames; each frame survives being sent."""
    (how,), body = leading(data, 1)
    whole = SlcanDecoder().feed(body)
    decoder = SlcanDecoder()
    pieces = [frame for piece in cut(body, how or 1) for frame in decoder.feed(piece)]
    assert pieces == whole, "pieces give other frames than the whole"
    for identifier, payload in whole:
        assert decode_line(encode_line(identifier, payload)[:-1]) == (identifier, payload)
    with contextlib.suppress(FrameError):
        decode_line(body)
    with contextlib.suppress(FrameError):
        encode_line(int.from_bytes(body[:2], "big"), body[2:])


def nimu(data: bytes) -> None:
    """Packets by the decoder and by the device."""
    (how, which, fail_at), body = leading(data, 3)
    span = tuple(CHECKSUM_SPANS)[which % 3]
    if which & 0x80:
        at = body.find(peers.NIMU_HEADER)
        while at >= 0:
            body = body[:at] + peers.nimu_summed(body[at:], CHECKSUM_SPANS[span])
            at = body.find(peers.NIMU_HEADER, at + 5)
    exhaust(nimu_room.PacketStream(span), body, how)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    config = nimu_room.NimuConfig(checksum_span=span, magnetometer=bool(which & 8))
    device = nimu_room.Nimu("imu", lambda: port, clock, config)
    drive(device, clock, spoken(port, body, how), STEPS_NS[which >> 4 & 7])


def qsb(data: bytes) -> None:
    """Lines by the decoder and by the device, whose commands are answered or not."""
    (how, which, fail_at), body = leading(data, 3)
    exhaust(qsb_room.LineStream(), body, how)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    if not which & 0x80:
        port.answer = lambda command: peers.qsb_answer(command, clock() // peers.QSB_TICK_NS)
    config = qsb_room.QsbConfig(
        interval_ticks=(1, 1, 5, 0xFFFE)[which & 3], sync_edge=(None, "falling", "rising", "rising")[which >> 2 & 3]
    )
    device = qsb_room.Qsb("joint", lambda: port, clock, config)
    drive(device, clock, spoken(port, body, how), STEPS_NS[which >> 4 & 7])


def modbus(data: bytes) -> None:
    """Answers to a read by the decoder and by the device."""
    (how, which, fail_at), body = leading(data, 3)
    answers = list(split(body))
    if which & 0x80:
        answers = [framed(said[:-2]) for said in answers]
    config = modbus_load_cell.ModbusLoadCellConfig(
        values=(("gross",), ("gross", "net"), ("net",))[which % 3],
        sign=("status", "twos_complement", "positive")[which // 3 % 3],
        echo=bool(which & 0x40),
        sample_period_ms=20.0 if which & 0x20 else 0.0,
    )
    for said in answers:
        decoder = modbus_load_cell.ModbusReply(read_request(1, 6, 8), config.echo)
        with contextlib.suppress(FrameError, ModbusException):
            for piece in cut(said, how >> 4):
                registers = decoder.receive(piece)
                assert decoder.missing >= 1
                if registers is not None:
                    modbus_load_cell.decode_weights(registers, config)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    device = modbus_load_cell.ModbusLoadCell("cell", lambda: port, clock, config)
    polled(device, port, clock, iter(answers), how)


def dsc(data: bytes) -> None:
    """Answers to a read by the decoder and by the device."""
    (how, which, fail_at), body = leading(data, 3)
    answers = list(split(body))
    for said in answers:
        with contextlib.suppress(FrameError):
            dsc_load_cell.decode_number(said)
        decoder = dsc_load_cell.DscReply()
        with contextlib.suppress(FrameError):
            for piece in cut(said, how >> 4):
                decoder.receive(piece)
    config = dsc_load_cell.DscLoadCellConfig(sample_period_ms=20.0 if which & 1 else 0.0)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    device = dsc_load_cell.DscLoadCell("cell", lambda: port, clock, config)
    polled(device, port, clock, iter(answers), how)


def dynamixel_line(data: bytes) -> None:
    """Answers of servos by the decoder and by the device of a line of them."""
    (how, which, fail_at), body = leading(data, 3)
    answers = list(split(body))
    if which & 0x80:
        answers = [said[:-2] + dynamixel.crc16(said[:-2]).to_bytes(2, "little") for said in answers]
    for said in answers:
        reply = dynamixel.Reply(DYNAMIXEL_IDS, 10, fast=bool(which & 1))
        with contextlib.suppress(FrameError):
            for piece in cut(said, how >> 4):
                reply.receive(piece)
                assert reply.missing >= 1
        assert len(reply.blocks) <= len(DYNAMIXEL_IDS)
    servos = [dynamixel.DynamixelConfig(f"joint_{one}", one, velocity=True, torque=True) for one in DYNAMIXEL_IDS]
    timing = dynamixel.DynamixelTiming(20.0 if which & 2 else 0.0, fast_sync_read=not which & 4)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    polled(dynamixel.DynamixelBus("arm", servos, lambda: port, clock, timing), port, clock, iter(answers), how)


def _frames_taken(data: bytes) -> list[bytes]:
    stream, taken = node_frame.FrameStream(), list[bytes]()
    stream.receive(data)
    while True:
        try:
            payloads = stream.take()
        except FrameError:
            continue
        if payloads is None:
            return taken
        taken += payloads


def _frames_in(data: bytes) -> list[bytes]:
    """By the cobs package: those of 4 bytes or more whose CRC is right, the CRC included."""
    found = []
    for frame in data.split(b"\0")[:-1]:
        with contextlib.suppress(cobs.DecodeError):
            payload = cobs.decode(frame)
            if len(payload) >= 4 and not binascii.crc_hqx(payload, 0xFFFF):
                found.append(payload)
    return found


def node(data: bytes) -> None:
    """Frames by the decoder and by the device; a bit of the head frames records that have no CRC and no COBS."""
    (how, which, fail_at), body = leading(data, 3)
    with contextlib.suppress(FrameError):
        node_frame.decode_descriptor(body)
    if which & 0x80:
        framed = b""
        schema = 0
        for record in split(body):
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
    assert _frames_taken(body) == _frames_in(body), "other frames than COBS and CRC allow"
    exhaust(node_frame.FrameStream(), body, how)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    device = node_frame.NodeFrame("node", lambda: port, clock, node_frame.NodeFrameConfig(channels=NODE_CHANNELS))
    drive(device, clock, spoken(port, body, how), STEPS_NS[which >> 4 & 7])


def sync_pulse(data: bytes) -> None:
    """Edges with any stamp and any number on the line; the port may fail."""
    clock = peers.Clock()
    port = peers.MemoryPulses()

    def steps() -> Iterator[None]:
        number = 0
        for at in range(0, len(data) - 3, 4):
            kind, step, low, high = data[at : at + 4]
            number = (number + (1, low, low << 8 | high, low << 24 | high << 16)[kind & 3]) % (1 << 32)
            port.waiting.append(Edge(clock() - (step << 12 if kind & 4 else 0), clock(), number))
            port.fails = kind & 0xC0 == 0xC0
            clock.now_ns += STEPS_NS[kind >> 3 & 7]
            if step & 1:
                yield

    drive(SyncPulse("pulse", port), clock, steps(), 0)


def bota(data: bytes) -> None:
    """Frames by the decoder and by the device, whose commands are answered with codes that the bytes say, or not."""
    (how, which, fail_at), body = leading(data, 3)
    if which & 0x80:  # the checksums are put right
        at = body.find(bota_frame.START)
        while at >= 0:
            content = body[at + 1 : at + 1 + bota_frame.CONTENT_BYTES]
            end = at + bota_frame.FRAME_BYTES
            body = body[: at + 1] + content + bota_frame.crc(content).to_bytes(2, "little") + body[end:]
            at = body.find(bota_frame.START, end)
    with contextlib.suppress(FrameError):
        bota_frame.decode_frame(body[: bota_frame.FRAME_BYTES])
    exhaust(bota_frame.wrench_stream(), body, how)
    clock, port = peers.Clock(), peers.MemorySerial(fail_at=fail_at)
    if not which & 0x40:
        port.answer = lambda command: b"r,0,%c,%d\r\n" % (command[0], which & 8)
    channels = [WrenchChannel("fx", 0, "N"), WrenchChannel("warm", 6, "degC")]
    device = BotaFt("wrist", channels, lambda: port, clock, BotaFtConfig((100.0, 800.0)[which & 1]))
    drive(device, clock, spoken(port, body, how), STEPS_NS[which >> 4 & 3])


CALLS: dict[str, Callable[[bytes], None]] = {
    "mpu6050": mpu6050_fifo,
    "canopen": canopen,
    "slcan": slcan,
    "nimu": nimu,
    "qsb": qsb,
    "modbus": modbus,
    "dsc": dsc,
    "dynamixel": dynamixel_line,
    "node_frame": node,
    "sync_pulse": sync_pulse,
    "bota_ft": bota,
}
