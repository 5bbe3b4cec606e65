"""Pulses: the sync line as it comes in, and as it is driven."""

from typing import Any, Literal

from drivers.records import CAN_SYNC, PULSE
from drivers.sync_pulse.code import SHORTEST_INTERVAL, SYMBOLS
from drivers.sync_pulse.device import SyncPulseConfig
from drivers.sync_pulse.generator import PulseGeneratorConfig
from onboard.config.devices.base import BusDevice, BusType, Channels
from onboard.config.types import Positive

MEAN_INTERVAL = SHORTEST_INTERVAL + (SYMBOLS - 1) / 2  # between two pulses, SYNC periods


class SyncPulseDevice(BusDevice):
    """The sync pulse line; intervals between pulses are whole numbers of ``sync_period_ms``, by the published code."""

    bus_type = BusType.PULSE
    records = PULSE
    kind: Literal["sync_pulse"]
    sync_period_ms: Positive

    @property
    def nominal_hz(self) -> float:
        """Mean over the code."""
        return 1e3 / (MEAN_INTERVAL * self.sync_period_ms)

    def settings(self, name: str) -> SyncPulseConfig:
        """See ``BusDevice``."""
        return self._settings(SyncPulseConfig)


class PpsDevice(BusDevice):
    """Pulses of somebody else's clock, every ``period_ms``, without a code."""

    bus_type = BusType.PULSE
    records = PULSE
    kind: Literal["pps"]
    period_ms: Positive = 1000.0

    @property
    def nominal_hz(self) -> float:
        """Nominal."""
        return 1e3 / self.period_ms

    def settings(self, name: str) -> Any:
        """Its driver has none."""
        return None


class PulseGeneratorDevice(BusDevice):
    """Drives the sync line by the published code, and sends SYNC with counter on the CAN bus ``sync_bus``."""

    bus_type = BusType.PULSE_OUTPUT
    records = PULSE
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

    def settings(self, name: str) -> PulseGeneratorConfig:
        """See ``BusDevice``."""
        return self._settings(PulseGeneratorConfig, sync_name=f"{name}_sync")
