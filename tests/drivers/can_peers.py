"""CANopen nodes and a SYNC producer for the tests of the driver, typed from CiA 301, 402, 404, 406: none of ours."""

import errno
import os
import struct

from drivers.ports import CanFrame

MS = 1_000_000
NO_OBJECT, READ_ONLY = 0x06020000, 0x06010002


def u8(value):
    return value.to_bytes(1, "little")


def u16(value):
    return value.to_bytes(2, "little")


def u32(value):
    return value.to_bytes(4, "little")


class FakeCan:
    """A CAN port: what is sent is kept, what waits is received. ``down`` makes it fail."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, bytes]] = []
        self.asked: list[tuple[int, int]] = []  # remote frames: identifier, size
        self.inbox: list[CanFrame] = []
        self.down = False
        self.muted = False

    def send(self, identifier, data):
        self._check()
        self.sent.append((identifier, bytes(data)))

    def request(self, identifier, size):
        self._check()
        self.asked.append((identifier, size))

    def receive(self, timeout_s):
        self._check()
        waiting, self.inbox = self.inbox, []
        return waiting

    def mute(self):
        self._check()
        self.muted = True

    def close(self):
        pass

    def put(self, host_ns, identifier, data, is_error=False):
        self.inbox.append(CanFrame(host_ns, identifier, bytes(data), is_error))

    def _check(self):
        if self.down:
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))


class PeerNode:
    """A node: object dictionary, SDO server, NMT state, heartbeat, one TPDO on SYNC.

    Args:
        number: Node number.
        factory: (index, subindex): bytes.
        objects: What is otherwise; None: it is not there.
        read_only: Objects that refuse a write.
    """

    def __init__(self, number, factory, objects=(), read_only=()) -> None:
        self.number = number
        changed = {**factory, **dict(objects)}
        self.factory = {key: value for key, value in changed.items() if value is not None}
        self.objects = dict(self.factory)
        self.read_only = set(read_only) | {(0x1000, 0)}
        self.state = 0x7F
        self.deaf = False
        self.requests: list[tuple] = []
        self.heartbeat_ns = 0
        self.answers = 0  # TPDOs sent on SYNC
        self.toggle = 0  # of its next answer to guarding
        self.guarded = 0

    def boot(self, now_ns):
        """Power-on: everything as from the factory, and a boot-up message."""
        self.objects = dict(self.factory)
        self.toggle = 0
        self.state = 0x7F
        self.heartbeat_ns = now_ns
        return [(0x700 + self.number, b"\0")]

    def nmt(self, command):
        self.state = {0x01: 0x05, 0x02: 0x04, 0x80: 0x7F}[command]

    def sdo(self, data):
        """Answer to a request; None when it does not answer."""
        command, index, subindex = struct.unpack_from("<BHB", data)
        key = (index, subindex)
        if self.deaf:
            return None
        head = struct.pack("<HB", index, subindex)
        if command == 0x40:
            self.requests.append(("read", *key))
            if key not in self.objects:
                return b"\x80" + head + u32(NO_OBJECT)
            value = self.objects[key]
            if len(value) > 4:
                return b"\x41" + head + u32(len(value))
            return bytes([{1: 0x4F, 2: 0x4B, 3: 0x47, 4: 0x43}[len(value)]]) + head + value.ljust(4, b"\0")
        if command == 0x80:
            self.requests.append(("abort", *key))
            return None
        size = {0x2F: 1, 0x2B: 2, 0x27: 3, 0x23: 4}[command]
        self.requests.append(("write", *key, int.from_bytes(data[4 : 4 + size], "little")))
        if key not in self.objects:
            return b"\x80" + head + u32(NO_OBJECT)
        if key in self.read_only:
            return b"\x80" + head + u32(READ_ONLY)
        assert size == len(self.objects[key]), f"{key} written with {size} bytes"
        self.objects[key] = data[4 : 4 + size]
        return b"\x60" + head + bytes(4)

    def heartbeat(self, now_ns):
        period_ns = int.from_bytes(self.objects.get((0x1017, 0), b"\0"), "little") * MS
        if period_ns and now_ns - self.heartbeat_ns >= period_ns and not self.deaf:
            self.heartbeat_ns = now_ns
            return [(0x700 + self.number, bytes([self.state]))]
        return []

    def guard(self):
        """Answer to a remote frame; None when it does not answer (CiA 301, 7.2.8.3.2.1)."""
        if self.deaf or int.from_bytes(self.objects.get((0x1017, 0), b"\0"), "little"):
            return None
        self.guarded += 1
        answer = bytes([self.toggle | self.state])
        self.toggle ^= 0x80
        return answer

    def on_sync(self, number, now_ns):
        """TPDOs that this node sends on SYNC ``number``."""
        if self.state != 0x05 or self.deaf:
            return []
        frames = []
        for pdo in range(4):
            cob_id = int.from_bytes(self.objects.get((0x1800 + pdo, 1), u32(1 << 31)), "little")
            kind = self.objects.get((0x1800 + pdo, 2), b"\xff")[0]
            if not cob_id & 0x8000_0000 and 1 <= kind <= 240:
                data = b""
                for place in range(self.objects[0x1A00 + pdo, 0][0]):
                    entry = int.from_bytes(self.objects[0x1A00 + pdo, place + 1], "little")
                    data += self.value(entry >> 16, number, now_ns)[: (entry & 0xFF) // 8]
                frames.append((cob_id & 0x7FF, data))
        self.answers += len(frames)
        return frames

    def value(self, index, number, now_ns):
        raise NotImplementedError


class Encoder(PeerNode):
    """CiA 406; its position is made of the SYNC number, so that every row can be recognised."""

    def __init__(self, number=1, offset=0, **changes) -> None:
        self.offset = offset
        objects = {
            (0x1000, 0): u32(0x0002_0196),
            (0x1017, 0): u16(0),
            (0x6000, 0): u16(0),
            (0x6001, 0): u32(500_000),
            (0x6501, 0): u32(500_000),
            (0x6200, 0): u16(10),
            (0x1800, 1): u32(0x4000_0180 + number),
            (0x1800, 2): u8(254),
            (0x1801, 1): u32(0x4000_0280 + number),
            (0x1801, 2): u8(1),
            (0x1A00, 0): u8(1),
            (0x1A00, 1): u32(0x6004_0020),
            (0x1A01, 0): u8(1),
            (0x1A01, 1): u32(0x6004_0020),
        }
        super().__init__(number, objects, **changes)

    def value(self, index, number, now_ns):
        assert index == 0x6004
        return u32((self.offset + number) % (1 << 32))


class LoadCell(PeerNode):
    """CiA 404; the value is made of the SYNC number."""

    def __init__(self, number=2, unit=0x0021_0000, digits=4, **changes) -> None:
        self.status = 0
        self.force = None
        objects = {
            (0x1000, 0): u32(0x0002_0194),
            (0x1017, 0): u16(0),
            (0x6131, 1): u32(unit),
            (0x6132, 1): u8(digits),
            (0x1800, 1): u32(0x180 + number),
            (0x1800, 2): u8(255),
            (0x1A00, 0): u8(1),
            (0x1A00, 1): u32(0x7130_0110),
            (0x1A00, 2): u32(0),
        }
        super().__init__(number, objects, **changes)

    def value(self, index, number, now_ns):
        if index == 0x6150:
            return u8(self.status)
        return struct.pack("<i", -number if self.force is None else self.force)


class Drive(PeerNode):
    """CiA 402; its values are made of the SYNC number. From the factory its TPDOs carry the status word on events."""

    def __init__(self, number=4, offset=0, **changes) -> None:
        self.offset = offset
        objects = {
            (0x1000, 0): u32(0x0002_0192),
            (0x1017, 0): u16(0),
            (0x6076, 0): u32(1_270),  # mN m
        }
        for pdo, mapped in enumerate((0x6041_0010, 0x6041_0010, 0x6041_0010, 0x6041_0010)):
            objects |= {
                (0x1800 + pdo, 1): u32(0x4000_0180 + 0x100 * pdo + number),
                (0x1800 + pdo, 2): u8(255),
                (0x1A00 + pdo, 0): u8(1),
                (0x1A00 + pdo, 1): u32(mapped),
                (0x1A00 + pdo, 2): u32(0),
                (0x1A00 + pdo, 3): u32(0),
            }
        super().__init__(number, objects, **changes)

    def value(self, index, number, now_ns):
        if index == 0x6064:
            return struct.pack("<i", (self.offset + number + 2**31) % 2**32 - 2**31)
        if index == 0x606C:
            return struct.pack("<i", -3 * number)
        assert index == 0x6077
        return struct.pack("<h", number % 2_000 - 1_000)


class ArmController(PeerNode):
    """A maker's own device: phase and event counter in an event-driven TPDO1."""

    def __init__(self, number=3, phase=0, **changes) -> None:
        objects = {
            (0x1000, 0): u32(0),
            (0x1017, 0): u16(0),
            (0x2000, 1): u8(phase),
            (0x2000, 2): u8(0),
            (0x1800, 1): u32(0x180 + number),
            (0x1800, 2): u8(255),
            (0x1A00, 0): u8(2),
            (0x1A00, 1): u32(0x2000_0108),
            (0x1A00, 2): u32(0x2000_0208),
        }
        super().__init__(number, objects, **changes)

    def change(self, phase):
        self.objects[0x2000, 1] = u8(phase)
        self.objects[0x2000, 2] = u8((self.objects[0x2000, 2][0] + 1) % 256)
        return (0x180 + self.number, self.objects[0x2000, 1] + self.objects[0x2000, 2])


class Bench:
    """A CAN bus in time: SYNC every 5 ms, the peers, and the driver pumped every 10 ms.

    ``drop(number, identifier)`` says which frames do not reach us: the nodes see every SYNC.
    """

    def __init__(self, clock, make_device, *nodes, first_sync=0, answer_ns=300_000) -> None:
        self.clock = clock
        self.port = FakeCan()
        self.device = make_device(self.port)
        self.nodes = {node.number: node for node in nodes}
        self.number = first_sync  # of the next SYNC
        self.answer_ns = answer_ns
        self.drop = lambda number, identifier: False
        self.sync_on = True
        self.batches = []
        self.unanswered = 0  # SDO requests to nodes that are not there

    def start(self):
        self.batches += self.device.start(self.clock())
        return self.run(600)

    def run(self, duration_ms):
        made = []
        for _ in range(int(duration_ms)):
            now = self.clock.advance(MS)
            self._serve(now)
            if now // MS % 5 == 0 and self.sync_on:
                self.sync_round(now)
            for node in self.nodes.values():
                for identifier, data in node.heartbeat(now):
                    self.port.put(now, identifier, data)
            if now // MS % 10 == 7:
                made += self.device.pump(now)
        self.batches += made
        return made

    def stop(self):
        self._serve(self.clock())
        self.batches += self.device.stop(self.clock())
        self._serve(self.clock())

    def put(self, frames):
        for identifier, data in frames:
            self.port.put(self.clock(), identifier, data)

    def sync_round(self, now):
        number = self.number
        self.number += 1
        if not self.drop(number, 0x080):
            self.port.put(now, 0x080, u8(number % 240 + 1))
        for node in self.nodes.values():
            for identifier, data in node.on_sync(number, now):
                if not self.drop(number, identifier):
                    self.port.put(now + self.answer_ns, identifier, data)

    def _serve(self, now):
        asked, self.port.asked = self.port.asked, []
        for identifier, size in asked:
            node = self.nodes.get(identifier - 0x700)
            assert size == 1
            answer = node.guard() if node and not self.drop(None, "question") else None
            if answer is not None and not self.drop(None, identifier):
                self.port.put(now, identifier, answer)
        sent, self.port.sent = self.port.sent, []
        for identifier, data in sent:
            if identifier == 0:
                for node in self.nodes.values():
                    if data[1] in {0, node.number} and not node.deaf:
                        node.nmt(data[0])
            elif 0x600 < identifier < 0x680:
                node = self.nodes.get(identifier - 0x600)
                answer = node.sdo(data) if node else None
                self.unanswered += node is None
                if answer is not None:
                    self.port.put(now, identifier - 0x80, answer)
