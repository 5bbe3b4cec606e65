"""The coded sync pulse: the line it comes on, and the code that numbers it."""

from drivers.sync_pulse.code import intervals, pulse_number, sync_numbers
from drivers.sync_pulse.device import SyncPulse, SyncPulseConfig

__all__ = ["SyncPulse", "SyncPulseConfig", "intervals", "pulse_number", "sync_numbers"]
