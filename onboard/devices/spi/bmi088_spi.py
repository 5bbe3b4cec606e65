"""Bosch BMI088 on SPI."""

from collections.abc import Iterator
from typing import ClassVar, Literal

from drivers import transports
from drivers.device import Device
from drivers.inertial import bmi088
from drivers.transports.url import parse
from onboard.devices.base import OpeningBus, Problem, Surroundings
from onboard.devices.buses import SpiDevice
from onboard.devices.i2c.bmi088 import NEW_KEYS, Bmi088Sensor


class Bmi088SpiDevice(SpiDevice, Bmi088Sensor):
    """BMI088 on SPI, both its dies: drained from their FIFOs (`mode = "fifo"`), or read once in `sample_period_ms`.

    Each die has a select line: the URL of the bus is the accelerometer's node (CSB1), its `second` the gyroscope's
    (CSB2). The data sheet states no delay of its filters: it is that of one pole at their bandwidth, where it is read
    once and half a period of the die, to `delay_sigma_ms`. Pins: PS to ground (SPI), SDO1 and SDO2 together.
    """

    new_bus = "imu_spi"
    new_url = "spi:///dev/spidev1.0?second=/dev/spidev1.1"
    new_keys: ClassVar[str] = NEW_KEYS
    spi_mode = bmi088.SPI_MODE
    kind: Literal["bmi088_spi"]

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        accel, gyro = (
            bus.own(transports.open_spi(bus.url, bus.clock, cls.spi_mode, second=second)) for second in (False, True)
        )
        port = bmi088.Bmi088SpiPort(accel, gyro)
        devices = {name: device for name, device in bus.devices.items() if isinstance(device, cls)}
        return [device.reader(name, port, "SPI") for name, device in devices.items()]

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``."""
        yield from super().problems(name, around)
        if "second" not in parse(around.url(self.bus), self.urls).options:
            text = "the gyroscope's node is missing; add ?second=/dev/spidev0.1"
            yield ["bus", self.bus, "url"], f"{self.bus!r} of {name!r}: {text}"
