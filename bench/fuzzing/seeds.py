"""Valid inputs to begin from, a few for each target."""

import struct

from bench import peers
from bench.fuzzing.decoders import CAN_GUARDS, CAN_IDS, CAN_NODES, NODE_CHANNELS
from bench.fuzzing.laws import joined
from drivers.bota_ft.frame import crc
from drivers.canopen_pdo import CanopenBus, SyncConfig
from drivers.modbus_load_cell.frame import read_request
from drivers.transports.can.can_slcan import encode_line
from tests.drivers.modbus_model import TransmitterModel, framed
from tests.drivers.nimu_model import NimuModel


def _canopen_seeds() -> list[bytes]:
    def entry(step: int, identifier: int, payload: bytes, *, pump: bool) -> bytes:
        return bytes([step << 5 | CAN_IDS.index(identifier), pump << 7 | len(payload)]) + payload

    rounds = b""
    for number in range(6):
        sync, *answers = peers.can_round(number)
        rounds += entry(2, *sync, pump=False)
        answers += [(0x184, struct.pack("<ii", 7 * number, -3)), (0x284, struct.pack("<h", number - 3))]
        rounds += b"".join(entry(1, *answer, pump=at == 3) for at, answer in enumerate(answers))
    phase = entry(0, 0x183, b"\3\1", pump=True)
    emergency = entry(0, 0x081, b"\x10\x81\x11\1\2\3\4\5", pump=True)
    beats = b"".join(entry(0, 0x701 + at, b"\5", pump=True) for at in range(4))
    boot = entry(5, 0x701, b"\0", pump=True) + entry(5, 0x702, b"\x7f", pump=True)
    clock = peers.Clock()
    port = peers.MemoryCan(clock)
    bus = CanopenBus(port, CAN_NODES, SyncConfig(), guards=CAN_GUARDS)
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
    return [b"\0\0\0" + wire, b"\2\0\0" + late, b"\0\x80\0" + joined(descriptor, *frames), b"\0\0\0" + descriptor]


def _dynamixel_seeds() -> list[bytes]:
    who = [peers.dynamixel_packet(f"fffffd000{n}0e005500fc03000000002d{n:02x}03fa", b"") for n in (1, 2)]
    limits = [peers.dynamixel_packet(f"fffffd000{n}05005500", b"P") for n in (1, 2)]
    present = bytes(range(10))
    rounds = [peers.dynamixel_packet(f"fffffd000{n}0e005500", present) for n in (1, 2)]
    fast = peers.dynamixel_packet("fffffd00fe1d00550001", present)
    fast = peers.dynamixel_packet((fast + b"\0\2").hex(), present)
    failing = peers.dynamixel_packet("fffffd00fe1d00558001", present)
    failing = peers.dynamixel_packet((failing + b"\0\2").hex(), present)
    error = peers.dynamixel_packet("fffffd000105005500", b"\x20")
    return [
        b"\1\1\0" + joined(*who, limits[0], fast, limits[1], fast, failing, error),
        b"\0\4\0" + joined(*who, *limits, *([b"".join(rounds)] * 3)),
        b"\x19\x81\x09" + joined(who[0], fast[:30], fast, rounds[0]),
    ]


def _bota_seeds() -> list[bytes]:
    content = [struct.pack("<H6fIf", 0, at, 0, -1, 0, 0, 0.5, 1000 * at, 25.0) for at in range(1, 60)]
    frames = [b"\xaa" + one + crc(one).to_bytes(2, "little") for one in content]
    again = b"".join(frames[:4])
    return [
        b"\0\0\0" + b"".join(frames[:24]),
        b"\x03\x90\0App Init\r\n" + b"".join(frames[:20]) + again,
        b"\0\x48\0" + again[:50] + b"".join(frames[5:9]) + b"r,0,C,0",
        b"\x05\xa1\x09" + b"".join(frames[30:50]) + again,
    ]


def seeds() -> dict[str, list[bytes]]:
    """Seeds by target."""
    imu = NimuModel()
    packets = b"".join(imu.packet() for _ in range(14))
    start = 10_000_000_000 // peers.QSB_TICK_NS
    lines = b"".join(peers.qsb_line("s", 0x0E, 1000 * at, start + at) for at in range(20))
    edges = peers.qsb_line("s", 0x05, 77, start + 21) + peers.qsb_line("s", 0x01, 1, start + 21)
    odd = b"s0E00000001!\r\ne 03 !\nQSB-D  0E!"
    asked = [read_request(1, 6, count) for count in (8, 9)]
    weights = [TransmitterModel(gross=one, net=one).receive(asked[0]) for one in (5, -5, 70_000)]
    refused = framed(b"\x01\x83\x02")
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
            b"\1\x01\0" + joined(*weights, refused),
            b"\x19\x81\x09"
            + joined(weights[0], weights[1][:9], refused, TransmitterModel(gross=9, net=9).receive(asked[1])),
            b"\1\x40\0" + joined(asked[0] + weights[0], weights[1]),
        ],
        "dsc": [b"\1\0\0" + joined(*numbers), b"\x19\1\x09" + joined(*numbers[::-1], b"+1\r+2\r", b"1" * 40)],
        "dynamixel": _dynamixel_seeds(),
        "bota_ft": _bota_seeds(),
        "node_frame": _node_seeds(),
        "sync_pulse": [
            bytes([0, 1, 0, 0]) * 20,
            bytes(
                [
                    0,
                    1,
                    0,
                    0,
                    1,
                    1,
                    3,
                    0,
                    2,
                    1,
                    0,
                    2,
                    8,
                    1,
                    0,
                    0,
                    0xC0,
                    1,
                    0,
                    0,
                    0,
                    1,
                    0,
                    0,
                    3,
                    1,
                    0xFF,
                    0xFF,
                    0,
                    1,
                    0,
                    0,
                ]
            ),
        ],
    }
