"""Bosch BMI088: an accelerometer (18h, 19h) and a gyroscope (68h, 69h), two dies with an oscillator each.

Source: data sheet BST-BMI088-DS001. A reading is two transfers: force and sensor time (12h to 1Ah), rates (02h to 07h),
low byte first: each word is up to a period of its die old; the faster the die, the less. Its FIFOs lose no sample and
tell each one's time (``bmi088_fifo``). The sensor time, 24 bits of 39.0625 us, tells an accelerometer that has stopped;
a gyroscope that has is told by its registers. The accelerometer
comes up suspended: it takes 1 ms for a write until it is active, and 50 ms to its first sample; the gyroscope 30 ms
after a reset. Known limits: self tests are not used; the data sheet states bandwidths of the filters, no delays.

SPI, modes 0 and 3: a select line for each die. Bit 7 of the first byte reads; the accelerometer's answer comes a byte
later than the gyroscope's. It comes up on I2C, also by a soft reset, and loses its first frame, which takes it to SPI.
An absent chip cannot be told from one that reads zeros, so each transfer first reads the die's identity in a frame of
its own, which is that first frame, too.
"""

import errno
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, FrameError, WrongDeviceError
from drivers.i2c.bus import RegisterBus
from drivers.i2c.sensor import MS, I2cSensor, Watched
from drivers.ports import I2cPort, I2cReply, SpiPort
from drivers.records import IMU, SampleStatus, Severity

# Accelerometer
CHIP_ID, FORCES, TEMPERATURE, ACC_CONF, ACC_RANGE, PWR_CONF, PWR_CTRL, ACC_SOFTRESET = (
    *(0x00, 0x12, 0x22, 0x40, 0x41, 0x7C, 0x7D, 0x7E),
)
# Gyroscope: 256 more
GYRO_CHIP_ID, RATES, GYRO_RANGE, GYRO_BANDWIDTH, GYRO_LPM1, GYRO_SOFTRESET = 0x100, 0x102, 0x10F, 0x110, 0x111, 0x114
IDENTITIES = {CHIP_ID: 0x1E, GYRO_CHIP_ID: 0x0F}
SPI_MODE, SPI_READ, SPI_NOTHING = 0, 0x80, (0x00, 0xFF)  # the last: identities of a line that no chip drives
FIFOS = (0x26, 0x3F)  # of either die: where reading on stays, also of who began before
ACTIVE, ON, SOFTRESET = 0x00, 0x04, 0xB6
STANDARD_GRAVITY_M_S2 = 9.80665
ACCEL_RANGES_G, GYRO_RANGES_DEG_S = (3, 6, 12, 24), (2000, 1000, 500, 250, 125)  # by their codes
RESET_NS, WRITE_NS, WAKE_NS = 30 * MS, 5 * MS, 50 * MS
TEMPERATURE_NS = 1280 * MS  # in which it is measured once
TICK_NS, TICKS = 39_062.5, 1 << 24  # of the sensor time
GYRO_ADDRESSES = (0x68, 0x69)
CLOCK_OFF = 0.1  # of the sensor time, at most: twice what an RC oscillator is off


class Filter(NamedTuple):
    """Codes of both dies; their rates and bandwidths, Hz."""

    accel_code: int
    gyro_code: int
    accel_rate_hz: float
    accel_hz: float
    gyro_rate_hz: float
    gyro_hz: float


FILTERS = (  # data sheet: ACC_CONF with its table of bandwidths, GYRO_BANDWIDTH
    Filter(0xAC, 0x00, 1600.0, 280.0, 2000.0, 532.0),
    Filter(0x9C, 0x01, 1600.0, 234.0, 2000.0, 230.0),
    Filter(0x8C, 0x02, 1600.0, 145.0, 1000.0, 116.0),
    Filter(0x8A, 0x03, 400.0, 40.0, 400.0, 47.0),
)


@dataclass(frozen=True)
class Bmi088Config:
    """Settings.

    Attributes:
        address: 7-bit I2C address of the accelerometer: 0x18, or 0x19 with SDO1 high.
        gyro_address: Of the gyroscope: 0x68, or 0x69 with SDO2 high.
        mode: "burst", the registers are read, or "fifo".
        sample_period_ms: Time between two readings of the registers.
        poll_period_ms: Time between two drains of the FIFOs.
        max_transfer_bytes: Longest single read of a FIFO.
        accel_range_g: 3, 6, 12 or 24.
        gyro_range_deg_s: 125, 250, 500, 1000 or 2000.
        filter_code: 0: 280 and 532 Hz, 1: 234 and 230, 2: 145 and 116, 3: 40 and 47 Hz of force and rate.

    Raises:
        ConfigurationError: A value the chip does not have.
    """

    address: int = 0x18
    gyro_address: int = 0x68
    mode: Literal["fifo", "burst"] = "burst"
    sample_period_ms: float = 5.0
    poll_period_ms: float = 10.0
    max_transfer_bytes: int = 252
    accel_range_g: int = 3
    gyro_range_deg_s: int = 250
    filter_code: int = 2

    def __post_init__(self) -> None:
        if self.address not in {0x18, 0x19} or self.gyro_address not in GYRO_ADDRESSES:
            text = f"{self.address:#x} and {self.gyro_address:#x}: a BMI088 has 0x18 or 0x19, and 0x68 or 0x69"
            raise ConfigurationError(text)
        if self.accel_range_g not in ACCEL_RANGES_G or self.gyro_range_deg_s not in GYRO_RANGES_DEG_S:
            text = f"{self.accel_range_g} g, {self.gyro_range_deg_s} deg/s: use 3, 6, 12 or 24, and 125 to 2000"
            raise ConfigurationError(text)
        if not 0 <= self.filter_code < len(FILTERS) or not self.sample_period_ms > 0.0:
            text = f"filter_code = {self.filter_code}, sample_period_ms = {self.sample_period_ms:g}"
            raise ConfigurationError(f"{text}: use 0 to 3, and a time")
        fastest_hz = max(FILTERS[self.filter_code].accel_rate_hz, FILTERS[self.filter_code].gyro_rate_hz)
        if not 0.0 < 2.0 * self.poll_period_ms * fastest_hz <= 1e5 or not 14 <= self.max_transfer_bytes <= 8192:
            text = f"poll_period_ms = {self.poll_period_ms:g}, max_transfer_bytes = {self.max_transfer_bytes}"
            raise ConfigurationError(f"{text}: use a time in which less than half a FIFO gathers, and 14 to 8192")

    @property
    def period_ms(self) -> float:
        """Time between two looks."""
        return self.poll_period_ms if self.mode == "fifo" else self.sample_period_ms

    @property
    def accel_scale_m_s2(self) -> float:
        """Specific force per count, m/s^2."""
        return STANDARD_GRAVITY_M_S2 * self.accel_range_g / 32768.0

    @property
    def gyro_scale_rad_s(self) -> float:
        """Angular rate per count, rad/s."""
        return math.radians(self.gyro_range_deg_s) / 32768.0


class Forces(NamedTuple):
    """Words of specific force along x, y, z, and sensor time in units of 39.0625 us."""

    words: NDArray[np.int16]
    ticks: int


def decode_forces(data: bytes) -> Forces:
    """Force and sensor time (12h to 1Ah).

    Raises:
        FrameError: Not nine bytes.
    """
    if len(data) != 9:
        raise FrameError(f"{len(data)} bytes are no force and time of a BMI088: check bus and address")
    return Forces(np.frombuffer(data[:6], "<i2"), int.from_bytes(data[6:], "little"))


def decode_temperature(data: bytes) -> int:
    """Temperature word (22h, 23h): 11 bits with a sign, 8 counts a kelvin, 0 at 23 degC."""
    word = data[0] << 3 | data[1] >> 5
    return word - 2048 if word > 1023 else word


def identify(port: I2cPort, address: int) -> str | None:
    """Name of the chip by the accelerometer's identity, which is all that is read; None: it is another.

    Raises:
        OSError: The transfer failed.
    """
    is_one = port.write_read(address, bytes([CHIP_ID]), 1).data[0] == IDENTITIES[CHIP_ID]
    return "BMI088, its accelerometer" if is_one else None


class DiesBus(RegisterBus):
    """Registers of two dies: 256 times the die, and the address in that."""

    def __init__(self, port: I2cPort, accel: int, gyro: int) -> None:
        super().__init__(port, accel)
        self._dies = accel, gyro

    def read(self, register: int, count: int = 1) -> I2cReply:
        """See ``RegisterBus``."""
        self._address = self._dies[register >> 8]
        return super().read(register & 0xFF, count)

    def pop(self, register: int, count: int) -> I2cReply:
        """See ``RegisterBus``."""
        self._address = self._dies[register >> 8]
        return super().pop(register & 0xFF, count)

    def write(self, register: int, value: int) -> None:
        """See ``RegisterBus``."""
        self._address = self._dies[register >> 8]
        super().write(register & 0xFF, value)


class Bmi088SpiPort:
    """An ``I2cPort`` of both dies, by their addresses on I2C.

    Args:
        accel: Select line CSB1.
        gyro: CSB2.
    """

    def __init__(self, accel: SpiPort, gyro: SpiPort) -> None:
        self._dies = accel, gyro

    def write(self, address: int, data: bytes) -> None:
        """See ``I2cPort``."""
        self._dies[address in GYRO_ADDRESSES].transfer(data, len(data))

    def write_read(self, address: int, data: bytes, count: int) -> I2cReply:
        """See ``I2cPort``.

        Raises:
            OSError: ENXIO where nothing answers, EBADMSG for a wrong identity before another register.
        """
        die = address in GYRO_ADDRESSES
        begin = 1 if die else 2
        size = begin + count
        frame, identifying = (bytes([SPI_READ | register]).ljust(size, b"\0") for register in (data[0], CHIP_ID))
        if data[0] in FIFOS:  # an identity that is read on to there takes out of the FIFO
            got, host_ns = self._dies[die].transfer(identifying[: begin + 1], begin + 1)
            got = got.ljust(size, b"\0")
        else:
            got, host_ns = self._dies[die].transfer(identifying + frame, size)
        identity = got[begin] if data[0] != CHIP_ID else got[size + begin]
        if identity in SPI_NOTHING:
            raise OSError(errno.ENXIO, "no chip drives the line")
        if data[0] != CHIP_ID and identity != IDENTITIES[die << 8]:
            raise OSError(errno.EBADMSG, f"CHIP_ID reads {identity:02x}h")
        if data[0] in FIFOS:
            got, host_ns = self._dies[die].transfer(frame, size)
            return I2cReply(got[begin:], host_ns)
        return I2cReply(got[size + begin :], host_ns)

    def close(self) -> None:
        """Release both."""
        for port in self._dies:
            port.close()


class Bmi088(I2cSensor):
    """A BMI088 on an ``I2cPort``, as IMU rows on the channel of its name.

    ``tick``: CLOCK_MONOTONIC just before the request, ``host_ns``: when both answers had come.

    Args:
        name: Channel, and source of its events.
        port: The bus, or a ``Bmi088SpiPort``.
        config: Settings.
        bus: Its name, for messages.
    """

    def __init__(self, name: str, port: I2cPort, config: Bmi088Config | None = None, bus: str = "I2C") -> None:
        self.config = own = config or Bmi088Config()
        super().__init__(name, port, own.address, round(own.period_ms * MS))
        self._bus: DiesBus = DiesBus(port, own.address, own.gyro_address)
        self._where = f"I2C {own.address:#x} and {own.gyro_address:#x}" if bus == "I2C" else bus
        self._next = 0
        self._last_ns: int | None = None
        self._seen: tuple[int, int, int] | None = None  # of the last reading: sensor time, request, answer
        self._temperature, self._warmed_ns = 0, 0
        self._first = SampleStatus.OK  # of the next row

    def _watched(self) -> list[Watched]:
        own, codes = self.config, FILTERS[self.config.filter_code]
        return [
            Watched(PWR_CONF, ACTIVE, 0x03),
            Watched(PWR_CTRL, ON, 0x00),
            Watched(ACC_CONF, codes.accel_code, 0xA8),
            Watched(ACC_RANGE, ACCEL_RANGES_G.index(own.accel_range_g), 0x01),
            Watched(GYRO_LPM1, ACTIVE, ACTIVE),
            Watched(GYRO_RANGE, GYRO_RANGES_DEG_S.index(own.gyro_range_deg_s), 0x00),
            Watched(GYRO_BANDWIDTH, codes.gyro_code, 0x00, 0x0F),  # bit 7 is always 1
        ]

    def _set_up(self) -> Iterator[int]:
        for register, identity in IDENTITIES.items():
            found = self._bus.byte(register)
            if found != identity:
                part = "gyroscope" if register >> 8 else "accelerometer"
                text = f"the {part} on {self._where} has CHIP_ID {found:#04x}, a BMI088's has {identity:#04x}"
                raise WrongDeviceError(f"{self.name}: {text}: fit that chip or correct its address or node")
        self._bus.write(ACC_SOFTRESET, SOFTRESET)
        self._bus.write(GYRO_SOFTRESET, SOFTRESET)
        yield RESET_NS
        self._bus.byte(CHIP_ID)  # on SPI this takes the accelerometer from I2C to there
        power, rest = self._watched()[:2], self._watched()[2:]
        for one in (*power, None, *rest):
            if one is None:
                yield WAKE_NS
            else:
                self._bus.write(one.register, one.value)
                yield WRITE_NS
        wrong = next(self._differing(), None)
        if wrong is not None:
            text = (
                f"register {wrong[0].register:#05x} reads {wrong[1]:#04x}, not {wrong[0].value:#04x}: replace the chip"
            )
            raise ConfigurationError(f"{self.name}: {text}")

    def _begin(self, now_ns: int, anew: bool) -> str:
        self._seen, self._warmed_ns = None, now_ns - TEMPERATURE_NS
        self._first = SampleStatus.AFTER_RESET if anew and self._next else SampleStatus.OK
        own = self.config
        ranges = f"{own.accel_range_g} g, {own.gyro_range_deg_s} deg/s, filter {own.filter_code}"
        return f"BMI088 runs: a reading in {own.period_ms:g} ms, {ranges}"

    def _warm(self, now_ns: int) -> None:
        """Read the temperature, where it may be another one. Raises OSError."""
        if now_ns - self._warmed_ns >= TEMPERATURE_NS:
            self._temperature, self._warmed_ns = decode_temperature(self._bus.read(TEMPERATURE, 2).data), now_ns

    def _stands_still(self, now_ns: int) -> None:
        text = "its sensor time stands still, or began anew: the chip is reset; check its supply"
        self._report.event(now_ns, Severity.ERROR, "no_samples", text)
        self._set_up_again(now_ns, "no_samples")

    def _take(self, now_ns: int) -> None:
        self._warm(now_ns)
        forces = decode_forces(self._bus.read(FORCES, 9).data)
        rates, host_ns = self._bus.read(RATES, 6)
        asked_ns = min(now_ns, host_ns)
        if not self._goes_on(forces.ticks, asked_ns, host_ns):
            self._stands_still(now_ns)
            return
        self._seen = forces.ticks, asked_ns, host_ns
        self._name_gap(now_ns)
        row = np.zeros(1, IMU)
        words = np.frombuffer(rates, "<i2")
        row["sequence"], row["tick"], row["host_ns"] = self._next, asked_ns, host_ns
        row["accel_scale_m_s2"], row["gyro_scale_rad_s"] = self.config.accel_scale_m_s2, self.config.gyro_scale_rad_s
        row["accel_raw"], row["gyro_raw"], row["temperature_raw"] = forces.words, words, self._temperature
        row["filter_code"] = self.config.filter_code
        ends = np.concatenate((forces.words, words))
        beyond = SampleStatus.SATURATED if ((ends == 32767) | (ends == -32768)).any() else SampleStatus.OK
        row["status"] = self._first | beyond
        self._report.rows(self.name, row)
        self._next += 1
        self._last_ns, self._first = now_ns, SampleStatus.OK

    def _goes_on(self, ticks: int, asked_ns: int, host_ns: int) -> bool:
        """Whether the sensor time has gone on as the host's did since the last reading."""
        if self._seen is None:
            return True
        before, last_asked_ns, last_host_ns = self._seen
        least_ns = (1.0 - CLOCK_OFF) * (asked_ns - last_host_ns) - TICK_NS
        most_ns = (1.0 + CLOCK_OFF) * (host_ns - last_asked_ns) + TICK_NS
        went_ns = TICK_NS * ((ticks - before) % TICKS)
        return least_ns <= went_ns <= most_ns or most_ns > TICK_NS * TICKS

    def _name_gap(self, now_ns: int) -> None:
        """Record the readings that were due since the last one as a gap, if it was away."""
        if self._cause and self._last_ns is not None:
            lost = max(round((now_ns - self._last_ns) / self._poll_ns) - 1, 0)
            if lost:
                last = self._next + lost - 1
                self._report.gap(now_ns, self.name, self._next, last, now_ns - self._last_ns, self._cause)
                self._next += lost
        self._cause = ""

    def _sleep(self, now_ns: int) -> None:
        self._bus.write(PWR_CTRL, 0)

    def _finish(self, now_ns: int) -> str:
        self._name_gap(now_ns)
        self._last_ns = None
        return f"{self._next} samples"
