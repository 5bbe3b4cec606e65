"""Six-axis force-torque sensors of Robotous, RFT series, on a serial line; never zeroed."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers import transports
from drivers.device import Device
from drivers.robotous_rft import PACKET_BYTES, RftConfig, RobotousRft, answering
from drivers.serial_line.scalars import WrenchChannel
from onboard.devices.base import Answering, OpeningBus, Problem, Surroundings
from onboard.devices.buses import ComponentDevice, PollPeriod, StreamedDevice
from onboard.section import Positive
from onboard.timebase.delays import on_wire_s

# by its baud rate: manual, revision 1.8
LARGEST_HZ: dict[float, int] = {57_600: 200, 115_200: 333, 230_400: 500, 460_800: 500, 921_600: 1000}


class RobotousRftDevice(StreamedDevice, ComponentDevice):
    """A component of a Robotous RFT sensor with a serial interface (RS-232, RS-422, USB), in its own axes.

    heft sets it up each time that it opens the line: `rate_hz`, no filter, its bias off. Rate and filter are stored in
    it, and are written only where they differ. An overload is an event, and its rows are saturated.
    """

    bus_type = "a serial line"
    urls = transports.SERIAL_URLS
    driver_configs = (RftConfig,)
    first_row_s = 2.0
    about_clock = (
        "Its packets have neither number nor time: they are counted, and the count is fitted to the least delayed "
        "arrivals; `latency_ms` and half of `poll_period_ms` are taken off. Without `latency_ms` it is half a period, "
        "and the packet's time on the line. All components have the same times."
    )
    answering: ClassVar[Answering | None] = staticmethod(answering)
    new_bus = "tty_wrist"
    new_baud = 115_200
    new_keys: ClassVar[str] = """rate_hz = 200                  # 10, 20, 50, 100, 200, 333 (above: a faster line)
counts_per_N_m = 2000          # 1000: RFT64-6A01, RFT80-6A01, RFT80-6A02
"""
    kind: Literal["robotous_rft"]
    rate_hz: Annotated[
        Positive, Field(description="Packets a second: 10, 20, 50, 100, 200, 333, 500 or 1000, by its baud rate.")
    ] = RftConfig.rate_hz
    counts_per_N_m: Annotated[  # noqa: N815
        Positive, Field(description="Of its model: 2000, or 1000 (RFT64-6A01, RFT80-6A01, RFT80-6A02).")
    ] = RftConfig.counts_per_N_m
    poll_period_ms: PollPeriod = RftConfig.poll_period_ms
    silence_ms: Positive = RftConfig.silence_ms

    @property
    def tick_ns(self) -> float:  # type: ignore[override]  # of others it is a constant
        """A period of its packets."""
        return 1e9 / self.rate_hz

    def arrival_ns(self, around: Surroundings) -> tuple[float, float]:
        """See ``StreamedDevice``: and the packet's time on the line, where not measured."""
        delay_ns, sigma_ns = self.delay_ns
        on_wire_ns = 1e9 * on_wire_s(PACKET_BYTES, around.baud(self.bus))
        return delay_ns + (on_wire_ns if self.latency_ms is None else 0.0), sigma_ns

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``: all of a sensor are a single driver."""
        parts = {name: one for name, one in bus.devices.items() if isinstance(one, RobotousRftDevice)}
        channels = [WrenchChannel(name, one.component - 1, one.unit) for name, one in parts.items()]
        config = next(iter(parts.values())).settings(bus.name)
        return [RobotousRft(bus.name, channels, partial(transports.open_serial, bus.url), bus.clock, config)]

    def parts(self, name: str) -> Mapping[str, str]:
        """See ``StreamedDevice``."""
        return {name: f"component {self.component}"}

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``."""
        yield from super().problems(name, around)
        baud = around.baud(self.bus)
        if baud not in LARGEST_HZ:
            known = ", ".join(map(str, LARGEST_HZ))
            yield ["bus", self.bus, "url"], f"{self.bus!r}: {name!r} has {known} baud; write what is set in it"
        elif self.rate_hz > LARGEST_HZ[baud]:
            text = f"{name!r}: at {baud} baud it sends {LARGEST_HZ[baud]} packets a second at the most; lower rate_hz"
            yield ["device", name, "rate_hz"], text
