"""Nuvoton NAU7802 with a load cell, on I2C."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.i2c.nau7802 import Nau7802, Nau7802Config, identify
from drivers.ports import I2cPort
from onboard.devices.bridge import BridgeDevice
from onboard.devices.buses import I2cDevice, Identify
from onboard.section import NotNegative, Positive


class Nau7802Device(I2cDevice, BridgeDevice):
    """NAU7802, a converter for one load cell; the cell gives `rated_output_mV_V` at `rated_load_N`.

    Where `delay_ms` and `delay_sigma_ms` are not given they are those of its filter: two conversions, and a quarter.
    Pins: bridge to E+ (AVDD), E- (ground), A+ and A- (VIN1P, VIN1N); SDA, SCL, 3.3 V. Nothing on channel 2.
    """

    driver_configs = (Nau7802Config,)
    new_keys: ClassVar[
        str
    ] = """sample_rate_hz = 320           # or 80, 40, 20, 10: less noise, more delay of its filter
amplifier = 128
rated_output_mV_V = 2.0        # yours: on the cell's label
rated_load_N = 50.0            # yours: at which it gives that
"""
    addresses: ClassVar[tuple[int, ...]] = (0x2A,)
    identify: ClassVar[Identify | None] = staticmethod(identify)
    kind: Literal["nau7802"]
    address: Annotated[Literal[0x2A], Field(description="7-bit I2C address: it has no other.")] = 0x2A
    sample_rate_hz: Literal[10, 20, 40, 80, 320] = 80
    amplifier: Literal[1, 2, 4, 8, 16, 32, 64, 128] = 128
    supply_V: NotNegative = Nau7802Config.supply_V  # noqa: N815
    poll_period_ms: Positive = Nau7802Config.poll_period_ms

    def settings(self, name: str) -> Nau7802Config:
        """See ``BusDevice``."""
        return self._settings(Nau7802Config, scale=1.0 / self.counts_per_N)

    def driver(self, name: str, port: I2cPort) -> Nau7802:
        """See ``I2cDevice``."""
        return Nau7802(name, port, self.settings(name))
