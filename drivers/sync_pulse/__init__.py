"""The coded sync pulse: input device, published code, generator."""

from drivers.sync_pulse.code import intervals, sync_numbers
from drivers.sync_pulse.device import SyncPulse, SyncPulseConfig
from drivers.sync_pulse.generator import PulseGenerator, PulseGeneratorConfig, PulseSchedule

__all__ = [
    "PulseGenerator",
    "PulseGeneratorConfig",
    "PulseSchedule",
    "SyncPulse",
    "SyncPulseConfig",
    "intervals",
    "sync_numbers",
]
