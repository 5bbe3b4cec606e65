"""ams AS5048A on SPI, AS5048B on I2C (40h to 43h): absolute angle of a magnet, 14 bits.

Source: data sheet 1-06, figures 22 (SPI) and 31 (I2C). Each reading has gain, diagnostics, magnitude and angle: of the
B in one transfer (FAh to FFh), of the A by three commands (3FFDh, 3FFEh, 3FFFh), each answered by the frame after it. A
frame of SPI has even parity (bit 15) and, from the chip, an error flag (bit 14) that reading 0001h clears. Nothing is
written: its zero position is left as it is, and looked at while it runs. Its names of what is wrong with the magnet are
those of its gain: COMP high is a weak one, COMP low a strong one. The chip has no identity: bits that it reserves as
zeros are looked at, and OCF, which is set once it has started. Known limit: of what the magnet turned while it was not
heard, whole turns are unknown.
"""

import errno
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from drivers.errors import ConfigurationError, FrameError, WrongDeviceError
from drivers.i2c.magnet import MagnetEncoder, MagnetReading
from drivers.i2c.sensor import MS, Watched
from drivers.ports import I2cPort, I2cReply, SpiPort

ZERO_H, ZERO_L, OUTPUT = 0x16, 0x17, 0xFA  # I2C; the zero position has the same numbers on SPI
STARTED, OVERFLOW, STRONG, WEAK = 0x01, 0x02, 0x04, 0x08  # diagnostics: OCF, COF, COMP low, COMP high
READ, ERROR_FLAG, CONTENT = 0x4000, 0x4000, 0x3FFF
NOTHING, ERRORS, OUTPUTS = 0x0000, 0x0001, (0x3FFD, 0x3FFE, 0x3FFF)  # SPI
SPI_MODE = 1
POWER_UP_NS = 10 * MS
COUNTS = 16384


@dataclass(frozen=True)
class As5048Config:
    """Settings.

    Attributes:
        counts_per_revolution: 16384 for each turn of the magnet in one of the joint; negative: reversed direction.
        zero_count: Reading at joint angle zero, counts.
        sample_period_ms: Time between two readings.
    """

    counts_per_revolution: int = COUNTS
    zero_count: int = 0
    sample_period_ms: float = 5.0

    def __post_init__(self) -> None:
        if not self.counts_per_revolution or not self.sample_period_ms > 0.0:
            text = f"{self.counts_per_revolution} counts, {self.sample_period_ms:g} ms: it needs counts and a period"
            raise ConfigurationError(f"{text}; correct them")


class Output(NamedTuple):
    """Content of a reading."""

    counts: int  # 0..16383
    diagnostics: int
    gain: int  # 0 in a strong field, 255 in a weak one
    magnitude: int


def decode_output(data: bytes) -> Output:
    """Gain, diagnostics, magnitude and angle (FAh to FFh).

    Raises:
        FrameError: Not six bytes, or bits are set that the chip reserves as zeros.
    """
    if len(data) != 6 or data[1] & 0xF0 or (data[3] | data[5]) & 0xC0:
        raise FrameError(f"{data[:8].hex(' ')} is no output of an AS5048: check bus and address")
    return Output(data[4] << 6 | data[5], data[1], data[0], data[2] << 6 | data[3])


def framed(word: int) -> bytes:
    """A frame with its parity bit."""
    return (word | (word.bit_count() & 1) << 15).to_bytes(2, "big")


def identify(port: I2cPort, address: int) -> str | None:
    """Name of the chip, where FAh to FFh can be a started AS5048B's; only these are read.

    Raises:
        OSError: The transfer failed.
    """
    try:
        output = decode_output(port.write_read(address, bytes([OUTPUT]), 6).data)
    except FrameError:
        return None
    return "AS5048B (by its reserved bits: it has no identity)" if output.diagnostics & STARTED else None


class As5048aPort:
    """An AS5048A on SPI, read as if it were an AS5048B on I2C.

    Args:
        spi: The bus, in mode 1.
    """

    def __init__(self, spi: SpiPort) -> None:
        self._spi = spi

    def write(self, address: int, data: bytes) -> None:
        """See ``I2cPort``: nothing is written to this chip."""
        raise OSError(errno.EPERM, "an AS5048A is not written")

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """See ``I2cPort``: a byte of the zero position, or 2, 4 or 6 outputs.

        Raises:
            OSError: ENXIO where nothing answers, EBADMSG for a wrong parity, EPROTO for the chip's error flag.
        """
        if data[0] < OUTPUT:
            (word, _), host_ns = self._read(data[0], OUTPUTS[0])
            return I2cReply(bytes([word & 0xFF]), host_ns)
        (state, *others), host_ns = self._read(*OUTPUTS[: count // 2])
        output = [state & 0xFF, state >> 8, *(part for word in others for part in (word >> 6, word & 0x3F))]
        return I2cReply(bytes(output), host_ns)

    def close(self) -> None:
        """Release the bus."""
        self._spi.close()

    def _read(self, *registers: int) -> tuple[list[int], int]:
        frames = [framed(READ | register) for register in registers]
        got, host_ns = self._spi.transfer(b"".join([*frames, framed(NOTHING)]), 2)
        words = [int.from_bytes(got[at : at + 2], "big") for at in range(2, len(got), 2)]
        if set(words) in ({0x0000}, {0xFFFF}):
            raise OSError(errno.ENXIO, "no chip drives the line")
        if any(word.bit_count() & 1 for word in words):
            raise OSError(errno.EBADMSG, "wrong parity")
        if any(word & ERROR_FLAG for word in words):
            got = self._spi.transfer(framed(READ | ERRORS) + framed(NOTHING), 2).data
            raise OSError(errno.EPROTO, f"the chip has refused a frame ({got[2:].hex()}h)")
        return [word & CONTENT for word in words], host_ns


class As5048(MagnetEncoder):
    """An AS5048B on an ``I2cPort``, or an AS5048A by ``As5048aPort``; ``device_status``: diagnostics.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        address: 7-bit address; 0 on SPI.
        config: Settings.
    """

    def __init__(self, name: str, port: I2cPort, address: int, config: As5048Config | None = None) -> None:
        self.config = config or As5048Config()
        super().__init__(
            name,
            port,
            address,
            bits=14,
            zero_count=self.config.zero_count,
            counts_per_revolution=self.config.counts_per_revolution,
            sample_period_ms=self.config.sample_period_ms,
        )
        self._where = f"I2C {address:#x}" if address else "SPI"
        self._zero = b"\0\0"  # its zero position, as it was found

    def _watched(self) -> list[Watched]:
        return [Watched(at, value, value) for at, value in zip((ZERO_H, ZERO_L), self._zero, strict=True)]

    def _set_up(self) -> Iterator[int]:
        yield POWER_UP_NS  # before that it shows no angle
        output = self._bus.read(OUTPUT, 4).data  # no angle: that would be a reading
        try:
            started = decode_output(output + b"\0\0").diagnostics & STARTED
        except FrameError as error:
            raise WrongDeviceError(f"{self.name}: {self._where}: {error}") from None
        if not started:
            text = f"{self._where}: {output.hex(' ')}: no AS5048, or one that does not start: check bus and supply"
            raise WrongDeviceError(f"{self.name}: {text}")
        self._zero = bytes([self._bus.byte(ZERO_H), self._bus.byte(ZERO_L)])

    def _begin(self, now_ns: int, anew: bool) -> str:
        return f"AS5048 runs: a reading in {self.config.sample_period_ms:g} ms"

    def _read(self) -> MagnetReading:
        reply = self._bus.read(OUTPUT, 6)
        output = decode_output(reply.data)
        seen = output.diagnostics
        wrong = (not seen & STARTED or bool(seen & OVERFLOW), bool(seen & WEAK), bool(seen & STRONG))
        codes = ("magnet_unread", "magnet_weak", "magnet_strong")
        fault = next((code for code, is_wrong in zip(codes, wrong, strict=True) if is_wrong), "")
        return MagnetReading(output.counts, seen, fault, reply.host_ns)
