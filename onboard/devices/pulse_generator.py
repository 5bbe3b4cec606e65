"""The sync line as it is driven, and SYNC sent beside it."""

from collections.abc import Iterator
from typing import Literal

from drivers import transports
from drivers.records import CAN_SYNC, PULSE
from drivers.sync_pulse.generator import PulseGenerator, PulseGeneratorConfig
from onboard.devices.base import Channels, OpeningBus, Problem, Surroundings
from onboard.devices.buses import PulseOutputDevice
from onboard.devices.can.canopen import CanDevice, sync_on
from onboard.devices.sync_pulse import MEAN_INTERVAL
from onboard.section import Positive


class PulseGeneratorDevice(PulseOutputDevice):
    """Drives the sync line by the published code, and sends SYNC with counter on the CAN bus ``sync_bus``."""

    about_clock = "None: it records when it sent. Read the line back by a `sync_pulse`."
    driver_configs = (PulseGeneratorConfig,)
    kind: Literal["pulse_generator"]
    sync_period_ms: Positive
    width_ms: Positive = PulseGeneratorConfig.width_ms
    sync_bus: str | None = None

    @property
    def nominal_hz(self) -> float:
        """Of the SYNCs, or where it sends none, of the pulses."""
        return 1e3 / self.sync_period_ms / (MEAN_INTERVAL if self.sync_bus is None else 1.0)

    def channels(self, name: str) -> Channels:
        """Pulses sent, and SYNCs sent."""
        syncs: Channels = {} if self.sync_bus is None else {f"{name}_sync": CAN_SYNC}
        return {name: PULSE, **syncs}

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``: its SYNCs go out on a CAN bus of the same period, which can be opened twice."""
        if self.sync_bus is None:
            return
        where = ["device", name, "sync_bus"]
        cans = [bus for bus in around.buses if any(isinstance(d, CanDevice) for d in around.devices_on(bus).values())]
        if self.sync_bus not in cans:
            yield where, f"no CAN bus {self.sync_bus!r} with devices; there are: {', '.join(cans) or 'none'}"
            return
        period_ms = sync_on(around, self.sync_bus)[1].period_ms
        if period_ms != self.sync_period_ms:
            text = f"bus {self.sync_bus!r} has period_ms = {period_ms:g}; give the same here"
            yield ["device", name, "sync_period_ms"], text
        if around.url(self.sync_bus).startswith("can+slcan:"):
            text = f"the adapter of bus {self.sync_bus!r} can be opened once, and its nodes are read through it"
            yield where, f"{text}; use can+socketcan"

    def settings(self, name: str) -> PulseGeneratorConfig:
        """See ``BusDevice``."""
        return self._settings(PulseGeneratorConfig, sync_name=f"{name}_sync")

    def driver(self, name: str, bus: OpeningBus) -> PulseGenerator:
        """See ``PulseOutputDevice``."""
        line = bus.own(transports.open_pulse_output(bus.url, bus.clock))
        can = None
        if self.sync_bus is not None:
            can = bus.own(transports.open_can(bus.around.url(self.sync_bus), bus.clock))
        return PulseGenerator(name, line, bus.clock, self.settings(name), can)
