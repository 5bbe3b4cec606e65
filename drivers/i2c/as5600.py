"""ams AS5600: absolute angle of a magnet, 12 bits, on I2C at 36h.

Source: data sheet 1-06. Each transfer reads STATUS (0Bh) and RAW ANGLE (0Ch, 0Dh) at once, so that the state of the
magnet is that of the angle. Set-up changes the fields of CONF that matter here and leaves the others, which may hold
factory settings: slow filter only, no hysteresis, no low-power mode, no watchdog. ZPOS, MPOS and MANG do not act on RAW
ANGLE. The chip has no identity register: bits that it reserves as zeros are looked at instead (a MAX17048 has the same
address). Known limit: of what the magnet turned while it was not heard, whole turns are unknown.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from drivers.errors import ConfigurationError, FrameError, WrongDeviceError
from drivers.i2c.magnet import MagnetEncoder, MagnetReading
from drivers.i2c.sensor import MS, Watched
from drivers.ports import I2cPort

CONF_H, CONF_L, STATUS = 0x07, 0x08, 0x0B
OURS_H, OURS_L = 0x3F, 0x0F  # WD, FTH, SF; HYST, PM
FILTER_CODE = {16: 0, 8: 1, 4: 2, 2: 3}  # SF
DETECTED, WEAK, STRONG = 0x20, 0x10, 0x08  # STATUS: MD, ML, MH
POWER_UP_NS = 10 * MS
COUNTS = 4096


@dataclass(frozen=True)
class As5600Config:
    """Settings.

    Attributes:
        counts_per_revolution: 4096 for each turn of the magnet in one of the joint; negative: reversed direction.
        zero_count: Reading at joint angle zero, counts.
        sample_period_ms: Time between two readings.
        slow_filter: Samples that its filter takes the mean of: 16, 8, 4 or 2.
    """

    counts_per_revolution: int = COUNTS
    zero_count: int = 0
    sample_period_ms: float = 5.0
    slow_filter: Literal[16, 8, 4, 2] = 2

    def __post_init__(self) -> None:
        if self.slow_filter not in FILTER_CODE or not self.counts_per_revolution or not self.sample_period_ms > 0.0:
            raise ConfigurationError(
                f"slow_filter {self.slow_filter}, {self.counts_per_revolution} counts, {self.sample_period_ms:g} ms: "
                "it has filters of 16, 8, 4 and 2, and needs counts and a period; correct them"
            )


class Transfer(NamedTuple):
    """Content of one transfer."""

    counts: int  # 0..4095
    status: int  # STATUS


def decode_reading(data: bytes) -> Transfer:
    """STATUS and RAW ANGLE (0Bh to 0Dh).

    Raises:
        FrameError: Not three bytes, or bits are set that the chip reserves as zeros.
    """
    if len(data) != 3 or data[0] & ~(DETECTED | WEAK | STRONG) or data[1] & 0xF0:
        raise FrameError(f"{data[:8].hex(' ')} is no status and angle of an AS5600: check bus and address")
    return Transfer(data[1] << 8 | data[2], data[0])


def identify(port: I2cPort, address: int) -> str | None:
    """Name of the chip, where STATUS and RAW ANGLE can be an AS5600's; only these are read.

    Raises:
        OSError: The transfer failed.
    """
    try:
        decode_reading(port.write_read(address, bytes([STATUS]), 3).data)
    except FrameError:
        return None
    return "AS5600 (by its reserved bits: it has no identity)"


class As5600(MagnetEncoder):
    """An AS5600 on an ``I2cPort``; ``device_status``: STATUS.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        config: Settings.
    """

    ADDRESS = 0x36

    def __init__(self, name: str, port: I2cPort, config: As5600Config | None = None) -> None:
        self.config = config or As5600Config()
        super().__init__(
            name,
            port,
            self.ADDRESS,
            bits=12,
            zero_count=self.config.zero_count,
            counts_per_revolution=self.config.counts_per_revolution,
            sample_period_ms=self.config.sample_period_ms,
        )

    def _watched(self) -> list[Watched]:
        return [Watched(CONF_H, FILTER_CODE[self.config.slow_filter], 0, OURS_H), Watched(CONF_L, 0, 0, OURS_L)]

    def _set_up(self) -> Iterator[int]:
        seen = bytes([self._bus.byte(STATUS), self._bus.byte(STATUS + 1), 0])
        try:
            decode_reading(seen)
        except FrameError as error:
            raise WrongDeviceError(f"{self.name}: I2C {self._address:#x}: {error}") from None
        for register, value, _, mask in self._watched():
            kept = self._bus.byte(register) & ~mask
            self._write(register, kept | value, mask)
        yield POWER_UP_NS  # before that it shows no angle

    def _begin(self, now_ns: int, anew: bool) -> str:
        return f"AS5600 runs: a reading in {self.config.sample_period_ms:g} ms, filter {self.config.slow_filter}x"

    def _read(self) -> MagnetReading:
        reply = self._bus.read(STATUS, 3)
        counts, status = decode_reading(reply.data)
        wrong = (not status & DETECTED, bool(status & WEAK), bool(status & STRONG))
        codes = ("magnet_missing", "magnet_weak", "magnet_strong")
        fault = next((code for code, seen in zip(codes, wrong, strict=True) if seen), "")
        return MagnetReading(counts, status, fault, reply.host_ns)
