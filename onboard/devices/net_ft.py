"""Six-axis force-torque sensors by RDT over UDP: ATI Net F/T, Ethernet Axia and compatible ones; read, never biased."""

from collections.abc import Mapping
from functools import partial
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.device import Device
from drivers.net_ft import NetFt, NetFtChannel, NetFtConfig
from drivers.net_ft.asking import answering
from drivers.transports.network import UDP_URLS, UdpPort
from onboard.devices.base import Answering, OpeningBus
from onboard.devices.buses import ComponentDevice, PollPeriod, StreamedDevice
from onboard.section import Positive


class NetFtDevice(StreamedDevice, ComponentDevice):
    """A component of a wrist sensor that sends RDT records, in the axes of the sensor; its own bias is not set.

    `rate_hz`, `counts_per_N` and `counts_per_N_m` are those on the sensor's configuration page, whose units have to be
    N and N m.
    """

    bus_type = "UDP"
    urls = UDP_URLS
    driver_configs = (NetFtConfig,)
    about_clock = (
        "The number of the record, which counts periods of the sensor's own oscillator, fitted to the least delayed "
        "arrivals; `latency_ms` and half of `poll_period_ms` are taken off. All components have the same times."
    )
    answering: ClassVar[Answering | None] = staticmethod(answering)
    new_bus = "box"
    new_url = "udp://192.168.1.1:49152"
    new_keys: ClassVar[str] = """rate_hz = 1000                 # these three: as on its configuration page
counts_per_N = 1e6
counts_per_N_m = 1e6
"""
    kind: Literal["net_ft"]
    rate_hz: Positive = NetFtConfig.rate_hz
    poll_period_ms: PollPeriod = NetFtConfig.poll_period_ms
    silence_ms: Positive = NetFtConfig.silence_ms
    counts_per_N: Annotated[Positive, Field(description="*Counts per Force* of its page.")] = 1e6  # noqa: N815
    counts_per_N_m: Annotated[Positive, Field(description="*Counts per Torque* of its page.")] = 1e6  # noqa: N815

    @property
    def tick_ns(self) -> float:  # type: ignore[override]  # of others it is a constant
        """A period of its records."""
        return 1e9 / self.rate_hz

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``: all of one sensor are one driver."""
        parts = {name: one for name, one in bus.devices.items() if isinstance(one, NetFtDevice)}
        channels = [one.channel(name) for name, one in parts.items()]
        config = next(iter(parts.values())).settings(bus.name)
        return [NetFt(bus.name, channels, partial(UdpPort.open, bus.url), bus.clock, config)]

    def channel(self, name: str) -> NetFtChannel:
        """What its driver is to make rows of."""
        counts = self.counts_per_N if self.unit == "N" else self.counts_per_N_m
        return NetFtChannel(name, self.component - 1, 1.0 / counts, self.unit)

    def parts(self, name: str) -> Mapping[str, str]:
        """See ``StreamedDevice``."""
        return {name: f"component {self.component}"}
