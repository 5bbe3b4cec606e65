"""ams AS5048A on SPI, above a magnet on a joint's axis."""

from typing import ClassVar, Literal

from drivers.i2c import as5048
from drivers.ports import SpiPort
from onboard.devices.buses import SpiDevice
from onboard.devices.i2c.as5048b import As5048Device


class As5048aDevice(SpiDevice, As5048Device):
    """AS5048A, the absolute angle of a magnet on the joint's axis in 14 bits, once in `sample_period_ms`.

    A magnet that is too weak or too strong is a fault: its samples are not valid. One beside the axis is a once-a-turn
    error, `eccentricity_rad`. On the motor side of a gear its zero is lost with a turn of the magnet.
    """

    spi_mode = as5048.SPI_MODE
    new_keys: ClassVar[str] = """zero_count = 0                 # yours: what it reads at joint angle zero, 0 to 16383
sample_period_ms = 5
noise_rad = 1.05e-3            # one sample: 0.06 degrees
"""
    kind: Literal["as5048a"]

    def driver(self, name: str, port: SpiPort) -> as5048.As5048:
        """See ``SpiDevice``."""
        return as5048.As5048(name, as5048.As5048aPort(port), 0, self.settings(name))
