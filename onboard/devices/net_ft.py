"""Six-axis force-torque sensors by RDT over UDP: ATI Net F/T, Ethernet Axia and compatible ones, OnRobot HEX."""

from collections.abc import Mapping
from functools import partial
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.device import Device
from drivers.net_ft import NetFt, NetFtChannel, NetFtConfig
from drivers.net_ft.device import answering
from drivers.net_ft.record import ANY_BIT, onrobot_set_up
from drivers.transports.network import UDP_URLS, UdpPort
from onboard.devices.base import Answering, OpeningBus
from onboard.devices.buses import ComponentDevice, PollPeriod, StreamedDevice
from onboard.section import Positive


class RdtDevice(StreamedDevice, ComponentDevice):
    """A component of a sensor that sends RDT records."""

    bus_type = "UDP"
    urls = UDP_URLS
    driver_configs = (NetFtConfig,)
    about_clock = (
        "The number of the record, which counts periods of the sensor's oscillator, fitted to the least delayed "
        "arrivals; `latency_ms` and half of `poll_period_ms` are taken off. All components have the same times."
    )
    new_bus = "box"
    new_url = "udp://192.168.1.1:49152"
    rate_hz: Positive = NetFtConfig.rate_hz
    poll_period_ms: PollPeriod = NetFtConfig.poll_period_ms
    silence_ms: Positive = NetFtConfig.silence_ms

    @property
    def counts(self) -> float:
        """Of a newton or newton metre."""
        raise NotImplementedError

    @property
    def tick_ns(self) -> float:  # type: ignore[override]  # of others it is a constant
        """A period of its records."""
        return 1e9 / self.rate_hz

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``: all of one sensor are one driver."""
        parts = {name: one for name, one in bus.devices.items() if isinstance(one, RdtDevice)}
        channels = [NetFtChannel(name, one.component - 1, 1.0 / one.counts, one.unit) for name, one in parts.items()]
        config = next(iter(parts.values())).settings(bus.name)
        return [NetFt(bus.name, channels, partial(UdpPort.open, bus.url), bus.clock, config)]

    def parts(self, name: str) -> Mapping[str, str]:
        """See ``StreamedDevice``."""
        return {name: f"component {self.component}"}


class NetFtDevice(RdtDevice):
    """A component of a wrist sensor that sends RDT records, in the axes of the sensor; its own bias is not set.

    `rate_hz`, `counts_per_N` and `counts_per_N_m` are those on the sensor's configuration page, whose units have to be
    N and N m.
    """

    answering: ClassVar[Answering | None] = staticmethod(answering)
    new_keys: ClassVar[str] = """rate_hz = 1000                 # these three: as on its configuration page
counts_per_N = 1e6
counts_per_N_m = 1e6
"""
    kind: Literal["net_ft"]
    counts_per_N: Annotated[Positive, Field(description="*Counts per Force* of its page.")] = 1e6  # noqa: N815
    counts_per_N_m: Annotated[Positive, Field(description="*Counts per Torque* of its page.")] = 1e6  # noqa: N815

    @property
    def counts(self) -> float:
        """See ``RdtDevice``."""
        return self.counts_per_N if self.unit == "N" else self.counts_per_N_m


class OnrobotHexDevice(RdtDevice):
    """A component of an OnRobot HEX at a Compute Box, in the axes of the sensor; the box's own bias is switched off.

    A `filter` other than 0 delays it by what its maker does not publish: `delay_ms`, as measured.
    """

    new_keys: ClassVar[str] = "rate_hz = 500                  # 1000 over a whole number\n"
    kind: Literal["onrobot_hex"]
    rate_hz: Annotated[Positive, Field(description="Records a second, set at each opening: 1000 / n, n whole.")] = 500.0
    filter: Annotated[
        int, Field(ge=0, le=6, description="Of the box: 0 none, 1 to 6: 500, 150, 50, 15, 5, 1.5 Hz.")
    ] = 0

    @property
    def counts(self) -> float:
        """See ``RdtDevice``: by the maker's example."""
        return 1e4 if self.unit == "N" else 1e5

    def settings(self, name: str) -> NetFtConfig:
        """See ``BusDevice``."""
        return self._settings(NetFtConfig, set_up=onrobot_set_up(self.rate_hz, self.filter), errors=ANY_BIT)
