"""A device on a clock line and a data line under fuzz: levels, times and errors are what the bytes say."""

import contextlib
import os
from collections.abc import Iterator

from bench import peers
from bench.fuzzing.laws import MOST_PUMPS, MS, STEPS_NS, drive, leading
from drivers import hx711
from drivers.errors import FrameError
from drivers.ports import Clocked, Look

ERRNOS = (5, 6, 16, 19)  # EIO, ENXIO, EBUSY, ENODEV
HIGH_NS = (2_000, 40_000, 60_000, 3_000_000)


class FuzzedLines:
    """Two lines (``drivers.ports.ClockedPort``), low after a time that the bytes say, with bits that they say."""

    def __init__(self, clock: peers.Clock) -> None:
        self.clock = clock
        self.bits, self.high_ns, self.took_ns = 1, 2_000, 200_000
        self.high = self.stays = False
        self.ready_ns = self.period_ns = 12_500_000
        self.fail_in, self.code = -1, 5

    def _call(self) -> None:
        self.fail_in -= 1
        if 0 <= self.fail_in + 1 < 3:
            raise OSError(self.code, os.strerror(self.code))

    def look(self) -> Look:
        """See ``ClockedPort``."""
        self._call()
        return Look(self.stays or self.clock() < self.ready_ns, self.clock())

    def drive(self, high: bool) -> None:
        """See ``ClockedPort``."""
        self._call()
        self.high = high

    def clock_out(self, pulses: int) -> Clocked:
        """See ``ClockedPort``."""
        self._call()
        self.clock.now_ns += self.took_ns
        self.ready_ns += ((self.clock() - self.ready_ns) // self.period_ns + 1) * self.period_ns
        return Clocked(
            self.bits << (pulses - 25) & (1 << pulses) - 1 | (1 << (pulses - 25)) - 1, self.high_ns, self.clock()
        )

    def close(self) -> None:
        """See ``ClockedPort``."""


def hx711_chip(data: bytes) -> None:
    """The decoder, the count of conversions and the device."""
    (which, rate), body = leading(data, 2)
    with contextlib.suppress(FrameError):
        hx711.decode_reading(int.from_bytes(body[:4], "big"), which % 30)
    lines = FuzzedLines(peers.Clock())
    config = hx711.Hx711Config(sample_rate_hz=(10, 80)[rate & 1], amplifier=(128, 64, 32)[which % 3])
    lines.period_ns = round(config.period_ns * (1.0 + (rate / 255.0 - 0.5) / 2.0))

    def steps() -> Iterator[None]:
        for number in range(min(len(body) // 3, MOST_PUMPS)):
            kind, a, b = body[3 * number : 3 * number + 3]
            if kind & 3 == 0:
                lines.bits = (a << 17 | b << 9 | kind << 1 | kind >> 6) & (1 << 25) - 1
            elif kind & 3 == 1:
                lines.fail_in, lines.code = a % 16, ERRNOS[b % 4]
            elif kind & 3 == 2:
                lines.high_ns, lines.took_ns, lines.stays = HIGH_NS[a & 3], b * 50_000, bool(a & 4)
            for _ in range(8):
                lines.clock.now_ns += MS
                yield
            lines.clock.now_ns += STEPS_NS[kind >> 3 & 7]
            yield

    drive(hx711.Hx711("cell", lines, config), lines.clock, steps(), 0)


SEEDS = [
    b"\0\x81" + bytes([0x40, 1, 2, 0x43, 0, 0, 0x5B, 0, 0]) * 8,
    b"\1\x60" + bytes([0x40, 1, 2, 2, 2, 4, 3, 0, 0, 2, 0, 4]) * 6,
    b"\2\x7f" + bytes([0x40, 0, 0, 1, 3, 1, 2, 5, 1, 0x23, 0, 0, 2, 0, 1]) * 4,
]
