"""Base class of devices per type of bus: URLs, opening, rules for devices on one bus.

``onboard.devices.can.canopen`` has that of CAN. A serial port comes and goes with its adapter, so its device opens it,
and reports when it cannot.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Annotated, ClassVar

from pydantic import Field

from drivers import transports
from drivers.device import Device
from drivers.ports import ClockedPort, I2cPort, PulsePort, SerialPort, SpiPort
from drivers.records import PULSE, SCALAR
from drivers.transports.url import parse
from onboard.devices.base import BusDevice, Channels, Clock, LoadCellDevice, OpeningBus, Problem, Surroundings
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay, on_wire_s
from onboard.timebase.timebase import ChannelClock, FollowerChannel, FreeChannel, PolledChannel

Identify = Callable[[I2cPort, int], str | None]
OpenSerial = Callable[[], SerialPort]
PollPeriod = Annotated[Positive, Field(description="How often the port is read.")]
SamplePeriod = Annotated[
    Positive, Field(description="Time between two requests; shorter than the link allows: back to back.")
]


class I2cDevice(BusDevice):
    """A device on I2C, among others, by ``address``."""

    bus_type = "I2C"
    urls = transports.I2C_URLS
    shares_bus = True
    new_bus = "i2c_1"
    addresses: ClassVar[tuple[int, ...]] = ()  # that it can have
    identify: ClassVar[Identify | None] = None  # names the chip at an address by reads alone; None: it is another
    address: int

    @property
    def places(self) -> tuple[int, ...]:
        """Addresses that it has on its bus."""
        return (self.address,)

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        port = bus.own(transports.open_i2c(bus.url, bus.clock))
        return [device.driver(name, port) for name, device in bus.devices.items()]

    @classmethod
    def bus_problems(cls, bus: str, devices: Mapping[str, BusDevice]) -> Iterator[Problem]:
        """See ``BusDevice``."""
        by_name = {name: device.places for name, device in devices.items() if isinstance(device, I2cDevice)}
        times = Counter(address for places in by_name.values() for address in places)
        for name, places in by_name.items():
            if any(times[address] > 1 for address in places):
                yield (
                    ["device", name],
                    f"{name!r} shares its I2C address; give either the other address (AD0), or another bus",
                )

    def driver(self, name: str, port: I2cPort) -> Device:
        """Its driver on an open bus."""
        raise NotImplementedError


class SerialLineDevice(BusDevice):
    """A device on a serial line of its own, whose speed and format stand in the URL of its bus."""

    bus_type = "a serial line"
    urls = transports.SERIAL_URLS
    records = SCALAR
    poll_period_ms: PollPeriod

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        baud = parse(bus.url, transports.SERIAL_URLS).integer("baud")
        open_port = partial(transports.open_serial, bus.url)
        return [device.driver(name, open_port, bus.clock, baud) for name, device in bus.devices.items()]

    def driver(self, name: str, open_port: OpenSerial, clock: Clock, baud: int) -> Device:
        """Its driver, which opens the line of ``baud`` bit/s itself; ``clock`` is CLOCK_MONOTONIC, ns."""
        raise NotImplementedError


class PolledLoadCellDevice(SerialLineDevice, LoadCellDevice):
    """A load cell polled for each sample; ``sample_period_ms`` shorter than the link allows: back to back."""

    about_clock = "The middle between request and answer, by the host's clock; half their distance is its uncertainty."
    sample_period_ms: SamplePeriod
    timeout_ms: Positive

    @property
    def exchange_bytes(self) -> tuple[int, int]:
        """Bytes of a question and, at the least, of its answer."""
        raise NotImplementedError

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        question, answer = self.exchange_bytes
        baud = around.baud(self.bus)
        clock = PolledChannel(1e9 * on_wire_s(question, baud), 1e9 * on_wire_s(answer, baud))
        return dict.fromkeys(self.channels(name), clock)

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        cause = "answer on the wire; the sample lies between it and the question's end"
        answer_ns = 1e9 * on_wire_s(self.exchange_bytes[1], around.baud(self.bus))
        on_wire = [Delay(channel, "", answer_ns * 1e-9, 0.0, cause) for channel in self.channels(name)]
        return super().delays(name, around) + on_wire


class StreamedDevice(BusDevice):
    """A part of what one instrument sends unasked; all on one bus come in the same packages, by one driver."""

    shares_bus = True
    records = SCALAR
    tick_ns: ClassVar[float]
    rate_hz: Annotated[Positive, Field(description="Packages a second.")]
    poll_period_ms: PollPeriod
    silence_ms: Annotated[Positive, Field(description="Time without a package after which it is asked anew.")]
    latency_ms: Annotated[
        NotNegative | None,
        Field(
            description="From the time stamp to the arrival of its package, as measured; half a period if not given."
        ),
    ] = None
    latency_sigma_ms: Annotated[NotNegative, Field(description="Standard deviation of `latency_ms`.")] = 0.0

    def parts(self, name: str) -> Mapping[str, str]:
        """Channels, and which part of the instrument each is."""
        raise NotImplementedError

    @classmethod
    def bus_problems(cls, bus: str, devices: Mapping[str, BusDevice]) -> Iterator[Problem]:
        """See ``BusDevice``: one driver asks for all."""
        first, leader = next(iter(devices.items()))
        taken: dict[str, str] = {}
        for name, one in devices.items():
            if isinstance(one, StreamedDevice) and isinstance(leader, StreamedDevice):
                if (one.settings(name), one.delay_ns) != (leader.settings(first), leader.delay_ns):
                    text = f"{name!r} and {first!r} share packages; give both the same rate_hz, periods and latency"
                    yield ["device", name], text
                for part in one.parts(name).values():
                    other = taken.setdefault(part, name)
                    if other != name:
                        yield ["device", name], f"{name!r} and {other!r} are {part}; give them different ones"

    @property
    def delay_ns(self) -> tuple[float, float]:
        """From time stamp to arrival, and sigma: within a period where not measured, and till the port is read."""
        period_ms = 1e3 / self.rate_hz
        latency_ms, sigma_ms = 0.5 * period_ms, period_ms / math.sqrt(12.0)
        if self.latency_ms is not None:
            latency_ms, sigma_ms = self.latency_ms, self.latency_sigma_ms
        sigma_ms = math.hypot(sigma_ms, self.poll_period_ms / math.sqrt(12.0))
        return 1e6 * (latency_ms + 0.5 * self.poll_period_ms), 1e6 * sigma_ms

    def arrival_ns(self, around: Surroundings) -> tuple[float, float]:
        """``delay_ns`` on its bus."""
        del around
        return self.delay_ns

    def channels(self, name: str) -> Channels:
        """See ``DeviceSection``."""
        return dict.fromkeys(self.parts(name), SCALAR)

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``: the first channel of the instrument leads."""
        first, leader = next(iter(around.devices_on(self.bus).items()))
        leads = next(iter(leader.channels(first)))
        clocks: dict[str, ChannelClock] = dict.fromkeys(self.channels(name), FollowerChannel(leads))
        return clocks | ({leads: FreeChannel(self.tick_ns, *self.arrival_ns(around))} if first == name else {})

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        delay_ns, sigma_ns = self.arrival_ns(around)
        cause = f"{self.bus}: from time stamp to package, and till the port is read; the same for all on it"
        known = 1e-9 * delay_ns, 1e-9 * sigma_ns, cause, self.bus
        common = [Delay(channel, "", *known) for channel in self.channels(name)]
        return [*super().delays(name, around), *common]


class ComponentDevice(LoadCellDevice):
    """A component of a six-axis sensor.

    `component`: 1 to 3 are forces, 4 to 6 moments, about `axis` of `frame`. Where a known weight reads as if it
    pulled the other way, turn `axis` round.
    """

    component: Annotated[int, Field(ge=1, le=6, description="1 to 3: force along x, y, z; 4 to 6: moment about them.")]

    @property
    def unit(self) -> str:
        """Of its rows."""
        return "N" if self.component < 4 else "N m"

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``."""
        yield from super().problems(name, around)
        if self.measures != ("force" if self.component < 4 else "moment") or self.lever_m != 1.0:
            text = "components 1 to 3 are forces, 4 to 6 moments, without lever_m"
            yield ["device", name, "measures"], f"{name!r} is component {self.component}: {text}; correct it"


class PairDevice(BusDevice):
    """A device on a clock line and a data line of its own."""

    bus_type = "a clock line and a data line"
    urls = transports.PAIR_URLS
    new_bus = "cell_lines"
    new_url = "gpio-pair:///dev/gpiochip0?data=5&clock=6"

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        port = bus.own(transports.open_pair(bus.url, bus.clock))
        return [device.driver(name, port) for name, device in bus.devices.items()]

    def driver(self, name: str, port: ClockedPort) -> Device:
        """Its driver on open lines."""
        raise NotImplementedError


class SpiDevice(BusDevice):
    """A device on SPI with a select line of its own: a bus has one."""

    bus_type = "SPI"
    urls = transports.SPI_URLS
    new_bus = "spi_{number}"
    spi_mode: ClassVar[int]  # CPOL x 2 + CPHA

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        port = bus.own(transports.open_spi(bus.url, bus.clock, cls.spi_mode))
        return [device.driver(name, port) for name, device in bus.devices.items()]

    def driver(self, name: str, port: SpiPort) -> Device:
        """Its driver on an open bus."""
        raise NotImplementedError


class PulseDevice(BusDevice):
    """It reads the edges of a line."""

    bus_type = "a pulse line"
    urls = transports.PULSE_URLS
    records = PULSE
    rate_tolerance = 0.5  # pulses come by a code, 150 to 305 ms apart

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        port = bus.own(transports.open_pulse(bus.url, bus.clock))
        return [device.driver(name, port) for name, device in bus.devices.items()]

    def driver(self, name: str, port: PulsePort) -> Device:
        """Its driver on an open line."""
        raise NotImplementedError


class PulseOutputDevice(BusDevice):
    """It drives a line."""

    bus_type = "a pulse output"
    urls = transports.PULSE_OUTPUT_URLS
    records = PULSE
    rate_tolerance = 0.5

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        return [device.driver(name, bus) for name, device in bus.devices.items()]

    def driver(self, name: str, bus: OpeningBus) -> Device:
        """Its driver, which opens what it drives."""
        raise NotImplementedError
