"""Mantracourt DSC digitiser of a load cell, on a serial line."""

from typing import Literal

from drivers.dsc_load_cell.device import DscLoadCell
from drivers.dsc_load_cell.message import DscLoadCellConfig
from onboard.devices.base import Clock
from onboard.devices.buses import OpenSerial, PolledLoadCellDevice, PollPeriod
from onboard.section import Positive

ANSWER_BYTES = 8  # at the least: a sign, six characters and CR


class DscLoadCellDevice(PolledLoadCellDevice):
    """Mantracourt DSC digitiser; ``unit`` is that of its system calibration."""

    about_clock = "As a `modbus_load_cell`."
    driver_configs = (DscLoadCellConfig,)
    new_keys = "sample_period_ms = 20\n"
    kind: Literal["dsc_load_cell"]
    station: int = DscLoadCellConfig.station
    command: str = DscLoadCellConfig.command
    unit: str = DscLoadCellConfig.unit
    timeout_ms: Positive = DscLoadCellConfig.timeout_ms
    poll_period_ms: PollPeriod = DscLoadCellConfig.poll_period_ms

    @property
    def exchange_bytes(self) -> tuple[int, int]:
        """See ``PolledLoadCellDevice``."""
        return len(f"!{self.station:03d}:{self.command}?\r"), ANSWER_BYTES

    def driver(self, name: str, open_port: OpenSerial, clock: Clock, baud: int) -> DscLoadCell:
        """See ``SerialLineDevice``."""
        return DscLoadCell(name, open_port, clock, self.settings(name))
