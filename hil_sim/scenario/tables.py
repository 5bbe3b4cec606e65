"""Tables of every scenario: header, sensors, clocks, buses, devices, faults."""

from typing import Annotated, Any

from pydantic import Field

from hil_sim.scenario.bus_tables import BusTable, DeviceTable
from hil_sim.scenario.sensor_tables import ClockTable, SensorTable, Table


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message names the file and the key, and says what to do."""


class ScenarioHeader(Table):
    """``[scenario]``. ``based_on``: the packaged scenario over which this one's tables lie.

    ``published``: it is a flight of which results were published, which its table shows beside.
    """

    name: str
    description: str
    based_on: str | None = None
    published: bool = False


class Scenario(Table):
    """A whole mission but for its bodies.

    ``device`` tables are read by ``hil_sim.devices``, and ``fault`` tables by ``hil_sim.faults``, where a mission is
    made of them.
    """

    scenario: ScenarioHeader
    sensor: dict[str, SensorTable]
    clock: dict[str, ClockTable]
    bus: dict[str, BusTable]
    device: Annotated[dict[str, DeviceTable], Field(min_length=1)]
    fault: tuple[dict[str, Any], ...] = ()
