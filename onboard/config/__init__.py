"""vehicle.toml to frozen objects. Units stand in the keys; a key nobody knows is refused with its line and a remedy."""

from onboard.config.devices import (
    BusDevice,
    CanopenObjectDevice,
    CanopenSyncDevice,
    Cia404Device,
    Cia406Device,
    Device,
    Mpu6050Device,
    RecordedDevice,
    RecordedImu,
    RecordedRate,
    SyncPulseDevice,
)
from onboard.config.errors import ConfigError
from onboard.config.estimation import Phases, Zero
from onboard.config.free_body import Load
from onboard.config.loader import load, packaged, parse
from onboard.config.vehicle import Vehicle

__all__ = [
    "BusDevice",
    "CanopenObjectDevice",
    "CanopenSyncDevice",
    "Cia404Device",
    "Cia406Device",
    "ConfigError",
    "Device",
    "Load",
    "Mpu6050Device",
    "Phases",
    "RecordedDevice",
    "RecordedImu",
    "RecordedRate",
    "SyncPulseDevice",
    "Vehicle",
    "Zero",
    "load",
    "packaged",
    "parse",
]
