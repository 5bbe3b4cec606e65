"""Encoder node (CiA 406)."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.profiles.cia406 import Cia406Config
from onboard.devices.base import JointDevice
from onboard.devices.can.canopen import CanopenNodeDevice


class Cia406Device(CanopenNodeDevice, JointDevice):
    """Encoder node (CiA 406), sampled on SYNC."""

    driver_configs = (Cia406Config, GuardConfig)
    new_keys = "node = {number}\n" + JointDevice.new_keys
    kind: Literal["cia406"]
    counts_per_revolution: Annotated[int, Field(gt=0, le=0xFFFFFFFF)]

    def settings(self, name: str) -> Cia406Config:
        """See ``BusDevice``."""
        return self._settings(Cia406Config, name=name)
