"""ams AS5600 above a magnet on a joint's axis, on I2C."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.i2c.as5600 import As5600, As5600Config, identify
from drivers.ports import I2cPort
from onboard.devices.buses import I2cDevice, Identify
from onboard.devices.i2c.magnet import MagnetDevice
from onboard.section import NotNegative

SETTLING_S = {16: 2.2e-3, 8: 1.1e-3, 4: 0.55e-3, 2: 0.286e-3}  # of the slow filter, data sheet figure 33
ECCENTRICITY_RAD = 6e-3  # rms: half a degree at most; the data sheet allows one with the magnet on the axis


class As5600Device(I2cDevice, MagnetDevice):
    """AS5600, the absolute angle of a magnet on the joint's axis, once in `sample_period_ms`.

    A magnet that is missing, too weak or too strong is a fault: its samples are not valid. One beside the axis is a
    once-a-turn error, `eccentricity_rad`. On the motor side of a gear its zero is lost with a turn of the magnet.
    """

    about_clock = (
        "The middle between request and answer, by the host's clock, less half of its filter's settling time; half "
        "their distance and a quarter of that time are its uncertainty. It has no input for the sync line."
    )
    driver_configs = (As5600Config,)
    new_bus = "i2c_{number}"  # it has one address
    new_keys: ClassVar[str] = """zero_count = 0                 # yours: what it reads at joint angle zero, 0 to 4095
sample_period_ms = 5
noise_rad = 9e-4               # of a sample: 0.043 degrees, and a count / sqrt(12)
"""
    addresses: ClassVar[tuple[int, ...]] = (0x36,)
    identify: ClassVar[Identify | None] = staticmethod(identify)
    kind: Literal["as5600"]
    address: Annotated[Literal[0x36], Field(description="7-bit I2C address: it has no other.")] = 0x36
    counts_per_revolution: int = As5600Config.counts_per_revolution
    eccentricity_rad: NotNegative = ECCENTRICITY_RAD
    slow_filter: Literal[2, 4, 8, 16] = 2

    @property
    def lag_s(self) -> tuple[float, float]:
        """See ``MagnetDevice``: half of its slow filter's settling time, and a quarter."""
        return 0.5 * SETTLING_S[self.slow_filter], 0.25 * SETTLING_S[self.slow_filter]

    def driver(self, name: str, port: I2cPort) -> As5600:
        """See ``I2cDevice``."""
        return As5600(name, port, self.settings(name))
