"""Splits received bytes into frames. No port, no clock, but of a line that is tried."""

import binascii
import contextlib
from collections.abc import Callable, Iterator
from typing import Generic, Protocol, TypeVar

from drivers.errors import FrameError
from drivers.ports import SerialPort

Frame = TypeVar("Frame")
Frame_co = TypeVar("Frame_co", covariant=True)

_STEP_S = 0.01  # between two looks at a line that is tried
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc_reflected(data: bytes) -> int:
    """CRC-16/MCRF4XX: polynomial 1021h reflected, from FFFFh; inverted it is CRC-16/X-25."""
    mirrored = binascii.crc_hqx(data.translate(_REVERSED), 0xFFFF)
    return int(f"{mirrored:016b}"[::-1], 2)


class FrameDecoder(Protocol[Frame_co]):
    """Splits received bytes into frames."""

    def receive(self, data: bytes) -> None:
        """Append received bytes."""

    def take(self) -> Frame_co | None:
        """The next frame, None for need more data. Raises FrameError; the bytes were discarded, call it again."""


class ReceivedBuffer:
    """Bytes that are received and not decoded yet.

    Attributes:
        waiting: These bytes.
    """

    def __init__(self) -> None:
        self.waiting = b""

    def receive(self, data: bytes) -> None:
        """Append bytes."""
        self.waiting += data

    def clear(self) -> None:
        """Drop a partial frame: the stream was interrupted."""
        self.waiting = b""


class FrameSplitter(ReceivedBuffer, Generic[Frame]):
    """Splits a byte stream into frames that begin with a start byte: ``receive``, then ``take`` until it returns None.

    ``take`` raises nothing but ``FrameError``.

    Args:
        start: First byte of a frame.
        size: Bytes of the frame that the bytes begin with, at least 1, as far as they tell it.
        decode: A whole frame; raises FrameError.

    Attributes:
        discarded: Bytes that belonged to no frame, in all.
    """

    def __init__(self, start: int, size: Callable[[bytes], int], decode: Callable[[bytes], Frame]) -> None:
        super().__init__()
        self.discarded = 0
        self._start, self._size, self._decode = start, size, decode

    def take(self) -> Frame | None:
        """The next frame; None when more bytes are needed.

        Raises:
            FrameError: No frame at this place; bytes that cannot begin one were discarded, call ``take`` again.
        """
        if not self.waiting:
            return None
        size = self._size(self.waiting)
        if self.waiting[0] == self._start and len(self.waiting) < size:
            return None
        try:
            frame = self._decode(self.waiting[:size])
        except FrameError as error:
            place = self.waiting.find(self._start, 1)
            skipped = len(self.waiting) if place < 0 else place
            self.waiting = self.waiting[skipped:]
            self.discarded += skipped
            raise FrameError(f"{error}; {skipped} bytes skipped") from None
        self.waiting = self.waiting[size:]
        return frame


def frames_heard(
    port: SerialPort, wait: Callable[[float], object], decoder: FrameDecoder[Frame], within_ns: float
) -> Iterator[Frame]:
    """Frames of a line that is tried, as they come; what is none is passed over.

    Raises:
        OSError: The line fails.
    """
    for _ in range(round(1e-9 * within_ns / _STEP_S)):
        wait(_STEP_S)
        waiting = port.in_waiting
        decoder.receive(port.read(waiting) if waiting else b"")
        has_more = True
        while has_more:
            with contextlib.suppress(FrameError):
                frame = decoder.take()
                has_more = frame is not None
                if frame is not None:
                    yield frame
