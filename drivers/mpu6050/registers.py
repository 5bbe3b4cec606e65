"""Registers of the MPU-6050 (RM-MPU-6000A 4.2) and the values that a configuration writes."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from drivers.errors import ConfigurationError
from drivers.ports import I2cPort

SELF_TEST_X = 0x0D  # and Y, Z, A behind it
SMPLRT_DIV = 0x19
CONFIG = 0x1A
GYRO_CONFIG = 0x1B
ACCEL_CONFIG = 0x1C
ACCEL_CONFIG_2 = 0x1D  # MPU-6500 family only
FIFO_EN = 0x23
INT_PIN_CFG = 0x37
INT_ENABLE = 0x38
INT_STATUS = 0x3A
ACCEL_XOUT_H = 0x3B
USER_CTRL = 0x6A
PWR_MGMT_1 = 0x6B
PWR_MGMT_2 = 0x6C
FIFO_COUNT_H = 0x72
FIFO_R_W = 0x74
WHO_AM_I = 0x75

EXT_SYNC_TEMP_OUT_L = 1 << 3  # CONFIG: FSYNC into bit 0 of the temperature
FIFO_EN_ALL = 0xF8  # FIFO_EN: temperature, gyro x, y, z, accel
FIFO_OFLOW = 1 << 4  # INT_ENABLE, INT_STATUS
USER_FIFO_EN = 1 << 6
USER_FIFO_RESET = 1 << 2
DEVICE_RESET = 1 << 7  # PWR_MGMT_1
SLEEP = 1 << 6
CLOCK_PLL_GYRO_X = 1

DATA_RDY = 1 << 0  # INT_ENABLE, INT_STATUS

FIFO_RUNS = {USER_CTRL: USER_FIFO_EN, FIFO_EN: FIFO_EN_ALL}  # besides the configuration
BURST_RUNS = {USER_CTRL: 0, FIFO_EN: 0}

STANDARD_GRAVITY_M_S2 = 9.80665
ACCEL_LSB_PER_G = {2: 16384.0, 4: 8192.0, 8: 4096.0, 16: 2048.0}  # AFS_SEL 0..3, PS 6.2
GYRO_LSB_PER_DEG_S = {250: 131.0, 500: 65.5, 1000: 32.8, 2000: 16.4}  # FS_SEL 0..3, PS 6.1
RESERVED_FILTER_CODE = 7


class Chip(NamedTuple):
    """A chip at the MPU-6050's address with a compatible FIFO."""

    name: str
    fifo_bytes: int
    temperature: str  # degC of its raw temperature word
    second_accel_config: int | None  # ACCEL_CONFIG_2 without its filter code; None: no such register


CHIPS = {
    0x68: Chip("MPU-6050", 1024, "raw/340 + 36.53", None),
    0x70: Chip("MPU-6500", 512, "raw/333.87 + 21", 0),
    0x71: Chip("MPU-9250", 512, "raw/333.87 + 21", 0),
    0x73: Chip("MPU-9255", 512, "raw/333.87 + 21", 0),
    0x74: Chip("MPU-6515", 512, "raw/333.87 + 21", 0),
    0x98: Chip("ICM-20689", 4096, "raw/326.8 + 25", 0xC0),  # FIFO_SIZE = 3: all of it
}
INCOMPATIBLE = {  # their FIFO has another order or count, or their registers lie in banks
    0x11: "ICM-20600",
    0x12: "ICM-20602",
    0xAF: "ICM-20608",
    0xEA: "ICM-20948",
    0x47: "ICM-42688",
}


def identify(port: I2cPort, address: int) -> str | None:
    """Name of the chip at an address by its WHO_AM_I, which is all that is read; None: it is none of ``CHIPS``.

    Raises:
        OSError: The transfer failed.
    """
    chip = CHIPS.get(port.write_read(address, bytes([WHO_AM_I]), 1).data[0])
    return chip.name if chip else None


@dataclass(frozen=True)
class Mpu6050Config:
    """Configuration of the chip.

    Attributes:
        address: 7-bit I2C address: 0x68, or 0x69 with AD0 high.
        sample_rate_hz: Nominal rate; a whole fraction of 1000.
        accel_range_g: 2, 4, 8 or 16.
        gyro_range_deg_s: 250, 500, 1000 or 2000.
        filter_code: DLPF_CFG, 0..6.
        poll_period_ms: Time between two drains of the FIFO; where that of a clone is small, it is drained before it
            is half full. Burst mode polls at the sample rate.
        max_transfer_bytes: Longest single read; some adapters are limited to 32, 255 or 4096 bytes.
        mode: ``fifo``, or ``burst``: one transfer of the data registers per sample.

    Raises:
        ConfigurationError: A value the chip does not have, or a FIFO that would run over between two drains.
    """

    address: int = 0x68
    sample_rate_hz: int = 1000
    accel_range_g: int = 4
    gyro_range_deg_s: int = 250
    filter_code: int = 2
    poll_period_ms: float = 10.0
    max_transfer_bytes: int = 252
    mode: Literal["fifo", "burst"] = "fifo"

    def __post_init__(self) -> None:
        if self.address not in {0x68, 0x69}:
            raise ConfigurationError(f"an MPU-6050 has no address {self.address:#x}: use 0x68, or 0x69 with AD0 high")
        if self.accel_range_g not in ACCEL_LSB_PER_G:
            raise ConfigurationError(f"accel_range_g = {self.accel_range_g}: use 2, 4, 8 or 16")
        if self.gyro_range_deg_s not in GYRO_LSB_PER_DEG_S:
            raise ConfigurationError(f"gyro_range_deg_s = {self.gyro_range_deg_s}: use 250, 500, 1000 or 2000")
        if not 0 <= self.filter_code < RESERVED_FILTER_CODE:
            raise ConfigurationError(f"filter_code = {self.filter_code}: DLPF_CFG is 0..6")
        if not 4 <= self.sample_rate_hz <= 1000 or 1000 % self.sample_rate_hz:
            raise ConfigurationError(f"sample_rate_hz = {self.sample_rate_hz}: use a whole fraction of 1000, 4 or more")
        if self.mode not in {"fifo", "burst"}:
            raise ConfigurationError(f"mode = {self.mode!r}: use fifo or burst")
        if self.mode == "fifo" and not 0.0 < self.poll_period_ms * self.sample_rate_hz <= 36_000.0:
            raise ConfigurationError(
                f"poll_period_ms = {self.poll_period_ms}: over 36 samples would gather, half the FIFO: poll faster"
            )
        if not 14 <= self.max_transfer_bytes <= 8192:
            raise ConfigurationError(f"max_transfer_bytes = {self.max_transfer_bytes}: use 14 (a packet) to 8192")

    @property
    def accel_scale_m_s2(self) -> float:
        """Specific force per count, m/s^2."""
        return STANDARD_GRAVITY_M_S2 / ACCEL_LSB_PER_G[self.accel_range_g]

    @property
    def gyro_scale_rad_s(self) -> float:
        """Angular rate per count, rad/s."""
        return 0.017453292519943295 / GYRO_LSB_PER_DEG_S[self.gyro_range_deg_s]

    @property
    def sample_period_ns(self) -> int:
        """Nominal sample period, ns."""
        return 1_000_000_000 // self.sample_rate_hz


def configuration(config: Mpu6050Config, chip: Chip) -> dict[int, int]:
    """Register values while the chip runs, in the order they are written."""
    gyro_rate_hz = 8000 if config.filter_code == 0 else 1000  # RM, register 25
    registers = {
        PWR_MGMT_1: CLOCK_PLL_GYRO_X,
        PWR_MGMT_2: 0,
        SMPLRT_DIV: gyro_rate_hz // config.sample_rate_hz - 1,
        CONFIG: EXT_SYNC_TEMP_OUT_L | config.filter_code,
        GYRO_CONFIG: list(GYRO_LSB_PER_DEG_S).index(config.gyro_range_deg_s) << 3,
        ACCEL_CONFIG: list(ACCEL_LSB_PER_G).index(config.accel_range_g) << 3,
        INT_PIN_CFG: 0,
        INT_ENABLE: FIFO_OFLOW if config.mode == "fifo" else DATA_RDY,
    }
    if chip.second_accel_config is not None:
        registers[ACCEL_CONFIG_2] = chip.second_accel_config | config.filter_code
    return registers
