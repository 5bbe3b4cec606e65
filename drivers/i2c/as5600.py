"""ams AS5600: absolute angle of a magnet, 12 bits, on I2C at 36h.

Source: data sheet 1-06. Each transfer reads STATUS (0Bh) and RAW ANGLE (0Ch, 0Dh) at once, so that the state of the
magnet is that of the angle. Set-up changes the fields of CONF that matter here and leaves the others, which may hold
factory settings: slow filter only, no hysteresis, no low-power mode, no watchdog. ZPOS, MPOS and MANG do not act on RAW
ANGLE. The chip has no identity register: bits that it reserves as zeros are looked at instead (a MAX17048 has the same
address). Known limit: of what the magnet turned while it was not heard, whole turns are unknown.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import tau
from typing import Literal, NamedTuple

import numpy as np

from drivers.errors import ConfigurationError, FrameError, WrongDeviceError
from drivers.i2c.sensor import MS, I2cSensor, Watched
from drivers.ports import I2cPort
from drivers.position import Position
from drivers.records import SCALAR, SampleStatus, Severity

CONF_H, CONF_L, STATUS = 0x07, 0x08, 0x0B
OURS_H, OURS_L = 0x3F, 0x0F  # WD, FTH, SF; HYST, PM
FILTER_CODE = {16: 0, 8: 1, 4: 2, 2: 3}  # SF
DETECTED, WEAK, STRONG = 0x20, 0x10, 0x08  # STATUS: MD, ML, MH
POWER_UP_NS = 10 * MS
COUNTS = 4096
LARGEST_STEP = COUNTS // 4  # between two samples
FAULTS = (
    ("magnet_missing", "no magnet is detected: fit it, or lower it to 0.5 to 3 mm above the chip"),
    ("magnet_weak", "the magnet is too weak: bring it nearer, or take a stronger magnet"),
    ("magnet_strong", "the magnet is too strong: raise it, or take a weaker magnet"),
)


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


class As5600(I2cSensor):
    """An AS5600 on an ``I2cPort``, as SCALAR rows in rad on the channel of its name.

    ``tick``: CLOCK_MONOTONIC just before the request, ``host_ns``: when the answer had come. ``device_status``: STATUS.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        config: Settings.
    """

    ADDRESS = 0x36

    def __init__(self, name: str, port: I2cPort, config: As5600Config | None = None) -> None:
        self.config = config or As5600Config()
        super().__init__(name, port, self.ADDRESS, round(self.config.sample_period_ms * MS))
        self._position = Position(LARGEST_STEP, self.config.zero_count, 12)
        self._next = 0
        self._last_ns: int | None = None
        self._magnet_fault = ""

    def _watched(self) -> list[Watched]:
        return [
            Watched(CONF_H, FILTER_CODE[self.config.slow_filter], 0, OURS_H),
            Watched(CONF_L, 0, 0, OURS_L),
        ]

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

    def _take(self, now_ns: int) -> None:
        reply = self._bus.read(STATUS, 3)
        try:
            reading = decode_reading(reply.data)
        except FrameError as error:
            self._report.event(now_ns, Severity.ERROR, "bad_frame", str(error))
            self._interrupt("bad_frame")
            return
        self._name_gap(now_ns)
        fault = self._magnet(now_ns, reading.status)
        position, accepted = self._position.place(reading.counts) if not fault else (reading.counts, False)
        row = np.zeros(1, SCALAR)
        scale = tau / self.config.counts_per_revolution
        status = SampleStatus.OK if accepted else SampleStatus.NOT_VALID
        asked_ns = min(now_ns, reply.host_ns)
        row[0] = (self._next, reply.host_ns, asked_ns, position, scale, b"rad", 0, reading.status, status)
        self._report.rows(self.name, row)
        self._next += 1
        self._last_ns = now_ns

    def _magnet(self, now_ns: int, status: int) -> bool:
        """Whether the magnet is at fault; an event is emitted when that changes."""
        seen = (not status & DETECTED, bool(status & WEAK), bool(status & STRONG))
        code, text = next((said for said, wrong in zip(FAULTS, seen, strict=True) if wrong), ("", ""))
        if code and code != self._magnet_fault:
            self._report.event(now_ns, Severity.ERROR, code, text)
        elif self._magnet_fault and not code:
            self._report.event(now_ns, Severity.INFO, "magnet_over", "the magnet is within its limits again")
        self._magnet_fault = code
        return bool(code)

    def _name_gap(self, now_ns: int) -> None:
        """Record the readings that were due since the last one as a gap, if it was away."""
        if self._cause and self._last_ns is not None:
            lost = max(round((now_ns - self._last_ns) / self._poll_ns) - 1, 0)
            if lost:
                first = self._next
                self._report.gap(now_ns, self.name, first, first + lost - 1, now_ns - self._last_ns, self._cause)
                self._next += lost
        self._cause = ""

    def _sleep(self, now_ns: int) -> None:
        """It has no state to be put to."""

    def _finish(self, now_ns: int) -> str:
        self._name_gap(now_ns)
        self._last_ns = None
        return f"{self._next} samples"
