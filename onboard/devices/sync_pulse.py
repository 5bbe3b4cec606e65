"""The sync line input."""

from typing import Literal

from drivers.ports import PulsePort
from drivers.sync_pulse.code import SHORTEST_INTERVAL, SYMBOLS
from drivers.sync_pulse.device import SyncPulse, SyncPulseConfig
from onboard.devices.buses import PulseDevice
from onboard.section import Positive
from onboard.timebase.timebase import SyncLine

MEAN_INTERVAL = SHORTEST_INTERVAL + (SYMBOLS - 1) / 2  # between two pulses, SYNC periods


class SyncPulseDevice(PulseDevice):
    """The sync pulse line; intervals between pulses are whole numbers of ``sync_period_ms``, by the published code."""

    about_role = "clock of all"
    about_clock = "The kernel's, CLOCK_MONOTONIC; all others are fitted to it."
    driver_configs = (SyncPulseConfig,)
    kind: Literal["sync_pulse"]
    sync_period_ms: Positive

    @property
    def nominal_hz(self) -> float:
        """Mean over the code."""
        return 1e3 / (MEAN_INTERVAL * self.sync_period_ms)

    def sync_line(self, name: str) -> SyncLine:
        """See ``DeviceSection``."""
        return SyncLine(name, self.sync_period_ms * 1e6)

    def driver(self, name: str, port: PulsePort) -> SyncPulse:
        """See ``PulseDevice``."""
        return SyncPulse(name, port)
