"""Devices of registers under fuzz: a chip that keeps what is written; bytes say its registers, errors and clock."""

import contextlib
import os
from collections.abc import Callable, Iterator

from bench import peers
from bench.fuzzing.laws import MOST_PUMPS, MS, STEPS_NS, drive, leading
from drivers.device import Device
from drivers.errors import FrameError
from drivers.i2c import as5048, as5600, nau7802
from drivers.inertial import bmi088, bmi088_fifo, icm20948
from drivers.inertial.packet import decode_words
from drivers.ports import I2cPort, I2cReply

TRANSFER_NS = 100_000
ERRNOS = (5, 6, 121, 110, 11)  # EIO, ENXIO, EREMOTEIO, ETIMEDOUT, EAGAIN


class Registers:
    """A slave of 256 registers (``drivers.ports.I2cPort``); ``shows``: bits that are set in what is read."""

    def __init__(self, clock: peers.Clock, shows: dict[int, int]) -> None:
        self.clock, self.shows = clock, shows
        self.values = bytearray(256)
        self.fail_in, self.code = -1, 5

    def _transfer(self) -> None:
        self.clock.now_ns += TRANSFER_NS
        self.fail_in -= 1
        if 0 <= self.fail_in + 1 < 5:
            raise OSError(self.code, os.strerror(self.code))

    def write(self, address: int, data: bytes) -> None:
        """See ``I2cPort``."""
        self._transfer()
        for place, value in enumerate(data[1:]):
            self.values[(data[0] + place) & 0xFF] = value

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """See ``I2cPort``."""
        self._transfer()
        places = [(data[0] + place) & 0xFF for place in range(count)]
        return I2cReply(bytes(self.values[at] | self.shows.get(at, 0) for at in places), self.clock())

    def close(self) -> None:
        """See ``I2cPort``."""


class Words:
    """Registers as an AS5048A has them on SPI (``drivers.ports.SpiPort``); ``spoil``: answers with a bit turned."""

    def __init__(self, chip: Registers, spoil: int) -> None:
        self._chip, self._spoil, self._frames = chip, spoil, 0

    def transfer(self, data: bytes, size: int) -> I2cReply:
        """See ``SpiPort``: each frame is answered at once, in the place of the next one."""
        got = bytes(size)
        for at in range(0, len(data) - size, size):
            register = int.from_bytes(data[at : at + size], "big") & 0xFF
            high, low = self._chip.write_read(0x40, bytes([register]), 2).data
            word = (high << 8 | low) & 0x7FFF
            word |= (word.bit_count() & 1) << 15
            self._frames += 1
            got += (word ^ (self._frames % 16 == self._spoil >> 3 & 15)).to_bytes(size, "big")
        return I2cReply(got, self._chip.clock())

    def close(self) -> None:
        """See ``SpiPort``."""


class Banked(Registers):
    """With four banks, by bits 5 and 4 of 7Fh; those above 0 keep what is written."""

    def __init__(self, clock: peers.Clock, shows: dict[int, int]) -> None:
        super().__init__(clock, shows)
        self.bank, self.above = 0, dict[tuple[int, int], int]()

    def write(self, address: int, data: bytes) -> None:
        """See ``I2cPort``."""
        if data[0] == 0x7F or not self.bank:
            super().write(address, data)
            self.bank = self.values[0x7F] >> 4 & 3
        else:
            self._transfer()
            self.above[self.bank, data[0]] = data[1]

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """See ``I2cPort``."""
        reply = super().write_read(address, data, count)
        return reply._replace(data=bytes([self.above.get((self.bank, data[0]), 0)] * count)) if self.bank else reply


class Dies(Registers):
    """With an identity at each address, and a sensor time that goes on."""

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """See ``I2cPort``."""
        self.values[0x00] = 0x1E if address == 0x18 else 0x0F
        reply = super().write_read(address, data, count)
        ticks = (int(reply.host_ns / 39_062.5) + self.values[0x1A]) & 0xFFFFFF
        is_forces = data == b"\x12" and count == 9
        return reply._replace(data=reply.data[:6] + ticks.to_bytes(3, "little")) if is_forces else reply


class DieLine:
    """Select line of a die of a BMI088 (``drivers.ports.SpiPort``); ``spoil``: which frames have a bit turned."""

    def __init__(self, chip: Dies, address: int, begin: int, spoil: int) -> None:
        self._chip, self._address, self._begin, self._spoil, self._frames = chip, address, begin, spoil, 0

    def transfer(self, data: bytes, size: int) -> I2cReply:
        """See ``SpiPort``."""
        got = b""
        for at in range(0, len(data), size):
            frame = data[at : at + size]
            self._frames += 1
            if frame[0] & 0x80:
                asked = bytes([frame[0] & 0x7F])
                got += bytes(self._begin) + self._chip.write_read(self._address, asked, size - self._begin).data
            else:
                self._chip.write(self._address, frame)
                got += bytes(size)
        spoils = self._frames % 16 == self._spoil & 15 and bool(self._spoil & 0x10)
        return I2cReply(bytes([*got[:-1], got[-1] ^ spoils]), self._chip.clock())

    def close(self) -> None:
        """See ``SpiPort``."""


def _fly(device: Device, chip: Registers, body: bytes, data_at: range) -> None:
    def steps() -> Iterator[None]:
        for _ in range(12):  # the setting up
            chip.clock.now_ns += 25 * MS
            yield
        for number in range(min(len(body) // 3, MOST_PUMPS)):
            kind, a, b = body[3 * number : 3 * number + 3]
            if kind & 3 == 0:
                chip.values[a] = b
            elif kind & 3 == 1:
                chip.fail_in, chip.code = a % 16, ERRNOS[b % 5]
            elif kind & 3 == 2:
                chip.values[data_at.start : data_at.stop] = (body[3 * number :] + bytes(8))[: len(data_at)]
            chip.clock.now_ns += STEPS_NS[kind >> 3 & 7]
            yield

    drive(device, chip.clock, steps(), 0)


def nau7802_chip(data: bytes) -> None:
    """The decoder, the count of conversions and the device."""
    (which, ready), body = leading(data, 2)
    with contextlib.suppress(FrameError):
        nau7802.decode_sample(body)
    config = nau7802.Nau7802Config(sample_rate_hz=(10, 20, 40, 80, 320)[which % 5], amplifier=1 << (which >> 5))
    chip = Registers(peers.Clock(), {0x00: 0x08 | (ready & 0x20), 0x07: 0x80, 0x1F: 0x0F})
    _fly(nau7802.Nau7802("cell", chip, config), chip, body, range(0x12, 0x15))


def as5600_chip(data: bytes) -> None:
    """The decoder and the device."""
    (which, status), body = leading(data, 2)
    with contextlib.suppress(FrameError):
        as5600.decode_reading(body)
    config = as5600.As5600Config((-4096, 4096, 40960)[which % 3], which, (1.0, 5.0, 50.0)[which >> 2 & 1])
    chip = Registers(peers.Clock(), {0x0B: status & 0x38})
    _fly(as5600.As5600("joint", chip, config), chip, body, range(0x0C, 0x0E))


def as5048_chip(data: bytes) -> None:
    """The decoder and the device, as B and, by words that the bytes say, as A."""
    (which, status), body = leading(data, 2)
    with contextlib.suppress(FrameError):
        as5048.decode_output(body)
    config = as5048.As5048Config((-16384, 16384, 163840)[which % 3], which, (1.0, 5.0, 50.0)[which >> 2 & 1])
    chip = Registers(peers.Clock(), {0xFB: status & 0x0F, 0xFD: 0x01})
    port: I2cPort = as5048.As5048aPort(Words(chip, which)) if which & 0x80 else chip
    _fly(as5048.As5048("joint", port, 0x40, config), chip, body, range(0xFA, 0x100))


def icm20948_chip(data: bytes) -> None:
    """The decoder and the device, its banks one above the other; ``count`` bytes are in its FIFO."""
    (which, count), body = leading(data, 2)
    with contextlib.suppress(FrameError):
        decode_words(body, icm20948.ORDER, icm20948.Icm20948Config())
    rate_hz, longest = (1125.0, 562.5, 225.0)[which % 3], (14, 30, 252)[(which >> 2) % 3]
    chip = Banked(peers.Clock(), {0x00: 0xEA})
    chip.values[0x71] = count
    config = icm20948.Icm20948Config(sample_rate_hz=rate_hz, max_transfer_bytes=longest)
    _fly(icm20948.Icm20948("imu", chip, config), chip, body, range(0x70, 0x7F))


def bmi088_chip(data: bytes) -> None:
    """The decoders and the device; a register has the same number and content in both dies."""
    (which, late), body = leading(data, 2)
    with contextlib.suppress(FrameError):
        bmi088.decode_forces(body[: 9 + late % 3])
    with contextlib.suppress(FrameError):
        bmi088_fifo.decode_frames(body)
    bmi088.decode_temperature((body + bytes(2))[:2])
    chip = Dies(peers.Clock(), {})
    _fly_bmi088(chip, chip, which, body, "I2C")


def _fly_bmi088(port: I2cPort, chip: Dies, which: int, body: bytes, bus: str) -> None:
    """By registers, or by FIFOs whose counts and bytes stand at 24h and, of the gyroscope, at 0Eh and 3Fh."""
    rate = which & 3
    if which & 0x40:
        config = bmi088.Bmi088Config(filter_code=rate, mode="fifo", max_transfer_bytes=(14, 40, 180)[which % 3])
        _fly(bmi088_fifo.Bmi088Fifo("imu", port, config, bus), chip, body, range(0x24, 0x2B))
    else:
        config = bmi088.Bmi088Config(filter_code=rate, sample_period_ms=(1.0, 5.0, 50.0)[which % 3])
        _fly(bmi088.Bmi088("imu", port, config, bus), chip, body, range(0x12, 0x1B))


def bmi088_spi_chip(data: bytes) -> None:
    """The device on two select lines, of which the bytes say when an answer has a bit turned."""
    (which, spoil), body = leading(data, 2)
    chip = Dies(peers.Clock(), {})
    port = bmi088.Bmi088SpiPort(DieLine(chip, 0x18, 2, spoil), DieLine(chip, 0x68, 1, spoil >> 3))
    _fly_bmi088(port, chip, which, body, "SPI")


CALLS: dict[str, Callable[[bytes], None]] = {
    "nau7802": nau7802_chip,
    "as5600": as5600_chip,
    "as5048": as5048_chip,
    "icm20948": icm20948_chip,
    "bmi088": bmi088_chip,
    "bmi088_spi": bmi088_spi_chip,
}
SEEDS = [
    b"\3\x20" + bytes([2, 1, 2, 8, 0, 0, 16, 0, 0, 2, 9, 9]) * 6,
    b"\3\0" + bytes([0, 0, 0xBE, 8, 0, 0, 0, 0, 0x9E, 48, 0, 0]) * 8,
    b"\4\x20" + bytes([1, 3, 2, 8, 0, 0, 0, 2, 0x70, 32, 0, 0]) * 8,
    b"\0\0" + bytes([0, 1, 0, 24, 0, 0]) * 6,
    b"\x42\0" + bytes([2, 7, 0, 0x84, 1, 2, 3, 4, 5]) * 8,
    b"\x41\0" + bytes([2, 0, 0, 0x44, 9, 32, 0, 0, 0x0E, 3]) * 8,
    b"\xb1\1" + bytes([0, 0xFF, 7, 16, 0xFE, 9, 24, 0xFD, 1, 1, 2, 3]) * 8,
]
