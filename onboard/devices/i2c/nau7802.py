"""Nuvoton NAU7802 with a load cell, on I2C."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from drivers.i2c.nau7802 import HIGHEST, Nau7802, Nau7802Config, identify
from drivers.ports import I2cPort
from drivers.records import SCALAR
from onboard.devices.base import LoadCellDevice, Problem, Surroundings
from onboard.devices.buses import I2cDevice, Identify
from onboard.section import NotNegative, Positive
from onboard.timebase.specs import ChannelClock, FreeChannel

FILTER_CONVERSIONS = 2.0  # delay of its filter: it settles in four conversions
FILTER_SIGMA = 0.25  # conversions: the data sheet says how it settles, not what it is


class Nau7802Device(I2cDevice, LoadCellDevice):
    """NAU7802, a converter for one load cell; the cell gives `rated_output_mV_V` at `rated_load_N`.

    Where `delay_ms` and `delay_sigma_ms` are not given they are those of its filter: two conversions, and a quarter.
    Pins: bridge to E+ (AVDD), E- (ground), A+ and A- (VIN1P, VIN1N); SDA, SCL, 3.3 V. Nothing on channel 2.
    """

    about_clock = (
        "The number of the conversion, by its own oscillator, fitted to when its data-ready bit was seen; sigma: "
        "`poll_period_ms` / sqrt(12), beside that of the filter's delay. It has no input for the sync line."
    )
    records = SCALAR
    driver_configs = (Nau7802Config,)
    new_keys: ClassVar[
        str
    ] = """sample_rate_hz = 320           # or 80, 40, 20, 10: less noise, more delay of its filter
amplifier = 128
rated_output_mV_V = 2.0        # yours: on the cell's label
rated_load_N = 50.0            # yours: at which it gives that
"""
    new_delay: ClassVar[str] = ""  # that of its own filter
    addresses: ClassVar[tuple[int, ...]] = (0x2A,)
    identify: ClassVar[Identify | None] = staticmethod(identify)
    kind: Literal["nau7802"]
    address: Annotated[Literal[0x2A], Field(description="7-bit I2C address: it has no other.")] = 0x2A
    sample_rate_hz: Literal[10, 20, 40, 80, 320] = 80
    amplifier: Literal[1, 2, 4, 8, 16, 32, 64, 128] = 128
    supply_V: NotNegative = Nau7802Config.supply_V  # noqa: N815
    rated_output_mV_V: Annotated[Positive, Field(description="Output of the cell at its rated load, mV/V.")] = 2.0  # noqa: N815
    rated_load_N: Annotated[  # noqa: N815
        Positive | None, Field(description="The cell's rated load; `capacity_N` where not given.")
    ] = None
    poll_period_ms: Positive = Nau7802Config.poll_period_ms

    @model_validator(mode="before")
    @classmethod
    def _filter(cls, said: Any) -> Any:
        """The delay of its own filter, where the file is silent."""
        if isinstance(said, dict) and said.get("sample_rate_hz", 80) in (10, 20, 40, 80, 320):
            conversion_ms = 1e3 / said.get("sample_rate_hz", 80)
            own = {"delay_ms": FILTER_CONVERSIONS * conversion_ms, "delay_sigma_ms": FILTER_SIGMA * conversion_ms}
            return own | said
        return said

    @property
    def counts_per_N(self) -> float:  # noqa: N802
        """Counts of a newton: full scale is half the reference over the gain."""
        return 2e-3 * self.rated_output_mV_V * self.amplifier * (HIGHEST + 1) / (self.rated_load_N or self.capacity_N)

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        return {name: FreeChannel(1e9 / self.sample_rate_hz, 0.0, 1e6 * self.poll_period_ms / 12**0.5)}

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``."""
        counts = self.capacity_N * self.counts_per_N
        if counts > HIGHEST:
            text = f"{self.capacity_N:g} N are {counts:.3g} counts, its range ends at {HIGHEST}; lower the amplifier"
            yield ["device", name, "amplifier"], text

    def settings(self, name: str) -> Nau7802Config:
        """See ``BusDevice``."""
        return self._settings(Nau7802Config, scale=1.0 / self.counts_per_N)

    def driver(self, name: str, port: I2cPort) -> Nau7802:
        """See ``I2cDevice``."""
        return Nau7802(name, port, self.settings(name))
