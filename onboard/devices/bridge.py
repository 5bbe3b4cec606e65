"""Base of load cells on a 24-bit converter that has its own oscillator: the cell by its label, delay of the filter."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar

from pydantic import Field, model_validator

from drivers.records import SCALAR
from onboard.devices.base import LoadCellDevice, Problem, Surroundings
from onboard.section import Positive
from onboard.timebase.timebase import ChannelClock, FreeChannel

FILTER_CONVERSIONS = 2.0  # delay of a filter that settles in four conversions
FILTER_SIGMA = 0.25  # conversions: data sheets say how it settles, not what it is
FULL_SCALE = 1 << 23  # counts, of half the bridge's supply over the gain


class BridgeDevice(LoadCellDevice):
    """A strain gauge bridge that gives ``rated_output_mV_V`` at ``rated_load_N``; ``sample_rate_hz`` is nominal."""

    records = SCALAR
    about_clock = (
        "The number of the conversion, by its oscillator, fitted to when its conversions were seen to be ready; "
        "sigma: `poll_period_ms` / sqrt(12), beside that of the filter's delay. It has no input for the sync line."
    )
    new_delay: ClassVar[str] = ""  # that of its own filter
    clock_tolerance: ClassVar[float] = 0.06  # largest relative error of its rate
    sample_rate_hz: Any
    amplifier: Any
    poll_period_ms: Positive
    rated_output_mV_V: Annotated[Positive, Field(description="Output of the cell at its rated load, mV/V.")] = 2.0  # noqa: N815
    rated_load_N: Annotated[  # noqa: N815
        Positive | None, Field(description="The cell's rated load; `capacity_N` where not given.")
    ] = None

    @classmethod
    def filter_conversions(cls, rate_hz: float) -> tuple[float, float]:
        """Delay of its filter and 1 sigma of that, conversions."""
        del rate_hz
        return FILTER_CONVERSIONS, FILTER_SIGMA

    @model_validator(mode="before")
    @classmethod
    def _filter(cls, said: Any) -> Any:
        """The delay of its own filter, where the file is silent."""
        rate = said.get("sample_rate_hz", cls.model_fields["sample_rate_hz"].default) if isinstance(said, dict) else 0
        if isinstance(rate, int | float) and rate > 0.0:
            delay_ms, sigma_ms = (1e3 / rate * conversions for conversions in cls.filter_conversions(rate))
            return {"delay_ms": delay_ms, "delay_sigma_ms": sigma_ms} | said
        return said

    @property
    def counts_per_N(self) -> float:  # noqa: N802
        """Counts of a newton: full scale is half the bridge's supply over the gain."""
        rated_N = self.rated_load_N or self.capacity_N
        return 2e-3 * self.rated_output_mV_V * float(self.amplifier) * FULL_SCALE / rated_N

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        sigma_ns = 1e6 * self.poll_period_ms / 12**0.5
        return {name: FreeChannel(1e9 / self.sample_rate_hz, 0.0, sigma_ns, self.clock_tolerance)}

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``."""
        counts = self.capacity_N * self.counts_per_N
        if counts >= FULL_SCALE:
            ends = f"its range ends at {FULL_SCALE - 1}"
            yield (
                ["device", name, "amplifier"],
                f"{self.capacity_N:g} N are {counts:.3g} counts, {ends}; lower the amplifier",
            )
