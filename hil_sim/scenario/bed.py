"""Test beds, flown by name: a packaged vehicle, and a scenario file of its name in ``hil_sim/scenario/beds``."""

from importlib import resources
from pathlib import Path
from typing import NamedTuple

_FILES = Path(str(resources.files("hil_sim.scenario"))) / "beds"
_VEHICLES = Path(str(resources.files("hil_sim"))).parent / "onboard" / "vehicles"


class Bed(NamedTuple):
    """A test bed."""

    vehicle: Path  # vehicle.toml
    scenario: Path  # with the tables that a scenario file of any vehicle may have


def names() -> tuple[str, ...]:
    """Names of all test beds, sorted."""
    return tuple(sorted(file.stem for file in _FILES.glob("*.toml")))


def find(name: str) -> Bed | None:
    """The test bed of a name; None where there is none."""
    return Bed(_VEHICLES / name / "vehicle.toml", _FILES / f"{name}.toml") if name in names() else None
