"""Test beds, flown by name: a packaged vehicle, and a scenario file of its name in ``hil_sim/scenario/beds``.

A bed's campaigns are files in ``beds/days`` that lie over it: ``parabolic_day1.toml``.
"""

from importlib import resources
from pathlib import Path
from typing import NamedTuple

from hil_sim.scenario.tables import ScenarioError

_FILES = Path(str(resources.files("hil_sim.scenario"))) / "beds"
VEHICLES = Path(str(resources.files("hil_sim"))).parent / "onboard" / "vehicles"


class Bed(NamedTuple):
    """A test bed."""

    vehicle: Path  # vehicle.toml
    scenario: Path  # with the tables that a scenario file of any vehicle may have


def names() -> tuple[str, ...]:
    """Names of all test beds, sorted."""
    return tuple(sorted(file.stem for file in _FILES.glob("*.toml")))


def find(name: str) -> Bed | None:
    """The test bed of a name; None where there is none."""
    return Bed(VEHICLES / name / "vehicle.toml", _FILES / f"{name}.toml") if name in names() else None


def campaigns(name: str) -> tuple[str, ...]:
    """Names of a bed's campaigns, sorted."""
    found = (_FILES / "days").glob(f"{name}_*.toml")
    return tuple(sorted(file.stem.removeprefix(f"{name}_") for file in found))


def campaign(name: str, which: str) -> Path:
    """The scenario file of a bed's campaign.

    Raises:
        ScenarioError: it has none of this name.
    """
    if which not in campaigns(name):
        having = [one for one in names() if campaigns(one)]
        flown = "; ".join(f"{one} has {', '.join(campaigns(one))}" for one in having)
        raise ScenarioError(f"{name} has no campaign {which!r}: {flown}")
    return _FILES / "days" / f"{name}_{which}.toml"
