"""TDK InvenSense ICM-20948 on I2C."""

from math import tau
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.inertial.icm20948 import ACCEL_BANDWIDTH_HZ, BASE_HZ, GYRO_BANDWIDTH_HZ, Icm20948, Icm20948Config, identify
from drivers.ports import I2cPort
from onboard.devices.buses import Identify
from onboard.devices.i2c.fsync_imu import FsyncImuDevice
from onboard.section import NotNegative

DELAY_SIGMA_MS = 0.2  # a quarter of a period of 1125 Hz: its decimator is known by its bandwidths alone


class Icm20948Device(FsyncImuDevice):
    """ICM-20948, its accelerometer and gyroscope, drained from its FIFO.

    The data sheet states no delay of its filters: it is that of one pole at their bandwidth and half a period of 1125
    Hz, to `delay_sigma_ms`. `sample_rate_hz` is 1125 / (1 + n). Pins of a board: VIN, GND, SDA, SCL, and FSYNC (FSY)
    to the sync line, at 1.8 V where the board does not shift its level; with AD0 low its address is 104.
    """

    new_keys = """address = 0x69                 # 0x68 with AD0 low
sample_rate_hz = 562.5         # 1125 / (1 + n)
accel_range_g = 4
gyro_range_deg_s = 250
filter_code = 2                # 111 Hz and 120 Hz
poll_period_ms = 10
accel_noise_m_s2 = 0.038       # of a sample: 230 ug/sqrt(Hz) x sqrt(562.5 Hz / 2), the data sheet's
gyro_noise_rad_s = 4.4e-3      # of a sample: 0.015 deg/s/sqrt(Hz) x sqrt(562.5 Hz / 2)
"""
    driver_configs = (Icm20948Config,)
    identify: ClassVar[Identify | None] = staticmethod(identify)
    filter_register = "ACCEL_DLPFCFG and GYRO_DLPFCFG"
    kelvin_per_count: ClassVar[float] = 1.0 / 333.87  # TEMP_OUT
    kind: Literal["icm20948"]
    address: Annotated[int, Field(ge=0x68, le=0x69)] = Icm20948Config.address
    sample_rate_hz: Annotated[float, Field(ge=4.0, le=BASE_HZ)] = Icm20948Config.sample_rate_hz
    delay_sigma_ms: NotNegative = DELAY_SIGMA_MS

    @property
    def filter_delays_s(self) -> tuple[float, float]:
        """See ``ImuDevice``."""
        gyro_hz, accel_hz = GYRO_BANDWIDTH_HZ[self.filter_code], ACCEL_BANDWIDTH_HZ[self.filter_code]
        return 1.0 / (tau * gyro_hz) + 0.5 / BASE_HZ, 1.0 / (tau * accel_hz) + 0.5 / BASE_HZ

    def driver(self, name: str, port: I2cPort) -> Icm20948:
        """See ``I2cDevice``."""
        return Icm20948(name, port, self.settings(name))
