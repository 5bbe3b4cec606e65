"""Pumps of the IMU on I2C and of the serial devices, out of memory."""

import binascii
import struct
from collections import deque

import numpy as np
from cobs import cobs  # type: ignore[import-untyped]  # it ships no type hints

from bench import peers
from bench.pumps.case import MS, NaiveSample, PumpCase, Rings, nothing
from drivers.mpu6050 import Mpu6050, Mpu6050Config, decode_packets
from drivers.node_frame import NodeFrame, NodeFrameConfig
from drivers.qsb import Qsb

_NODE = struct.Struct("<BBHIIIIB")


def mpu6050_cases(rings: Rings) -> list[PumpCase]:
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
    samples: deque[NaiveSample] = deque()

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
            samples.append(NaiveSample(0, number, words))

    name = f"MPU-6050 FIFO, {count} samples"
    return [
        PumpCase(f"{name}, decode and push", 1.5, count, count, nothing, decoded, naive, samples),
        PumpCase(f"{name}, whole drain of the device", 1.5, count, count, fill, drained, naive, samples),
    ]


def node_case(rings: Rings, count: int, channels: int) -> PumpCase:
    """COBS frames, ``count`` of them a pump."""
    names = tuple(f"value_{place}" for place in range(channels))
    clock, port = peers.Clock(), peers.MemorySerial()
    config = NodeFrameConfig(channels=names)
    device = NodeFrame(f"node_{count}_{channels}", lambda: port, clock, config)
    descriptor = peers.node_descriptor(names, 0, clock() // 1000)
    schema = peers.node_schema(descriptor)
    samples: deque[NaiveSample] = deque()
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
                samples.append(NaiveSample(0, number, values))

    name = f"COBS node frames of {channels} channel{'s' * (channels > 1)}, {count} a pump"
    return PumpCase(name, 3.0, count, count * channels, fill, pumped, naive, samples)


def qsb_case(rings: Rings, count: int) -> PumpCase:
    """QSB lines, ``count`` of them a pump."""
    clock = peers.Clock()
    tick = clock() // peers.QSB_TICK_NS
    port = peers.MemorySerial(lambda command: peers.qsb_answer(command, clock() // peers.QSB_TICK_NS))
    device = Qsb(f"qsb_{count}", lambda: port, clock)
    samples: deque[NaiveSample] = deque()

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
                samples.append(NaiveSample(0, int(stamp, 16), (int(value, 16),)))

    return PumpCase(f"QSB lines, {count} a pump", 3.0, count, count, fill, pumped, naive, samples)
