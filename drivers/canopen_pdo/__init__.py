"""CANopen devices whose process data is bound to SYNC: configured over SDO, read from TPDOs.

Sources: CiA 301 (base), CiA 402 (drives), CiA 404 (measuring devices), CiA 406 (encoders). The ``canopen`` package is
not used: its SDO client waits on a thread and the wall clock, and time here is an argument. Known limits: expedited SDO
only, one SYNC producer (``drivers.sync_pulse.generator``, or another node); an answer that is late by a whole SYNC
period is attributed to the next SYNC.
"""

from drivers.canopen_pdo.bus import CanopenBus
from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.profiles.cia402 import Cia402Config
from drivers.canopen_pdo.profiles.cia404 import Cia404Config
from drivers.canopen_pdo.profiles.cia406 import Cia406Config
from drivers.canopen_pdo.profiles.mapped_object import CanopenObjectConfig
from drivers.canopen_pdo.sync import SyncConfig

__all__ = [
    "CanopenBus",
    "CanopenObjectConfig",
    "Cia402Config",
    "Cia404Config",
    "Cia406Config",
    "GuardConfig",
    "SyncConfig",
]
