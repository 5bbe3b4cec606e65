"""MPU-6050 family IMU on I2C."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.mpu6050.device import Mpu6050
from drivers.mpu6050.registers import Mpu6050Config, identify
from drivers.ports import I2cPort
from onboard.devices.buses import Identify
from onboard.devices.i2c.fsync_imu import FsyncImuDevice

# DLPF_CFG 0..6: delay of the accelerometer's and of the gyroscope's low-pass filter, s (register map, register 26)
FILTER_DELAY_S = (
    (0.0, 0.98e-3),
    (2.0e-3, 1.9e-3),
    (3.0e-3, 2.8e-3),
    (4.9e-3, 4.8e-3),
    (8.5e-3, 8.3e-3),
    (13.8e-3, 13.4e-3),
    (19.0e-3, 18.6e-3),
)


class Mpu6050Device(FsyncImuDevice):
    """MPU-6050 family IMU: drained from its FIFO, or read sample by sample (``mode = "burst"``)."""

    new_keys = """address = 0x68
sample_rate_hz = 1000
accel_range_g = 4
gyro_range_deg_s = 250
filter_code = 2                # DLPF_CFG: 94/98 Hz
poll_period_ms = 10
accel_noise_m_s2 = 0.088       # of a sample: 400 ug/sqrt(Hz) x sqrt(1000 Hz / 2), the data sheet's
gyro_noise_rad_s = 1.95e-3     # of a sample: 0.005 deg/s/sqrt(Hz) x sqrt(1000 Hz / 2)
"""
    driver_configs = (Mpu6050Config,)
    identify: ClassVar[Identify | None] = staticmethod(identify)
    filter_register = "DLPF_CFG"
    kind: Literal["mpu6050"]
    kelvin_per_count: ClassVar[float] = 1.0 / 340.0  # register map, registers 65 and 66
    address: Annotated[int, Field(ge=0x68, le=0x69)] = Mpu6050Config.address
    sample_rate_hz: Annotated[int, Field(ge=4, le=1000)] = Mpu6050Config.sample_rate_hz
    mode: Literal["fifo", "burst"] = "fifo"

    @property
    def filter_delays_s(self) -> tuple[float, float]:
        """See ``ImuDevice``."""
        accel_s, gyro_s = FILTER_DELAY_S[self.filter_code]
        return gyro_s, accel_s

    def driver(self, name: str, port: I2cPort) -> Mpu6050:
        """See ``I2cDevice``."""
        return Mpu6050(name, port, self.settings(name))
