"""Pulses of an external clock."""

from typing import Literal

from drivers.ports import PulsePort
from drivers.sync_pulse.device import SyncPulse
from onboard.devices.buses import PulseDevice
from onboard.section import Positive
from onboard.timebase.timebase import SyncLine


class PpsDevice(PulseDevice):
    """Pulses of an external clock, every ``period_ms``, without a code."""

    about_role = "clock of all, where there is no `sync_pulse`"
    about_clock = "The kernel's; edges are identified by arrival, as they carry no code. SYNC needs the code."
    kind: Literal["pps"]
    period_ms: Positive = 1000.0

    def sync_line(self, name: str) -> SyncLine:
        """See ``DeviceSection``."""
        return SyncLine(name, self.period_ms * 1e6, coded=False)

    def driver(self, name: str, port: PulsePort) -> SyncPulse:
        """See ``PulseDevice``."""
        return SyncPulse(name, port)
