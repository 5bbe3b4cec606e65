"""Load cell transmitter on Modbus-RTU (Laumas map)."""

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.modbus_load_cell.device import ModbusLoadCell, answering
from drivers.modbus_load_cell.registers import ModbusLoadCellConfig
from drivers.records import SCALAR
from onboard.devices.base import Answering, Channels, Clock
from onboard.devices.buses import OpenSerial, PolledLoadCellDevice, PollPeriod
from onboard.section import Positive

QUESTION_BYTES, ANSWER_BYTES = 8, 21  # eight registers, 40007 to 40014


class ModbusLoadCellDevice(PolledLoadCellDevice):
    """Load cell transmitter on Modbus-RTU (Laumas map). The first of ``values`` is the force that is estimated with.

    ``scale`` and ``unit``: of a count; by the transmitter's division and unit where not given.
    """

    driver_configs = (ModbusLoadCellConfig,)
    answering: ClassVar[Answering | None] = staticmethod(answering)
    new_keys = 'address = 1\nunit = "N"\nscale = 0.001                  # N in a count\nsample_period_ms = 10\n'
    kind: Literal["modbus_load_cell"]
    address: Annotated[int, Field(ge=1, le=247)] = ModbusLoadCellConfig.address
    values: tuple[Literal["gross", "net"], ...] = ("gross",)
    scale: Annotated[
        float | None, Field(description="`unit` per count; where not given, the transmitter's division and unit.")
    ] = None
    unit: str | None = None
    sign: Literal["status", "twos_complement", "positive"] = "status"
    echo: bool = ModbusLoadCellConfig.echo
    timeout_ms: Positive = ModbusLoadCellConfig.timeout_ms
    poll_period_ms: PollPeriod = ModbusLoadCellConfig.poll_period_ms

    def channels(self, name: str) -> Channels:
        """One of the device's name, or one for each of both values."""
        single = len(self.values) == 1
        return dict.fromkeys([name] if single else [f"{name}_{value}" for value in self.values], SCALAR)

    @property
    def exchange_bytes(self) -> tuple[int, int]:
        """See ``PolledLoadCellDevice``."""
        return QUESTION_BYTES, ANSWER_BYTES

    def driver(self, name: str, open_port: OpenSerial, clock: Clock, baud: int) -> ModbusLoadCell:
        """See ``SerialLineDevice``. The bit rate decides the silence between frames."""
        return ModbusLoadCell(name, open_port, clock, replace(self.settings(name), baud=baud))
