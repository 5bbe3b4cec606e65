"""A Memsense nIMU typed from DOC00290 rev J, table 3: 38-byte packets, a 16-bit timer of 2.1701 us."""

import struct

TICK_NS = 2170.1
PERIOD = 3072  # ticks, 150 Hz

# DOC00290 table 3 by hand: timer 1234h; gyro 1, -1, 256; accel 10922 (1 g), 0, -2; magnetometer 0, 0, 11498 (1 gauss);
# temperature 0, 55, -55
PACKET = bytes.fromhex(
    "ffffffff 26 ff 14 1234 0000 0042 0001 ffff 0100 2aaa 0000 fffe 0000 0000 2cea 0000 0037 ffc9 a3".replace(" ", "")
)
WORDS = [1, -1, 256, 10922, 0, -2, 0, 0, 11498, 0, 55, -55]


class NimuModel:
    """Packets numbered in the payload; ``span`` is what the checksum sums."""

    def __init__(self, span: str = "packet", period_ticks: int = PERIOD, timer: int = 0) -> None:
        self.span, self.period_ticks, self.timer, self.number = span, period_ticks, timer, 0

    @property
    def period_ns(self) -> float:
        return self.period_ticks * TICK_NS

    def payload(self, number: int) -> list[int]:
        """Gyro, accel, magnetometer, temperature."""
        return [number & 0x3FFF, -7, 0, number >> 14, -100, 10922, 5, -6, -1, -1, -1, number % 100]

    def packet(self, words: list[int] | None = None) -> bytes:
        """The next packet."""
        head = b"\xff\xff\xff\xff" + struct.pack(">BBBHHH", 38, 0xFF, 0x14, self.timer & 0xFFFF, 0, 0x1234)
        payload = struct.pack(">12h", *(self.payload(self.number) if words is None else words))
        body = head + payload
        summed = {"packet": body, "after_sync": body[4:], "payload": payload}[self.span]
        self.skip()
        return body + bytes([sum(summed) % 256])

    def skip(self, packets: int = 1) -> None:
        """Packets are made and go astray."""
        self.timer += packets * self.period_ticks
        self.number += packets
