"""ODrive axes on CAN under fuzz: frames, their times and lengths, and errors of the bus are what the bytes say."""

import contextlib
import struct
from collections.abc import Iterator

from bench import peers
from bench.fuzzing.laws import MS, drive, leading
from drivers.errors import FrameError
from drivers.odrive import OdriveAxis, Odrives
from drivers.odrive import message as messages
from drivers.ports import CanFrame

AXES = (
    OdriveAxis("near", 0, rate_hz=100.0, velocity=True, torque=True),
    OdriveAxis("far", 63, -(1 << 20), rate_hz=1000.0),
)
IDENTIFIERS = (0x001, 0x009, 0x01C, 0x7E1, 0x7E9, 0x7FC, 0x003, 0x029, 0x080, 0x7FF)  # of both, of others, of none
STEPS_NS = (0, MS, 10 * MS, 9 * MS, -MS, 100 * MS, 600 * MS, 3000 * MS)


def odrive(data: bytes) -> None:
    """The decoders and the device."""
    for decode in (messages.decode_heartbeat, messages.decode_pair):
        with contextlib.suppress(FrameError):
            decode(data[:9])
    (which,), body = leading(data, 1)
    clock = peers.Clock()
    port = peers.MemoryCan(clock, answering=False)
    bus = Odrives(port, AXES[: 1 + (which & 1)], "can_0")

    def steps() -> Iterator[None]:
        at = 0
        while at + 2 <= len(body):
            head, size = body[at : at + 2]
            step_ns = STEPS_NS[head >> 5]  # a stamp may be older than the one before it, the clock never goes back
            clock.now_ns += max(step_ns, 0)
            payload = body[at + 2 : at + 2 + (size & 15) % 9]
            identifier = IDENTIFIERS[(head & 15) % len(IDENTIFIERS)]
            port.waiting.append(CanFrame(clock() + min(step_ns, 0), identifier, payload, bool(head & 16)))
            at += 2 + (size & 15) % 9
            if size & 0x80:
                yield
        yield

    drive(bus, clock, steps(), 0)


def _entry(step: int, identifier: int, payload: bytes) -> bytes:
    return bytes([step << 5 | IDENTIFIERS.index(identifier), 0x80 | len(payload)]) + payload


def _seeds() -> list[bytes]:
    beat, boot = struct.pack("<IBBB", 0, 8, 0, 0), struct.pack("<IBBB", 1, 1, 0, 0)
    moving = b"".join(_entry(2, 0x009, struct.pack("<ff", 0.01 * at, 0.5)) for at in range(12))
    far = b"".join(_entry(1, 0x7E9, struct.pack("<ff", -0.02 * at, 1.0)) for at in range(12))
    torque = _entry(0, 0x01C, struct.pack("<ff", 0.0, -0.5)) + _entry(3, 0x01C, struct.pack("<ff", 0.0, float("nan")))
    return [
        b"\1" + _entry(0, 0x001, beat) + moving + torque + far,
        b"\0" + moving[:40] + _entry(6, 0x001, boot) + moving[40:] + _entry(7, 0x001, beat + b"\0") + torque,
        b"\1" + _entry(4, 0x7E1, beat[:5]) + far + _entry(5, 0x7FC, struct.pack("<ff", 1e30, 0.0)) + far[:50],
    ]


SEEDS = _seeds()
