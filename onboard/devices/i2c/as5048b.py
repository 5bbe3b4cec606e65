"""ams AS5048B above a magnet on a joint's axis, on I2C; and what the AS5048A on SPI has in common with it."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.i2c.as5048 import As5048, As5048Config, identify
from drivers.ports import I2cPort
from onboard.devices.buses import I2cDevice, Identify
from onboard.devices.i2c.magnet import MagnetDevice
from onboard.section import NotNegative

SAMPLE_S, PROPAGATION_S = 1.0 / 11_250.0, (100e-6, 5e-6)  # and sigma: data sheet, 90.7 to 110.2 us
ECCENTRICITY_RAD = 9.9e-3  # rms: the data sheet allows 0.8 degrees with the magnet on the axis


class As5048Device(MagnetDevice):
    """An AS5048 of either interface."""

    about_clock = (
        "The middle between request and answer, by the host's clock, less 144 us from sample to output; half their "
        "distance and 26 us are its uncertainty. It has no input for the sync line."
    )
    driver_configs = (As5048Config,)
    counts_per_revolution: int = As5048Config.counts_per_revolution
    eccentricity_rad: NotNegative = ECCENTRICITY_RAD

    @property
    def lag_s(self) -> tuple[float, float]:
        """See ``MagnetDevice``: its propagation delay, and the age of the last sample, half a period on average."""
        return PROPAGATION_S[0] + 0.5 * SAMPLE_S, math.hypot(PROPAGATION_S[1], SAMPLE_S / math.sqrt(12.0))


class As5048bDevice(I2cDevice, As5048Device):
    """AS5048B, the absolute angle of a magnet on the joint's axis in 14 bits, once in `sample_period_ms`.

    A magnet that is too weak or too strong is a fault: its samples are not valid. One beside the axis is a once-a-turn
    error, `eccentricity_rad`. On the motor side of a gear its zero is lost with a turn of the magnet.
    """

    new_bus = "i2c_{number}"
    new_keys: ClassVar[str] = """address = 0x40                 # by A1, A2: four share a bus, 0x40 to 0x43
zero_count = 0                 # yours: what it reads at joint angle zero, 0 to 16383
sample_period_ms = 5
noise_rad = 1.05e-3            # one sample: 0.06 degrees
"""
    addresses: ClassVar[tuple[int, ...]] = (0x40, 0x41, 0x42, 0x43)
    identify: ClassVar[Identify | None] = staticmethod(identify)
    kind: Literal["as5048b"]
    address: Annotated[int, Field(ge=0x40, le=0x43, description="7-bit I2C address, by its pins A1 and A2.")] = 0x40

    def driver(self, name: str, port: I2cPort) -> As5048:
        """See ``I2cDevice``."""
        return As5048(name, port, self.address, self.settings(name))
