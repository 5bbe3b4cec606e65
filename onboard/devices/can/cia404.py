"""Load cell node (CiA 404)."""

from typing import Literal

from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.profiles.cia404 import Cia404Config
from onboard.devices.base import LoadCellDevice
from onboard.devices.can.canopen import CanopenNodeDevice


class Cia404Device(CanopenNodeDevice, LoadCellDevice):
    """Load cell node (CiA 404), sampled on SYNC. ``tare``: zero it when it is first set up, unloaded."""

    driver_configs = (Cia404Config, GuardConfig)
    new_keys = "node = {number}\n"
    kind: Literal["cia404"]
    tare: bool = Cia404Config.tare

    def settings(self, name: str) -> Cia404Config:
        """See ``BusDevice``."""
        return self._settings(Cia404Config, name=name)
