"""Header of a scenario, and what is raised where one cannot be used."""

from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from hil_sim.scenario.sensor_tables import Table

Files = tuple[tuple[str, str], ...]  # path and text of each, laid over those before it


class BadTable(NamedTuple):
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

    def __init__(self, message: str, refused: tuple[BadTable, ...] = (), label: str = "", files: Files = ()) -> None:
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
