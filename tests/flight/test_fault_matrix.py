"""Every fault on every device in flight: named, contained, over when it is over, and never a confident wrong answer."""

from pathlib import Path

import pytest

from hil_sim.faults import FaultKind
from tests.flight import fault_matrix
from tests.flight.fault_matrix import EJECTION_S, Cell, Outcome, flights, others_lost, outcomes

pytestmark = pytest.mark.timeout(600)
COMMITTED = Path(__file__).resolve().parents[2] / "docs" / "faults.md"
PLACES = [(flight, place) for flight in flights() for place in range(len(flight))]


def name_of(place: object) -> str:
    if isinstance(place, tuple):
        cell = place[0][place[1]]
        when = "-ejection" if cell.start_s == EJECTION_S else ""
        return f"{cell.device}-{cell.name}-{cell.last_s:g}s{when}"
    return ""


@pytest.fixture(params=PLACES, ids=name_of)
def outcome(request: pytest.FixtureRequest) -> Outcome:
    flight, place = request.param
    found: Outcome = outcomes(flight)[place]
    return found


def test_a_fault_is_named_contained_and_over_when_it_is_over(outcome: Outcome) -> None:
    cell = outcome.cell
    assert set(cell.reported) <= set(outcome.reported)
    assert others_lost(outcome) == {}
    assert outcome.recovery_s <= cell.recovery_s
    mine = [outcome.unaccounted[channel] for channel in fault_matrix.CHANNELS[cell.device]]
    assert max(mine) <= cell.unnamed
    strangers = {name: n for name, n in outcome.unaccounted.items() if n and name not in touched(outcome)}
    assert strangers == {}
    assert "wrong" not in outcome.estimate.values()
    assert outcome.worst < 1.0  # nor at any time on the way


def touched(outcome: Outcome) -> set[str]:
    """Channels of all devices that failed in the same flight."""
    flight = next(f for f in flights() if outcome.cell in f)
    return {channel for cell in flight for channel in fault_matrix.CHANNELS[cell.device]}


def test_every_kind_that_the_vehicle_can_have_is_flown() -> None:
    elsewhere = {FaultKind.BYTE_LOSS, FaultKind.BYTE_GARBLE, FaultKind.UNPLUG, FaultKind.WHO_AM_I}  # serial; start-up
    assert {FaultKind(cell.kind) for cell in fault_matrix.CELLS} | elsewhere == set(FaultKind)
    assert len(set(fault_matrix.CELLS)) == len(fault_matrix.CELLS)
    assert all(isinstance(cell, Cell) for flight in flights() for cell in flight)


def test_the_committed_table_is_what_the_flights_give() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == fault_matrix.table()
