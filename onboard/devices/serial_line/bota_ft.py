"""Six-axis force-torque sensors of Bota Systems on a serial line, read with their own calibration; never zeroed."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers import transports
from drivers.bota_ft import BotaFt, BotaFtConfig
from drivers.bota_ft.device import TEMPERATURE, answering
from drivers.bota_ft.frame import FRAME_BYTES
from drivers.device import Device
from drivers.serial_line.scalars import WrenchChannel
from onboard.devices.base import Answering, OpeningBus, Problem, Surroundings
from onboard.devices.buses import ComponentDevice, PollPeriod, StreamedDevice
from onboard.section import Positive
from onboard.timebase.delays import on_wire_s

TICK_NS = 1000.0  # its frames count microseconds
BAUD = 460_800


class BotaFtDevice(StreamedDevice, ComponentDevice):
    """A component of a sensor of Bota Systems with a serial interface (SensONE, MegaONE, Rokubi), in its own axes.

    heft sets it up each time that it opens the line: calibrated numbers, `rate_hz` by its sinc filter, no other
    filter; nothing is saved in it. A status other than 0 is an event.
    """

    bus_type = "a serial line"
    urls = transports.SERIAL_URLS
    driver_configs = (BotaFtConfig,)
    tick_ns = TICK_NS
    first_row_s = 6.0  # opening the line may start it anew
    about_clock = (
        "The sensor's time stamp, fitted to the least delayed arrivals; `latency_ms` and half of `poll_period_ms` are "
        "taken off. Without `latency_ms` it is half a period, and the frame's time on the line. All components have "
        "the same times."
    )
    answering: ClassVar[Answering | None] = staticmethod(answering)
    new_bus = "tty_wrist"
    new_baud = BAUD
    new_keys: ClassVar[str] = (
        "rate_hz = 400                  # 51,200 over a whole number: 100, 200, 256, 400, 512, 800\n"
    )
    kind: Literal["bota_ft"]
    rate_hz: Positive = BotaFtConfig.rate_hz
    poll_period_ms: PollPeriod = BotaFtConfig.poll_period_ms
    silence_ms: Positive = BotaFtConfig.silence_ms
    temperature: Annotated[bool, Field(description="Whether `NAME_temperature`, degC, is recorded too.")] = False

    @property
    def delay_ns(self) -> tuple[float, float]:
        """See ``StreamedDevice``: and the frame's time on the line, where not measured."""
        delay_ns, sigma_ns = super().delay_ns
        return delay_ns + (1e9 * on_wire_s(FRAME_BYTES, BAUD) if self.latency_ms is None else 0.0), sigma_ns

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``: all of one sensor are one driver."""
        parts = {name: one for name, one in bus.devices.items() if isinstance(one, BotaFtDevice)}
        channels = [channel for name, one in parts.items() for channel in one.outputs(name)]
        config = next(iter(parts.values())).settings(bus.name)
        return [BotaFt(bus.name, channels, partial(transports.open_serial, bus.url), bus.clock, config)]

    def outputs(self, name: str) -> list[WrenchChannel]:
        """What its driver is to make rows of."""
        warm = [WrenchChannel(f"{name}_temperature", TEMPERATURE, "degC")] if self.temperature else []
        return [WrenchChannel(name, self.component - 1, self.unit), *warm]

    def parts(self, name: str) -> Mapping[str, str]:
        """See ``StreamedDevice``."""
        warm = {f"{name}_temperature": "temperature"} if self.temperature else {}
        return {name: f"component {self.component}", **warm}

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``."""
        yield from super().problems(name, around)
        if around.baud(self.bus) != BAUD:
            yield ["bus", self.bus, "url"], f"{self.bus!r}: {name!r} is set up for baud={BAUD}; write that in the URL"
