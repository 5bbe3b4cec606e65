"""TDK InvenSense ICM-20948: accelerometer and gyroscope on I2C at 68h or 69h, read from its FIFO.

Source: data sheet DS-000189 1.3. Registers lie in four banks; those read in flight are in bank 0. All of a sample goes
into the FIFO in the order of the registers: accel x, y, z, gyro x, y, z, temperature. A pulse on FSYNC marks bit 0 of
the temperature (FSYNC_CONFIG, EXT_SYNC_SET = 1). Both sensors have the same divider, and begin together (ODR_ALIGN_EN).

Known limits: the compass inside (AK09916) is not read, nor the self test. The data sheet has 512 bytes of FIFO, and
more in parts without DMP firmware: a count beyond 512 is taken for an overflow. Gyroscope rates are stated by it as
fractions of 1100 Hz, those of the accelerometer of 1125 Hz, which have one oscillator: the rate is fitted.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from drivers.errors import ConfigurationError, WrongDeviceError
from drivers.i2c.banked import BankedBus
from drivers.i2c.sensor import MS, I2cSensor, Watched
from drivers.inertial.fifo import Fifo
from drivers.inertial.packet import PACKET_BYTES, WordOrder
from drivers.inertial.stream import MARKED, SampleStream
from drivers.ports import I2cPort, I2cReply
from drivers.records import Batch, Severity
from drivers.repeats import Repeats, longest_run
from drivers.reporter import Reporter

# Bank 0
WHO_AM_I, USER_CTRL, LP_CONFIG, PWR_MGMT_1, PWR_MGMT_2 = 0x00, 0x03, 0x05, 0x06, 0x07
INT_ENABLE_2, INT_STATUS_2, FIFO_EN_1, FIFO_EN_2, FIFO_RST, FIFO_MODE = 0x12, 0x1B, 0x66, 0x67, 0x68, 0x69
FIFO_COUNTH, FIFO_R_W, REG_BANK_SEL = 0x70, 0x72, 0x7F
# Bank 2
GYRO_SMPLRT_DIV, GYRO_CONFIG_1, ODR_ALIGN_EN, ACCEL_SMPLRT_DIV_1, ACCEL_SMPLRT_DIV_2 = 0x200, 0x201, 0x209, 0x210, 0x211
ACCEL_CONFIG, FSYNC_CONFIG = 0x214, 0x252

IDENTITY = 0xEA
USER_FIFO_EN = 1 << 6
DEVICE_RESET, SLEEP, AUTO_CLOCK = 1 << 7, 1 << 6, 1  # PWR_MGMT_1
ASLEEP = SLEEP | AUTO_CLOCK  # after a reset
EVERY_SENSOR = 0x1F  # FIFO_EN_2: temperature, gyro x, y, z, accel
FIFO_ALL = 0x1F  # FIFO_RST, INT_ENABLE_2, INT_STATUS_2
EXT_SYNC_TEMP_OUT_L = 1

BASE_HZ = 1125.0
FIFO_BYTES, LARGEST_COUNT = 512, 4096
STANDARD_GRAVITY_M_S2 = 9.80665
ACCEL_LSB_PER_G = {2: 16384.0, 4: 8192.0, 8: 4096.0, 16: 2048.0}  # ACCEL_FS_SEL 0..3
GYRO_LSB_PER_DEG_S = {250: 131.0, 500: 65.5, 1000: 32.8, 2000: 16.4}  # GYRO_FS_SEL 0..3
ACCEL_BANDWIDTH_HZ = (246.0, 246.0, 111.4, 50.4, 23.9, 11.5, 5.7)  # by ACCEL_DLPFCFG; 7 is 473 Hz
ACCEL_NOISE_HZ = (265.0, 265.0, 136.0, 68.8, 34.4, 17.0, 8.3)
GYRO_BANDWIDTH_HZ = (196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7)  # by GYRO_DLPFCFG; 7 is 361.4 Hz
GYRO_NOISE_HZ = (229.8, 187.6, 154.3, 73.3, 35.9, 17.8, 8.9)
ACCEL_NOISE_G, GYRO_NOISE_DEG_S = 60e-6, 0.0075  # per sqrt(Hz): a quarter and half of the data sheet's, a lower bound

RESET_NS, WAKE_NS, SILENCE_NS = 100 * MS, 100 * MS, 100 * MS  # start-up of registers 100 ms at most, of the gyro 35 ms
LAST_DRAINS = 8
ORDER = WordOrder(slice(0, 3), 6, slice(3, 6))


@dataclass(frozen=True)
class Icm20948Config:
    """Settings.

    Attributes:
        address: 7-bit I2C address: 0x68, or 0x69 with AD0 high (as most boards have it).
        sample_rate_hz: Nominal: 1125 / (1 + n), n from 0 to 255.
        accel_range_g: 2, 4, 8 or 16.
        gyro_range_deg_s: 250, 500, 1000 or 2000.
        filter_code: ACCEL_DLPFCFG and GYRO_DLPFCFG, 0..6.
        poll_period_ms: Time between two drains of the FIFO.
        max_transfer_bytes: Longest single read; some adapters are limited to 32, 255 or 4096 bytes.

    Raises:
        ConfigurationError: A value the chip does not have, or a FIFO that would run over between two drains.
    """

    address: int = 0x69
    sample_rate_hz: float = 562.5
    accel_range_g: int = 4
    gyro_range_deg_s: int = 250
    filter_code: int = 2
    poll_period_ms: float = 10.0
    max_transfer_bytes: int = 252

    def __post_init__(self) -> None:
        if self.address not in {0x68, 0x69}:
            raise ConfigurationError(f"an ICM-20948 has no address {self.address:#x}: use 0x68, or 0x69 with AD0 high")
        if self.accel_range_g not in ACCEL_LSB_PER_G or self.gyro_range_deg_s not in GYRO_LSB_PER_DEG_S:
            raise ConfigurationError(
                f"{self.accel_range_g} g, {self.gyro_range_deg_s} deg/s: use 2, 4, 8 or 16, and 250, 500, 1000 or 2000"
            )
        if not 0 <= self.filter_code < len(GYRO_BANDWIDTH_HZ):
            raise ConfigurationError(f"filter_code = {self.filter_code}: use 0..6")
        if not 4.0 <= self.sample_rate_hz <= BASE_HZ or BASE_HZ / self.sample_rate_hz % 1.0:
            raise ConfigurationError(
                f"sample_rate_hz = {self.sample_rate_hz:g}: it is 1125 / (1 + n): 1125, 562.5, 375, 281.25, 225, 187.5"
            )
        if not 0.0 < 2.0 * PACKET_BYTES * self.poll_period_ms * self.sample_rate_hz <= 1e3 * FIFO_BYTES:
            raise ConfigurationError(
                f"poll_period_ms = {self.poll_period_ms:g}: over half its FIFO would gather: poll faster"
            )
        if not PACKET_BYTES <= self.max_transfer_bytes <= 8192:
            raise ConfigurationError(f"max_transfer_bytes = {self.max_transfer_bytes}: use 14 (a packet) to 8192")

    @property
    def accel_scale_m_s2(self) -> float:
        """Specific force per count, m/s^2."""
        return STANDARD_GRAVITY_M_S2 / ACCEL_LSB_PER_G[self.accel_range_g]

    @property
    def gyro_scale_rad_s(self) -> float:
        """Angular rate per count, rad/s."""
        return math.radians(1.0) / GYRO_LSB_PER_DEG_S[self.gyro_range_deg_s]

    @property
    def sample_period_ns(self) -> int:
        """Nominal sample period, ns."""
        return round(1e9 / self.sample_rate_hz)

    @property
    def most_repeats(self) -> int:
        """Longest run of equal samples that may occur by chance (``drivers.repeats.longest_run``)."""
        code = self.filter_code
        accel = ACCEL_NOISE_G * math.sqrt(ACCEL_NOISE_HZ[code]) * ACCEL_LSB_PER_G[self.accel_range_g]
        gyro = GYRO_NOISE_DEG_S * math.sqrt(GYRO_NOISE_HZ[code]) * GYRO_LSB_PER_DEG_S[self.gyro_range_deg_s]
        narrowest_hz = min(ACCEL_BANDWIDTH_HZ[code], GYRO_BANDWIDTH_HZ[code])
        return longest_run([accel] * 3 + [gyro] * 3, narrowest_hz, self.sample_rate_hz)


def identify(port: I2cPort, address: int) -> str | None:
    """Name of the chip by its WHO_AM_I, which is all that is read; None: another one, or not in its bank 0.

    Raises:
        OSError: The transfer failed.
    """
    return "ICM-20948" if port.write_read(address, bytes([WHO_AM_I]), 1).data[0] == IDENTITY else None


def settings(config: Icm20948Config) -> dict[int, int]:
    """Register values while the chip runs, in the order they are written."""
    divider = round(BASE_HZ / config.sample_rate_hz) - 1
    accel = list(ACCEL_LSB_PER_G).index(config.accel_range_g)
    gyro = list(GYRO_LSB_PER_DEG_S).index(config.gyro_range_deg_s)
    return {
        PWR_MGMT_1: AUTO_CLOCK,
        PWR_MGMT_2: 0,
        LP_CONFIG: 0,
        GYRO_CONFIG_1: config.filter_code << 3 | gyro << 1 | 1,
        ACCEL_CONFIG: config.filter_code << 3 | accel << 1 | 1,
        FSYNC_CONFIG: EXT_SYNC_TEMP_OUT_L,
        ODR_ALIGN_EN: 1,
        GYRO_SMPLRT_DIV: divider,
        ACCEL_SMPLRT_DIV_1: 0,
        ACCEL_SMPLRT_DIV_2: divider,
        INT_ENABLE_2: FIFO_ALL,
        FIFO_MODE: 0,
        FIFO_EN_1: 0,
    }


_AFTER_RESET = {PWR_MGMT_1: ASLEEP, LP_CONFIG: 0x40, GYRO_CONFIG_1: 1, ACCEL_CONFIG: 1}  # others 0


class Icm20948Fifo(Fifo):
    """See ``Fifo``."""

    order = ORDER
    fifo_bytes = FIFO_BYTES
    largest_count = LARGEST_COUNT

    def __init__(self, config: Icm20948Config, bus: BankedBus, stream: SampleStream, report: Reporter) -> None:
        super().__init__(config, stream, report)
        self._bus = bus

    def silence(self) -> None:
        """See ``Fifo``."""
        self._bus.write(FIFO_EN_2, 0)

    def _clear(self) -> int:
        self.silence()
        self._bus.write(USER_CTRL, USER_FIFO_EN)
        self._bus.write(FIFO_RST, FIFO_ALL)
        self._bus.write(FIFO_RST, 0)
        return self._bus.read(INT_STATUS_2).host_ns

    def _open(self) -> None:
        self._bus.write(FIFO_EN_2, EVERY_SENSOR)

    def _queued(self) -> I2cReply:
        return self._bus.read(FIFO_COUNTH, 2)

    def _read(self, count: int) -> I2cReply:
        return self._bus.pop(FIFO_R_W, count)

    def _has_run_over(self) -> bool:
        return bool(self._bus.byte(INT_STATUS_2) & FIFO_ALL)


class Icm20948(I2cSensor):
    """An ICM-20948 on an ``I2cPort``, as IMU rows on the channel of its name.

    ``sequence`` and ``tick`` are both the sample number since the first start, lost samples included. Rows of one drain
    share ``host_ns``: the stamp of the count, when the newest sample was less than one period old.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        config: Settings.
    """

    def __init__(self, name: str, port: I2cPort, config: Icm20948Config | None = None) -> None:
        self.config = config or Icm20948Config()
        super().__init__(name, port, self.config.address, round(self.config.poll_period_ms * MS))
        self._bus: BankedBus = BankedBus(port, self.config.address, REG_BANK_SEL)
        repeats = Repeats(self.config.most_repeats, self._report)
        self._stream = SampleStream(name, self.config.sample_period_ns, repeats, self._report)
        self._fifo = Icm20948Fifo(self.config, self._bus, self._stream, self._report)
        self._sampled_ns = 0

    def rests_until(self, now_ns: int) -> int:
        """See ``drivers.device.Rests``: samples may wait in the FIFO: marks and not arrivals give their times."""
        rests = self.is_running and self._stream.marks > MARKED
        return now_ns + self._fifo.rests_ns if rests else now_ns

    def start(self, now_ns: int) -> list[Batch]:
        """See ``drivers.device.Device``."""
        self._stream.begin()
        self._fifo.running = False
        return super().start(now_ns)

    def _watched(self) -> list[Watched]:
        own = settings(self.config) | ({USER_CTRL: USER_FIFO_EN, FIFO_EN_2: EVERY_SENSOR} if self._fifo.running else {})
        return [Watched(register, value, _AFTER_RESET.get(register, 0)) for register, value in own.items()]

    def _set_up(self) -> Iterator[int]:
        self._fifo.running = False
        identity = self._bus.byte(WHO_AM_I)
        if identity != IDENTITY and self._bus.byte(REG_BANK_SEL) in (0x10, 0x20, 0x30):  # somebody left it there
            self._bus.select(None)
            identity = self._bus.byte(WHO_AM_I)
        if identity != IDENTITY:
            raise WrongDeviceError(
                f"{self.name}: I2C {self._address:#x} has WHO_AM_I {identity:#04x}, ICM-20948 has 0xea: fit that chip "
                "or correct the address"
            )
        self._bus.write(PWR_MGMT_1, DEVICE_RESET)
        yield RESET_NS
        self._write(PWR_MGMT_1, AUTO_CLOCK)
        yield WAKE_NS
        for register, value in settings(self.config).items():
            self._write(register, value)

    def _begin(self, now_ns: int, anew: bool) -> str:
        if not self._fifo.running:
            self._stream.after_reset = anew and self._stream.next > 0
            self._fifo.restart(now_ns)
        self._sampled_ns = now_ns
        config = self.config
        ranges = f"{config.accel_range_g} g, {config.gyro_range_deg_s} deg/s, filter {config.filter_code}"
        return f"ICM-20948 runs: {config.sample_rate_hz:g} Hz, {ranges}"

    def _interrupt(self, cause: str) -> None:
        self._stream.cause = self._stream.cause or cause

    def _take(self, now_ns: int) -> None:
        if self._fifo.take(now_ns):
            self._sampled_ns = now_ns
            return
        silent_ns, period_ns = now_ns - self._sampled_ns, self.config.sample_period_ns
        if silent_ns < max(5 * period_ns, 2 * self._poll_ns):
            return
        lost = next(self._differing(), None)
        if lost is not None:
            self._lose_configuration(now_ns, *lost)
        elif silent_ns > max(SILENCE_NS, 20 * period_ns):
            text = "no samples although awake and configured: the chip is reset"
            self._report.event(now_ns, Severity.ERROR, "no_samples", text)
            self._set_up_again(now_ns, "no_samples")

    def _sleep(self, now_ns: int) -> None:
        for _ in range(LAST_DRAINS):
            self._fifo.silence()
            if not self._fifo.take(now_ns):
                break
        self._bus.write(USER_CTRL, 0)
        self._bus.write(PWR_MGMT_1, ASLEEP)

    def _finish(self, now_ns: int) -> str:
        stream = self._stream
        if stream.cause and stream.clock:
            stream.lose(now_ns, stream.clock.produced(now_ns))
        self._fifo.running = False
        return f"{stream.next} samples"
