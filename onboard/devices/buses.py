"""Base class of devices per type of bus: URLs, opening, rules for devices on one bus.

``onboard.devices.can.canopen`` has that of CAN. A serial port comes and goes with its adapter, so its device opens it,
and reports when it cannot.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Annotated, ClassVar

from pydantic import Field

from drivers import transports
from drivers.device import Device
from drivers.ports import I2cPort, PulsePort, SerialPort
from drivers.records import PULSE, SCALAR
from drivers.transports.url import parse
from onboard.devices.base import BusDevice, Clock, LoadCellDevice, OpeningBus, Problem, Surroundings
from onboard.section import Positive
from onboard.timebase.delays import Delay, on_wire_s
from onboard.timebase.specs import ChannelClock, PolledChannel

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

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        port = bus.own(transports.open_i2c(bus.url, bus.clock))
        return [device.driver(name, port) for name, device in bus.devices.items()]

    @classmethod
    def bus_problems(cls, bus: str, devices: Mapping[str, BusDevice]) -> Iterator[Problem]:
        """See ``BusDevice``."""
        by_name = {name: device.address for name, device in devices.items() if isinstance(device, I2cDevice)}
        times = Counter(by_name.values())
        for name, address in by_name.items():
            if times[address] > 1:
                yield (
                    ["device", name],
                    f"{name!r} shares its I2C address; give one the other address (AD0), or another bus",
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
