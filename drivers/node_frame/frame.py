"""Decodes node frames from bytes to payloads, many at once. No port, no clock. Format: ``docs/node_frame.md``."""

import binascii
import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from cobs import cobs  # type: ignore[import-untyped]  # it ships no type hints

from drivers.errors import ConfigurationError, FrameError

DATA = 0x10  # high nibble: version of the format; low nibble: kind of frame
DESCRIPTOR = 0x11
CRC_SEED = 0xFFFF  # CRC-16/CCITT-FALSE, sent high byte first: over frame and CRC together it is 0
LONGEST_FRAME = 2048  # encoded
MOST_FRAMES = 4096  # in one take
SHORTEST_PAYLOAD = 4
FULL_BLOCK = 255  # shorter ones have no block without a zero at its end
LATEST_TICK = 1 << 62

HEADER = [
    ("kind", "u1"),
    ("node", "u1"),
    ("schema", "<u2"),
    ("sequence", "<u4"),
    ("tick", "<u4"),
    ("pulse", "<u4"),
    ("pulse_tick", "<u4"),
    ("status", "u1"),
]
_DESCRIPTOR_HEAD = struct.Struct("<BBHIQI")  # kind, node, schema, next sequence, tick, boot
_BODY_HEAD = struct.Struct("<IB")  # tick_hz, channels
_CHANNEL = struct.Struct("<BBib8s16s")  # type, flags, scale mantissa, scale exponent, unit, name
TYPES = ("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<i8")
WRAPS = 1  # flag of a channel: a counter that wraps at the width of its type


class FrameChannel(NamedTuple):
    """One channel in a node's descriptor.

    Attributes:
        name: Its name.
        dtype: NumPy type of its values on the wire.
        wraps: Whether it is a wrapping counter, to be unwrapped.
        scale: ``unit`` per count.
        unit: Unit of a scaled value.
    """

    name: str
    dtype: str
    wraps: bool
    scale: float
    unit: str


class Descriptor(NamedTuple):
    """Descriptor that a node sends every second.

    Attributes:
        node: Node number.
        schema: CRC-16 of the channel list; repeated in each data frame.
        sequence: Sequence of the next data frame.
        tick: The node's clock, 64 bits.
        boot: Differs between starts of the node, if the node can provide that.
        tick_hz: Nominal rate of that clock.
        channels: In the order of the values.
    """

    node: int
    schema: int
    sequence: int
    tick: int
    boot: int
    tick_hz: int
    channels: tuple[FrameChannel, ...]


@dataclass(frozen=True)
class NodeFrameConfig:
    """Configuration of a custom node.

    Attributes:
        channels: Names of its channels in the order of its descriptor; a node with other channels is refused.
        node: Node number, 0..255.
        poll_period_ms: How often the port is read; 0: the port waits.
        silence_ms: Time without a frame after which the port is reopened.

    Raises:
        ConfigurationError: A value out of range.
    """

    channels: tuple[str, ...]
    node: int = 1
    poll_period_ms: float = 10.0
    silence_ms: float = 2500.0

    def __post_init__(self) -> None:
        if not 0 <= self.node <= 255:
            raise ConfigurationError(f"node = {self.node}: use 0..255")
        if not self.channels or len(set(self.channels)) < len(self.channels):
            raise ConfigurationError(f"channels = {self.channels}: name each channel of the node, once")


def payload_dtype(channels: tuple[FrameChannel, ...]) -> np.dtype[np.void]:
    """The packed dtype of a data frame: the header's fields, then ``value_0``, ``value_1`` ... and the CRC."""
    values = [(f"value_{place}", channel.dtype) for place, channel in enumerate(channels)]
    return np.dtype([*HEADER, *values, ("crc", ">u2")])


def decode_frame(data: bytes) -> bytes:
    """One frame without its delimiter: the payload, CRC included.

    Raises:
        FrameError: Invalid COBS, or wrong CRC.
    """
    try:
        payload: bytes = cobs.decode(data)
    except cobs.DecodeError as error:
        raise FrameError(f"frame of {len(data)} bytes is not COBS ({error}): bytes were lost or added") from error
    if len(payload) < SHORTEST_PAYLOAD or binascii.crc_hqx(payload, CRC_SEED):
        raise FrameError(f"frame of {len(data)} bytes has a wrong CRC: check wiring and baud rate")
    return payload


def decode_descriptor(payload: bytes) -> Descriptor:
    """The payload of a descriptor frame, CRC included.

    Raises:
        FrameError: The payload violates the format.
    """
    body = payload[_DESCRIPTOR_HEAD.size : -2]
    if len(payload) < _DESCRIPTOR_HEAD.size + _BODY_HEAD.size + 2:
        raise FrameError(f"descriptor of {len(payload)} bytes: it is cut short, correct the node's encoder")
    kind, node, schema, sequence, tick, boot = _DESCRIPTOR_HEAD.unpack_from(payload)
    tick_hz, count = _BODY_HEAD.unpack_from(body)
    if kind != DESCRIPTOR or len(body) != _BODY_HEAD.size + count * _CHANNEL.size:
        raise FrameError(f"descriptor of kind {kind:#04x} with {count} channels in {len(body)} bytes: fix the encoder")
    if schema != binascii.crc_hqx(body, CRC_SEED):
        raise FrameError(f"schema {schema:#06x} is not the CRC of the channel list: correct the node's encoder")
    if tick_hz == 0 or count == 0 or tick >= LATEST_TICK:
        raise FrameError(f"{count} channels, {tick_hz} ticks/s, tick {tick:#x}: correct the node's configuration")
    channels = tuple(_channel(*_CHANNEL.unpack_from(body, _BODY_HEAD.size + n * _CHANNEL.size)) for n in range(count))
    return Descriptor(node, schema, sequence, tick, boot, tick_hz, channels)


def _channel(code: int, flags: int, mantissa: int, exponent: int, unit: bytes, name: bytes) -> FrameChannel:
    texts = [text.rstrip(b"\0") for text in (name, unit)]
    if code >= len(TYPES) or not all(text.isascii() and text.decode("ascii").isprintable() for text in texts):
        raise FrameError(f"channel of type {code}, name {name!r}, unit {unit!r}: correct the node's configuration")
    # from decimal text, as the nearest double: 1 and -3 are 0.001 and not 1 * 10 ** -3
    scale = float(f"{mantissa}e{exponent}")
    wraps = bool(flags & WRAPS) and TYPES[code] != "<i8"  # a 64-bit value does not wrap
    return FrameChannel(texts[0].decode("ascii"), TYPES[code], wraps, scale, texts[1].decode("ascii"))


class FrameStream:
    """Splits a byte stream into frames: ``receive`` bytes, then ``take`` until it returns None.

    ``take`` raises nothing but ``FrameError``.

    Attributes:
        waiting: Bytes of a frame that is not whole.
    """

    def __init__(self) -> None:
        self._frames: list[bytes] = []
        self.waiting = b""

    def receive(self, data: bytes) -> None:
        """Append bytes."""
        *whole, rest = data.split(b"\0")
        if whole:
            whole[0] = self.waiting + whole[0]
            self._frames += filter(None, whole)  # skip empty frames: a node may begin with a delimiter
            self.waiting = rest
        else:
            self.waiting += rest

    def clear(self) -> None:
        """Drop a partial frame: the stream was interrupted."""
        self._frames.clear()
        self.waiting = b""

    def take(self) -> list[bytes] | None:
        """Payloads (CRC included) of all whole frames up to the first bad one; None when more bytes are needed.

        Raises:
            FrameError: No valid frame at this place; the bytes were discarded, call ``take`` again.
        """
        payloads: list[bytes] = []
        crc_of = binascii.crc_hqx
        taken = 0
        for frame in self._frames[:MOST_FRAMES]:
            size = len(frame)
            if SHORTEST_PAYLOAD < size < FULL_BLOCK:
                plain = bytearray(frame)
                at = 0
                while at < size:  # each code is the distance to the next zero
                    code = plain[at]
                    plain[at] = 0
                    at += code
                del plain[0]
                if at > size or crc_of(plain, CRC_SEED):
                    break
                payloads.append(bytes(plain))
            else:
                try:
                    payloads.append(decode_frame(frame))
                except FrameError:
                    break
            taken += 1
        del self._frames[:taken]
        if payloads:
            return payloads
        if self._frames:
            return [decode_frame(self._frames.pop(0))]
        if len(self.waiting) > LONGEST_FRAME:
            count, self.waiting = len(self.waiting), b""
            raise FrameError(f"{count} bytes without a delimiter: check baud rate and wiring")
        return None
