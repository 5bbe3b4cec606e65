"""Tables of every scenario: header, sensors, clocks, buses, devices, faults."""

from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, Field, PrivateAttr, ValidationError

from hil_sim.scenario.bus_tables import BusTable, DeviceTable
from hil_sim.scenario.sensor_tables import ClockTable, SensorTable, Table

Files = tuple[tuple[str, str], ...]  # path and text of each, laid over those before it


class Refused(NamedTuple):
    """A table that a class did not take: pydantic's error, the class, the table, and where it stands."""

    error: ValidationError
    model: type[BaseModel]
    table: dict[str, Any]
    under: tuple[str, ...] = ()


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message names the file and the key, and says what to do.

    Attributes:
        refused: tables that are wrong, for whoever says it better.
        label: of the scenario.
        files: that it was made of.
    """

    def __init__(self, message: str, refused: tuple[Refused, ...] = (), label: str = "", files: Files = ()) -> None:
        super().__init__(message)
        self.refused, self.label, self.files = refused, label, files


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
    _files: Files = PrivateAttr(default=())

    @property
    def files(self) -> Files:
        """That it was made of."""
        return self._files

    def of(self, files: Files) -> "Scenario":
        """The same, made of these files."""
        self._files = files
        return self
