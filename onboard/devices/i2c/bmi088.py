"""Bosch BMI088 on I2C, and what it has in common with one on SPI."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.inertial.bmi088 import FILTERS, TICK_NS, Bmi088, Bmi088Config, identify
from drivers.inertial.bmi088_fifo import Bmi088Fifo
from drivers.ports import I2cPort
from drivers.records import IMU
from onboard.devices.base import BusDevice, ImuDevice, Surroundings
from onboard.devices.buses import I2cDevice, Identify, SamplePeriod
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock, FreeChannel, PolledChannel

DELAY_SIGMA_MS = 0.3  # a period of 1000 Hz / sqrt(12): the age of a sample that is read
NEW_KEYS = """mode = "fifo"
poll_period_ms = 10
accel_range_g = 3
gyro_range_deg_s = 250
filter_code = 2                # 145 Hz and 116 Hz
accel_noise_m_s2 = 0.049       # of a sample: 175 ug/sqrt(Hz) x sqrt(1600 Hz / 2), the data sheet's
gyro_noise_rad_s = 6.9e-3      # of a sample: 0.014 deg/s/sqrt(Hz) x sqrt(1600 Hz / 2)
"""


class Bmi088Sensor(BusDevice, ImuDevice):
    """A BMI088 on either bus."""

    about_clock = (
        '`mode = "fifo"`: the sensor time of the accelerometer\'s sample, fitted to the stamps of its readings; the '
        'rates lie between the two samples of the gyroscope around it. `mode = "burst"`: the middle between the first '
        "request and the last answer, by the host's clock; half their distance is its uncertainty, and the age of what "
        "is read a part of `delay_sigma_ms`. The sync line is not marked in its samples."
    )
    records = IMU
    driver_configs = (Bmi088Config,)
    kelvin_per_count: ClassVar[float] = 0.125
    mode: Literal["fifo", "burst"] = "burst"
    sample_period_ms: SamplePeriod = Bmi088Config.sample_period_ms
    poll_period_ms: Positive = Bmi088Config.poll_period_ms
    max_transfer_bytes: int = Bmi088Config.max_transfer_bytes
    accel_range_g: Literal[3, 6, 12, 24] = 3
    gyro_range_deg_s: Literal[125, 250, 500, 1000, 2000] = 250
    filter_code: Annotated[int, Field(ge=0, le=3)] = 2
    delay_sigma_ms: NotNegative = DELAY_SIGMA_MS

    @property
    def nominal_hz(self) -> float:
        """See ``DeviceSection``: of its FIFO the accelerometer's rate."""
        return FILTERS[self.filter_code].accel_rate_hz if self.mode == "fifo" else 1e3 / self.sample_period_ms

    @property
    def filter_delays_s(self) -> tuple[float, float]:
        """See ``ImuDevice``."""
        one, age = FILTERS[self.filter_code], 0.0 if self.mode == "fifo" else 0.5
        gyro_s = 0.5 / math.pi / one.gyro_hz + age / one.gyro_rate_hz
        return gyro_s, 0.5 / math.pi / one.accel_hz + age / one.accel_rate_hz

    def reader(self, name: str, port: I2cPort, bus: str = "I2C") -> Bmi088:
        """Its driver."""
        return (Bmi088Fifo if self.mode == "fifo" else Bmi088)(name, port, self.settings(name), bus)

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        return {name: FreeChannel(TICK_NS, 0.0, TICK_NS) if self.mode == "fifo" else PolledChannel()}

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        gyro_s, accel_s = self.filter_delays_s
        age = "" if self.mode == "fifo" else ", and age of a sample"
        sigma_s, why = 1e-3 * self.delay_sigma_ms, f"low-pass filter {self.filter_code}{age}"
        return [Delay(name, "gyro", gyro_s, sigma_s, why), Delay(name, "accel", accel_s, sigma_s, why)]


class Bmi088Device(I2cDevice, Bmi088Sensor):
    """BMI088, both its dies: drained from their FIFOs (`mode = "fifo"`), or read once in `sample_period_ms`.

    The data sheet states no delay of its filters: it is that of one pole at their bandwidth, where it is read once and
    half a period of the die, to `delay_sigma_ms`. Pins: PS to the supply (I2C), SDO1 and SDO2 to ground (0x18, 0x68).
    """

    new_keys = f"address = 0x18\ngyro_address = 0x68\n{NEW_KEYS}"
    addresses: ClassVar[tuple[int, ...]] = (0x18, 0x19)
    identify: ClassVar[Identify | None] = staticmethod(identify)
    kind: Literal["bmi088"]
    address: Annotated[int, Field(ge=0x18, le=0x19)] = Bmi088Config.address
    gyro_address: Annotated[int, Field(ge=0x68, le=0x69)] = Bmi088Config.gyro_address

    @property
    def places(self) -> tuple[int, ...]:
        """See ``I2cDevice``."""
        return self.address, self.gyro_address

    def driver(self, name: str, port: I2cPort) -> Bmi088:
        """See ``I2cDevice``."""
        return self.reader(name, port)
